"""The record that leaves the motion stage: markers and ground reactions on one clock."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True)
class Trial:
    """One recorded (or synthetic) motion in the OpenSim frame: x forward, y up, z to the right.

    Gaps are NaN in the markers and never filled in silence. Forces are sampled at the markers' instants
    after filtering; a foot without load has force, point and torque zero.

    Attributes:
        name: The trial's name.
        origin: ``"recorded"`` or ``"synthetic"``; a synthetic trial is never called a measurement.
        time: Instants [s].
        rate_hz: Marker rate [Hz].
        marker_names: Names as in the file.
        markers: Marker positions [m]; NaN where a marker is hidden.
        static_marker_names: Names in the standing trial; empty where there is none, so that the subject is
            measured in the motion.
        static_markers: Mean marker positions while standing [m].
        feet: ``("right", "left")``, the order of the second axis of the arrays below.
        ground_force: Force of the ground on each foot [N].
        centre_of_pressure: Point where it acts [m].
        free_torque: Torque of the ground on each foot about that point [N*m].
        mass_kg: The subject's mass [kg].
        height_m: The subject's height [m]; 0 where unknown.
        marker_map: Name or path of the marker map that gives the names their meaning.
        notes: What the reader noticed (unused plates, filled header fields), one sentence each.
        surveyed_markers: Marker positions at instants spread over the whole recording, beyond the window
            too, in which a subject without a standing trial is measured [m]; empty with a standing trial.
    """

    name: str
    origin: str
    time: Float[Array, " frame"]
    rate_hz: float
    marker_names: tuple[str, ...]
    markers: Float[Array, "frame marker 3"]
    static_marker_names: tuple[str, ...]
    static_markers: Float[Array, "static_marker 3"]
    feet: tuple[str, ...]
    ground_force: Float[Array, "frame foot 3"]
    centre_of_pressure: Float[Array, "frame foot 3"]
    free_torque: Float[Array, "frame foot 3"]
    mass_kg: float
    height_m: float
    marker_map: str
    notes: tuple[str, ...]
    surveyed_markers: Float[Array, "instant surveyed 3"] = field(default_factory=lambda: np.zeros((0, 0, 3)))

    def markers_to_measure(self) -> Float[Array, "instant marker 3"]:
        """Where a subject without a standing trial is measured [m]: the survey, or else the motion."""
        return self.surveyed_markers if len(self.surveyed_markers) else self.markers
