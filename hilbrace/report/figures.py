"""The report's pictures; each function draws one."""

from __future__ import annotations

import matplotlib

matplotlib.use("Agg")

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from scipy.spatial import KDTree

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.body.body import Body
from hilbrace.body.posing import posed_skin
from hilbrace.config import ANGLES
from hilbrace.domain.domain import Domain
from hilbrace.motion.trial import Trial
from hilbrace.optimize.design import Design
from hilbrace.pattern.pattern import Solid
from hilbrace.pattern.picture import strut_width_colours
from hilbrace.report.paint import BACK, FRONT, LEFT, RIGHT, SKIN, Colours, paint, screen_axes
from hilbrace.units import GRAVITY, MM_PER_M

Array = np.ndarray

INK = "#22313f"
FIRM = np.array([0.16, 0.50, 0.40])
SOFT = np.array([0.93, 0.60, 0.28])
BRACE = (0.36, 0.55, 0.72)
SERIES = ("#2a6f97", "#c8553d", "#588157", "#8a6fae", "#b08900", INK)
UNIFORM = "#9aa5ad"
FIELD = "viridis"

ROUND = -0.3
"""How far pictures of the solid go round the limb's outline, so that struts across it stay whole [-]."""

MUSCLES = {
    "bflh": "biceps femoris, long head",
    "bfsh": "biceps femoris, short head",
    "edl": "extensor digitorum longus",
    "ehl": "extensor hallucis longus",
    "fdl": "flexor digitorum longus",
    "fhl": "flexor hallucis longus",
    "gaslat": "gastrocnemius lateralis",
    "gasmed": "gastrocnemius medialis",
    "grac": "gracilis",
    "perbrev": "peroneus brevis",
    "perlong": "peroneus longus",
    "recfem": "rectus femoris",
    "sart": "sartorius",
    "semimem": "semimembranosus",
    "semiten": "semitendinosus",
    "soleus": "soleus",
    "tfl": "tensor fasciae latae",
    "tibant": "tibialis anterior",
    "tibpost": "tibialis posterior",
    "vasint": "vastus intermedius",
    "vaslat": "vastus lateralis",
    "vasmed": "vastus medialis",
}
"""Muscles across knee and ankle by their names in the built-in model."""


def key_frames(trial: Trial, body: Body, loads: JointLoads, joint: str) -> Figure:
    """The body at the motion's key frames, with the ground's force on each foot."""
    frames = key_instants(loads, joint)
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    axes = figure.add_subplot()
    skin = posed_skin(body, loads.coordinate_names, loads.coordinates[frames])
    colours = np.broadcast_to(SKIN, (len(body.triangles), 3))
    spacing = 0.95
    towards = (0.72, 0.12, 0.69 if joint.endswith("_r") else -0.69)
    for place, (frame, vertices) in enumerate(zip(frames, skin, strict=True)):
        centre = np.array([vertices[:, 0].mean(), 0.0, vertices[:, 2].mean()])
        paint(axes, vertices - centre, body.triangles, colours, towards, shift=(place * spacing, 0.0))
        _ground_forces(axes, trial, frame, centre, towards, place * spacing)
        axes.text(
            place * spacing, -0.22, f"{loads.time[frame]:.2f} s", ha="center", va="top", color=INK, fontsize=9
        )
    axes.autoscale_view()
    axes.axhline(0.0, color=INK, linewidth=0.6, zorder=0)
    return figure


