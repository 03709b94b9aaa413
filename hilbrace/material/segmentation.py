"""Where the brace is firm and where it is soft: a cut of the skin by how much the motion strains it.

Skin that the motion hardly strains (low elastic energy) takes the firm microstructure, the rest the soft one
(paper, Sec. 3.3.2). Each triangle is first told apart by its energy, in one of two ways:

``spectral`` is the paper's, self-tuning spectral clustering. Energy over a limb is smooth and has no gap; its
clusters then part near the median, whatever monotone function of the energy is taken, since every sample
measures in its own scale. About half of the sleeve comes out soft, a ring around the whole shank with it, and
such a ring gives away the frontal stiffness that the firm cells were put there for.

``graphcut`` parts the energy where two classes have the largest variance between them (Otsu 1979), which
calls only the strongly strained skin soft.

In both ways the border is then straightened by the minimum cut of a graph over the triangles, which weighs
how surely each triangle belongs to its class against the length of the border (Greig, Porteous & Seheult
1989), and patches too small to matter join their surroundings: a clean-up without which the patterns would
meet along a ragged line, and in specks smaller than a cell.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow

from hilbrace.errors import GeometryError
from hilbrace.material.spectral import field_memberships

Array = np.ndarray
Method = Literal["graphcut", "spectral"]

BORDER_WEIGHT = {"graphcut": 0.15, "spectral": 1.0}
"""Price of a border one mean edge long, in sure memberships of one mean triangle."""
SMALLEST_PATCH = 0.02
"""Share of the whole area below which a patch is no region of its own."""
MOST_PATCHES = 4
"""Most patches of one label; smaller ones beyond that join their surroundings."""
_FLOW_UNITS = 10_000


def segment(
    energy_density: Float[Array, " triangle"],
    areas: Float[Array, " triangle"],
    triangles: Int[Array, "triangle 3"],
    vertices: Float[Array, "vertex 3"],
    method: Method = "graphcut",
) -> Bool[Array, " triangle"]:
    """Split the skin into firm (low energy) and soft (high energy) regions.

    Args:
        energy_density: Worst elastic energy density over the motion per triangle [-].
        areas: Areas of the triangles [mm^2].
        triangles: Vertex indices of the closed mesh.
        vertices: Positions [mm].
        method: How triangles are told apart; see above.

    Returns:
        True where firm. All firm if the energy is the same everywhere.

    Raises:
        GeometryError: An energy is not finite.
    """
    lost = np.flatnonzero(~np.isfinite(energy_density))
    if lost.size:
        raise GeometryError(
            f"the elastic energy of {lost.size} triangles is not finite",
            where=f"triangle {lost[0]} of the domain",
            hint="check the frames of the motion that pose the skin",
        )
    if np.ptp(energy_density) <= 1e-9 * np.abs(energy_density).max():
        return np.ones(len(triangles), dtype=bool)
    cost = _lowness(energy_density, areas, method) * areas / areas.mean()
    edges, pairs = dual_edges(triangles)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    firm = _minimum_cut(cost, pairs, BORDER_WEIGHT[method] * lengths / lengths.mean())
    return without_small_patches(firm, areas, pairs)


def otsu_threshold(value: Float[Array, " sample"], weight: Float[Array, " sample"]) -> float:
    """Value that splits weighted samples into two classes with the largest variance between them."""
    order = np.argsort(value, kind="stable")
    value, weight = value[order], weight[order] / weight.sum()
    below = np.cumsum(weight)[:-1]
    moment = np.cumsum(weight * value)
    mean, moment = moment[-1], moment[:-1]
    distinct = np.diff(value) > 0
    between = np.where(distinct, (mean * below - moment) ** 2 / (below * (1 - below)), -np.inf)
    best = int(np.argmax(between))
    return float((value[best] + value[best + 1]) / 2)


def dual_edges(triangles: Int[Array, "triangle 3"]) -> tuple[Int[Array, "edge 2"], Int[Array, "edge 2"]]:
    """Inner edges of a mesh: their two vertices, and the two triangles that share them."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort((owner, edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    shared = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    return edges[shared], np.stack([owner[shared], owner[shared + 1]], axis=1)


