"""The report of a fitted scan that a clinician can read: a page, a picture and a coloured mesh."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import jinja2
import matplotlib
import numpy as np
import trimesh
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from hilbrace.run.records import write_atomic
from hilbrace.scan.deviation import GOOD_95, GOOD_COVER, GOOD_MEAN, NEAR, Deviation, girths
from hilbrace.scan.free_form import FittedSkin
from hilbrace.scan.surface_scan import SurfaceScan, describe_holes
from hilbrace.units import MM_PER_M

Array = np.ndarray

SCALE_MM = 3.0
"""Distance that is drawn in the last colour [mm]."""
UNSEEN = 0.8
"""Grey of skin that was not scanned, and of points that belong to something else."""
_VIEWS = (("front", (1.0, 0.0)), ("right", (0.0, 1.0)), ("back", (-1.0, 0.0)), ("left", (0.0, -1.0)))
_PALETTE = "RdYlBu_r"
_LEGS = {"l": "left leg", "r": "right leg"}
_ANGLE_WORDS = {
    "hip_flexion": "hip flexion",
    "hip_adduction": "hip adduction",
    "hip_rotation": "hip rotation inwards",
    "knee_angle": "knee flexion",
    "knee_adduction": "knee adduction",
    "knee_rotation": "knee rotation inwards",
    "ankle_angle": "ankle dorsiflexion",
    "subtalar_angle": "foot inversion",
}


def report_figures(skin: FittedSkin, scan: SurfaceScan, found: Deviation) -> dict[str, object]:
    """All figures of a fit, unit in each key."""
    return {
        "mean_mm": found.mean_mm,
        "p95_mm": found.p95_mm,
        "max_mm": found.max_mm,
        "max_where": found.worst,
        "model_mean_mm": found.model_mean_mm,
        "knee_region_seen": found.cover,
        "points": len(scan.points),
        "points_elsewhere": found.elsewhere,
        "dropped": scan.dropped,
        "unit": scan.unit,
        "holes_mm": [hole.width * MM_PER_M for hole in scan.gaps],
        "foot_seen": skin.fit.foot,
        "angles_deg": skin.fit.angles_deg,
        "girths_mm": girths(skin),
        "good_enough": not found.doubts,
        "doubts": found.doubts,
    }


def write_report(
    skin: FittedSkin, scan: SurfaceScan, found: Deviation, doubts: list[str], folder: Path
) -> None:
    """Write ``report.html``, ``deviation.png``, ``deviation.glb`` and ``fitted.ply`` (mm, as scanned).

    Args:
        skin: The fitted skin.
        scan: The scan.
        found: Distances between them.
        doubts: What speaks against a design on it.
        folder: Where to write.
    """
    picture = deviation_picture(skin, scan, found)
    write_atomic(folder / "deviation.png", picture)
    write_atomic(folder / "deviation.glb", _coloured_mesh(skin, scan, found))
    fitted = trimesh.Trimesh(skin.vertices * MM_PER_M, skin.triangles, process=False)
    write_atomic(folder / "fitted.ply", _bytes(fitted.export(file_type="ply")))
    loader = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True
    )
    page = loader.get_template("deviation.html.j2").render(
        name=Path(scan.where).name,
        points=f"{len(scan.points):,}",
        unit=f"file in {scan.unit}",
        legs=" and ".join(_LEGS[side] for side in skin.fit.limb.sides),
        good=not doubts,
        doubts=doubts,
        mean=found.mean_mm,
        p95=found.p95_mm,
        largest=found.max_mm,
        worst=found.worst,
        cover=100.0 * found.cover,
        picture=base64.b64encode(picture).decode(),
        interactive=True,
        girths=girths(skin),
        angles=_angles_in_words(skin),
        limits=(GOOD_MEAN, GOOD_95, 100.0 * GOOD_COVER),
        foot=skin.fit.foot,
        holes=describe_holes(scan),
        dropped=scan.dropped,
        model=skin.body.model,
        model_mean=found.model_mean_mm,
    )
    write_atomic(folder / "report.html", page.encode())


def _angles_in_words(skin: FittedSkin) -> dict[str, float]:
    """Angles that were fitted, in words [deg]; of one leg the pelvis is not seen, nor any hip's angle."""
    words = {}
    for name, angle in skin.fit.angles_deg.items():
        kind, side = name[:-2], name[-1]
        hidden = kind.startswith("hip") and len(skin.fit.limb.sides) == 1
        if not hidden and (skin.fit.foot or kind not in ("ankle_angle", "subtalar_angle")):
            words[f"{_ANGLE_WORDS[kind]}, {_LEGS[side]}"] = angle
    return words


