"""Stiffness and damping of a joint about its recorded motion: what a brace works against.

A brace changes the angles of a joint by little, so that the joint answers it as a linear system about the
recorded motion: passive tissue, the muscles at the tension that they have, and damping. Inertia and the
Jacobian of the brace's wrench are part of `hilbrace.biomech.joint_loads.JointLoads` already.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.errors import ConfigError

Array = np.ndarray

SHORT_RANGE = 23.4
"""Stiffness of active fibres over tension, times optimal length [-] (Cui et al. 2008, J Biomech 41:1945)."""

TENDON_STIFFNESS = 1.375 / 0.049
"""Stiffness of a tendon at the muscle's greatest force, over that force, times slack length [-]: Millard et
al. 2013, J Biomech Eng 135:021005, with 4.9 % strain at that force."""

SLACK_SHARE = 0.05
"""Share of the greatest force below which a tendon gets no softer [-]."""

DAMPING_RATIO = 0.3
"""Damping ratio of the joint [-], an assumption. Zhang and Wang 2001 (J Biomech 34:1107) find the ratio of
the knee's frontal motion constant over muscle contraction, so that it holds for every stiffness."""

_PARTS = {"direct": np.eye(3), "coupled": np.ones((3, 3)), "none": np.zeros((3, 3))}
"""Entries of the muscles' stiffness that each kind keeps."""


def short_range_stiffness(
    tension: Float[Array, "frame muscle"],
    max_force: Float[Array, " muscle"],
    optimal_length: Float[Array, " muscle"],
    slack_length: Float[Array, " muscle"],
) -> Float[Array, "frame muscle"]:
    """Stiffness of muscles against small, quick stretches: fibres in series with tendon [N/m].

    The fibres' cross-bridges are as stiff as they pull (Cui et al. 2008). The tangent of a tendon falls with
    its force, as that of an exponential spring does.

    Args:
        tension: Tension of each muscle [N].
        max_force: Greatest isometric force [N].
        optimal_length: Optimal length of the fibres [m].
        slack_length: Slack length of the tendon [m].
    """
    pull = np.maximum(tension, 0.0)
    fibre = SHORT_RANGE * pull / optimal_length
    tendon = TENDON_STIFFNESS * np.maximum(pull, SLACK_SHARE * max_force) / slack_length
    return fibre * tendon / (fibre + tendon)


def muscle_stiffness(loads: JointLoads, joint: str, kind: str = "coupled") -> Float[Array, "frame 3 3"]:
    """What the muscles add to the stiffness of a joint about its three angles [N*m/rad].

    ``R diag(k) R^T`` of their short-range stiffnesses k and moment arms R, and the geometric part, by which
    moment arms change. The sum is freed of negative eigenvalues: a joint that its muscles alone would let
    buckle is held by what the passive stiffness stands for.

    Muscles of constant activation couple the angles: the knee that a sleeve hinders in flexion would turn in
    adduction by more than the sleeve's frontal stiffness turns it back. People restore their flexion by
    activation instead, so that ``"direct"`` leaves these terms out.

    Args:
        loads: Tensions, moment arms and geometric stiffness; without muscles the result is zero.
        joint: One of the record's joints.
        kind: ``"coupled"`` for the whole matrix, ``"direct"`` for its diagonal, ``"none"`` for nothing.

    Raises:
        ConfigError: There is no such kind.
    """
    if kind not in _PARTS:
        raise ConfigError(
            f"no such muscle stiffness: {kind!r}",
            where="optimize.muscle_stiffness",
            hint=f"use {', '.join(_PARTS)}",
        )
    at = loads.joints.index(joint)
    along = short_range_stiffness(
        loads.muscle_force, loads.muscle_max_force, loads.muscle_optimal_length, loads.muscle_slack_length
    )
    arms = loads.muscle_arms[:, at]
    whole = np.einsum("fim,fm,fjm->fij", arms, along, arms) + loads.geometric_stiffness[:, at]
    return nearest_semidefinite(whole) * _PARTS[kind]


def nearest_semidefinite(matrices: Float[Array, "frame 3 3"]) -> Float[Array, "frame 3 3"]:
    """The nearest symmetric matrices without negative eigenvalues (Higham 1988)."""
    values, vectors = np.linalg.eigh(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))
    return np.einsum("fik,fk,fjk->fij", vectors, np.maximum(values, 0.0), vectors)


def proportional_damping(
    inertia: Float[Array, "frame 3 3"], stiffness: Float[Array, "frame 3 3"], ratio: float = DAMPING_RATIO
) -> Float[Array, "frame 3 3"]:
    """Damping that gives every mode of vibration of the joint one damping ratio [N*m*s/rad].

    ``C = 2 ratio M^1/2 (M^-1/2 K M^-1/2)^1/2 M^1/2``; on one axis ``2 ratio sqrt(K M)``.

    Args:
        inertia: Inertia about the joint's angles [kg*m^2], positive definite.
        stiffness: Stiffness about them [N*m/rad], without negative eigenvalues.
        ratio: Damping ratio [-].
    """
    root = _power(inertia, 0.5)
    inverse = _power(inertia, -0.5)
    damping = 2.0 * ratio * root @ _power(inverse @ stiffness @ inverse, 0.5) @ root
    return 0.5 * (damping + np.swapaxes(damping, 1, 2))


def _power(matrices: Float[Array, "frame 3 3"], exponent: float) -> Float[Array, "frame 3 3"]:
    values, vectors = np.linalg.eigh(0.5 * (matrices + np.swapaxes(matrices, 1, 2)))
    lifted = np.maximum(values, 1e-12 * values[:, -1:]) ** exponent
    return np.einsum("fik,fk,fjk->fij", vectors, lifted, vectors)
