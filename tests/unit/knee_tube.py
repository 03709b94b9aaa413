"""A tapered tube that bends like a knee, and loads to go with it: a design task that is solved in seconds."""

from __future__ import annotations

import numpy as np

from hilbrace.biomech.joint_loads import JOINTS, JointLoads, without_muscles
from hilbrace.domain.deformation import deformation_gradients
from hilbrace.domain.domain import Domain
from hilbrace.domain.flatten import periodic_lscm, quasi_conformal
from hilbrace.domain.limb import Surface
from hilbrace.domain.seam import cut_along

HALF_LENGTH = 120.0
COORDINATES = 41


def tube(around: int = 24, along: int = 16) -> Surface:
    """A tapered tube about the y axis [mm], outward triangles, in rows from distal to proximal."""
    angle = 2 * np.pi * np.arange(around) / around
    height = np.linspace(-HALF_LENGTH, HALF_LENGTH, along + 1)
    radius = 55.0 + 10.0 * (height + HALF_LENGTH) / (2 * HALF_LENGTH)
    rows = [
        np.stack([r * np.cos(angle), np.full(around, y), r * np.sin(angle)], axis=1)
        for r, y in zip(radius, height, strict=True)
    ]
    triangles = []
    for row in range(along):
        for column in range(around):
            a, b = row * around + column, row * around + (column + 1) % around
            c, d = a + around, b + around
            triangles += [(a, c, b), (b, c, d)] if (row + column) % 2 else [(a, d, b), (a, c, d)]
    return Surface(np.concatenate(rows), np.array(triangles))


def bent(vertices: np.ndarray, flexion: float) -> np.ndarray:
    """The tube with its upper half turned about the z axis through the origin, smoothly."""
    share = 1.0 / (1.0 + np.exp(-vertices[:, 1] / 25.0))
    turn = -flexion * share
    x, y = vertices[:, 0], vertices[:, 1]
    turned = [np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, vertices[:, 2]]
    return np.stack(turned, axis=1)


def knee_loads(frames: int = 60, seconds: float = 1.0) -> JointLoads:
    """A landing-like motion of a left knee: it bends to 60 degrees, with some adduction and a peak force."""
    time = np.linspace(0.0, seconds, frames)
    pulse = np.sin(np.pi * time / seconds) ** 2
    joints = len(JOINTS)
    angles = np.zeros((frames, joints, 3))
    angles[:, :, 0] = np.deg2rad(5.0 + 55.0 * pulse)[:, None]
    angles[:, :, 1] = np.deg2rad(4.0 * pulse)[:, None]
    force = np.zeros((frames, joints, 3))
    force[:, :, 1] = -(300.0 + 900.0 * pulse)[:, None]
    force[:, :, 2] = (120.0 * pulse)[:, None]
    axes = np.zeros((frames, joints, 3, 3))
    axes[:, :, 0, 2], axes[:, :, 1, 0], axes[:, :, 2, 1] = -1.0, -1.0, -1.0
    return JointLoads(
        time=time,
        body_mass_kg=70.0,
        coordinate_names=tuple(f"coordinate_{index}" for index in range(COORDINATES)),
        coordinates=np.zeros((frames, COORDINATES)),
        muscles=80,
        joints=JOINTS,
        angles=angles,
        distal_rotation=np.broadcast_to(np.eye(3), (frames, joints, 3, 3)).copy(),
        joint_axes=axes,
        acting_force=force,
        acting_moment=np.zeros((frames, joints, 3)),
        convention="intersegmental",
        inertia=np.broadcast_to(np.diag([0.35, 0.35, 0.02]), (frames, joints, 3, 3)).copy(),
        distal_jacobian=np.concatenate([np.zeros_like(axes), np.swapaxes(axes, 2, 3)], axis=2),
        marker_names=("marker",),
        marker_error=np.zeros((frames, 1)),
        cutoff_hz=12.0,
        pelvis_residual_force=np.zeros((frames, 3)),
        **without_muscles(frames, joints, COORDINATES),
    )


def knee_domain(loads: JointLoads, around: int = 24, along: int = 16, frames: int = 5) -> Domain:
    """The tube as a design domain of a left knee."""
    surface = tube(around, along)
    lower, upper = np.arange(around), along * around + np.arange(around)
    cut = cut_along(surface, np.arange(along + 1) * around + around // 2)
    flat = periodic_lscm(surface.vertices, cut)
    kept = np.linspace(0, len(loads.time) - 1, frames).round().astype(int)
    joint = loads.joints.index("knee_l")
    posed = np.stack([bent(surface.vertices, loads.angles[frame, joint, 0]) for frame in kept])
    return Domain(
        joint="knee_l",
        vertices=surface.vertices,
        triangles=surface.triangles,
        upper_loop=upper,
        lower_loop=lower,
        cut_triangles=cut.triangles,
        weld=cut.weld,
        uv=flat.uv,
        seam_pairs=cut.pairs,
        flatten="periodic",
        period_u=flat.period_u,
        time=loads.time[kept],
        posed=posed,
        deformation=deformation_gradients(surface.vertices, posed, surface.triangles),
        quasi_conformal=quasi_conformal(surface.vertices[cut.weld], flat.uv, cut.triangles),
    )
