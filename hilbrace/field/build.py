"""The field that the settings ask for."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.config import OptimizeSettings
from hilbrace.field.gaussian import GaussianField
from hilbrace.field.network import NetworkField
from hilbrace.field.protocol import Field

Array = np.ndarray


def build_field(points_uv: Float[Array, "point 2"], settings: OptimizeSettings, period_u: float) -> Field:
    """Prepare a field for some points of the flat map.

    Args:
        points_uv: Points in the unit square.
        settings: The optimizer's settings: ``field`` and what belongs to each kind.
        period_u: Width of the map around the limb [uv units] where it closes; 0 for a map that is cut.

    Raises:
        GeometryError: A point lies outside the unit square.
    """
    if settings.field == "network":
        return NetworkField(points_uv, settings.network_layers, settings.network_waves, period_u)
    return GaussianField(points_uv, settings.sigma, period_u=period_u)
