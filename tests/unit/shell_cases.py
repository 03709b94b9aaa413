"""Meshes, and the benchmark problems of the shell literature, for the tests of the shell.

Problem data and reference displacements: Ko, Lee, Lee & Bathe 2017, "Performance of the MITC3+ and MITC4+
shell elements in widely-used benchmark problems", Computers & Structures 193:187-206.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from hilbrace.shell.directors import tangent_basis
from hilbrace.shell.element import element_stiffness
from hilbrace.shell.model import unit_stiffness
from hilbrace.shell.section import isotropic


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


def bent_frames(vertices, frames, deepest=75.0):
    """The shape in every frame: the part below the origin turns about z, smoothly around the joint."""
    share = 1 / (1 + np.exp(vertices[:, 1] / 12.0))
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


@dataclass
class Problem:
    """A shell with directors from its exact surface, supports in global axes (3 moves, 3 turns) and loads."""

    vertices: np.ndarray
    triangles: np.ndarray
    directors: np.ndarray
    thickness: float
    modulus: float
    poisson: float
    load: np.ndarray = field(init=False)
    fixed: list[int] = field(default_factory=list)

    def __post_init__(self):
        self.load = np.zeros((len(self.vertices), 3))

    def hold(self, where, axes):
        self.fixed += [6 * int(v) + a for v in np.flatnonzero(where) for a in axes]

    def press(self, pressure):
        """Give each corner a third of its triangles' area times a load per area."""
        corners = self.vertices[self.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        third = np.linalg.norm(cross, axis=1) / 6
        np.add.at(self.load, self.triangles, third[:, None, None] * np.asarray(pressure))

    def stiffness(self):
        """Six global degrees of freedom per node; a spring about the director, which carries no strain."""
        tangents = tangent_basis(self.directors)
        corners = self.triangles
        local = element_stiffness(
            self.vertices[corners],
            self.directors[corners],
            tangents[corners],
            np.full(len(corners), self.thickness),
            isotropic(self.poisson),
        )
        turn = np.zeros((len(corners), 15, 18))
        drill = np.zeros((len(corners), 18, 18))
        for node in range(3):
            turn[:, 5 * node : 5 * node + 3, 6 * node : 6 * node + 3] = np.eye(3)
            turn[:, 5 * node + 3 : 5 * node + 5, 6 * node + 3 : 6 * node + 6] = tangents[corners[:, node]]
            director = self.directors[corners[:, node]]
            part = slice(6 * node + 3, 6 * node + 6)
            drill[:, part, part] = 1e-4 * self.thickness**3 * director[:, :, None] * director[:, None, :]
        values = self.modulus * (turn.transpose(0, 2, 1) @ local @ turn + drill)
        dofs = (6 * corners[:, :, None] + np.arange(6)).reshape(-1, 18)
        rows, columns = np.repeat(dofs, 18, axis=1).ravel(), np.tile(dofs, (1, 18)).ravel()
        size = 6 * len(self.vertices)
        return sp.coo_array((values.ravel(), (rows, columns)), shape=(size, size)).tocsc()

    def solve(self, moved=None):
        """Displacements (vertex, 6); supports stay, or move as given."""
        matrix = self.stiffness()
        free = np.setdiff1d(np.arange(matrix.shape[0]), self.fixed)
        answer = np.zeros(matrix.shape[0]) if moved is None else moved.ravel().copy()
        answer[free] = 0.0
        force = np.pad(self.load, ((0, 0), (0, 3))).ravel() - matrix @ answer
        answer[free] = splu(matrix[free][:, free].tocsc()).solve(force[free])
        return answer.reshape(-1, 6)


def plate(n, thickness, clamped):
    """Quarter of a square plate of side 2 under pressure; central deflection over the thin-plate value."""
    u, v, triangles = grid(n, n, rising=False)
    flat = np.stack([u, v, 0 * u], axis=1)
    case = Problem(flat, triangles, np.tile([0.0, 0.0, 1.0], (len(u), 1)), thickness, 1e4, 0.3)
    case.hold(u == 0, [0, 4, 5])
    case.hold(v == 0, [1, 3, 5])
    case.hold((u == 1) | (v == 1), range(6) if clamped else range(3))
    pressure = thickness**3
    case.press([0, 0, -pressure])
    bending = 1e4 * thickness**3 / 12 / (1 - 0.09)
    reference = (1.267e-3 if clamped else 4.062e-3) * pressure * 2.0**4 / bending
    return -case.solve()[0, 2] / reference


def scordelis_lo(n):
    """Quarter of the Scordelis-Lo roof under its weight; middle of the free edge."""
    u, v, triangles = grid(n, n, rising=True)
    angle = np.deg2rad(40) * u
    directors = np.stack([np.sin(angle), 0 * v, np.cos(angle)], axis=1)
    case = Problem(25 * directors + np.outer(25 * v, [0, 1, 0]), triangles, directors, 0.25, 4.32e8, 0.0)
    case.hold(u == 0, [0, 4, 5])
    case.hold(v == 0, [1, 3, 5])
    case.hold(v == 1, [0, 2, 4])
    case.press([0, 0, -90.0])
    return case.solve()[np.flatnonzero((u == 1) & (v == 0))[0], 2] / -0.3024


def pinched_cylinder(n):
    """Eighth of a cylinder on diaphragms, pinched at mid-length; under the load."""
    u, v, triangles = grid(n, n, rising=False)
    angle = np.pi / 2 * u
    directors = np.stack([np.sin(angle), 0 * v, np.cos(angle)], axis=1)
    case = Problem(300 * directors + np.outer(300 * v, [0, 1, 0]), triangles, directors, 3.0, 3e6, 0.3)
    case.hold(u == 0, [0, 4, 5])
    case.hold(u == 1, [2, 3, 4])
    case.hold(v == 0, [1, 3, 5])
    case.hold(v == 1, [0, 2, 4])
    case.load[0, 2] = -0.25
    return case.solve()[0, 2] / -1.8248e-5


def hemisphere(n, thickness):
    """Quarter of a hemisphere with an 18 degree hole, pulled and pushed at the equator; under the load."""
    u, v, triangles = grid(n, n, rising=False)
    longitude, latitude = np.pi / 2 * u, np.deg2rad(72) * v
    across = np.cos(latitude)
    directors = np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], axis=1)
    case = Problem(10 * directors, triangles, directors, thickness, 6.825e7, 0.3)
    force = 1.0 if thickness == 0.04 else 1e-3
    case.load[0, 0], case.load[n, 1] = force, -force
    case.hold(u == 0, [1, 3, 5])
    case.hold(u == 1, [0, 4, 5])
    case.fixed.append(2)
    return case.solve()[0, 0] / 0.093


