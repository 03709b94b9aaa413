"""The evolving field as a small film: in the flat map and on the limb, beside the course of the loop.

Each view is rasterised once; a frame then only looks its colours up, so that a film takes about a second.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from hilbrace.domain.animation import TO_FRONT, vertex_normals
from hilbrace.domain.domain import Domain
from hilbrace.domain.glb import INDICES, VERTICES, BinaryPart, container
from hilbrace.errors import InputError
from hilbrace.optimize.design import Design
from hilbrace.optimize.history import TRACE
from hilbrace.run.records import write_atomic

Array = np.ndarray

SIZE = 960, 540
"""Width and height of a frame [pixels]."""

FRAME_MS, LAST_MS = 120, 2500
"""How long a snapshot, and the finished field, stay [ms]."""

INK, PALE, PAPER = (34, 49, 63), (205, 212, 217), (255, 255, 255)
GREEN, BLUE = (63, 125, 82), (42, 111, 151)
_FINER = 2
"""Samples along each side of a pixel."""
_SIDES = {"front": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0)}


@dataclass(frozen=True)
class Raster:
    """A mesh seen from one direction: which vertices every pixel of a frame looks at.

    Attributes:
        row: Row of each pixel that the mesh covers, in the fine raster.
        column: Its column.
        corners: Vertices of the nearest triangle there.
        weights: What they weigh [-].
        light: Brightness [-].
    """

    row: Int[Array, " pixel"]
    column: Int[Array, " pixel"]
    corners: Int[Array, "pixel 3"]
    weights: Float[Array, "pixel 3"]
    light: Float[Array, " pixel"]


def write_film(domain: Domain, design: Design, path: Path) -> None:
    """Write the snapshots of a design as an animated GIF; the bytes depend on the arguments alone.

    Args:
        domain: The brace's surface and its map.
        design: The design, with snapshots.
        path: File to write.

    Raises:
        InputError: The design has no snapshots.
    """
    frames = film_frames(domain, design)
    palette = _palette(frames)
    pictures = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames
    ]
    buffer = io.BytesIO()
    duration = [FRAME_MS] * (len(frames) - 1) + [LAST_MS]
    pictures[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=pictures[1:],
        duration=duration,
        loop=0,
        optimize=False,
    )
    write_atomic(path, buffer.getvalue())


def film_frames(domain: Domain, design: Design) -> list[UInt8[Array, "row column 3"]]:
    """The frames of the film, one for each snapshot.

    Raises:
        InputError: The design has no snapshots.
    """
    if not len(design.film):
        raise InputError(
            "the design has no snapshots", where="optimize", hint="set optimize.snapshots above zero"
        )
    views = _views(domain)
    colours = (255 * colormaps["viridis"](np.linspace(0, 1, 256))[:, :3]).astype(np.float64)
    return [
        _frame(views, colours, design, snapshot, int(iteration))
        for snapshot, iteration in enumerate(design.film_iterations)
    ]


def write_film_glb(domain: Domain, design: Design, path: Path) -> None:
    """Write the snapshots as a turnable binary glTF film: one coloured brace a snapshot, shown in turn.

    Args:
        domain: The brace's surface and its map.
        design: The design, with snapshots.
        path: File to write.
    """
    binary = BinaryPart()
    vertices = domain.vertices[domain.weld]
    normals = vertex_normals(domain.vertices, domain.triangles)[domain.weld]
    place = binary.add(vertices, "VEC3", VERTICES, bounds=True)
    normal = binary.add(normals, "VEC3", VERTICES)
    faces = binary.add(domain.cut_triangles.reshape(-1), "SCALAR", INDICES)
    linear = colormaps["viridis"](np.linspace(0, 1, 256))[:, :3] ** 2.2
    meshes = []
    for iteration, values in zip(design.film_iterations.tolist(), design.film, strict=True):
        colour = binary.add(linear[values], "VEC3", VERTICES)
        attributes = {"POSITION": place, "NORMAL": normal, "COLOR_0": colour}
        primitive = {"attributes": attributes, "indices": faces, "material": 0}
        meshes.append({"name": f"iteration {iteration}", "primitives": [primitive]})
    clock = binary.add(FRAME_MS / 1000.0 * np.arange(len(meshes)), "SCALAR", bounds=True)
    shown = [binary.add(np.repeat(row, 3).reshape(-1, 3), "VEC3") for row in np.eye(len(meshes))]
    document = _film_document(meshes, clock, shown) | {
        "buffers": [{"byteLength": len(binary.data)}],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
    }
    write_atomic(path, container(document, bytes(binary.data)))


def _film_document(meshes: list[dict[str, Any]], clock: int, shown: list[int]) -> dict[str, Any]:
    """Nodes of which one at a time has a size, and the animation that chooses it."""
    nodes = [
        {"name": mesh["name"], "mesh": place, "scale": [float(place == len(meshes) - 1)] * 3}
        for place, mesh in enumerate(meshes)
    ]
    root = {"children": [*range(1, len(nodes) + 1)], "scale": [0.001] * 3, "rotation": list(TO_FRONT)}
    return {
        "asset": {"version": "2.0", "generator": "hilbrace"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [root, *nodes],
        "meshes": meshes,
        "materials": [
            {"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}
        ],
        "animations": [
            {
                "name": "iterations",
                "channels": [
                    {"sampler": place, "target": {"node": place + 1, "path": "scale"}}
                    for place in range(len(shown))
                ],
                "samplers": [{"input": clock, "output": output, "interpolation": "STEP"} for output in shown],
            }
        ],
    }


def rasterised(
    points: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    box: tuple[int, int, int, int],
    shaded: bool,
) -> Raster:
    """Rasterise a mesh into a box of the fine raster, as large as it fits.

    Args:
        points: Right, up and towards the camera, in any unit.
        triangles: Vertex indices.
        box: Left, top, width and height of the box in the fine raster.
        shaded: Whether slanting triangles are darker.
    """
    left, top, width, height = box
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    zoom = min((width - 1) / (high[0] - low[0]), (height - 1) / (high[1] - low[1]))
    middle = 0.5 * (low + high)
    x = left + 0.5 * width + zoom * (points[:, 0] - middle[0])
    y = top + 0.5 * height - zoom * (points[:, 1] - middle[1])
    flat = np.stack([x, y], axis=1)[triangles]
    edge = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2).max()
    weights = _lattice(int(np.clip(np.ceil(1.5 * edge), 2, 120)))
    place = np.einsum("sk,tkc->tsc", weights, flat)
    depth = (weights @ points[triangles, 2].T).T.ravel()
    column, row = np.floor(place).astype(np.int64).reshape(-1, 2).T
    pixel = row * (_FINER * SIZE[0]) + column
    order = np.lexsort((depth, pixel))
    nearest = order[np.append(np.diff(pixel[order]) != 0, True)]
    triangle, sample = np.divmod(nearest, len(weights))
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.abs(normal[:, 2]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    light = 0.55 + 0.45 * facing[triangle] if shaded else np.ones(len(triangle))
    return Raster(row[nearest], column[nearest], triangles[triangle], weights[sample], light)


def _views(domain: Domain) -> list[Raster]:
    """The flat map, and the limb from front and back, in their boxes."""
    fine = _FINER
    flat = np.concatenate([domain.uv, np.zeros((len(domain.uv), 1))], axis=1)
    views = [rasterised(flat, domain.cut_triangles, (20 * fine, 70 * fine, 330 * fine, 400 * fine), False)]
    vertices = domain.vertices[domain.weld]
    for place, towards in enumerate(_SIDES.values()):
        near = np.array(towards)
        right = np.cross((0.0, 1.0, 0.0), near)
        seen = np.stack([vertices @ right, vertices[:, 1], vertices @ near], axis=1)
        box = ((370 + 150 * place) * fine, 70 * fine, 140 * fine, 400 * fine)
        views.append(rasterised(seen, domain.cut_triangles, box, True))
    return views


def _frame(
    views: list[Raster], colours: Float[Array, "256 3"], design: Design, snapshot: int, iteration: int
) -> UInt8[Array, "row column 3"]:
    width, height = SIZE
    canvas = np.full((_FINER * height, _FINER * width, 3), 255, dtype=np.uint8)
    values = design.film[snapshot].astype(np.float64)
    for view in views:
        level = (values[view.corners] * view.weights).sum(axis=1)
        shown = colours[np.clip(np.round(level), 0, 255).astype(np.int64)] * view.light[:, None]
        canvas[view.row, view.column] = np.round(shown).astype(np.uint8)
    image = Image.fromarray(canvas).reduce(_FINER)
    draw = ImageDraw.Draw(image)
    draw.text((20, 16), "design variable d", font=_font(20), fill=INK)
    draw.text((20, 42), f"iteration {iteration} of {design.iterations}", font=_font(15), fill=INK)
    for label, x in (("flat map", 160), ("front", 425), ("back", 575)):
        draw.text((x, 480), label, font=_font(13), fill=INK)
    _bar(draw, colours)
    course = dict(zip(TRACE, design.trace.T, strict=True))
    shown = ((design.history[:, -1], "total loss", BLUE), (course["ratio_vs_uniform"], _RATIO, GREEN))
    for place, (curve, title, colour) in enumerate(shown):
        _curve(draw, curve, iteration, (700, 78 + 225 * place, 235, 150), title, colour)
    return np.asarray(image)


_RATIO = "frontal / sagittal stiffness, x uniform"


def _curve(
    draw: ImageDraw.ImageDraw,
    values: Float[Array, " iteration"],
    now: int,
    box: tuple[int, int, int, int],
    title: str,
    colour: tuple[int, int, int],
) -> None:
    """A curve in a box: pale to its end, in colour so far, with the present value beside its title."""
    left, top, width, height = box
    low, high = float(values.min()), float(values.max())
    x = left + width * np.arange(len(values)) / max(1, len(values) - 1)
    y = top + height * (1.0 - (values - low) / max(high - low, 1e-300))
    points = list(zip(x.tolist(), y.tolist(), strict=True))
    draw.text((left, top - 26), title, font=_font(13), fill=INK)
    draw.line([(left, top + height + 4), (left + width, top + height + 4)], fill=PALE)
    draw.line(points, fill=PALE, width=2)
    draw.line([*points[: now + 1], points[now]], fill=colour, width=3)
    draw.ellipse(
        [points[now][0] - 4, points[now][1] - 4, points[now][0] + 4, points[now][1] + 4], fill=colour
    )
    draw.text((left, top + height + 10), f"{values[now]:.3g}", font=_font(16), fill=colour)


def _bar(draw: ImageDraw.ImageDraw, colours: Float[Array, "256 3"]) -> None:
    """The colours' meaning, from thin struts to thick ones."""
    for step, colour in enumerate(np.round(colours[::2]).astype(int).tolist()):
        draw.line([(120 + step, 508), (120 + step, 518)], fill=tuple(colour))
    draw.text((20, 504), "thin struts 0", font=_font(13), fill=INK)
    draw.text((256, 504), "1 thick", font=_font(13), fill=INK)


def _palette(frames: list[UInt8[Array, "row column 3"]]) -> Image.Image:
    """Colours for all frames: those of the first, the middle and the last."""
    chosen = [frames[place] for place in (0, len(frames) // 2, -1)]
    return Image.fromarray(np.concatenate(chosen)).quantize(colors=255, method=Image.Quantize.MEDIANCUT)


def _lattice(count: int) -> Float[Array, "sample 3"]:
    """Barycentric coordinates on an even lattice of a triangle, its edges included."""
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    inside = i + j <= count
    a, b = i[inside] / count, j[inside] / count
    return np.stack([a, b, 1.0 - a - b], axis=1)


@lru_cache(maxsize=8)
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(
        str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size
    )
