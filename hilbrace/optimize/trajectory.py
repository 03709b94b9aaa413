"""The trajectory of a linear system of three angles, and the exact adjoint of its integrator.

``M dd + C d + K delta = tau`` with matrices that change over time, by Newmark's average acceleration (1959),
which neither gains nor loses energy by itself. The motion starts in static equilibrium, ``K delta = tau``.
With the trapezoidal rule for angles and velocities the whole path solves one block-triangular linear system
``A delta = tau``; its adjoint ``A^T lambda = g`` is the same recursion run backwards, and gives

    dL/dtau = lambda,  dL/dK = -lambda delta^T,  dL/dC = -lambda velocity^T,  dL/dM = -lambda acceleration^T

instant by instant (implicit function theorem).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

Array = np.ndarray


def trajectory(
    inertia: Float[Tensor, "instant 3 3"],
    damping: Float[Tensor, "instant 3 3"],
    stiffness: Float[Tensor, "instant 3 3"],
    torque: Float[Tensor, "instant 3"],
    step: float,
) -> Float[Tensor, "instant 3"]:
    """Angles that follow a torque, differentiable by all four.

    Args:
        inertia: M [kg*m^2].
        damping: C [N*m*s/rad].
        stiffness: K [N*m/rad], regular.
        torque: tau [N*m].
        step: Time between instants [s].

    Returns:
        delta [rad].
    """
    return _Trajectory.apply(inertia, damping, stiffness, torque, step)


class _Trajectory(torch.autograd.Function):
    """(M, C, K, tau) -> delta."""

    @staticmethod
    def forward(
        ctx: Any, inertia: Tensor, damping: Tensor, stiffness: Tensor, torque: Tensor, step: float
    ) -> Tensor:
        mass, drag, spring, load = (
            tensor.detach().numpy() for tensor in (inertia, damping, stiffness, torque)
        )
        of_mass, of_drag = 4.0 / step**2, 2.0 / step
        effective = spring + of_mass * mass + of_drag * drag
        effective[0] = spring[0]
        inverse = np.linalg.inv(effective)
        path = np.zeros((3, *load.shape))
        position, velocity, acceleration = path[0], path[1], path[2]
        position[0] = inverse[0] @ load[0]
        for now in range(1, len(load)):
            q, v, a = path[:, now - 1]
            carried = mass[now] @ (of_mass * q + 2.0 * of_drag * v + a) + drag[now] @ (of_drag * q + v)
            position[now] = inverse[now] @ (load[now] + carried)
            moved = position[now] - q
            velocity[now] = of_drag * moved - v
            acceleration[now] = of_mass * moved - 2.0 * of_drag * v - a
        ctx.system = mass, drag, inverse, path, of_mass, of_drag
        return torch.from_numpy(position.copy())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        mass, drag, inverse, path, of_mass, of_drag = ctx.system
        gradient = grad_outputs[0].numpy()
        multiplier = np.empty_like(gradient)
        by_q = by_v = by_a = np.zeros(3)
        for now in range(len(gradient) - 1, 0, -1):
            by_moved = of_drag * by_v + of_mass * by_a
            multiplier[now] = inverse[now].T @ (gradient[now] + by_q + by_moved)
            through_mass, through_drag = mass[now].T @ multiplier[now], drag[now].T @ multiplier[now]
            by_q = of_mass * through_mass + of_drag * through_drag - by_moved
            by_v, by_a = (
                2.0 * of_drag * (through_mass - by_a) + through_drag - by_v,
                through_mass - by_a,
            )
        multiplier[0] = inverse[0].T @ (gradient[0] + by_q)
        position, velocity, acceleration = (-multiplier[:, :, None] * part[:, None, :] for part in path)
        return *map(torch.from_numpy, (acceleration, velocity, position, multiplier)), None
