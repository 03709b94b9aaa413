"""What each element adds to the stiffness of the free nodes and of the loops, and the same read backwards.

The unknowns are the free degrees of freedom and the twelve rigid motions q of the loops; a displacement is
``u + G q``. In them the stiffness is linear in the modulus,

    K(E) = sum_e E_e [ k_ff  k_fb G ; G^T k_bf  G^T k_bb G ],

and so is every derivative: a sum of energies ``x^T k_e y`` over pairs of displacement fields, element by
element. `assemble` goes from the modulus to K, `contract` from pairs of fields back to the elements. Maps
made from the slopes dk0/dt instead of k0 give the derivative by the thickness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from hilbrace.shell.assembly import Numbering, refill_map
from hilbrace.shell.blocks import times
from hilbrace.shell.element import NODE_DOFS
from hilbrace.shell.loops import LOOP_DOFS
from hilbrace.shell.symmetric import Sparsity, product

Array = np.ndarray

_FIELDS = 8
"""Fields whose energies are found at a time."""

_PAIRS = 512
"""Pairs of vertices at a time: what they need stays in the processor's cache."""


@dataclass(frozen=True)
class VertexPairs:
    """The stored entries of the free stiffness, as blocks of the degrees of freedom of two vertices.

    Attributes:
        row: Free vertex of the rows of each block.
        column: Free vertex of its columns.
        entry: Position of each stored entry in the flattened blocks.
        share: 1 for entries on the diagonal and 2 for all others, which stand for two.
    """

    row: Int[Array, " pair"]
    column: Int[Array, " pair"]
    entry: Int[Array, " entry"]
    share: Float[Array, " entry"]


@dataclass(frozen=True)
class StiffnessMaps:
    """Contributions of the elements, for unit modulus.

    Attributes:
        pairs: Blocks of the stored triangle of the free stiffness.
        refill: Matrix from the modulus to that triangle.
        held: Elements that touch a loop.
        force: Their nodal forces per unit rigid motion of a loop, k_e G.
        ends: Their part in the stiffness between the motions of the loops, G^T k_e G.
    """

    pairs: VertexPairs
    refill: sp.csr_array
    held: Int[Array, " held"]
    force: Float[Array, "held 15 12"]
    ends: Float[Array, "held 12 12"]


@dataclass(frozen=True)
class Assembled:
    """The stiffness of one shell, in the free degrees of freedom and the motions of the loops.

    Attributes:
        values: Stored triangle of K_ff.
        coupling: K_fb G, forces on the free nodes per motion of the loops.
        ends: G^T K_bb G.
    """

    values: Float[Array, " entry"]
    coupling: Float[Array, "free 12"]
    ends: Float[Array, "12 12"]


