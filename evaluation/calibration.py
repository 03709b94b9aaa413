"""Static calibration: one standing trial ties each cluster to its segment's anatomical frame.

One standing trial without a brace serves all conditions, as long as the clusters stay on the skin: a brace
covers the epicondyles, and markers put back over it move the knee axis, and with it every frontal angle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from evaluation.conventions import Side, anatomical_degrees
from evaluation.hip_models import Points, hip_centre
from evaluation.joint_angles import cardan_angles, relative_rotation
from evaluation.protocol import HipModel, MarkerLabels, Protocol
from evaluation.rigid_fit import NARROWEST, width_over_length
from evaluation.segment_frames import foot_frame, frame_from_axes, long_bone_frame
from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.motion.recording import Recording, keep_markers
from hilbrace.motion.static_pose import static_pose

Array = np.ndarray

LONGEST_SEGMENT_M, SHORTEST_SEGMENT_M = 0.8, 0.15
"""Plausible lengths of thigh and shank."""

STILL_SECONDS = 1.0
"""Length of the part of a standing trial that calibrates."""

LARGEST_LEAN_DEG = 45.0
"""A standing leg that leans further does not stand along the axis that is called upward."""

_NO_PLATE_N = 20.0
_UPWARDS = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Segment:
    """One segment as it stood: its cluster, frame and ends.

    Attributes:
        name: ``thigh``, ``shank`` or ``foot``.
        labels: Markers of its cluster.
        template: Their standing positions [m].
        frame: Anatomical frame, columns anterior, up, right.
        proximal: Proximal joint centre [m].
        distal: Distal joint centre [m].
    """

    name: str
    labels: tuple[str, ...]
    template: Float[Array, "marker 3"]
    frame: Float[Array, "3 3"]
    proximal: Float[Array, " 3"]
    distal: Float[Array, " 3"]


@dataclass(frozen=True)
class LimbCalibration:
    """A standing leg.

    Attributes:
        side: Which leg.
        thigh: The thigh.
        shank: The shank.
        foot: The foot, if it carries markers.
        knee_deg: Anatomical knee angles while standing [deg].
        knee_width_m: Distance between the epicondyles [m].
        cross_talk_deg: How far the thigh's frame was turned about its long axis [deg].
        source: The standing trial, for messages.
        notes: What was noticed, one sentence each.
    """

    side: Side
    thigh: Segment
    shank: Segment
    foot: Segment | None
    knee_deg: Float[Array, " 3"]
    knee_width_m: float
    cross_talk_deg: float
    source: str
    notes: tuple[str, ...]

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Thigh, shank, and the foot if there is one."""
        return (self.thigh, self.shank, *((self.foot,) if self.foot else ()))


def calibrate(standing: Recording, protocol: Protocol, source: str) -> LimbCalibration:
    """Build the frames of a leg from a standing trial.

    Args:
        standing: The standing trial, y up; positions are medians over its stillest second.
        protocol: Labels, side and hip model.
        source: The file, for messages.

    Raises:
        ConfigError: The hip model lacks a label or figure, or the foot its heel and toe.
        InputError: A marker is missing, the subject moves, or the leg has impossible sizes.
        GeometryError: Landmarks lie on one line.
    """
    labels = protocol.markers
    needed = _needed(labels, protocol.hip.model)
    points, notes = _standing_points(standing, needed, source)
    hip = hip_centre(points, labels, protocol.hip, protocol.side)
    knee = (points[labels.knee_lateral] + points[labels.knee_medial]) / 2
    ankle = (points[labels.ankle_lateral] + points[labels.ankle_medial]) / 2
    for name, length in (("thigh", np.linalg.norm(hip - knee)), ("shank", np.linalg.norm(knee - ankle))):
        if not SHORTEST_SEGMENT_M <= length <= LONGEST_SEGMENT_M:
            raise InputError(
                f"the {name} would be {100 * length:.0f} cm long",
                where=source,
                hint="check the labels of hip, knee and ankle, and the unit of the file",
            )
    thigh_frame = long_bone_frame(
        hip, knee, points[labels.knee_lateral], points[labels.knee_medial], protocol.side, "thigh"
    )
    shank_frame = _shank_frame(points, protocol, knee, ankle)
    thigh = Segment("thigh", labels.thigh, _cluster(points, labels.thigh, "thigh"), thigh_frame, hip, knee)
    shank = Segment("shank", labels.shank, _cluster(points, labels.shank, "shank"), shank_frame, knee, ankle)
    standing_angles = cardan_angles(relative_rotation(thigh_frame, shank_frame))
    return LimbCalibration(
        side=protocol.side,
        thigh=thigh,
        shank=shank,
        foot=_foot(points, labels, ankle),
        knee_deg=anatomical_degrees(standing_angles, protocol.side),
        knee_width_m=float(np.linalg.norm(points[labels.knee_lateral] - points[labels.knee_medial])),
        cross_talk_deg=0.0,
        source=source,
        notes=(*notes, *_lean(hip - ankle)),
    )


