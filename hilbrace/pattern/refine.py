"""A finer mesh of the skin that remembers where on the domain it came from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hilbrace.domain.domain import Domain

Array = np.ndarray


@dataclass(frozen=True)
class RefinedSkin:
    """The domain's triangles split into equal parts, closed around the limb.

    Attributes:
        vertices: Positions [mm].
        normals: Outward unit normals, interpolated from the domain's vertex normals [-].
        triangles: Vertex indices, outward.
        edges: Edges, each once.
        parent: Domain triangle that each vertex takes its values from.
        barycentric: Weights of that triangle's corners.
        loop_edges: Edges of the skin's own border: its two ends, and windows if it has some.
        loop: Number of the closed line that each of them belongs to.
        edge_mm: Mean length of an edge [mm].
    """

    vertices: Float[Array, "vertex 3"]
    normals: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    edges: Int[Array, "edge 2"]
    parent: Int[Array, " vertex"]
    barycentric: Float[Array, "vertex 3"]
    loop_edges: Int[Array, "loop_edge 2"]
    loop: Int[Array, " loop_edge"]
    edge_mm: float

    def from_vertices(
        self, triangles: Int[Array, "triangle 3"], value: Float[Array, " corner"]
    ) -> Float[Array, " vertex"]:
        """Values at the refined vertices, linear in the domain's triangles.

        Args:
            triangles: ``triangles`` or ``cut_triangles`` of the domain.
            value: Value at the vertices that these index.
        """
        return (value[triangles[self.parent]] * self.barycentric).sum(axis=1)


def refine(domain: Domain, resolution_mm: float) -> RefinedSkin:
    """Split every triangle of the domain into ``k * k`` equal ones whose edges are near the resolution.

    Points on shared edges are one vertex, also across the seam. Where two triangles share a point it takes
    its values from the one on the left of the seam, so that a map that does not close has one value there
    and the surface stays in one piece.

    Args:
        domain: The design domain.
        resolution_mm: Wanted edge length [mm].
    """
    p = domain.vertices[domain.triangles]
    edge = float(np.linalg.norm(p - p[:, [1, 2, 0]], axis=2).mean())
    k = max(1, int(np.ceil(edge / resolution_mm - 1e-9)))
    weights, small = _split_pattern(k)
    index, count = _weld(domain.triangles, len(domain.vertices), weights, k)

    # later entries win, so triangles right of the seam come first
    order = np.argsort(~np.isin(domain.cut_triangles, domain.seam_pairs[:, 1]).any(axis=1), kind="stable")
    parent, corner = np.zeros(count, dtype=np.intp), np.zeros(count, dtype=np.intp)
    parent[index[order].ravel()] = np.repeat(order, len(weights))
    corner[index[order].ravel()] = np.tile(np.arange(len(weights)), len(order))
    barycentric = weights[corner] / k

    normals = np.einsum("vk,vkx->vx", barycentric, vertex_normals(domain)[domain.triangles[parent]])
    triangles = index[:, small].reshape(-1, 3)
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    _, first, times = np.unique(_edge_code(edges, count), return_index=True, return_counts=True)
    loops = edges[np.sort(first[times == 1])]
    return RefinedSkin(
        vertices=np.einsum("vk,vkx->vx", barycentric, domain.vertices[domain.triangles[parent]]),
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        triangles=triangles,
        edges=edges[first],
        parent=parent,
        barycentric=barycentric,
        loop_edges=loops,
        loop=_loop_numbers(loops, count),
        edge_mm=edge / k,
    )


def vertex_normals(domain: Domain) -> Float[Array, "vertex 3"]:
    """Outward unit normals of the domain's vertices, triangles weighed by their angles there."""
    p = domain.vertices[domain.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    face /= np.linalg.norm(face, axis=1, keepdims=True)
    normals = np.zeros_like(domain.vertices)
    for k in range(3):
        a, b = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        np.add.at(normals, domain.triangles[:, k], angle[:, None] * face)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _split_pattern(k: int) -> tuple[Int[Array, "local 3"], Int[Array, "small 3"]]:
    """Integer barycentric weights (sum k) of the points of a split triangle, and its small triangles."""
    weights = np.array([(k - i - j, i, j) for i in range(k + 1) for j in range(k + 1 - i)])
    at = {(int(w[1]), int(w[2])): n for n, w in enumerate(weights)}
    up = [(at[i, j], at[i + 1, j], at[i, j + 1]) for i in range(k) for j in range(k - i)]
    down = [(at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]) for i in range(k) for j in range(k - i - 1)]
    return weights, np.array(up + down)


def _weld(
    triangles: Int[Array, "triangle 3"], vertices: int, weights: Int[Array, "local 3"], k: int
) -> tuple[Int[Array, "triangle local"], int]:
    """Number of each point of each split triangle: corners first, then points on edges, then inner ones."""
    sides = np.sort(triangles[:, [[1, 2], [2, 0], [0, 1]]], axis=2)
    edges, edge_of = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1, 3)
    inner_start = vertices + len(edges) * (k - 1)
    inner = np.flatnonzero((weights > 0).all(axis=1))
    index = np.empty((len(triangles), len(weights)), dtype=np.intp)
    for local, weight in enumerate(weights):
        zero = np.flatnonzero(weight == 0)
        if len(zero) == 2:
            index[:, local] = triangles[:, int(np.argmax(weight))]
        elif len(zero) == 1:
            side = int(zero[0])
            a, b = (side + 1) % 3, (side + 2) % 3
            steps = np.where(triangles[:, a] < triangles[:, b], weight[b], weight[a])
            index[:, local] = vertices + edge_of[:, side] * (k - 1) + steps - 1
        else:
            index[:, local] = (
                inner_start + np.arange(len(triangles)) * len(inner) + np.searchsorted(inner, local)
            )
    return index, inner_start + len(triangles) * len(inner)


def _loop_numbers(edges: Int[Array, "edge 2"], vertices: int) -> Int[Array, " edge"]:
    graph = coo_array((np.ones(len(edges), dtype=bool), edges.T), shape=(vertices, vertices))
    _, component = connected_components(graph, directed=False)
    return np.unique(component[edges[:, 0]], return_inverse=True)[1]


def _edge_code(edges: Int[Array, "edge 2"], vertices: int) -> Int[Array, " edge"]:
    return edges.min(axis=1) * vertices + edges.max(axis=1)