def key_instants(loads: JointLoads, joint: str, count: int = 6) -> list[int]:
    """Frames that tell the motion: peak force, highest pelvis, peak flexion, the ends, wide gaps halved."""
    index, last = loads.joints.index(joint), len(loads.time) - 1
    force = np.linalg.norm(loads.acting_force[:, index], axis=1)
    height = [loads.coordinates[:, k] for k, name in enumerate(loads.coordinate_names) if name == "pelvis_ty"]
    peaks = (force, *height, loads.angles[:, index, 0])
    wanted = [*(int(np.argmax(values)) for values in peaks), 0, last]
    frames: list[int] = []
    for frame in wanted:
        if all(abs(frame - kept) > 0.08 * last for kept in frames):
            frames.append(frame)
    while len(frames) < min(count, last + 1):
        ordered = sorted({0, last, *frames})
        gaps = np.diff(ordered)
        widest = int(np.argmax(gaps))
        frames.append(ordered[widest] + max(1, int(gaps[widest]) // 2))
    return sorted(set(frames))


def ground_reactions(trial: Trial) -> Figure:
    """Vertical ground reaction of each foot in body weights."""
    figure, axes = _plot("vertical ground reaction [BW]")
    weight = trial.mass_kg * GRAVITY
    for foot, name in enumerate(trial.feet):
        axes.plot(trial.time, trial.ground_force[:, foot, 1] / weight, color=SERIES[foot], label=name)
    axes.legend(frameon=False)
    return figure


def joint_angles(loads: JointLoads, joint: str) -> Figure:
    """The angles of the braced joint: three of a knee, two of an ankle."""
    figure, axes = _plot("angle [deg]")
    angles = np.rad2deg(loads.angles[:, loads.joints.index(joint)])
    for column, name in enumerate(ANGLES[joint.split("_")[0]]):
        axes.plot(loads.time, angles[:, column], color=SERIES[column], label=name)
    axes.legend(frameon=False)
    return figure


def acting_force(loads: JointLoads, joint: str) -> Figure:
    """The acting force across the joint in body weights, in the frame of the distal segment."""
    figure, axes = _plot("acting force [BW]")
    force = loads.acting_force[:, loads.joints.index(joint)] / (loads.body_mass_kg * GRAVITY)
    for column, name in enumerate(("anterior", "proximal", "to the right")):
        axes.plot(loads.time, force[:, column], color=SERIES[column], label=name)
    axes.plot(loads.time, np.linalg.norm(force, axis=1), color=INK, linewidth=2.0, label="magnitude")
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def contact_force(loads: JointLoads, joint: str) -> Figure:
    """What the bones press on each other, its compartments, and the muscles that press them together.

    Empty but for a sentence where the model has no muscles.
    """
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    index, weight = loads.joints.index(joint), loads.body_mass_kg * GRAVITY
    left, right = (figure.add_subplot(1, 2, place + 1) for place in (0, 1))
    for axes, label in ((left, "contact force [BW]"), (right, "muscle force [BW]")):
        axes.set(xlabel="time [s]", ylabel=label)
        _quiet(axes)
    force = loads.contact_force[:, index]
    if not np.isfinite(force).any():
        left.text(0.5, 0.5, "the model has no muscles here", ha="center", transform=left.transAxes, color=INK)
        return figure
    left.plot(loads.time, np.linalg.norm(force, axis=1) / weight, color=INK, linewidth=2.0, label="magnitude")
    compartments = (("medial", loads.contact_medial), ("lateral", loads.contact_lateral))
    for column, (name, values) in enumerate(compartments):
        if np.isfinite(values[:, index]).any():
            left.plot(loads.time, values[:, index] / weight, color=SERIES[column], label=name)
    net = np.linalg.norm(loads.acting_force[:, index], axis=1) / weight
    left.plot(loads.time, net, color=UNIFORM, linestyle="--", label="acting force")
    left.legend(frameon=False, fontsize=8)
    for column, (name, tension) in enumerate(_strongest(loads, index, count=6)):
        right.plot(loads.time, tension / weight, color=SERIES[column % len(SERIES)], label=name)
    right.legend(frameon=False, fontsize=8, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def _strongest(loads: JointLoads, joint: int, count: int) -> list[tuple[str, Float[np.ndarray, " frame"]]]:
    """Muscles across a joint with the largest peaks, largest first."""
    across = np.abs(loads.muscle_pull[:, joint]).max(axis=(0, 2), initial=0.0) > 0.0
    peaks = np.where(across, loads.muscle_force.max(axis=0, initial=0.0), -1.0)
    order = [k for k in np.argsort(-peaks, kind="stable")[:count] if peaks[k] >= 0.0]
    return [(_in_words(loads.muscle_names[k]), loads.muscle_force[:, k]) for k in order]


def _in_words(muscle: str) -> str:
    """The anatomical name of a muscle of the built-in model; others keep their own."""
    return MUSCLES.get(muscle.removesuffix("_l").removesuffix("_r"), muscle)


def field_on_leg(domain: Domain, design: Design) -> Figure:
    """The design variable on the brace's surface from four sides."""
    norm = Normalize(0.0, 1.0)
    colours = colormaps[FIELD](norm(design.d_triangle))[:, :3]
    figure = _four_sides(domain.vertices, domain.triangles, colours, domain.joint)
    bar = figure.colorbar(ScalarMappable(norm, FIELD), ax=figure.axes, shrink=0.8, pad=0.01)
    bar.set_label("design variable d [-]")
    return figure


def soft_and_firm(domain: Domain, design: Design) -> Figure:
    """Where the firm (green) and the soft (orange) microstructure go."""
    share = design.firm_triangle[:, None]
    return _four_sides(domain.vertices, domain.triangles, share * FIRM + (1 - share) * SOFT, domain.joint)


def flat_map(domain: Domain, design: Design) -> Figure:
    """The design variable in the flat domain, and the boundary of soft and firm."""
    figure = Figure(figsize=(5.4, 4.6), layout="constrained")
    axes = figure.add_subplot()
    mesh = Triangulation(domain.uv[:, 0], domain.uv[:, 1], domain.cut_triangles)
    image = axes.tripcolor(mesh, design.d_triangle, cmap=FIELD, vmin=0, vmax=1, rasterized=True)
    firm = design.firm_vertex[domain.weld]
    if firm.min() < 0.5 < firm.max():
        axes.tricontour(mesh, firm, levels=[0.5], colors="white", linewidths=1.2)
    axes.set(xlabel="u [-]", ylabel="v [-]", aspect="equal")
    figure.colorbar(image, ax=axes, label="design variable d [-]", shrink=0.85)
    _quiet(axes)
    return figure


def losses(design: Design) -> Figure:
    """Normalised losses over the iterations."""
    figure, axes = _plot("loss, normalised [-]", xlabel="iteration")
    labels = ("L1 joint stability", "L2 elastic energy", "L3 compliance", "L4 volume", "L5 seam", "total")
    for column, label in enumerate(labels):
        width = 2.2 if label == "total" else 1.2
        axes.plot(design.history[:, column], color=SERIES[column], linewidth=width, label=label)
    axes.legend(frameon=False, ncols=2, fontsize=8)
    return figure


def stiffness(design: Design, joint: str) -> Figure:
    """Brace stiffness against flexion, beside the uniform design of the same volume."""
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    flexion = np.rad2deg(design.stiffness_flexions)
    kind = joint.split("_")[0]
    planes = ((1, "what it gives: frontal stiffness"), (0, "what it costs: sagittal stiffness"))
    for place, (column, name) in enumerate(planes):
        axes = figure.add_subplot(1, 2, place + 1)
        own, plain = design.stiffness_posed[:, column], design.stiffness_posed_uniform[:, column]
        axes.plot(flexion, plain, "o--", color=UNIFORM, label="uniform, same volume")
        axes.plot(flexion, own, "o-", color=SERIES[place], label="optimized")
        axes.set(xlabel=f"{kind} {ANGLES[kind][0]} [deg]", ylabel="stiffness [N*m/deg]")
        axes.set_title(name, fontsize=10, color=INK)
        axes.set_ylim(bottom=0)
        axes.legend(frameon=False)
        _quiet(axes)
    return figure


def flexion_moment(design: Design, joint: str) -> Figure:
    """Moment of the brace against flexion along the motion, free on the skin and stuck to it."""
    figure = Figure(figsize=(8.6, 3.2), layout="constrained")
    flexion = np.rad2deg(design.moment_flexions)
    kind = joint.split("_")[0]
    limits = (("sliding on the skin", design.moment_free), ("stuck to the skin", design.moment_held))
    for place, (name, moment) in enumerate(limits):
        axes = figure.add_subplot(1, 2, place + 1)
        axes.plot(flexion, moment[1], "--", color=UNIFORM, label="uniform, same volume")
        axes.plot(flexion, moment[0], color=SERIES[1], label="optimized")
        axes.set(xlabel=f"{kind} {ANGLES[kind][0]} [deg]", ylabel="moment against flexion [N*m]")
        axes.set_title(name, fontsize=10, color=INK)
        axes.legend(frameon=False)
        _quiet(axes)
    return figure


def predicted_change(domain: Domain, design: Design) -> Figure:
    """What the model predicts the brace does to the angles."""
    figure, axes = _plot("predicted change of angle [deg]")
    change = np.rad2deg(design.angle_change)
    for column, name in enumerate(ANGLES[domain.joint.split("_")[0]]):
        axes.plot(domain.time, change[:, column], color=SERIES[column], label=name)
    axes.legend(frameon=False)
    return figure


def solid(brace: Solid, domain: Domain) -> Figure:
    """The solid from four sides, the far side left out so that the pattern can be seen."""
    outward = _outward(brace, domain)
    return _four_sides(brace.vertices, brace.triangles, BRACE, domain.joint, outward)


def strut_widths(brace: Solid, domain: Domain, min_strut_mm: float) -> Figure:
    """Width of the struts from four sides, dark at the least that can be cast."""
    colours = strut_width_colours(brace, min_strut_mm)
    return _four_sides(brace.vertices, brace.triangles, colours, domain.joint, _outward(brace, domain))


def brace_on_body(brace: Solid, body: Body, domain: Domain) -> Figure:
    """The solid on the standing body, the whole figure and the braced joint from front and back."""
    figure = Figure(figsize=(8.6, 4.6), layout="constrained")
    joint, outward = domain.joint, _outward(brace, domain)
    centre = body.joint_centres[body.joint_names.index(joint)]
    skin = (body.vertices - centre) * MM_PER_M
    outer = 0.8 if joint.endswith("_r") else -0.8
    front, back = (0.8, 0.1, outer), (-0.9, 0.1, outer)
    for place, (towards, reach) in enumerate(((front, None), (front, 330.0), (back, 330.0))):
        axes = figure.add_subplot(1, 3, place + 1)
        paint(axes, skin, body.triangles, SKIN, towards)
        paint(axes, brace.vertices, brace.triangles[_near_side(outward, towards)], BRACE, towards)
        if reach is not None:
            axes.set(xlim=(-0.7 * reach, 0.7 * reach), ylim=(-reach, reach))
    return figure


def _outward(brace: Solid, domain: Domain) -> Float[Array, "triangle 3"]:
    """Outward normal of the limb under each triangle of the solid [-]."""
    limb = trimesh.Trimesh(domain.vertices, domain.triangles, process=False)
    _, below = KDTree(domain.vertices).query(brace.vertices[brace.triangles].mean(axis=1))
    return limb.vertex_normals[below]


def _near_side(
    outward: Float[Array, "triangle 3"], towards: tuple[float, float, float], least: float = 0.0
) -> Bool[Array, " triangle"]:
    """Triangles on the camera's side of the limb, which hides the others; below zero a little round it."""
    return outward @ screen_axes(towards)[2] > least


def _four_sides(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    colours: Colours,
    joint: str,
    outward: Float[Array, "triangle 3"] | None = None,
) -> Figure:
    """The same from front, lateral, back and medial; only the near side where ``outward`` tells it."""
    outer, inner = (RIGHT, LEFT) if joint.endswith("_r") else (LEFT, RIGHT)
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    views = (("front", FRONT), ("lateral", outer), ("back", BACK), ("medial", inner))
    for place, (name, towards) in enumerate(views):
        axes = figure.add_subplot(1, 4, place + 1)
        near = np.ones(len(triangles), bool) if outward is None else _near_side(outward, towards, ROUND)
        tones = colours[near] if isinstance(colours, np.ndarray) else colours
        paint(axes, vertices, triangles[near], tones, towards)
        axes.set_title(name, fontsize=9, color=INK)
    return figure


def _ground_forces(
    axes: Axes,
    trial: Trial,
    frame: int,
    centre: Float[Array, "3"],
    towards: tuple[float, float, float],
    shift: float,
) -> None:
    right, up, _ = screen_axes(towards)
    scale = 0.45 / (trial.mass_kg * GRAVITY)
    for foot in range(len(trial.feet)):
        force = trial.ground_force[frame, foot]
        if force[1] <= 0:
            continue
        start = trial.centre_of_pressure[frame, foot] - centre
        end = start + scale * force
        tip, tail = (end @ right + shift, end @ up), (start @ right + shift, start @ up)
        axes.annotate(
            "", tip, tail, arrowprops={"arrowstyle": "-|>", "color": SERIES[1], "linewidth": 1.8}, zorder=5
        )


def _plot(ylabel: str, xlabel: str = "time [s]") -> tuple[Figure, Axes]:
    figure = Figure(figsize=(5.4, 3.0), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xlabel=xlabel, ylabel=ylabel)
    _quiet(axes)
    return figure, axes


def _quiet(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e3e8eb", linewidth=0.6)
    axes.set_axisbelow(True)
