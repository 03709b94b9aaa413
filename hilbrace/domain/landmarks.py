"""Named places on the skin around a joint, found by rays from the limb's axis.

A place is given by how far along a segment the ray starts and by its direction in the segment's own axes, so
that it is the same place on every body, model or scan. Positions follow surface anatomy (e.g. Gray's Anatomy,
lower limb) to within about a centimetre: near enough to centre a window or a relief on, not to measure by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.domain.limb import Limb, Surface
from hilbrace.errors import ConfigError, GeometryError

Array = np.ndarray


@dataclass(frozen=True)
class Ray:
    """Where to look for a landmark.

    Attributes:
        along: Start on the axis: fraction of the segment above the joint, or less the fraction of the one
            below it [-].
        direction: Components to the front (dorsal on the foot), to the upper end, and lateral [-].
    """

    along: float
    direction: tuple[float, float, float]


LANDMARKS: dict[str, dict[str, Ray]] = {
    "knee": {
        "patella": Ray(0.03, (1.0, 0.0, 0.0)),
        "tibial_tuberosity": Ray(-0.11, (1.0, 0.0, 0.0)),
        "fibular_head": Ray(-0.08, (-0.5, 0.0, 1.0)),
        "lateral_condyle": Ray(0.0, (0.0, 0.0, 1.0)),
        "medial_condyle": Ray(0.0, (0.0, 0.0, -1.0)),
        "popliteal_fossa": Ray(0.0, (-1.0, 0.0, 0.0)),
    },
    "ankle": {
        "heel": Ray(0.0, (-1.0, -1.0, 0.0)),
        "lateral_malleolus": Ray(0.0, (0.0, 0.0, 1.0)),
        "medial_malleolus": Ray(0.02, (0.0, 0.0, -1.0)),
        "achilles_tendon": Ray(0.08, (-1.0, 0.0, 0.0)),
        "instep": Ray(-0.25, (1.0, 0.0, 0.0)),
        "navicular": Ray(-0.25, (0.3, 0.0, -1.0)),
        "fifth_metatarsal_base": Ray(-0.35, (-0.6, 0.0, 1.0)),
    },
}
"""Landmarks of each joint."""


@dataclass(frozen=True)
class Landmark:
    """A place on the skin.

    Attributes:
        name: Its name.
        position: Where the ray leaves the skin, in limb axes [mm].
        outward: Unit direction of the ray [-].
        upward: Unit direction on the skin towards the upper end of the limb [-].
    """

    name: str
    position: Float[Array, " xyz"]
    outward: Float[Array, " xyz"]
    upward: Float[Array, " xyz"]


def find_landmark(skin: Surface, limb: Limb, name: str, key: str) -> Landmark:
    """A named landmark on the skin around the joint.

    Args:
        skin: The skin in limb axes [mm].
        limb: Axes of the limb.
        name: One of `LANDMARKS` of the joint.
        key: Configuration key that names it.

    Raises:
        ConfigError: The joint has no landmark of this name.
        GeometryError: The skin is not met there.
    """
    known = LANDMARKS[limb.name]
    if name not in known:
        raise ConfigError(
            f"the {limb.name} has no landmark '{name}'",
            where=key,
            hint=f"landmarks of the {limb.name} are: {', '.join(known)}",
        )
    ray = known[name]
    start, axes = _segment(limb, ray.along)
    outward = np.array(ray.direction) @ axes
    outward /= np.linalg.norm(outward)
    distance = leaves_skin(skin, start, outward)
    if distance is None:
        raise GeometryError(
            f"no skin was met where the {name.replace('_', ' ')} should be",
            where=key,
            hint="fill the holes of the scan, or check that skin and joint centres share one frame",
        )
    # Behind a bent joint the limb's axis turns: there "up" leans with the ray.
    upward = axes[1] - (axes[1] @ outward) * outward
    return Landmark(name, start + distance * outward, outward, upward / np.linalg.norm(upward))


def leaves_skin(skin: Surface, start: Float[Array, " xyz"], direction: Float[Array, " xyz"]) -> float | None:
    """Distance along a ray at which it first leaves the skin [mm] (Moeller and Trumbore 1997).

    Args:
        skin: Triangles, outward.
        start: A point inside.
        direction: Unit direction of the ray.

    Returns:
        The distance, or None where the ray meets no skin from inside.
    """
    corner = skin.vertices[skin.triangles]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    across = np.cross(direction, second)
    volume = (first * across).sum(axis=1)
    outward = volume < 0.0
    scale = 1.0 / np.where(outward, volume, 1.0)
    away = start - corner[:, 0]
    u = (away * across).sum(axis=1) * scale
    turned = np.cross(away, first)
    v = (turned @ direction) * scale
    distance = (turned * second).sum(axis=1) * scale
    met = outward & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (distance > 0.0)
    return float(distance[met].min()) if met.any() else None


def _segment(limb: Limb, along: float) -> tuple[Float[Array, " xyz"], Float[Array, "3 3"]]:
    """A point on the limb's axis, and the front, upward and lateral direction of the segment there."""
    end = limb.upper if along >= 0.0 else limb.lower
    up = limb.proximal if along >= 0.0 else -limb.lower / np.linalg.norm(limb.lower)
    front = np.cross(up, [0.0, 0.0, 1.0])
    front /= np.linalg.norm(front)
    return abs(along) * end, np.stack([front, up, np.cross(front, up)])
