"""Knee angles of the frames that have just come, with the same fits and axes as the recorded ones.

Frames are neither filtered nor filled here, since both need the frames to come: the angles on the screen
carry the markers' noise, and the table is made from the recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from evaluation.calibration import LimbCalibration, Segment
from evaluation.conventions import anatomical_degrees
from evaluation.joint_angles import cardan_angles, relative_rotation
from evaluation.rigid_fit import fit_rigid
from evaluation.sources.stream import SourceInfo, y_up
from hilbrace.errors import InputError
from hilbrace.units import MM_PER_M

Array = np.ndarray


@dataclass(frozen=True)
class KneeFrames:
    """Knee angles of consecutive frames.

    Attributes:
        knee_deg: Anatomical angles: extension, adduction, internal rotation [deg]; NaN where too few markers
            are seen.
        residual_mm: Misfit of the clusters of thigh and shank [mm].
        knee_gap_mm: Distance of the knee's centre as thigh and shank carry it [mm].
    """

    knee_deg: Float[Array, "frame 3"]
    residual_mm: Float[Array, "frame 2"]
    knee_gap_mm: Float[Array, " frame"]


class LiveKnee:
    """Turns marker frames of one source into knee angles.

    Args:
        calibration: The standing leg.
        info: What the source delivers.

    Raises:
        InputError: The source names fewer than three markers of a cluster.
    """

    def __init__(self, calibration: LimbCalibration, info: SourceInfo) -> None:
        names = [label.rsplit(":", 1)[-1] for label in info.labels]
        self._calibration = calibration
        self._up: Literal["y", "z"] = info.up
        self._thigh = _columns(calibration.thigh, names, info.source)
        self._shank = _columns(calibration.shank, names, info.source)

    def angles(self, positions: Float[Array, "frame marker 3"]) -> KneeFrames:
        """Knee angles of some frames.

        Args:
            positions: Markers as the source sends them, in the laboratory's axes [m].
        """
        thigh, shank = self._calibration.thigh, self._calibration.shank
        upper = fit_rigid(thigh.template[self._thigh[1]], y_up(positions[:, self._thigh[0]], self._up))
        lower = fit_rigid(shank.template[self._shank[1]], y_up(positions[:, self._shank[0]], self._up))
        turn = relative_rotation(upper.rotation @ thigh.frame, lower.rotation @ shank.frame)
        apart = upper.carry(thigh.distal) - lower.carry(shank.proximal)
        return KneeFrames(
            knee_deg=anatomical_degrees(cardan_angles(turn), self._calibration.side),
            residual_mm=MM_PER_M * np.column_stack([upper.residual, lower.residual]),
            knee_gap_mm=MM_PER_M * np.linalg.norm(apart, axis=1),
        )


def _columns(segment: Segment, names: list[str], source: str) -> tuple[list[int], list[int]]:
    """Columns of the segment's markers in a frame, and the template's rows that they belong to."""
    rows = [row for row, label in enumerate(segment.labels) if label in names]
    if len(rows) < 3:
        raise InputError(
            f"'{source}' names {len(rows)} of the {segment.name}'s markers {', '.join(segment.labels)}",
            where="live markers",
            hint="label them in the recording software, or correct [protocol.markers]",
        )
    return [names.index(segment.labels[row]) for row in rows], rows
