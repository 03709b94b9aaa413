"""Draw triangle meshes into a matplotlib figure: orthographic, far to near, with a soft light.

Enough for the report's pictures, and it needs no graphics driver.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

Array = np.ndarray
Colours = Float[Array, "triangle channel"] | tuple[float, float, float]
"""One colour for all, or one per triangle."""

FRONT = (1.0, 0.0, 0.0)
BACK = (-1.0, 0.0, 0.0)
RIGHT = (0.0, 0.0, 1.0)
LEFT = (0.0, 0.0, -1.0)
"""Directions from the limb to the camera (x anterior, y up, z to the right)."""

SKIN = (0.86, 0.79, 0.73)


def screen_axes(
    towards: tuple[float, float, float],
) -> tuple[Float[Array, "3"], Float[Array, "3"], Float[Array, "3"]]:
    """Unit vectors right, up and towards the camera of a view; up is as close to +y as it can be."""
    near = np.asarray(towards, dtype=float) / np.linalg.norm(towards)
    right = np.cross((0.0, 1.0, 0.0), near)
    right /= np.linalg.norm(right)
    return right, np.cross(near, right), near


def paint(
    axes: Axes,
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    colours: Colours = SKIN,
    towards: tuple[float, float, float] = FRONT,
    opacity: float = 1.0,
    shift: tuple[float, float] = (0.0, 0.0),
) -> None:
    """Paint a mesh seen from one direction.

    Args:
        axes: Axes to paint in; given an equal aspect and no frame.
        vertices: Positions, any unit.
        triangles: Outward triangles; those that face away are painted first, darker.
        colours: One colour, or one per triangle.
        towards: Direction from the mesh to the camera.
        opacity: 1 is solid.
        shift: Moves the picture on the paper, in the unit of the vertices.
    """
    right, up, near = screen_axes(towards)
    corners = vertices[triangles]
    flat = np.stack([corners @ right + shift[0], corners @ up + shift[1]], axis=-1)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ near
    base = np.broadcast_to(np.asarray(colours, dtype=float)[..., :3], (len(triangles), 3))
    light = near + 0.5 * up + 0.3 * right
    light /= np.linalg.norm(light)
    brightness = 0.5 + 0.5 * np.clip(_smooth_normals(vertices, triangles) @ light, 0.0, 1.0)
    brightness = np.where(facing < 0, 0.45, brightness)
    order = np.argsort(corners.mean(axis=1) @ near, kind="stable")
    shaded = np.clip(base * brightness[:, None], 0.0, 1.0)[order]
    collection = PolyCollection(
        list(flat[order]),
        facecolors=shaded,
        edgecolors=shaded,
        linewidths=0.25,
        alpha=opacity,
        rasterized=True,
    )
    axes.add_collection(collection)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.axis("off")


def _smooth_normals(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> Array:
    """Unit normal of each triangle, averaged over its corners so that a coarse mesh looks round."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at_vertex = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(at_vertex, triangles[:, corner], normals)
    mean = at_vertex[triangles].sum(axis=1)
    return mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)
