"""Projection of the field into the range of the design variable.

The paper places a projection behind the layer that keeps d within [0, 1]. Here it is a sigmoid with one bias
for the whole brace, and a slope that a schedule may raise. The bias is free, or it is solved so that the
brace has exactly the wanted volume; then its derivative comes from the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from scipy.optimize import brentq

from hilbrace.errors import SolverError

_SATURATED = 36.0
"""A sigmoid of this argument is 1 to double precision, and of its opposite below 3e-16."""


def project(
    logits: Float[torch.Tensor, " point"], bias: float | Float[torch.Tensor, ""], sharpness: float = 1.0
) -> Float[torch.Tensor, " point"]:
    """Design variable ``d = sigmoid(sharpness (logits + bias))`` in (0, 1).

    Args:
        logits: The field.
        bias: Its level.
        sharpness: Slope of the projection against the plain sigmoid's [-].
    """
    level = logits + bias
    return torch.sigmoid(level if sharpness == 1.0 else sharpness * level)


def project_to_volume(
    logits: Float[torch.Tensor, " point"],
    volume_of_d: Callable[[Float[torch.Tensor, " point"]], Float[torch.Tensor, ""]],
    target: float,
    sharpness: float = 1.0,
) -> tuple[Float[torch.Tensor, " point"], Float[torch.Tensor, ""]]:
    """Project with the bias that meets a volume exactly.

    Both results carry exact first derivatives, also by whatever else ``volume_of_d`` depends on: the last
    Newton step of the solve is taken inside the graph, which is the implicit derivative
    ``d bias = -(d volume | bias fixed) / (d volume / d bias)``.

    Args:
        logits: Field at the points that make up the volume.
        volume_of_d: Volume (or volume fraction) of a design variable at these points; growing with it.
        target: Wanted value of that volume.
        sharpness: Slope of the projection, see `project`.

    Returns:
        The design variable at the points, and the bias [-] with which to `project` the field elsewhere.

    Raises:
        SolverError: No bias gives that volume.
    """
    frozen = logits.detach()

    def excess(bias: float) -> float:
        with torch.no_grad():
            return float(volume_of_d(project(frozen, bias, sharpness))) - target

    low = -_SATURATED / sharpness - float(frozen.max())
    high = _SATURATED / sharpness - float(frozen.min())
    at_low, at_high = excess(low), excess(high)
    if not at_low < 0.0 < at_high:
        raise SolverError(
            f"no design has the volume {target:g}",
            where=f"volumes from {target + at_low:g} to {target + at_high:g} can be reached",
            hint="set optimize.volume_fraction inside this range; wider cells (pattern.period_mm) or a "
            "smaller pattern.min_strut_mm widens it",
        )
    root = torch.tensor(brentq(excess, low, high, xtol=1e-14), dtype=torch.float64)
    slope = _slope(frozen, volume_of_d, root, sharpness)
    bias = root - (volume_of_d(project(logits, root, sharpness)) - target) / slope
    return project(logits, bias, sharpness), bias


def _slope(
    logits: Float[torch.Tensor, " point"],
    volume_of_d: Callable[[Float[torch.Tensor, " point"]], Float[torch.Tensor, ""]],
    bias: Float[torch.Tensor, ""],
    sharpness: float,
) -> Float[torch.Tensor, ""]:
    """Derivative of the volume by the bias."""
    with torch.enable_grad():
        moving = bias.detach().requires_grad_()
        (slope,) = torch.autograd.grad(volume_of_d(project(logits, moving, sharpness)), moving)
    return slope.detach()
