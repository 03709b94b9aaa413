"""The posed skin against the skeleton; around a bent knee no fold collapses and nothing crosses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hilbrace.body.body import Body
from hilbrace.body.posing import body_skeleton, bone_transforms, posed_skin
from hilbrace.body.skinning import bind, skin
from hilbrace.errors import InputError
from tests.unit.body_people import person

ANGLES = np.radians([60.0, 90.0, 100.0, 110.0])


def sleeve(body: Body, side: str = "r") -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the skin from 40 % of the thigh above the knee to 38 % of the shank below it."""
    hip, knee, ankle = (
        body.joint_centres[body.joint_names.index(f"{j}_{side}")] for j in ("hip", "knee", "ankle")
    )
    own = (
        body.bone_weights[:, [body.bones.index(f"{b}_{side}") for b in ("femur", "tibia")]].sum(axis=1) > 0.5
    )
    above, below = 0.40 * (hip - knee)[1], 0.38 * (knee - ankle)[1]
    up = body.vertices[:, 1] - knee[1]
    near = own & (up < above) & (-up < below)
    return body.vertices, body.triangles[near[body.triangles].all(axis=1)]


def refined(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle in four, new points half-way along the edges."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2)
    unique, place = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    middle = len(points) + place.reshape(-1, 3)
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([points, points[unique].mean(axis=1)]), np.concatenate(
        [np.stack(t, 1) for t in corners]
    )


def areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(points[..., triangles, :], -2, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=-1) / 2


def crossings(points: np.ndarray, triangles: np.ndarray) -> int:
    """Pairs of an edge and a triangle that pass through each other (Moeller & Trumbore 1997)."""
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    low, high = points[triangles].min(axis=1), points[triangles].max(axis=1)
    count = 0
    for part in np.array_split(edges, max(1, len(edges) // 400)):
        first, last = points[part].min(axis=1)[:, None], points[part].max(axis=1)[:, None]
        i, j = np.nonzero(((first <= high) & (last >= low)).all(axis=2))
        edge, face = part[i], triangles[j]
        apart = ~(face[:, :, None] == edge[:, None, :]).any(axis=(1, 2))
        origin, end = points[edge[apart, 0]], points[edge[apart, 1]]
        a, b, c = (points[face[apart, k]] for k in range(3))
        ray, u, v, offset = end - origin, b - a, c - a, origin - a
        normal, turned = np.cross(ray, v), np.cross(offset, u)
        det = (u * normal).sum(axis=1)
        flat = np.abs(det) < 1e-18
        det = np.where(flat, 1.0, det)
        x, y, t = ((p * q).sum(axis=1) / det for p, q in ((offset, normal), (ray, turned), (v, turned)))
        count += int((~flat & (x >= 0) & (y >= 0) & (x + y <= 1) & (t >= 0) & (t <= 1)).sum())
    return count


def bent_sleeve(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sleeve at rest, bent to `ANGLES`, and its triangles; refined flat, so that points stay on the skin."""
    points, triangles = sleeve(body)
    used, triangles = np.unique(triangles, return_inverse=True)
    points, triangles = refined(points[used], triangles.reshape(-1, 3))
    motion = bone_transforms(body, ["knee_angle_r"], ANGLES[:, None])
    return points, skin(points, bind(points, body), *motion), triangles


def test_crossings_are_found():
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [3, 3, 0.0]])
    assert crossings(square, np.array([[0, 1, 2], [3, 4, 5]])) == 2
    assert (
        crossings(square + np.array([[0, 0, 0]] * 3 + [[5, 0, 0]] * 3), np.array([[0, 1, 2], [3, 4, 5]])) == 0
    )


@pytest.mark.parametrize(("mass", "height"), [(75.0, 1.75), (55.0, 1.60), (90.0, 1.90)])
def test_the_skin_around_a_bent_knee_stays_whole(mass, height):
    rest, bent, triangles = bent_sleeve(person(mass, height))
    ratio = areas(bent, triangles) / areas(rest, triangles)
    assert ratio.min() > 0.25
    assert ratio.max() < 2.2
    for angle, points in zip(ANGLES, bent, strict=True):
        if np.degrees(angle) < 105:
            assert crossings(points, triangles) == 0


def test_raw_weights_would_fold_the_skin():
    """The check above can fail: without smoothing the hollow of the knee collapses."""
    rest, bent, triangles = bent_sleeve(person(smoothing_mm=0.0))
    ratio = areas(bent, triangles) / areas(rest, triangles)
    assert ratio[-1].min() < 0.15
    assert crossings(bent[-1], triangles) > 0


def test_zero_coordinates_are_the_neutral_pose():
    body = person()
    posed = posed_skin(body, ["knee_angle_r", "pelvis_ty"], np.zeros((2, 2)))
    np.testing.assert_allclose(posed, np.stack([body.vertices] * 2), atol=1e-12)


def test_the_pelvis_carries_everything_rigidly():
    body = person()
    names = ["pelvis_tilt", "pelvis_tx", "pelvis_ty", "pelvis_tz"]
    posed = posed_skin(body, names, np.array([[0.4, 1.0, 0.9, -0.3]]))[0]
    turn = Rotation.from_euler("z", 0.4).as_matrix()
    np.testing.assert_allclose(posed, body.vertices @ turn.T + [1.0, 0.9, -0.3], atol=1e-9)


def test_bones_move_as_the_skeleton_moves():
    """Joint centres carried by the bones on both of their sides, against the skeleton's own frames."""
    body = person()
    rng = np.random.default_rng(0)
    names = ["hip_flexion_l", "hip_adduction_l", "hip_rotation_l", "ankle_angle_l", "lumbar_extension"]
    values = rng.normal(0.0, 0.4, (5, len(names)))
    rotations, translations = bone_transforms(body, names, values)
    pose = body_skeleton(body).forward(dict(zip(names, values.T, strict=True)))
    for joint, distal, proximal in (("hip_l", "femur_l", "pelvis"), ("ankle_l", "talus_l", "tibia_l")):
        rest = body.joint_centres[body.joint_names.index(joint)]
        row = body.bones.index(proximal)
        carried = rotations[:, row] @ rest + translations[:, row]
        np.testing.assert_allclose(carried, np.broadcast_to(pose[distal].origin, (5, 3)), atol=1e-12)


def test_skin_far_from_the_joints_follows_its_bone():
    body = person()
    names, values = ["knee_angle_r", "hip_flexion_r"], np.radians([[70.0, 40.0]])
    posed = posed_skin(body, names, values)[0]
    rotations, translations = bone_transforms(body, names, values)
    shank = body.bones.index("tibia_r")
    own = body.bone_weights[:, shank] > 0.97
    rigid = body.vertices[own] @ rotations[0, shank].T + translations[0, shank]
    assert own.sum() > 30
    assert np.linalg.norm(posed[own] - rigid, axis=1).max() < 0.008


def test_knee_flexion_takes_the_heel_backward_and_up():
    body = person()
    posed = posed_skin(body, ["knee_angle_r"], np.radians([[90.0]]))[0]
    foot = body.bone_weights[:, body.bones.index("calcn_r")] > 0.9
    move = (posed - body.vertices)[foot].mean(axis=0)
    assert move[0] < -0.3
    assert move[1] > 0.3


def test_names_and_values_must_agree():
    with pytest.raises(InputError, match="2 coordinate names"):
        bone_transforms(person(), ["knee_angle_r", "knee_angle_l"], np.zeros((3, 1)))
    with pytest.raises(InputError, match="not a coordinate"):
        posed_skin(person(), ["knee"], np.zeros((1, 1)))
