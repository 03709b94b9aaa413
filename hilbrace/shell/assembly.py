"""Numbering, sparsity and refill of the global stiffness: K(E) = sum over elements of E_e k0_e.

The sparsity depends on the triangles and the clamped vertices alone, so it is found once, for one triangle of
the symmetric matrix. Its values are one sparse product, ``values = S @ E``: column e of S is what element e
adds to each entry of K.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from hilbrace.shell.element import ELEMENT_DOFS, NODE_DOFS
from hilbrace.shell.symmetric import Sparsity, both_triangles

Array = np.ndarray


@dataclass(frozen=True)
class Numbering:
    """What the triangles and the clamped vertices decide, whatever the shape.

    Attributes:
        vertices: Number of vertices.
        element_dofs: Global degrees of freedom of each element.
        free: Degrees of freedom that are not clamped, ascending.
        equation: Position of each degree of freedom among the free ones, -1 where it is clamped.
        sparsity: Where the lower triangle of the free stiffness has entries.
        entry_start: Pointers of S: where the contributions to each entry of K begin.
        entry_element: Element of each contribution.
        entry_source: Position of each contribution in the flattened element stiffnesses.
    """

    vertices: int
    element_dofs: Int[Array, "element 15"]
    free: Int[Array, " free"]
    equation: Int[Array, " dof"]
    sparsity: Sparsity
    entry_start: Int[Array, " entry_plus_one"]
    entry_element: Int[Array, " contribution"]
    entry_source: Int[Array, " contribution"]


def number(vertices: int, triangles: Int[Array, "triangle 3"], clamped: Int[Array, " clamped"]) -> Numbering:
    """Number the degrees of freedom and find the sparsity of the stiffness.

    Args:
        vertices: Number of vertices.
        triangles: Vertex indices.
        clamped: Vertices that do not move.
    """
    dofs = (NODE_DOFS * triangles[:, :, None] + np.arange(NODE_DOFS)).reshape(-1, ELEMENT_DOFS)
    is_free = np.ones((vertices, NODE_DOFS), dtype=bool)
    is_free[clamped] = False
    free = np.flatnonzero(is_free)
    equation = np.full(vertices * NODE_DOFS, -1)
    equation[free] = np.arange(len(free))
    local = equation[dofs]
    row = np.repeat(local, ELEMENT_DOFS, axis=1).ravel()
    column = np.tile(local, (1, ELEMENT_DOFS)).ravel()
    source = np.flatnonzero((column >= 0) & (row >= column))
    key = column[source].astype(np.int64) * len(free) + row[source]
    order = np.argsort(key, kind="stable")
    key, source = key[order], source[order]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    start = np.searchsorted(key[first], np.arange(len(free) + 1) * len(free)).astype(np.int32)
    return Numbering(
        vertices=vertices,
        element_dofs=dofs,
        free=free,
        equation=equation,
        sparsity=Sparsity(start, (key[first] % len(free)).astype(np.int32)),
        entry_start=np.append(first, len(key)).astype(np.int32),
        entry_element=(source // ELEMENT_DOFS**2).astype(np.int32),
        entry_source=source,
    )


def refill_map(numbering: Numbering, stiffness: Float[Array, "element 15 15"]) -> sp.csr_array:
    """The matrix S of ``values = S @ E``, for the unit-modulus stiffness of the elements."""
    values = stiffness.reshape(-1)[numbering.entry_source]
    shape = (numbering.sparsity.entries, len(stiffness))
    return sp.csr_array((values, numbering.entry_element, numbering.entry_start), shape=shape)


def free_stiffness(
    numbering: Numbering, refill: sp.csr_array, modulus: Float[Array, " element"]
) -> sp.csc_array:
    """Stiffness of the free degrees of freedom, both triangles, for the modulus of each element [MPa].

    For other programs and for looking at it; the solvers take the one triangle ``refill @ modulus``.
    """
    size = numbering.sparsity.size
    start, row, source = both_triangles(numbering.sparsity)
    return sp.csc_array(((refill @ modulus)[source], row, start), shape=(size, size))