def deviation_picture(skin: FittedSkin, scan: SurfaceScan, found: Deviation) -> bytes:
    """Four views of the fitted skin, coloured by how far the scan lies from it; PNG. Grey was not scanned."""
    upright = (skin.vertices - skin.fit.pose.translation) @ skin.fit.pose.rotation * MM_PER_M
    corners = upright[skin.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    colours = _triangle_colours(skin, scan, found)
    middle, reach = (upright.min(axis=0) + upright.max(axis=0)) / 2.0, np.ptp(upright, axis=0).max() / 2.0
    wide = np.abs((upright - middle)[:, [0, 2]]).max() + 5.0
    figure = Figure(figsize=(11.0, 7.4), dpi=110, layout="constrained")
    panels = figure.subplots(1, len(_VIEWS))
    for axes, (title, (ahead, right)) in zip(panels, _titled_views(skin), strict=True):
        camera = np.array([ahead, 0.0, right])
        across = np.cross([0.0, 1.0, 0.0], camera)
        order = np.argsort(corners.mean(axis=1) @ camera)
        order = order[normals[order] @ camera > 0.0]
        light = 0.72 + 0.28 * (normals[order] @ camera)
        drawn = np.stack([corners[order] @ across, corners[order][:, :, 1]], axis=-1)
        shaded = np.clip(colours[order] * light[:, None], 0.0, 1.0)
        axes.add_collection(PolyCollection(list(drawn), facecolors=shaded, edgecolors=shaded, linewidths=0.3))
        axes.set_xlim(middle @ across - wide, middle @ across + wide)
        axes.set_ylim(middle[1] - reach - 5.0, middle[1] + reach + 5.0)
        axes.set_title(title, fontsize=11)
        axes.set_aspect("equal")
        axes.axis("off")
    scale = ScalarMappable(Normalize(-SCALE_MM, SCALE_MM), _PALETTE)
    bar = figure.colorbar(scale, ax=list(panels), shrink=0.6, pad=0.02, extend="both")
    bar.set_label("scan outside (+) or inside (-) the fitted skin [mm]")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _titled_views(skin: FittedSkin) -> list[tuple[str, tuple[float, float]]]:
    """Views with their names; of one leg, which side is the outer one."""
    sides = skin.fit.limb.sides
    if len(sides) > 1:
        return list(_VIEWS)
    outer = "right" if sides == ("r",) else "left"
    faces = {"right", "left"}
    return [
        (f"{name} ({'lateral' if name == outer else 'medial'})" if name in faces else name, view)
        for name, view in _VIEWS
    ]


def _triangle_colours(skin: FittedSkin, scan: SurfaceScan, found: Deviation) -> Float[Array, "triangle 3"]:
    """Colour of the mean distance of the scan's points around each triangle; grey where there are none."""
    points, distance = scan.points[found.counted], found.distance_mm[found.counted]
    middles = skin.vertices[skin.triangles].mean(axis=1)
    tree = cKDTree(points)
    seen = np.asarray(tree.query(middles)[0]) < NEAR
    near = np.asarray(tree.query(middles[seen], k=4)[1])
    colours = np.full((len(middles), 3), UNSEEN)
    share = 0.5 + 0.5 * distance[near].mean(axis=1) / SCALE_MM
    colours[seen] = matplotlib.colormaps[_PALETTE](share)[:, :3]
    return colours


def _coloured_mesh(skin: FittedSkin, scan: SurfaceScan, found: Deviation) -> bytes:
    """The scan's mesh, or the fitted skin of a cloud, coloured by the distance; metres."""
    if len(scan.triangles):
        vertices, triangles = scan.vertices, scan.triangles
    else:
        vertices, triangles = skin.vertices, skin.triangles
    nearest = cKDTree(scan.points).query(vertices)[1]
    share = np.clip(0.5 + 0.5 * found.distance_mm[nearest] / SCALE_MM, 0.0, 1.0)
    colours = matplotlib.colormaps[_PALETTE](share)
    colours[~found.counted[nearest]] = (UNSEEN, UNSEEN, UNSEEN, 1.0)
    upright = (vertices - skin.fit.pose.translation) @ skin.fit.pose.rotation
    mesh = trimesh.Trimesh(upright, triangles, vertex_colors=(255 * colours).astype(np.uint8), process=False)
    return _bytes(mesh.export(file_type="glb"))


def _bytes(content: str | bytes | dict[str, object]) -> bytes:
    return content if isinstance(content, bytes) else str(content).encode()
