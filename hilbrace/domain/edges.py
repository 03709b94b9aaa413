"""The planes that the sleeve ends at: at fractions of the segments, at landmarks, or anywhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.config.domain import DomainSettings, EdgeSettings
from hilbrace.domain.landmarks import find_landmark
from hilbrace.domain.limb import Limb, Surface
from hilbrace.errors import ConfigError, GeometryError

Array = np.ndarray

PRESETS = {"knee": (0.40, 0.38), "ankle": (0.42, 0.42)}
"""Upper and lower edge where none are asked for: fractions of the segments above and below the joint [-]."""

_BEYOND = {"knee": ("crotch", "foot"), "ankle": ("knee", "toes")}

_NEAREST = 10.0
"""Least distance of an edge from the joint [mm]."""


@dataclass(frozen=True)
class Edge:
    """A plane that the sleeve ends at.

    Attributes:
        key: Configuration key that asks for it.
        normal: Unit normal, away from the joint, in limb axes [-].
        offset: Distance of the plane from the joint along the normal [mm].
        beyond: What lies beyond, for messages.
    """

    key: str
    normal: Float[Array, " xyz"]
    offset: float
    beyond: str


def edges_at(limb: Limb, above: float | None, below: float | None) -> tuple[Edge, Edge]:
    """Edges across both segments at fractions of their lengths, the joint's preset where None.

    Args:
        limb: Axes of the limb.
        above: Upper edge, fraction of the segment above the joint [-].
        below: Lower edge, fraction of the segment below the joint [-].
    """
    high, low = (
        preset if wanted is None else wanted
        for preset, wanted in zip(PRESETS[limb.name], (above, below), strict=True)
    )
    over, under = _BEYOND[limb.name]
    return (
        Edge("domain.above", limb.proximal, high * float(limb.upper @ limb.proximal), over),
        Edge("domain.below", limb.distal, low * float(limb.lower @ limb.distal), under),
    )


def find_edges(skin: Surface, limb: Limb, settings: DomainSettings) -> tuple[Edge, Edge]:
    """The edges that a configuration asks for.

    Args:
        skin: Skin in limb axes [mm].
        limb: Axes of the limb.
        settings: Section ``domain``.

    Raises:
        ConfigError: An edge is given twice, or neither by a landmark nor by a plane.
        GeometryError: A landmark is not on the skin, or an edge lies on the wrong side of the joint.
    """
    upper, lower = edges_at(limb, settings.above, settings.below)
    if settings.upper_edge is not None:
        _check_once("upper_edge", "above", settings.above)
        upper = _described(skin, limb, settings.upper_edge, upper, "domain.upper_edge")
    if settings.lower_edge is not None:
        _check_once("lower_edge", "below", settings.below)
        lower = _described(skin, limb, settings.lower_edge, lower, "domain.lower_edge")
    for edge, axis, where in ((upper, limb.proximal, "above"), (lower, limb.distal, "below")):
        if edge.offset < _NEAREST or edge.normal @ axis < 0.3:
            raise GeometryError(
                f"the edge does not lie {where} the {limb.name} across the limb, with the joint in the brace",
                where=edge.key,
                hint=f"move it to a place at least {_NEAREST:g} mm {where} the joint's centre",
            )
    return upper, lower


def _check_once(edge: str, fraction: str, value: float | None) -> None:
    if value is not None:
        raise ConfigError(
            f"both domain.{fraction} and domain.{edge} say where the brace ends",
            where=f"domain.{edge}",
            hint="leave one of them out",
        )


def _described(skin: Surface, limb: Limb, wanted: EdgeSettings, preset: Edge, key: str) -> Edge:
    """An edge through a landmark or a point; across the segment unless another normal is given."""
    if (wanted.landmark is None) == (wanted.point_mm is None):
        raise ConfigError(
            "an edge is given by a landmark or by a point",
            where=key,
            hint=f"set either {key}.landmark or {key}.point_mm",
        )
    normal = preset.normal
    if wanted.normal is not None:
        given = limb.rest_frame(np.array(wanted.normal, float))
        if not np.linalg.norm(given) > 0.0:
            raise ConfigError(
                "a normal of no length names no plane", where=f"{key}.normal", hint="write e.g. [0, 1, 0.2]"
            )
        normal = given / np.linalg.norm(given)
        normal = normal if normal @ preset.normal > 0.0 else -normal
    if wanted.landmark is not None:
        point = find_landmark(skin, limb, wanted.landmark, f"{key}.landmark").position
    else:
        point = limb.rest_frame(np.array(wanted.point_mm, float))
    return Edge(key, normal, float(point @ normal) + wanted.offset_mm, preset.beyond)
