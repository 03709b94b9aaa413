"""Which recorded marker sits where on the model, and whether the markers suffice."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.errors import InputError
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

BEHIND = {"RPSI": 0.3, "LPSI": 0.3}
"""Weight of the posterior iliac spines in the standing pose, against 1 for the anterior ones [-].

Flesh and marker put both apart from the bone, those behind two to three times as far; equal weights would
carry the hips back by a centimetre and bend the standing knee by two degrees.
"""
TORSO_WEIGHT = 0.5
ARM_WEIGHT = 0.1
"""Weights of markers above the pelvis, against 1 for pelvis and legs [-].

The shoulder girdle moves on the trunk and the model's does not, so that these markers would pull the pelvis.
Published tasks for such models weigh trunk by 5 and arms by 1 to 2 where pelvis and legs have 10 to 20
(``ik_tasks_walk.xml`` of Rajagopal et al. 2016; likewise the tasks of Modenese, Barzan & Carty 2021 for the
knee challenge).
"""

SEGMENTS = (
    ("pelvis", ("pelvis",), 3, 3),
    ("right thigh", ("femur_r",), 2, 1),
    ("left thigh", ("femur_l",), 2, 1),
    ("right shank", ("tibia_r",), 2, 1),
    ("left shank", ("tibia_l",), 2, 1),
    ("right foot", ("talus_r", "calcn_r", "toes_r"), 2, 1),
    ("left foot", ("talus_l", "calcn_l", "toes_l"), 2, 1),
)
"""Segments that must show: name, bodies, least number of markers in motion, of landmarks while standing."""


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


def weight_of(body: str) -> float:
    """Weight of a marker on a body in the fit [-]."""
    if body == "torso":
        return TORSO_WEIGHT
    arm = body.partition("_")[0] in ("humerus", "ulna", "radius", "hand")
    return ARM_WEIGHT if arm else 1.0


def _standing_weight(name: str, body: str) -> float:
    return weight_of(body) * (SOFT_WEIGHT if name in SOFT else BEHIND.get(name, 1.0))


def with_ankle_centres(
    markers: PlacedMarkers, measured: Float[Array, "frame marker 3"], on_model: dict[str, str]
) -> tuple[PlacedMarkers, Float[Array, "frame marker 3"]]:
    """Replace the two malleoli of a leg by the point between them.

    The direction from one to the other is the shank's torsion, which is anatomy and differs by 20 deg
    between people; the model's is a given. Left in, it would turn the knee and the thigh.

    Args:
        markers: Landmarks at the model's places.
        measured: Their measured places [m].
        on_model: The model's marker that each name stands for.
    """
    locations, measured, weights = markers.locations.copy(), measured.copy(), markers.weights.copy()
    place = {on_model[name]: k for k, name in enumerate(markers.names)}
    for side in "RL":
        pair = [place.get(f"{side}{name}") for name in ("LMAL", "MMAL")]
        both = [k for k in pair if k is not None]
        if len(both) == 2:
            locations[both] = locations[both].mean(axis=0)
            measured[:, both] = measured[:, both].mean(axis=1, keepdims=True)
    return PlacedMarkers(markers.names, markers.bodies, locations, weights), measured


def landmarks_on_model(marker_map: MarkerMap, figures: ModelFigures) -> PlacedMarkers:
    """The map's landmarks at the model's own places, flesh weighted down."""
    on_model = list(marker_map.landmarks.values())
    bodies = tuple(figures.marker_bodies[name] for name in on_model)
    return PlacedMarkers(
        tuple(marker_map.landmarks),
        bodies,
        np.array([figures.marker_locations[name] for name in on_model]).reshape(-1, 3),
        np.array([_standing_weight(name, body) for name, body in zip(on_model, bodies, strict=True)]),
    )


def markers_of_model(figures: ModelFigures) -> PlacedMarkers:
    """All markers that a user's model brings, with weight 1, as OpenSim's own tool takes them."""
    names, bodies = tuple(figures.marker_bodies), tuple(figures.marker_bodies.values())
    locations = np.array([figures.marker_locations[name] for name in names]).reshape(-1, 3)
    return PlacedMarkers(names, bodies, locations, np.ones(len(names)))


def segments_lacking(markers: PlacedMarkers, standing: bool = False) -> tuple[str, ...]:
    """Segments that the markers leave loose, with how many each has and needs; empty if none."""
    lacking = []
    for segment, bodies, moving, still in SEGMENTS:
        least = still if standing else moving
        found = sum(body in bodies for body in markers.bodies)
        if found < least:
            lacking.append(f"the {segment} has {found} of the {least} markers needed")
    return tuple(lacking)


def check_segments(
    markers: PlacedMarkers, recorded: Iterable[str], where: str, standing: bool = False
) -> None:
    """Refuse a set of markers that leaves a segment loose.

    Args:
        markers: Markers that both the recording and the model have.
        recorded: Names that the recording shows.
        where: What is checked, for the message.
        standing: Whether these are the landmarks of a standing trial.

    Raises:
        InputError: A segment has too few markers; lists the recorded names that have no place on the model.
    """
    lacking = segments_lacking(markers, standing)
    if lacking:
        strange = sorted(set(recorded) - set(markers.names))
        raise InputError(
            f"{'; '.join(lacking)}; recorded without a place on the model: {', '.join(strange) or 'none'}",
            where=where,
            hint="record or rename markers there, or set motion.marker_map to a map that lists them",
        )
