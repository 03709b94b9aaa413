"""Which recorded marker sits where on the model, and whether the markers suffice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.errors import InputError

if TYPE_CHECKING:
    from hilbrace.motion.marker_maps import MarkerMap

Array = np.ndarray

SOFT = frozenset(
    f"{side}{name}"
    for side in "RL"
    for name in ("UA1", "UA2", "UA3", "TH1", "TH2", "TH3", "TB1", "TB2", "TB3", "FAsuperior")
)
"""Markers of the model that sit on flesh, where no two people put them alike: they follow the static pose."""

SOFT_WEIGHT = 0.01
"""Weight of such a marker in the static pose, against 1 for a bony landmark [-]."""

SEGMENTS = (
    ("pelvis", ("pelvis",), 3),
    ("right thigh", ("femur_r",), 2),
    ("left thigh", ("femur_l",), 2),
    ("right shank", ("tibia_r",), 2),
    ("left shank", ("tibia_l",), 2),
    ("right foot", ("talus_r", "calcn_r", "toes_r"), 2),
    ("left foot", ("talus_l", "calcn_l", "toes_l"), 2),
)
"""Segments that a motion must show: name, bodies, least number of markers."""


@dataclass(frozen=True)
class PlacedMarkers:
    """Markers on bodies of the model.

    Attributes:
        names: Names as in the recording.
        bodies: Body that carries each.
        locations: Place in that body [m].
        weights: Weight in the fit [-].
    """

    names: tuple[str, ...]
    bodies: tuple[str, ...]
    locations: Float[Array, "marker 3"]
    weights: Float[Array, " marker"]

    def of(self, names: Iterable[str]) -> PlacedMarkers:
        """Those of some names, in this order."""
        wanted = set(names)
        kept = [k for k, name in enumerate(self.names) if name in wanted]
        return PlacedMarkers(
            tuple(self.names[k] for k in kept),
            tuple(self.bodies[k] for k in kept),
            self.locations[kept],
            self.weights[kept],
        )


def landmarks_on_model(marker_map: MarkerMap, figures: ModelFigures) -> PlacedMarkers:
    """The map's landmarks at the model's own places, bony ones with weight 1.

    Raises:
        InputError: The map names a marker or a body that the model lacks.
    """
    unknown = sorted(set(marker_map.landmarks.values()) - set(figures.marker_bodies))
    unknown += sorted(set(marker_map.clusters.values()) - set(figures.bodies))
    if unknown:
        raise InputError(
            f"the model has no {', '.join(unknown)}",
            where=f"marker map '{marker_map.name}'",
            hint="use names of the model's markers for landmarks and of its bodies for clusters",
        )
    on_model = list(marker_map.landmarks.values())
    return PlacedMarkers(
        tuple(marker_map.landmarks),
        tuple(figures.marker_bodies[name] for name in on_model),
        np.array([figures.marker_locations[name] for name in on_model]).reshape(-1, 3),
        np.array([SOFT_WEIGHT if name in SOFT else 1.0 for name in on_model]),
    )


def markers_of_model(figures: ModelFigures) -> PlacedMarkers:
    """All markers that a user's model brings, with weight 1."""
    names = tuple(figures.marker_bodies)
    return PlacedMarkers(
        names,
        tuple(figures.marker_bodies[name] for name in names),
        np.array([figures.marker_locations[name] for name in names]).reshape(-1, 3),
        np.ones(len(names)),
    )


def check_segments(
    markers: PlacedMarkers, recorded: Sequence[str], expected: Iterable[str], where: str, known: Iterable[str]
) -> None:
    """Refuse a set of markers that leaves a segment loose.

    Args:
        markers: Markers that both the recording and the model have.
        recorded: Names in the recording.
        expected: Names that the map or model knows.
        where: What is checked, for the message.
        known: Names that need no mention (those the map ignores).

    Raises:
        InputError: A segment has too few markers; lists unmatched names both ways.
    """
    for segment, bodies, least in SEGMENTS:
        found = [name for name, body in zip(markers.names, markers.bodies, strict=True) if body in bodies]
        if len(found) < least:
            strange, missing = unmatched(recorded, expected, known)
            raise InputError(
                f"{segment}: {len(found)} markers, {least} are needed; in the recording but unknown: "
                f"{', '.join(strange) or 'none'}; expected but not in the recording: "
                f"{', '.join(missing) or 'none'}",
                where=where,
                hint="rename the markers, or write a marker map with these names and set motion.marker_map",
            )


def unmatched(
    recorded: Iterable[str], expected: Iterable[str], known: Iterable[str]
) -> tuple[list[str], list[str]]:
    """Recorded names that nobody expects, and expected names that are not recorded, both sorted."""
    recorded, expected, known = set(recorded), set(expected), set(known)
    return sorted(recorded - expected - known), sorted(expected - recorded)
