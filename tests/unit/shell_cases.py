"""Meshes and a dense assembly for the tests of the shell."""

from __future__ import annotations

import numpy as np

from hilbrace.shell.model import unit_stiffness


def grid(columns, rows, rising):
    """Unit square of 2 x columns x rows triangles; the diagonals rise to the right or fall."""
    v, u = np.divmod(np.arange((columns + 1) * (rows + 1)), columns + 1)
    a = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    b, c, d = a + 1, a + columns + 2, a + columns + 1
    pair = ((a, b, c), (a, c, d)) if rising else ((a, b, d), (b, c, d))
    triangles = np.stack([np.stack(corners, axis=1) for corners in pair], axis=1).reshape(-1, 3)
    return u / columns, v / rows, triangles


def tube(columns, rows, radius, length, waviness=0.0, window=False):
    """A tube along y about the origin, outward triangles; gives also its upper and lower loop."""
    j, i = np.divmod(np.arange(columns * (rows + 1)), columns)
    angle = 2 * np.pi * (i + 0.5 * (j % 2)) / columns
    height = length * (j / rows - 0.5)
    r = radius * (1 + waviness * np.sin(2 * angle + 0.02 * height) - 0.5 * waviness * height / length)
    vertices = np.stack([r * np.cos(angle), height, -r * np.sin(angle)], axis=1)
    triangles = []
    for row in range(rows):
        low, high = row * columns, (row + 1) * columns
        for k in range(columns):
            n = (k + 1) % columns
            if row % 2 == 0:
                triangles += [[low + k, low + n, high + k], [low + n, high + n, high + k]]
            else:
                triangles += [[low + k, low + n, high + n], [low + k, high + n, high + k]]
    triangles = np.array(triangles)
    upper, lower = np.flatnonzero(j == rows), np.flatnonzero(j == 0)
    if window:
        centre = vertices[triangles].mean(axis=1)
        hole = (centre[:, 0] > 0) & (
            (centre[:, 2] / (0.45 * radius)) ** 2 + (centre[:, 1] / (0.12 * length)) ** 2 < 1
        )
        triangles = triangles[~hole]
        used, flat = np.unique(triangles, return_inverse=True)
        triangles, vertices = flat.reshape(-1, 3), vertices[used]
        upper, lower = np.searchsorted(used, upper), np.searchsorted(used, lower)
    return vertices, triangles, upper, lower


def bent_frames(vertices, frames, deepest=75.0, width=12.0):
    """The shape in every frame: the part below the origin turns about z, smoothly around the joint."""
    share = 1 / (1 + np.exp(vertices[:, 1] / width))
    posed = []
    for flexion in np.deg2rad(deepest) * np.sin(np.linspace(0.2, 3.0, frames)):
        cos, sin = np.cos(flexion * share), np.sin(flexion * share)
        x, y, z = vertices.T
        posed.append(np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1))
    return np.stack(posed)


def global_stiffness(shell, modulus):
    """All degrees of freedom, dense, element by element."""
    size = 5 * len(shell.vertices)
    dense, stiffness = np.zeros((size, size)), unit_stiffness(shell)
    for element, dofs in enumerate(shell.numbering.element_dofs):
        dense[np.ix_(dofs, dofs)] += modulus[element] * stiffness[element]
    return dense
