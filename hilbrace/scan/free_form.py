"""What the body model cannot be: a free displacement of the fitted skin towards the scan (stage two).

The skin is subdivided once by Loop's rule and moved along its normals. The displacement is the smoothest one,
in the sense of its Laplacian, that follows the scan; where nothing was scanned it goes on smoothly and fades.
"""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from hilbrace.body.body import ScannedBody
from hilbrace.scan.fit_limb import Limb, PosedLimb, limb_of, pose_limb, unposed, whole_body
from hilbrace.scan.fit_pose import LimbFit
from hilbrace.scan.nearest import border_vertices, nearest, vertex_normals
from hilbrace.scan.surface_scan import SurfaceScan

Array = np.ndarray

ROUNDS = 5
STIFFNESS = 2e-6
"""Weight of the squared Laplacian against the squared distance, a density of points apart [m^2]."""
HELD = 1e-3
"""Weight of the displacement itself [-]."""
REACH = 0.015
"""Points farther off in the first round are none of this surface; the reach shrinks to `LAST_REACH` [m]."""
LAST_REACH = 0.006
SOFT = 0.003
"""Distance at which a point's pull is halved [m]."""
FADE = 0.04
"""Distance from the border of the limb over which the displacement comes down to nothing [m]."""


@dataclass(frozen=True)
class FittedSkin:
    """A limb's skin after both stages, in the scan's frame.

    Attributes:
        fit: Shape and pose.
        vertices: Skin [m].
        triangles: Its triangles.
        model: The same skin before the displacement [m].
        part: Part that carries each vertex: 0 pelvis, then thigh, shank and foot of each side.
        joints: Joint centres [m].
        body: The whole body in the model's own pose, with the displacement.
    """

    fit: LimbFit
    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    model: Float[Array, "vertex 3"]
    part: Int[Array, " vertex"]
    joints: dict[str, Float[Array, "3"]]
    body: ScannedBody


def displaced(fit: LimbFit, scan: SurfaceScan) -> FittedSkin:
    """Move the fitted skin onto the scan.

    Args:
        fit: Shape and pose.
        scan: The scan.
    """
    limb = limb_of(fit.limb.model, fit.limb.sides)
    everything = whole_body(fit.limb.model, fit.limb.sides)
    posed = pose_limb(everything, fit.shape, fit.pose)
    finer, triangles = _subdivided(everything)
    belongs = np.zeros(len(posed.vertices))
    belongs[limb.vertex] = 1.0
    inside = np.asarray(finer @ belongs) > 0.99
    own = triangles[inside[triangles].all(axis=1)]
    vertex, flat = np.unique(own, return_inverse=True)
    patch = np.ascontiguousarray(flat.reshape(-1, 3))
    start = np.asarray(finer @ posed.vertices)[vertex]
    moved = _onto(start, patch, scan)
    faded = start + _fade(start, patch)[:, None] * (moved - start)
    weights = np.asarray(finer @ everything.weights)
    blend = np.einsum("vb,bij->vij", weights[vertex], _turns(everything.weights, posed))
    move = np.zeros((int(triangles.max()) + 1, 3))
    move[vertex] = unposed(blend, faded - start)
    return FittedSkin(
        fit=fit,
        vertices=faded,
        triangles=patch,
        model=start,
        part=np.asarray(weights)[vertex].argmax(axis=1),
        joints=posed.joints,
        body=_body(fit, finer, triangles, move),
    )


def _subdivided(limb: Limb) -> tuple[sparse.csr_matrix, Int[Array, "triangle 3"]]:
    """Loop's subdivision: the matrix that makes the finer vertices, and the finer triangles."""
    matrix, triangles = igl.loop_matrix(np.ascontiguousarray(limb.triangles), len(limb.vertex))
    return sparse.csr_matrix(matrix), np.asarray(triangles, dtype=np.int64)


def _onto(
    start: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"], scan: SurfaceScan
) -> Float[Array, "vertex 3"]:
    smooth = _roughness(start, triangles)
    step = max(1, len(scan.points) // 40000)
    points, normals = scan.points[::step], scan.normals[::step]
    moved = start
    for reach in np.geomspace(REACH, LAST_REACH, ROUNDS):
        near = nearest(points, moved, triangles)
        outward = vertex_normals(moved, triangles)
        facing = (near.normal * normals).sum(axis=1)
        weight = (near.distance < reach) / (1.0 + (near.distance / SOFT) ** 2)
        weight *= (facing if scan.oriented else np.abs(facing)) > 0.5
        weight *= ~near.beyond
        # A shift s of the vertices along their normals moves the place by the mean of s n along its normal.
        lever = near.share * np.einsum("pki,pi->pk", outward[near.corner], near.normal)
        rows = np.repeat(np.arange(len(points)), 3)
        slope = sparse.csr_matrix((lever.ravel(), (rows, near.corner.ravel())), (len(points), len(moved)))
        ahead = ((points - near.place) * near.normal).sum(axis=1)
        scale = len(moved) / max(1, len(points))
        sofar = ((moved - start) * outward).sum(axis=1)
        normal_matrix = scale * slope.T @ sparse.diags(weight) @ slope
        normal_matrix = normal_matrix + STIFFNESS * smooth + HELD * sparse.identity(len(moved))
        pull = scale * slope.T @ (weight * ahead) - STIFFNESS * smooth @ sofar - HELD * sofar
        shift = splu(sparse.csc_matrix(normal_matrix)).solve(pull)
        moved = moved + shift[:, None] * outward
    return np.ascontiguousarray(moved)


def _roughness(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> sparse.csr_matrix:
    """Integral of the squared Laplacian as a quadratic form."""
    stiffness = igl.cotmatrix(vertices, triangles)
    mass = np.asarray(igl.massmatrix(vertices, triangles, igl.MASSMATRIX_TYPE_VORONOI).diagonal())
    return sparse.csr_matrix(stiffness @ sparse.diags(np.reciprocal(mass)) @ stiffness)


def _fade(vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]) -> Float[Array, " vertex"]:
    """1 inside, coming down to 0 at the border of the limb."""
    edge = vertices[border_vertices(triangles, len(vertices))]
    share = np.clip(cKDTree(edge).query(vertices)[0] / FADE, 0.0, 1.0)
    return share**2 * (3.0 - 2.0 * share)


def _turns(weights: Float[Array, "vertex bone"], posed: PosedLimb) -> Float[Array, "bone 3 3"]:
    """The bones' own turns, from the blends of the vertices."""
    solved = np.linalg.lstsq(weights, posed.blend.reshape(len(weights), 9), rcond=None)[0]
    return solved.reshape(-1, 3, 3)


def _body(
    fit: LimbFit,
    finer: sparse.csr_matrix,
    triangles: Int[Array, "triangle 3"],
    move: Float[Array, "vertex 3"],
) -> ScannedBody:
    model = fit.limb.model
    joints = model.joints(fit.shape)
    return ScannedBody(
        model=model.name,
        sides=fit.limb.sides,
        shape=fit.shape,
        vertices=finer @ model.vertices(fit.shape) + move,
        triangles=triangles,
        raw_weights=finer @ model.bone_weights(),
        smoothed_on=finer @ model.template,
        joint_names=tuple(joints),
        joint_centres=np.stack(list(joints.values())),
    )