def patches(
    firm: Bool[Array, " triangle"], pairs: Int[Array, "edge 2"]
) -> tuple[Int[Array, " triangle"], Bool[Array, " patch"]]:
    """Connected patch of each triangle, and the label of each patch.

    Args:
        firm: Label of each triangle.
        pairs: Triangles that share an edge.
    """
    inside = firm[pairs[:, 0]] == firm[pairs[:, 1]]
    graph = coo_array((np.ones(inside.sum()), pairs[inside].T), shape=(len(firm), len(firm)))
    count, patch = connected_components(graph, directed=False)
    label = np.zeros(count, dtype=bool)
    label[patch] = firm
    return patch.astype(np.int64), label


def without_small_patches(
    firm: Bool[Array, " triangle"], areas: Float[Array, " triangle"], pairs: Int[Array, "edge 2"]
) -> Bool[Array, " triangle"]:
    """Give small patches the label around them, smallest first.

    Args:
        firm: Label of each triangle.
        areas: Areas of the triangles [mm^2].
        pairs: Triangles that share an edge.

    Returns:
        Labels whose patches are all at least `SMALLEST_PATCH` of the area, and at most `MOST_PATCHES` of each
        label.
    """
    firm = firm.copy()
    limit = SMALLEST_PATCH * areas.sum()
    while True:
        patch, label = patches(firm, pairs)
        size = np.bincount(patch, areas, minlength=len(label))
        crowded = np.bincount(label, minlength=2) > MOST_PATCHES
        candidates = (size < limit) | crowded[label.astype(int)]
        if len(label) == 1 or not candidates.any():
            return firm
        smallest = int(np.argmin(np.where(candidates, size, np.inf)))
        firm[patch == smallest] ^= True


def _lowness(
    energy: Float[Array, " triangle"], areas: Float[Array, " triangle"], method: Method
) -> Float[Array, " triangle"]:
    """How surely each triangle is one of low energy [-]: positive low, negative high, 1 a typical one."""
    if method == "spectral":
        return -field_memberships(energy, areas)
    energy = _capped(energy, areas)
    threshold = otsu_threshold(energy, areas)
    low = energy <= threshold
    spread = np.average(energy[~low], weights=areas[~low]) - np.average(energy[low], weights=areas[low])
    return (threshold - energy) / spread


def _capped(energy: Float[Array, " triangle"], areas: Float[Array, " triangle"]) -> Float[Array, " triangle"]:
    """Energy of which the highest share that is no patch by itself counts alike: a fold sets no threshold."""
    order = np.argsort(energy, kind="stable")
    share = np.cumsum(areas[order]) / areas.sum()
    return np.minimum(energy, energy[order[int(np.searchsorted(share, 1.0 - SMALLEST_PATCH))]])


def _minimum_cut(
    cost: Float[Array, " triangle"], pairs: Int[Array, "edge 2"], weight: Float[Array, " edge"]
) -> Bool[Array, " triangle"]:
    """Labels of least total cost: true earns ``cost``, a border costs ``weight``."""
    count = len(cost)
    source, sink = count, count + 1
    ends = np.round(cost * _FLOW_UNITS).astype(np.int32)
    border = np.round(weight * _FLOW_UNITS).astype(np.int32)
    gain, loss = np.flatnonzero(ends > 0), np.flatnonzero(ends < 0)
    rows = np.concatenate([np.full(len(gain), source), loss, pairs[:, 0], pairs[:, 1]])
    columns = np.concatenate([gain, np.full(len(loss), sink), pairs[:, 1], pairs[:, 0]])
    values = np.concatenate([ends[gain], -ends[loss], border, border])
    capacity = csr_array((values, (rows, columns)), shape=(count + 2, count + 2))
    residual = csr_array(capacity - maximum_flow(capacity, source, sink).flow)
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    reached = np.zeros(count + 2, dtype=bool)
    reached[breadth_first_order(residual, source, return_predecessors=False)] = True
    return reached[:count]