def twisted_beam(n, thickness, direction):
    """Cantilever twisted by 90 degrees, 6n x n; tip deflection in the plane of its width or out of it."""
    u, v, triangles = grid(n, 6 * n, rising=True)
    angle, across = np.pi / 2 * v, 1.1 * (u - 0.5)
    vertices = np.stack([12 * v, across * np.cos(angle), across * np.sin(angle)], axis=1)
    width = np.stack([0 * v, np.cos(angle), np.sin(angle)], axis=1)
    turn = np.pi / 2 * across
    along = np.stack([0 * v + 12, -turn * np.sin(angle), turn * np.cos(angle)], axis=1)
    directors = np.cross(width, along)
    directors /= np.linalg.norm(directors, axis=1, keepdims=True)
    case = Problem(vertices, triangles, directors, thickness, 29e6, 0.22)
    case.hold(v == 0, range(6))
    tip = np.flatnonzero((v == 1) & (np.abs(u - 0.5) < 1e-9))[0]
    axis = {"in": 2, "out": 1}[direction]
    force = 1.0 if thickness == 0.32 else 1e-6
    case.load[tip, axis] = force
    reference = {0.32: {"in": 5.424e-3, "out": 1.754e-3}, 0.0032: {"in": 5.256e-3, "out": 1.294e-3}}
    return case.solve()[tip, axis] / reference[thickness][direction]


def hook(n):
    """Raasch's hook, 6n x n: two arcs of radii 14 and 46, sheared at the tip along its width."""
    u, v, triangles = grid(n, 6 * n, rising=True)
    first, second = np.deg2rad(60), np.deg2rad(150)
    on_first = v <= 0.5
    a = 2 * v * first
    b = 2 * (v - 0.5) * second + np.arctan2(-np.sin(first), np.cos(first))
    joint = np.array([-np.cos(first), np.sin(first)])
    radial = np.where(
        on_first[:, None], np.stack([-np.cos(a), np.sin(a)], 1), np.stack([np.cos(b), np.sin(b)], 1)
    )
    plane = np.where(on_first[:, None], 14 * radial, 60 * joint + 46 * radial)
    outward = np.where(on_first[:, None], radial, -radial)
    vertices = np.column_stack([plane, 20 * u])
    case = Problem(vertices, triangles, np.column_stack([outward, 0 * u]), 2.0, 3.3e3, 0.3)
    case.hold(v == 0, range(6))
    tip = np.flatnonzero(v == 1)
    share = np.ones(len(tip))
    share[[0, -1]] = 0.5
    case.load[tip, 2] = share / share.sum()
    return case.solve()[tip, 2].mean() / 4.82482
