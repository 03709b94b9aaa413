"""What every body model with shape coefficients gives, so that one fit serves them all."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray


@runtime_checkable
class BodyModel(Protocol):
    """A closed skin that is linear in its shape coefficients, with joints; OpenSim axes, metres.

    Its pose does not matter much (A-pose, T-pose, the skeleton's zero): `hilbrace.body.neutral.place` brings
    it onto the skeleton's neutral pose. From there on the skeleton moves it by OpenSim's coordinates, so that
    all models have the same joints: knees with three rotations among them.
    """

    @property
    def name(self) -> str:
        """Name of the model, as the body's record keeps it."""
        ...

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names of the shape coefficients."""
        ...

    @property
    def spread(self) -> Float[Array, " coefficient"]:
        """Standard deviation of each coefficient in the population."""
        ...

    @property
    def template(self) -> Float[Array, "vertex 3"]:
        """Skin of the mean person [m]."""
        ...

    @property
    def directions(self) -> Float[Array, "coefficient vertex 3"]:
        """Change of the skin per unit of each coefficient [m]."""
        ...

    @property
    def triangles(self) -> Int[Array, "triangle 3"]:
        """Closed skin, counter-clockwise from outside."""
        ...

    def vertices(self, shape: Float[Array, " coefficient"]) -> Float[Array, "vertex 3"]:
        """Skin of one person [m]; coefficients that are left out are zero."""
        ...

    def joints(self, shape: Float[Array, " coefficient"]) -> dict[str, Float[Array, " 3"]]:
        """Joint centres by name and side [m]: hips, knees, ankles, shoulders, elbows, wrists at least."""
        ...

    def joint_moves(self) -> dict[str, Float[Array, "coefficient 3"]]:
        """Change of the joint centres per unit of each coefficient [m]."""
        ...

    def bone_weights(self) -> Float[Array, "vertex bone"]:
        """Skinning weights on the skeleton's bodies, in the order of `hilbrace.body.segments.BONES`."""
        ...
