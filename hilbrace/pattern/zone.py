"""A neighbourhood of some places, outside of which work can be spared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

Array = np.ndarray


@dataclass(frozen=True)
class Zone:
    """All points near one of some places, or all points.

    Attributes:
        places: The places [mm]; ``None`` stands for everywhere.
        reach_mm: Distance up to which a point is near [mm].
    """

    places: Float[Array, "place 3"] | None
    reach_mm: float = 0.0

    def holds(self, points: Float[Array, "point 3"]) -> Bool[Array, " point"]:
        """Whether each point lies in the zone."""
        if self.places is None:
            return np.ones(len(points), dtype=bool)
        if not len(self.places):
            return np.zeros(len(points), dtype=bool)
        return np.isfinite(self._tree.query(points, distance_upper_bound=self.reach_mm, workers=-1)[0])

    def grown(self, by_mm: float) -> Zone:
        """The zone with a larger reach."""
        return self if self.places is None else Zone(self.places, self.reach_mm + by_mm)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.places)


EVERYWHERE = Zone(None)
