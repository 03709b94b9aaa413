"""From a moving trial to the angles of knee and ankle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from evaluation.calibration import LimbCalibration, Segment
from evaluation.conventions import anatomical_degrees
from evaluation.gaps import FilledCluster, fill_cluster
from evaluation.joint_angles import cardan_angles, relative_rotation
from evaluation.protocol import Processing
from evaluation.rigid_fit import RigidFit, fit_rigid
from hilbrace.errors import InputError
from hilbrace.motion.filters import lowpass
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.units import MM_PER_M

Array = np.ndarray


@dataclass(frozen=True)
class LimbMotion:
    """Angles of one leg over time, and how well the markers support them.

    Attributes:
        time: Instants [s].
        rate_hz: Frames per second [Hz].
        knee_deg: Anatomical knee angles: extension, adduction, internal rotation [deg]; NaN in gaps.
        ankle_deg: Dorsiflexion, inversion, internal rotation of the foot [deg]; NaN without foot markers.
        hip: Path of the hip joint centre, carried by the thigh [m].
        knee: Path of the knee's centre, carried by the thigh [m].
        ankle: Path of the ankle's centre, carried by the shank [m].
        residual_mm: Misfit of the cluster of each segment [mm].
        visible: Recorded markers of each cluster, before filling.
        knee_gap_mm: Distance of the knee's centre as the thigh and as the shank carry it [mm].
        filled_by_cluster: Samples that a cluster's other markers filled.
        filled_by_spline: Samples that neighbouring frames filled.
        left_open: Samples of cluster markers that stayed unknown.
    """

    time: Float[Array, " frame"]
    rate_hz: float
    knee_deg: Float[Array, "frame 3"]
    ankle_deg: Float[Array, "frame 3"]
    hip: Float[Array, "frame 3"]
    knee: Float[Array, "frame 3"]
    ankle: Float[Array, "frame 3"]
    residual_mm: Float[Array, "frame segment"]
    visible: Int[Array, "frame segment"]
    knee_gap_mm: Float[Array, " frame"]
    filled_by_cluster: int
    filled_by_spline: int
    left_open: int


def track(
    markers: MarkerTable, calibration: LimbCalibration, processing: Processing, where: str
) -> LimbMotion:
    """Angles of a moving trial.

    Gaps inside a cluster are filled first, markers are filtered next, clusters fitted last.

    Args:
        markers: The moving trial, y up.
        calibration: The standing leg.
        processing: Filter and gaps.
        where: The file, for messages.

    Raises:
        InputError: A cluster has fewer than three markers in the file.
    """
    filled = {segment.name: _filled(markers, segment, processing, where) for segment in calibration.segments}
    fits = {segment.name: _fit(filled[segment.name], segment, markers, processing)
            for segment in calibration.segments}  # fmt: skip
    visible = [_visible(markers, segment) for segment in calibration.segments]
    thigh, shank = fits["thigh"], fits["shank"]
    thigh_frame = thigh.rotation @ calibration.thigh.frame
    shank_frame = shank.rotation @ calibration.shank.frame
    knee = anatomical_degrees(cardan_angles(relative_rotation(thigh_frame, shank_frame)), calibration.side)
    ankle = np.full_like(knee, np.nan)
    if calibration.foot is not None:
        foot_axes = fits["foot"].rotation @ calibration.foot.frame
        ankle = anatomical_degrees(cardan_angles(relative_rotation(shank_frame, foot_axes)), calibration.side)
    knee_of_thigh, knee_of_shank = (
        thigh.carry(calibration.thigh.distal),
        shank.carry(calibration.shank.proximal),
    )
    return LimbMotion(
        time=markers.time,
        rate_hz=markers.rate_hz,
        knee_deg=knee,
        ankle_deg=ankle,
        hip=thigh.carry(calibration.thigh.proximal),
        knee=knee_of_thigh,
        ankle=shank.carry(calibration.shank.distal),
        residual_mm=np.column_stack([MM_PER_M * fit.residual for fit in fits.values()]),
        visible=np.column_stack(visible),
        knee_gap_mm=MM_PER_M * np.linalg.norm(knee_of_thigh - knee_of_shank, axis=1),
        filled_by_cluster=sum(cluster.by_cluster for cluster in filled.values()),
        filled_by_spline=sum(cluster.by_spline for cluster in filled.values()),
        left_open=sum(cluster.left for cluster in filled.values()),
    )


def _observed(markers: MarkerTable, segment: Segment) -> Float[Array, "frame marker 3"]:
    """The cluster's paths; a marker that the file lacks is hidden throughout."""
    nowhere = np.full((len(markers.time), 3), np.nan)
    paths = [
        markers.positions[:, markers.names.index(name)] if name in markers.names else nowhere
        for name in segment.labels
    ]
    return np.stack(paths, axis=1)


def _visible(markers: MarkerTable, segment: Segment) -> Int[Array, " frame"]:
    return np.isfinite(_observed(markers, segment)).all(axis=2).sum(axis=1)


def _filled(markers: MarkerTable, segment: Segment, processing: Processing, where: str) -> FilledCluster:
    present = [name for name in segment.labels if name in markers.names]
    if len(present) < 3:
        raise InputError(
            f"the {segment.name} has {len(present)} of its markers {', '.join(segment.labels)}",
            where=where,
            hint="label at least three of them, or correct the labels under [protocol.markers]",
        )
    longest = round(processing.longest_gap_s * markers.rate_hz)
    return fill_cluster(segment.template, _observed(markers, segment), longest)


def _fit(cluster: FilledCluster, segment: Segment, markers: MarkerTable, processing: Processing) -> RigidFit:
    positions = cluster.positions
    if processing.cutoff_hz:
        positions = lowpass(positions, markers.rate_hz, processing.cutoff_hz)
    return fit_rigid(segment.template, positions)