def _needed(labels: MarkerLabels, hip: HipModel) -> tuple[str, ...]:
    """Markers that have to stand still together; those of the pelvis where the hip model needs them."""
    landmarks = (labels.knee_lateral, labels.knee_medial, labels.ankle_lateral, labels.ankle_medial)
    optional = (labels.heel, labels.toe) if labels.foot else ()
    named = (*labels.thigh, *labels.shank, *labels.foot, *landmarks, *(name for name in optional if name))
    repeated = sorted({name for name in landmarks if named.count(name) > 1})
    if repeated or len(set(labels.thigh) | set(labels.shank)) < len(labels.thigh) + len(labels.shank):
        raise ConfigError(
            f"'{(repeated or ['a cluster marker'])[0]}' is named twice",
            where="markers",
            hint="give each marker one meaning",
        )
    pelvis = {
        "bell": (labels.left_asis, labels.right_asis),
        "harrington": (labels.left_asis, labels.right_asis, labels.left_psis, labels.right_psis),
    }.get(hip, (labels.hip,))
    return tuple(dict.fromkeys((*named, *(name for name in pelvis if name))))


def _lean(upwards: Float[Array, " 3"]) -> tuple[str, ...]:
    """A sentence about a standing leg that is far from upright."""
    lean = float(np.degrees(np.arccos(upwards @ _UPWARDS / np.linalg.norm(upwards))))
    if lean <= LARGEST_LEAN_DEG:
        return ()
    return (
        f"While standing the leg leans by {lean:.0f} deg from the vertical: the laboratory's upward axis is "
        "another, set protocol.vertical_axis; until then the hip, the foot and the flight are not right.",
    )


def _standing_points(
    standing: Recording, needed: tuple[str, ...], source: str
) -> tuple[Points, tuple[str, ...]]:
    table = standing.markers
    lacking = [name for name in needed if name not in table.names]
    lacking += [name for name in needed if name in table.names and not _seen(table, name)]
    if lacking:
        raise InputError(
            f"the standing trial lacks {', '.join(lacking)}",
            where=source,
            hint=f"correct the labels under [protocol.markers]; the file names {', '.join(table.names[:20])}",
        )
    still = stillest_part(keep_markers(table, needed))
    pose = static_pose(Recording(still, None, ()), needed, _NO_PLATE_N, source)
    points = dict(zip(pose.names, pose.positions, strict=True))
    return points, pose.notes


def stillest_part(table: MarkerTable, seconds: float = STILL_SECONDS) -> MarkerTable:
    """The part of a recording in which the markers move least; all of it if it is no longer than that.

    Frames that hide a marker count as movement.

    Args:
        table: The markers that have to hold still.
        seconds: Length of the part [s].
    """
    length = round(seconds * table.rate_hz)
    if len(table.time) <= length:
        return table
    step = np.linalg.norm(np.diff(table.positions, axis=0), axis=2).sum(axis=1)
    moved = np.convolve(np.where(np.isnan(step), np.inf, step), np.ones(length - 1), "valid")
    start = int(np.argmin(np.where(np.isnan(moved), np.inf, moved)))
    part = slice(start, start + length)
    return MarkerTable(table.names, table.time[part], table.rate_hz, table.positions[part])


def _seen(table: MarkerTable, name: str) -> bool:
    return bool(np.isfinite(table.positions[:, table.names.index(name)]).any())


def _cluster(points: Points, labels: tuple[str, ...], segment: str) -> Float[Array, "marker 3"]:
    template = np.stack([points[name] for name in labels])
    if width_over_length(template) < 2 * NARROWEST:
        raise InputError(
            f"the markers of the {segment} lie nearly on one line",
            where="static calibration",
            hint="spread the cluster in two directions, or correct its labels",
        )
    return template


def _shank_frame(
    points: Points, protocol: Protocol, knee: Float[Array, " 3"], ankle: Float[Array, " 3"]
) -> Float[Array, "3 3"]:
    labels, side = protocol.markers, protocol.side
    knee_axis = points[labels.knee_lateral] - points[labels.knee_medial]
    ankle_axis = points[labels.ankle_lateral] - points[labels.ankle_medial]
    axes: Mapping[str, Float[Array, " 3"]] = {
        "ankle": ankle_axis,
        "knee": knee_axis,
        "both": _common_axis(points, labels, ankle_axis),
    }
    outward = axes[protocol.processing.shank_axis]
    return frame_from_axes(knee - ankle, outward if side == "right" else -outward, "shank")


def _common_axis(points: Points, labels: MarkerLabels, outward: Float[Array, " 3"]) -> Float[Array, " 3"]:
    """Lateral axis in the plane nearest to both epicondyles and both malleoli."""
    corners = np.stack(
        [
            points[n]
            for n in (labels.knee_lateral, labels.knee_medial, labels.ankle_lateral, labels.ankle_medial)
        ]
    )
    normal = np.linalg.svd(corners - corners.mean(axis=0))[2][2]
    along = corners[:2].mean(axis=0) - corners[2:].mean(axis=0)
    axis = np.cross(normal, along)
    return axis if axis @ outward > 0 else -axis


def _foot(points: Points, labels: MarkerLabels, ankle: Float[Array, " 3"]) -> Segment | None:
    if not labels.foot:
        return None
    if labels.heel is None or labels.toe is None:
        raise ConfigError(
            "a foot cluster needs the foot's direction",
            where="markers.heel, markers.toe",
            hint="name the heel's and the toe's marker; they may belong to the cluster",
        )
    heel, toe = points[labels.heel], points[labels.toe]
    frame = foot_frame(heel, toe, _UPWARDS)
    return Segment("foot", labels.foot, _cluster(points, labels.foot, "foot"), frame, ankle, toe)
