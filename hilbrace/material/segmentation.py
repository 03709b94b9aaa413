"""Where the brace is firm and where it is soft: a cut of the skin by how much the motion strains it.

Skin that the motion hardly strains (low elastic energy) takes the firm microstructure, the rest the soft
one (paper, Sec. 3.3.2). The energy is cut at the threshold that best separates it into two classes (Otsu
1979), and the cut is straightened by the minimum cut of a graph over the triangles, which weighs each
triangle's distance from the threshold against the length of the border. Patches too small to matter join
their surroundings.

The energy itself is cut and not its logarithm: the logarithm calls half of the sleeve soft, a ring around
the whole shank with it, and such a ring gives away the frontal stiffness that the firm cells were put there
for.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, maximum_flow
from scipy.sparse.linalg import splu

Array = np.ndarray

BORDER_WEIGHT = 0.15
"""Price of a border one mean edge long, in class distances of one mean triangle."""
SMALLEST_PATCH = 0.02
"""Share of the whole area below which a patch is no region of its own."""
_FLOW_UNITS = 10_000


def segment(
    energy_density: Float[Array, " triangle"],
    areas: Float[Array, " triangle"],
    triangles: Int[Array, "triangle 3"],
    vertices: Float[Array, "vertex 3"],
) -> Bool[Array, " triangle"]:
    """Split the skin into firm (low energy) and soft (high energy) regions.

    Args:
        energy_density: Worst elastic energy density over the motion per triangle [-].
        areas: Areas of the triangles [mm^2].
        triangles: Vertex indices of the closed mesh.
        vertices: Positions [mm].

    Returns:
        True where firm. All firm if the energy is the same everywhere.
    """
    energy = energy_density
    if np.ptp(energy) <= 1e-9 * np.abs(energy).max():
        return np.ones(len(triangles), dtype=bool)
    threshold = otsu_threshold(energy, areas)
    low = energy <= threshold
    spread = np.average(energy[~low], weights=areas[~low]) - np.average(energy[low], weights=areas[low])
    edges, pairs = dual_edges(triangles)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    cost = (threshold - energy) / spread * areas / areas.mean()
    firm = _minimum_cut(cost, pairs, BORDER_WEIGHT * lengths / lengths.mean())
    return _without_small_patches(firm, areas, pairs)


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


def blend_map(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    firm: Bool[Array, " triangle"],
    width_mm: float,
) -> tuple[Float[Array, " vertex"], Float[Array, " triangle"]]:
    """Smooth the firm/soft map across a band (paper, Sec. 4.3: the blending map ``f_seg``).

    Solves ``(M + width^2 / 8 L) f = M chi`` with the lumped mass and the cotangent Laplacian, negative
    cotangents left out so that the values stay in [0, 1]. Across a straight border ``f`` climbs from 0.1 to
    0.9 within 1.14 ``width_mm``.

    Args:
        vertices: Positions [mm].
        triangles: Vertex indices of the closed mesh.
        firm: True where firm.
        width_mm: Width of the transition [mm].

    Returns:
        Firm fraction per vertex and per triangle [-].
    """
    laplacian, mass, chi = _blend_system(vertices, triangles, firm)
    system = diags_array(mass) + width_mm**2 / 8 * laplacian
    solution = splu(system.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
        mass * chi
    )
    fraction = np.clip(solution, 0.0, 1.0)
    return fraction, fraction[triangles].mean(axis=1)


def _minimum_cut(
    cost: Float[Array, " triangle"], pairs: Int[Array, "edge 2"], weight: Float[Array, " edge"]
) -> Bool[Array, " triangle"]:
    """Labels of least total cost: true earns ``cost``, a border costs ``weight`` (Greig et al. 1989)."""
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


def _without_small_patches(
    firm: Bool[Array, " triangle"], areas: Float[Array, " triangle"], pairs: Int[Array, "edge 2"]
) -> Bool[Array, " triangle"]:
    firm = firm.copy()
    limit = SMALLEST_PATCH * areas.sum()
    while True:
        inside = firm[pairs[:, 0]] == firm[pairs[:, 1]]
        graph = coo_array((np.ones(inside.sum()), pairs[inside].T), shape=(len(firm), len(firm)))
        count, patch = connected_components(graph, directed=False)
        size = np.bincount(patch, areas, minlength=count)
        smallest = int(np.argmin(size))
        if count == 1 or size[smallest] >= limit:
            return firm
        firm[patch == smallest] ^= True


def _blend_system(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], firm: Bool[Array, " triangle"]
) -> tuple[csr_array, Float[Array, " vertex"], Float[Array, " vertex"]]:
    count = len(vertices)
    p = vertices[triangles]
    double_area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    mass = np.bincount(triangles.ravel(), np.repeat(double_area / 6, 3), minlength=count)
    chi = np.bincount(triangles.ravel(), np.repeat(firm * double_area / 6, 3), minlength=count) / mass
    laplacian = csr_array((count, count))
    for k in range(3):
        i, j = triangles[:, (k + 1) % 3], triangles[:, (k + 2) % 3]
        a, b = vertices[i] - p[:, k], vertices[j] - p[:, k]
        half_cotangent = np.maximum((a * b).sum(axis=1) / double_area, 0.0) / 2
        weights = coo_array((half_cotangent, (i, j)), shape=(count, count)).tocsr()
        weights = weights + weights.T
        laplacian = laplacian + diags_array(weights.sum(axis=1)) - weights
    return csr_array(laplacian), mass, chi
