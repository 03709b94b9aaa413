"""Figures of the scaled musculoskeletal model, as the engine reports them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True)
class ModelFigures:
    """Names and inertial figures of a model.

    Attributes:
        name: Name of the model.
        coordinates: Coordinates that no other drives, in the model's order.
        defaults: Their values in the model's default pose [rad or m].
        locked: Those that the model locks by default.
        bodies: Rigid bodies, in the model's order.
        masses: Mass of each body [kg].
        centres: Centre of mass of each body in its frame [m].
        inertias: Inertia of each body about its centre of mass in its frame [kg*m^2].
        joint_centres: Centre of the joint that carries a body, in the body's frame [m].
        marker_bodies: Body that carries each of the model's markers.
        marker_locations: Place of each marker in its body [m].
        muscles: Number of muscles.
    """

    name: str
    coordinates: tuple[str, ...]
    defaults: Float[Array, " coordinate"]
    locked: tuple[str, ...]
    bodies: tuple[str, ...]
    masses: Float[Array, " body"]
    centres: Float[Array, "body 3"]
    inertias: Float[Array, "body 3 3"]
    joint_centres: dict[str, Float[Array, " 3"]]
    marker_bodies: dict[str, str]
    marker_locations: dict[str, Float[Array, " 3"]]
    muscles: int

    @property
    def mass_kg(self) -> float:
        """Mass of the whole model [kg]."""
        return float(self.masses.sum())

    def columns(self, coordinates: Sequence[str]) -> list[int]:
        """Places of some coordinates among all."""
        return [self.coordinates.index(name) for name in coordinates]

    def rows(self, bodies: Sequence[str]) -> list[int]:
        """Places of some bodies among all."""
        return [self.bodies.index(name) for name in bodies]
