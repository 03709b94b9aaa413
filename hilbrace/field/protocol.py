"""What every field over the flat map can do, whatever it is made of."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor


@runtime_checkable
class Field(Protocol):
    """A function of the flat map with free parameters, prepared for one set of points.

    Two fields of one kind that are prepared for different points and given the same parameters are one
    function: where points coincide they agree, and along a period they close.
    """

    def start(self, seed: int, spread: float) -> Float[Tensor, "*layer"]:
        """Parameters of a nearly even field.

        Args:
            seed: Seed of what is random about them.
            spread: Size of its unevenness [-].
        """
        ...

    def logits(self, theta: Float[Tensor, "*layer"], contrast: float = 10.0) -> Float[Tensor, " point"]:
        """The field at the points, in the units of a sigmoid's argument; differentiable.

        Args:
            theta: Free parameters.
            contrast: How much a field's own unit counts for the sigmoid [-].
        """
        ...
