"""The joint's response as a CasADi function, for people who bring their own optimal control problem.

It is the same map as `hilbrace.optimize.joint_response`, written down once more: all instants as one sparse
linear system in angles, velocities and accelerations, which CasADi solves and differentiates by the implicit
function theorem. Nothing else in hilbrace needs it, and no process may load it beside OpenSim: the two wheels
carry different builds of one library.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi
import numpy as np
from jaxtyping import Float

from hilbrace.errors import ConfigError
from hilbrace.optimize.joint_response import JointMotion

Array = np.ndarray

ANGLES = 3


def joint_response_function(motion: JointMotion, coupling: str = "stiffness") -> casadi.Function:
    """What a brace does to the angles of a joint, as a ``casadi.Function`` with named inputs and outputs.

    For T instants the input is

    * ``"stiffness"``: ``brace_stiffness`` (3, 3 T), the brace's stiffness about the three angles at each
      instant, side by side [N*m/rad];
    * ``"paper"``: ``wrench`` (6, T), force [N] and moment about the joint's centre [N*m] of the brace on the
      part below the joint, in the frame of the brace;

    and the outputs are ``angles`` and ``angle_change`` (3, T) [rad]. The function differentiates itself:
    ``function.jacobian()``, or through any expression that calls it.

    Args:
        motion: The joint's motion and constants; from a run by
            ``joint_motion(load(JointLoads, Path("run/biomech/biomech.npz")), "knee_l", (0.5, 5.0, 1.5))``.
        coupling: ``"stiffness"`` or ``"paper"``.

    Raises:
        ConfigError: There is no such coupling.

    Example:
        How stiff must a brace be in the frontal plane to take a tenth of a degree off the largest adduction
        of a landing? CasADi's Newton solver finds out:

        >>> import casadi, numpy, torch
        >>> from hilbrace.optimize.casadi_response import joint_response_function
        >>> from hilbrace.optimize.joint_response import JointMotion
        >>> time = numpy.linspace(0.0, 1.0, 61)
        >>> pulse = numpy.sin(numpy.pi * time) ** 2
        >>> angles = numpy.outer(pulse, [1.0, 0.08, 0.05])
        >>> each = lambda matrix: numpy.broadcast_to(matrix, (61, *numpy.shape(matrix))).copy()
        >>> inertia, damping = each(numpy.diag([0.35, 0.35, 0.02])), each(numpy.diag([1.9, 6.0, 0.8]))
        >>> stiffness = each(numpy.diag([29.0, 286.0, 86.0]))
        >>> jacobian = each(numpy.vstack([numpy.zeros((3, 3)), numpy.eye(3)]))
        >>> constants = (time, angles, inertia, damping, stiffness, jacobian)
        >>> motion = JointMotion(*map(torch.from_numpy, constants))
        >>> response = joint_response_function(motion, "stiffness")
        >>> response.name_in(), response.size_in(0), response.name_out()
        (['brace_stiffness'], (3, 183), ['angles', 'angle_change'])
        >>> frontal = casadi.MX.sym("frontal")
        >>> brace = casadi.diag(casadi.vertcat(0, frontal, 0))
        >>> change = response(brace_stiffness=casadi.repmat(brace, 1, 61))["angle_change"]
        >>> wanted = change[1, 30] + numpy.deg2rad(0.1)
        >>> solve = casadi.rootfinder("solve", "newton", {"x": frontal, "g": wanted})
        >>> print(f"{float(solve(x0=1.0)['x']):.2f} N*m/rad")
        6.28 N*m/rad
    """
    written = _WRITTEN.get(coupling)
    if written is None:
        raise ConfigError(
            f"no such coupling: {coupling!r}", where="optimize.coupling", hint=f"use {', '.join(_WRITTEN)}"
        )
    name, given, spring, torque = written(motion)
    change = _solve(motion, spring, torque)
    return casadi.Function(
        f"joint_response_{coupling}",
        [given],
        [_columns(motion.angles.numpy()) + change, change],
        [name],
        ["angles", "angle_change"],
    )


Written = tuple[str, casadi.MX, list[casadi.MX], list[casadi.MX]]
"""Name and symbol of an input, stiffness of joint and brace, and torque of the brace, at every instant."""


def _by_stiffness(motion: JointMotion) -> Written:
    brace = casadi.MX.sym("brace_stiffness", ANGLES, ANGLES * len(motion.time))
    parts = casadi.horzsplit(brace, ANGLES)
    joint = motion.stiffness.numpy()
    spring = [casadi.DM(own) + part for own, part in zip(joint, parts, strict=True)]
    angles = motion.angles.numpy()
    torque = [-(part @ casadi.DM(angle)) for part, angle in zip(parts, angles, strict=True)]
    return "brace_stiffness", brace, spring, torque


def _by_wrench(motion: JointMotion) -> Written:
    wrench = casadi.MX.sym("wrench", 6, len(motion.time))
    spring = [casadi.MX(casadi.DM(own)) for own in motion.stiffness.numpy()]
    jacobian = motion.jacobian.numpy()
    torque = [casadi.DM(j).T @ wrench[:, now] for now, j in enumerate(jacobian)]
    return "wrench", wrench, spring, torque


_WRITTEN: dict[str, Callable[[JointMotion], Written]] = {"stiffness": _by_stiffness, "paper": _by_wrench}


def _solve(motion: JointMotion, spring: list[casadi.MX], torque: list[casadi.MX]) -> casadi.MX:
    """Angles (3, T) from the equations of all instants.

    Unknowns of an instant are the angles q, velocities h v and accelerations h^2 a over its step h, so that
    all rows are of one size: ``M a + C v + K q = tau``, and the trapezoidal rule for q and v.
    """
    count, step = len(motion.time), motion.step
    one, none = casadi.DM.eye(ANGLES), casadi.DM(ANGLES, ANGLES)
    tie = casadi.vertcat(casadi.horzcat(one, -0.5 * one, none), casadi.horzcat(none, one, -0.5 * one))
    carry = casadi.vertcat(casadi.horzcat(-one, -0.5 * one, none), casadi.horzcat(none, -one, -0.5 * one))
    start = casadi.horzcat(casadi.DM(2 * ANGLES, ANGLES), casadi.DM.eye(2 * ANGLES))
    rows = []
    for now in range(count):
        drag, mass = motion.damping[now].numpy() / step, motion.inertia[now].numpy() / step**2
        dynamic = casadi.horzcat(spring[now], casadi.DM(drag), casadi.DM(mass))
        own = casadi.vertcat(dynamic, tie if now else start)
        before = [casadi.vertcat(casadi.DM(ANGLES, 3 * ANGLES), carry)] if now else []
        first = 3 * ANGLES * (now - len(before))
        last = 3 * ANGLES * (count - now - 1)
        parts = [casadi.DM(3 * ANGLES, first), *before, own, casadi.DM(3 * ANGLES, last)]
        rows.append(casadi.horzcat(*parts))
    still = casadi.DM(2 * ANGLES, 1)
    loads = casadi.vertcat(*(casadi.vertcat(moment, still) for moment in torque))
    found = casadi.solve(casadi.vertcat(*rows), loads, "csparse")
    return casadi.reshape(found, 3 * ANGLES, count)[:ANGLES, :]


def _columns(values: Float[Array, "instant 3"]) -> casadi.DM:
    return casadi.DM(values.T)
