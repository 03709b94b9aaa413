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
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from hilbrace.run.records import write_atomic
from hilbrace.scan.deviation import Deviation, girths
from hilbrace.scan.free_form import FittedSkin
from hilbrace.scan.surface_scan import SurfaceScan, describe_holes
from hilbrace.units import MM_PER_M

Array = np.ndarray

SCALE_MM = 3.0
"""Distance that is drawn in the last colour [mm]."""
DRAWN = 30000
_VIEWS = (("front", (1.0, 0.0)), ("right", (0.0, 1.0)), ("back", (-1.0, 0.0)), ("left", (0.0, -1.0)))
_PALETTE = "coolwarm"
_LEGS = {"l": "left leg", "r": "right leg"}


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
        angles=skin.fit.angles_deg,
        foot=skin.fit.foot,
        holes=describe_holes(scan),
        dropped=scan.dropped,
        model=skin.body.model,
        model_mean=found.model_mean_mm,
    )
    write_atomic(folder / "report.html", page.encode())


def deviation_picture(skin: FittedSkin, scan: SurfaceScan, found: Deviation) -> bytes:
    """Four views of the scan, coloured by its distance from the fitted skin, as PNG."""
    step = max(1, len(scan.points) // DRAWN)
    points = (scan.points[::step] - skin.fit.pose.translation) @ skin.fit.pose.rotation * MM_PER_M
    counted, distance = found.counted[::step], found.distance_mm[::step]
    own = (skin.vertices - skin.fit.pose.translation) @ skin.fit.pose.rotation * MM_PER_M
    outward = _outward(points, own, skin)
    figure = Figure(figsize=(11.0, 6.0), dpi=110)
    drawn = None
    for number, (title, (ahead, right)) in enumerate(_VIEWS):
        axes = figure.add_subplot(1, len(_VIEWS), number + 1)
        camera = np.array([ahead, 0.0, right])
        across = np.cross([0.0, 1.0, 0.0], camera)
        shown = outward @ camera > 0.0
        axes.scatter(own @ across, own[:, 1], s=2, color="0.9", linewidths=0)
        other = shown & ~counted
        axes.scatter(points[other] @ across, points[other, 1], s=1, color="0.6", linewidths=0)
        near = shown & counted
        drawn = axes.scatter(
            points[near] @ across, points[near, 1], c=distance[near], s=2, cmap=_PALETTE, linewidths=0,
            vmin=-SCALE_MM, vmax=SCALE_MM,
        )  # fmt: skip
        axes.set_title(title)
        axes.set_aspect("equal")
        axes.axis("off")
    if drawn is not None:
        bar = figure.colorbar(drawn, ax=figure.axes, shrink=0.6, pad=0.02)
        bar.set_label("scan outside (+) or inside (-) the fitted skin [mm]")
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _outward(
    points: Float[Array, "point 3"], own: Float[Array, "vertex 3"], skin: FittedSkin
) -> Float[Array, "point 3"]:
    """Outward normals of the fitted skin next to the points."""
    normals = trimesh.Trimesh(own, skin.triangles, process=False).vertex_normals
    return np.asarray(normals)[cKDTree(own).query(points)[1]]


def _coloured_mesh(skin: FittedSkin, scan: SurfaceScan, found: Deviation) -> bytes:
    """The scan's mesh, or the fitted skin of a cloud, coloured by the distance; metres."""
    if len(scan.triangles):
        vertices, triangles = scan.vertices, scan.triangles
    else:
        vertices, triangles = skin.vertices, skin.triangles
    nearest = cKDTree(scan.points).query(vertices)[1]
    share = np.clip(0.5 + 0.5 * found.distance_mm[nearest] / SCALE_MM, 0.0, 1.0)
    colours = matplotlib.colormaps[_PALETTE](share)
    colours[~found.counted[nearest]] = (0.6, 0.6, 0.6, 1.0)
    upright = (vertices - skin.fit.pose.translation) @ skin.fit.pose.rotation
    mesh = trimesh.Trimesh(upright, triangles, vertex_colors=(255 * colours).astype(np.uint8), process=False)
    return _bytes(mesh.export(file_type="glb"))


def _bytes(content: str | bytes | dict[str, object]) -> bytes:
    return content if isinstance(content, bytes) else str(content).encode()
