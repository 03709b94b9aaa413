"""What stays the same while the field changes: shells, loads, energies, limits and curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import (
    ANGLES,
    MaterialSettings,
    OptimizeSettings,
    PatternSettings,
    controlled_angles,
    passive_stiffness,
)
from hilbrace.domain.domain import Domain, RimBand
from hilbrace.domain.rim import rim_band
from hilbrace.field import Field, build_field
from hilbrace.material.curves import Microstructures, load_microstructures
from hilbrace.material.neo_hookean import worst_energy_density
from hilbrace.material.segmentation import Method
from hilbrace.material.strut_width import cell_scale, map_length, maximum_width, minimum_width
from hilbrace.optimize.joint_response import FLEXION, JointMotion, joint_motion
from hilbrace.optimize.task_checks import check_loaded, check_moves
from hilbrace.shell import (
    LoadPattern,
    ShellFamily,
    ShellModel,
    build_shell,
    geometry_mode,
    joint_line_shares,
    lay_on_skin,
    pose_shell,
    shell_family,
    skin,
)

Array = np.ndarray

POSTURE_STEP, POSTURE_GAP = np.deg2rad(30.0), np.deg2rad(15.0)
"""Postures are taken every so many degrees of flexion; two that are closer than the second are one [rad]."""


@dataclass(frozen=True)
class Posture:
    """A shape in which the brace's stiffness is evaluated.

    Attributes:
        flexion: Flexion of the joint [rad].
        shell: The shell in this shape, free of stress.
        axes: Unit axes of flexion, adduction, rotation in the brace's frame [-].
    """

    flexion: float
    shell: ShellModel
    axes: Float[Array, "3 3"]


@dataclass(frozen=True)
class Place:
    """Where the field is sampled, and how its widths translate there.

    Attributes:
        field: The field at these points.
        mm_per_uv: Length of one unit of the flat map [mm].
    """

    field: Field
    mm_per_uv: Float[Tensor, " point"]


@dataclass(frozen=True)
class Problem:
    """One design task.

    Attributes:
        domain: The brace's surface.
        triangles: The field at triangle centres.
        vertices: The field at the cut vertices.
        areas: Areas of the triangles [mm^2].
        rim: Triangles that stay solid.
        cells: Curves of the two microstructures.
        solid_modulus: Young's modulus of the rubber [MPa].
        poisson: Its Poisson's ratio [-].
        scale: Period of the cells in the flat map, closed around the limb.
        limits: Narrowest strut and narrowest slit [mm].
        blend_mm: Width of the transition from firm to soft [mm].
        unit_energy: Worst elastic energy density over the motion for unit modulus [-].
        segmentation: How firm and soft are told apart by it.
        motion: The joint's motion.
        preserve: Columns of the angles to keep.
        prevent: Columns of the angles to bring to zero.
        postures: Shapes for the stiffness, flexion rising; the rest shape is one of them.
        shapes: Shapes in which the frames' loads act.
        load: Acting force of every frame.
        settings: The optimizer's settings.
        sharpness: Slope of the field's projection; a schedule of the loop may raise it [-].
    """

    domain: Domain
    triangles: Place
    vertices: Place
    areas: Float[Tensor, " triangle"]
    rim: Bool[Tensor, " triangle"]
    cells: Microstructures
    solid_modulus: float
    poisson: float
    scale: float
    limits: tuple[float, float]
    blend_mm: float
    unit_energy: Float[Tensor, " triangle"]
    segmentation: Method
    motion: JointMotion
    preserve: tuple[int, ...]
    prevent: tuple[int, ...]
    postures: tuple[Posture, ...]
    shapes: ShellFamily
    load: LoadPattern
    settings: OptimizeSettings
    sharpness: float = 1.0

    @property
    def rest_posture(self) -> int:
        """Place of the rest shape among the postures."""
        return next(k for k, posture in enumerate(self.postures) if posture.flexion == 0.0)


def build_problem(
    loads: JointLoads,
    domain: Domain,
    settings: OptimizeSettings,
    material: MaterialSettings,
    pattern: PatternSettings,
) -> Problem:
    """Prepare a design task.

    Args:
        loads: Kinematics and loads of the joints.
        domain: The brace's surface and its motion.
        settings: The optimizer's settings.
        material: The rubber and its microstructures.
        pattern: Scale, limits of casting and rims.

    Raises:
        InputError: The motion moves no angle that is to be preserved, or loads the joint in no frame though
            the design asks for its load.
    """
    length = map_length(domain.vertices, domain.triangles, domain.uv, domain.cut_triangles)
    corner_uv = domain.uv[domain.cut_triangles]
    rest = build_shell(
        domain.vertices,
        domain.triangles,
        domain.upper_loop,
        domain.lower_loop,
        material.thickness_mm,
        material.poisson,
    )
    edges = domain.vertices[domain.triangles]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]), axis=1)
    band: RimBand = rim_band(domain, pattern.rim_mm)
    kind = domain.joint.split("_")[0]
    preserve, prevent = controlled_angles(settings, kind)
    passive = passive_stiffness(settings, kind)
    motion = joint_motion(loads, domain.joint, passive, settings.muscle_stiffness)
    kept = [ANGLES[kind].index(name) for name in preserve]
    check_moves(motion.angles[:, kept].numpy(), preserve, domain.joint)
    return Problem(
        domain=domain,
        triangles=_place(corner_uv.mean(axis=1), length, settings, domain),
        vertices=_place(domain.uv, _at_cut_vertices(length, domain), settings, domain),
        areas=torch.from_numpy(areas),
        rim=torch.from_numpy(band.triangles),
        cells=load_microstructures(soft=material.soft, firm=material.firm),
        solid_modulus=material.youngs_modulus_mpa,
        poisson=material.poisson,
        scale=cell_scale(pattern, domain),
        limits=(pattern.min_strut_mm, pattern.min_slit_mm),
        blend_mm=pattern.blend_mm,
        unit_energy=torch.from_numpy(
            worst_energy_density(domain.deformation, material.poisson, material.lame)
        ),
        segmentation=material.segmentation,
        motion=motion,
        preserve=tuple(kept),
        prevent=tuple(map(ANGLES[kind].index, prevent)),
        postures=_postures(loads, domain, rest),
        shapes=_shapes(domain, rest, settings),
        load=_load(loads, domain, settings),
        settings=settings,
    )


def width_limits(
    problem: Problem, place: Place, firm: Float[Tensor, " point"]
) -> tuple[Float[Tensor, " point"], Float[Tensor, " point"]]:
    """Range of the design variable in which struts and slits can be cast, at each point.

    Args:
        problem: The design task.
        place: The points.
        firm: Firm fraction at the points.
    """
    strut, slit = problem.limits
    cells = problem.cells
    low = cells.design_variable(minimum_width(strut, problem.scale, place.mm_per_uv), firm).clamp(0.0, 0.9)
    pinch = cells.pinch_width(firm)
    high = cells.design_variable(maximum_width(pinch, slit, problem.scale, place.mm_per_uv), firm)
    return low, torch.maximum(high.clamp(max=1.0), low + 0.1)


def _place(points: Array, mm_per_uv: Array, settings: OptimizeSettings, domain: Domain) -> Place:
    """Sample the field there, the middle of the map in the middle of the neurons.

    The field then sees the map of a mirrored limb, in which u runs the other way, as its mirror image.
    """
    ends = domain.uv[:, 0].min() + domain.uv[:, 0].max()
    offset = np.array([0.5 * ((domain.period_u or 1.0) - ends), 0.0])
    return Place(build_field(points + offset, settings, domain.period_u), torch.from_numpy(mm_per_uv))


def _at_cut_vertices(values: Float[Array, " triangle"], domain: Domain) -> Float[Array, " cut_vertex"]:
    corners = domain.cut_triangles.ravel()
    count = len(domain.uv)
    return np.bincount(corners, np.repeat(values, 3), count) / np.bincount(corners, minlength=count)


def _postures(loads: JointLoads, domain: Domain, rest: ShellModel) -> tuple[Posture, ...]:
    """The rest shape, shapes at even steps of flexion and the shapes bent furthest to both sides."""
    joint = loads.joints.index(domain.joint)
    frames = np.array([int(np.argmin(np.abs(loads.time - instant))) for instant in domain.time])
    flexion = loads.angles[frames, joint, FLEXION]
    axes = loads.joint_axes[:, joint]
    postures = [Posture(0.0, rest, _unit(axes.mean(axis=0)))]
    steps = np.arange(np.ceil(flexion.min() / POSTURE_STEP), flexion.max() / POSTURE_STEP) * POSTURE_STEP
    nearest = [int(np.abs(flexion - step).argmin()) for step in steps]
    for kept in (int(flexion.argmax()), int(flexion.argmin()), *nearest):
        if min(abs(flexion[kept] - posture.flexion) for posture in postures) > POSTURE_GAP:
            shell = pose_shell(rest, domain.posed[kept])
            postures.append(Posture(float(flexion[kept]), shell, axes[frames[kept]]))
    return tuple(sorted(postures, key=lambda posture: posture.flexion))


def _shapes(domain: Domain, rest: ShellModel, settings: OptimizeSettings) -> ShellFamily:
    """Shapes for the loads of the frames, borne by the skin if it is to bear."""
    if settings.skin_n_per_mm3 > 0:
        rest = lay_on_skin(rest, skin(domain.vertices, settings.skin_n_per_mm3))
    return shell_family(rest, domain.posed, geometry_mode(settings.geometry), torch.get_num_threads())


def _unit(axes: Float[Array, "axis 3"]) -> Float[Array, "axis 3"]:
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _load(loads: JointLoads, domain: Domain, settings: OptimizeSettings) -> LoadPattern:
    joint = loads.joints.index(domain.joint)
    force = np.stack(
        [np.interp(domain.time, loads.time, loads.acting_force[:, joint, axis]) for axis in range(3)], axis=1
    )
    if settings.coupling == "paper" or settings.weights.compliance > 0.0:
        check_loaded(force, domain.joint)
    shares = joint_line_shares(domain.vertices, domain.triangles, settings.load_window_mm)
    return LoadPattern(shares, torch.from_numpy(settings.load_share * force))


def seam_pairs(domain: Domain) -> Int[Tensor, "pair 2"]:
    """The seam's pairs as a tensor."""
    return torch.from_numpy(np.asarray(domain.seam_pairs, dtype=np.int64))