def vertex_pairs(sparsity: Sparsity) -> VertexPairs:
    """Blocks of a sparsity whose equations are those of vertices, all of a vertex or none."""
    column = np.repeat(np.arange(sparsity.size), np.diff(sparsity.start))
    vertices = sparsity.size // NODE_DOFS
    key = (column // NODE_DOFS).astype(np.int64) * vertices + sparsity.row // NODE_DOFS
    pairs, block = np.unique(key, return_inverse=True)
    return VertexPairs(
        row=pairs % vertices,
        column=pairs // vertices,
        entry=block * NODE_DOFS**2 + (sparsity.row % NODE_DOFS) * NODE_DOFS + column % NODE_DOFS,
        share=np.where(sparsity.row == column, 1.0, 2.0),
    )


def stiffness_maps(
    numbering: Numbering,
    pairs: VertexPairs,
    stiffness: Float[Array, "element 15 15"],
    motions: Float[Array, "dof 12"],
) -> StiffnessMaps:
    """Maps of a shell.

    Args:
        numbering: Its degrees of freedom.
        pairs: Blocks of its sparsity.
        stiffness: Element stiffness for unit modulus, or its slope by the thickness.
        motions: Rigid motions G of the clamped degrees of freedom, zero on free ones.
    """
    held = np.flatnonzero((numbering.equation[numbering.element_dofs] < 0).any(axis=1))
    local = motions[numbering.element_dofs[held]]
    force = stiffness[held] @ local
    ends = local.transpose(0, 2, 1) @ force
    return StiffnessMaps(pairs, refill_map(numbering, stiffness), held, force, ends)


def assemble(numbering: Numbering, maps: StiffnessMaps, modulus: Float[Array, " element"]) -> Assembled:
    """The stiffness for the modulus of each element [MPa]."""
    scale = modulus[maps.held]
    force = scale[:, None, None] * maps.force
    scatter = _scatter(numbering, maps.held)
    return Assembled(
        values=maps.refill @ modulus,
        coupling=scatter @ force.reshape(-1, LOOP_DOFS),
        ends=(scale[:, None, None] * maps.ends).sum(axis=0),
    )


def contract(
    numbering: Numbering,
    maps: StiffnessMaps,
    fields: Float[Array, "free field"],
    pairing: Float[Array, "field field"],
    motions: int,
) -> Float[Array, " element"]:
    """Sum over pairs of fields of ``pairing[a, b] x_a^T k_e x_b``, for every element and unit modulus.

    Args:
        numbering: Degrees of freedom.
        maps: Contributions of the elements.
        fields: Displacements of the free nodes. Field i < `motions` belongs to unit motion i of the loops;
            in all others the loops stay.
        pairing: Symmetric weights of the pairs.
        motions: Number of leading fields that move a loop: 12, or none.
    """
    weighted = times(fields, pairing)
    values = sampled_product(maps.pairs, weighted, np.ascontiguousarray(fields))
    out = maps.refill.T @ (values * maps.pairs.share)
    if motions:
        on_nodes = _scatter(numbering, maps.held).T @ weighted[:, :motions]
        out[maps.held] += 2.0 * np.einsum("eij,eij->e", on_nodes.reshape(maps.force.shape), maps.force)
        out[maps.held] += np.einsum("eij,ij->e", maps.ends, pairing[:motions, :motions])
    return out


def field_energies(
    numbering: Numbering, maps: StiffnessMaps, fields: Float[Array, "free field"]
) -> Float[Array, "field element"]:
    """Energies ``x^T k_e x`` of every element in every field that leaves the loops where they are."""
    sparsity = numbering.sparsity
    columns = np.repeat(np.arange(sparsity.size), np.diff(sparsity.start))
    backwards = maps.refill.T.tocsr()
    out = np.empty((fields.shape[1], len(numbering.element_dofs)))
    for first in range(0, fields.shape[1], _FIELDS):
        part = np.ascontiguousarray(fields[:, first : first + _FIELDS])
        squares = part[sparsity.row] * part[columns]
        out[first : first + _FIELDS] = (backwards @ (maps.pairs.share[:, None] * squares)).T
    return out


def field_forces(
    numbering: Numbering,
    maps: StiffnessMaps,
    scale: Float[Array, "field element"],
    fields: Float[Array, "free field"],
) -> Float[Array, "free field"]:
    """Forces ``sum_e scale[i, e] k_e x_i`` on the free nodes, for fields that leave the loops in place."""
    out = np.empty(fields.shape, order="F")
    for i, factors in enumerate(scale):
        out[:, i] = product(numbering.sparsity, maps.refill @ factors, fields[:, i : i + 1])[:, 0]
    return out


def sampled_product(
    pairs: VertexPairs, left: Float[Array, "free field"], right: Float[Array, "free field"]
) -> Float[Array, " entry"]:
    """Entries of ``left @ right.T`` at the stored triangle of a symmetric matrix."""
    count = left.shape[1]
    rows, columns = (one.reshape(-1, NODE_DOFS * count) for one in (left, right))
    blocks = np.empty((len(pairs.row), NODE_DOFS, NODE_DOFS))
    for first in range(0, len(blocks), _PAIRS):
        part = slice(first, first + _PAIRS)
        row = rows[pairs.row[part]].reshape(-1, NODE_DOFS, count)
        column = columns[pairs.column[part]].reshape(-1, NODE_DOFS, count)
        np.matmul(row, column.transpose(0, 2, 1), out=blocks[part])
    return blocks.reshape(-1)[pairs.entry]


def _scatter(numbering: Numbering, held: Int[Array, " held"]) -> sp.csr_array:
    """Matrix that adds the nodal forces of elements to the free degrees of freedom."""
    equation = numbering.equation[numbering.element_dofs[held]].ravel()
    on_free = np.flatnonzero(equation >= 0)
    shape = (numbering.sparsity.size, len(equation))
    return sp.csr_array((np.ones(len(on_free)), (equation[on_free], on_free)), shape=shape)
