"""The brace on which this shell and its peers are measured: a knee sleeve with a patella window.

300 mm long, tapering from 70 mm radius at the thigh to 55 mm at the calf, with a waist at the joint, a bulge
for the patella and an elliptic window in front. x points forward, y up, the joint is the origin, as in the
package. The nodes are jittered, so that no element is a copy of another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LENGTH_MM = 300.0
MEAN_RADIUS_MM = 60.0
THICKNESS_MM = 4.0
POISSON = 0.45
LOAD_WINDOW_MM = 40.0
FRAMES = 45
FLEXION_DEG = np.linspace(5.0, 90.0, FRAMES)


@dataclass(frozen=True)
class KneeBrace:
    """A mesh with its loops, a design (modulus of each triangle [MPa]) and the force of each frame [N]."""

    vertices: np.ndarray
    triangles: np.ndarray
    upper_loop: np.ndarray
    lower_loop: np.ndarray
    modulus: np.ndarray
    forces: np.ndarray


def knee_brace(triangles):
    """The brace meshed by about this many triangles."""
    around, along = _cells(triangles)
    row, column = np.divmod(np.arange(around * (along + 1)), around)
    inner = (row > 0) & (row < along)
    jitter = np.random.default_rng(0).uniform(-0.2, 0.2, (2, len(row))) * inner
    angle = 2 * np.pi * (column + 0.5 * (row % 2) + jitter[0]) / around
    height = LENGTH_MM * ((row + jitter[1]) / along - 0.5)
    radius = _radius(angle, height)
    vertices = np.stack([radius * np.cos(angle), height, -radius * np.sin(angle)], axis=1)
    faces = _without_window(vertices, _strips(around, along))
    used, flat = np.unique(faces, return_inverse=True)
    vertices, row, faces = vertices[used], row[used], flat.reshape(-1, 3)
    return KneeBrace(
        vertices,
        faces,
        upper_loop=np.flatnonzero(row == along),
        lower_loop=np.flatnonzero(row == 0),
        modulus=_modulus(vertices[faces].mean(axis=1)),
        forces=np.random.default_rng(1).standard_normal((FRAMES, 3)),
    )


def posed(brace):
    """The brace in every frame: what lies below the joint swings back, over a length that folds nothing."""
    share = 1 / (1 + np.exp(brace.vertices[:, 1] / 37))
    angle = -np.deg2rad(FLEXION_DEG)[:, None] * share
    x, y, z = brace.vertices.T
    turned = [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y]
    return np.stack([*turned, np.broadcast_to(z, angle.shape)], axis=-1)


def _cells(triangles):
    """Cells around and along for nearly equilateral triangles; the window takes a fortieth of them."""
    girth = 2 * np.pi * MEAN_RADIUS_MM
    edge = np.sqrt(2 * LENGTH_MM * girth / (1.026 * triangles))
    return round(girth / edge), round(LENGTH_MM / edge)


def _radius(angle, height):
    taper = 55 + 15 * (height / LENGTH_MM + 0.5) ** 1.3
    return taper - 6 * np.exp(-((height / 40) ** 2)) + 4 * np.exp(-((height / 30) ** 2)) * np.cos(angle)


def _strips(around, along):
    low = around * np.arange(along)[:, None] + np.arange(around)
    right = around * np.arange(along)[:, None] + np.roll(np.arange(around), -1)
    high, across = low + around, right + around
    even = np.stack([low, right, high, right, across, high], axis=-1)
    odd = np.stack([low, right, across, low, across, high], axis=-1)
    rising = (np.arange(along) % 2 == 1)[:, None, None]
    return np.where(rising, odd, even).reshape(-1, 3)


def _without_window(vertices, faces):
    x, y, z = vertices[faces].mean(axis=1).T
    return faces[~((x > 0) & ((z / 25) ** 2 + (y / 32) ** 2 < 1))]


def _modulus(centres):
    """Soft and firm patches between 0.05 and 1.15 MPa, as a design has them."""
    angle = np.arctan2(-centres[:, 2], centres[:, 0])
    return 0.6 + 0.55 * np.sin(3 * angle) * np.cos(2 * np.pi * centres[:, 1] / 100)
