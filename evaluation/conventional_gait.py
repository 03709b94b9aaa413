"""Knee angles of the conventional gait model from raw markers and the subject's measurements.

This is the model that Vicon sells as Plug-in Gait: hip centres from the pelvis (Davis et al. 1991, Hum Mov
Sci 10:575-587), knee and ankle centres half a joint's width away from their lateral markers, in the plane of
a third marker (Kadaba et al. 1990, J Orthop Res 8:383-392). It serves to check our angles against a
laboratory's own; braces are measured with clusters.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from evaluation.conventions import Side
from evaluation.plug_in_gait import plug_in_gait_angles
from hilbrace.errors import InputError
from hilbrace.motion.opensim_files import MarkerTable
from hilbrace.units import MM_PER_M

Array = np.ndarray

DAVIS_THETA, DAVIS_BETA = 0.5, 0.314
"""Angles of the hip in the pelvis [rad], Davis et al. 1991."""

USUAL_MARKER_MM = 14.0

_ROTATIONS = ("ThighRotation", "ShankRotation", "TibialTorsion", "TibiaRotation")


def knee_angles_from_markers(
    markers: MarkerTable, measurements: Mapping[str, float], side: Side, where: str
) -> Float[Array, "frame 3"]:
    """Flexion, varus and internal rotation of the knee [deg], as Plug-in Gait computes them.

    Args:
        markers: LASI, RASI, SACR (or LPSI and RPSI), and THI, KNE, TIB, ANK of the side; any laboratory axes.
        measurements: Figures of the group PROCESSING [mm].
        side: Which leg.
        where: The file, for messages.

    Raises:
        InputError: A marker or measurement is missing, or the model was run with a rotation of thigh or shank
            (knee alignment device), which is not reproduced.
    """
    letter = side[0].upper()
    for key in _ROTATIONS:
        if abs(measurements.get(letter + key, 0.0)) > 1e-6:
            raise InputError(
                f"the model was run with {letter}{key} = {measurements[letter + key]:g}",
                where=where,
                hint="angles from raw markers are checked for models without rotations of thigh and shank",
            )
    lengths = _lengths(measurements, letter, where)
    thigh_wand, knee_mark, shank_wand, ankle_mark = (
        _path(markers, letter + name, where) for name in ("THI", "KNE", "TIB", "ANK")
    )
    hip = _hip_centre(markers, lengths, side, where)
    knee = joint_centre(hip, knee_mark, thigh_wand, lengths["KneeWidth"] / 2 + lengths["MarkerRadius"])
    ankle = joint_centre(knee, ankle_mark, shank_wand, lengths["AnkleWidth"] / 2 + lengths["MarkerRadius"])
    thigh, shank = (
        _frames(hip - knee, knee_mark - knee, side),
        _frames(knee - ankle, ankle_mark - ankle, side),
    )
    return plug_in_gait_angles(thigh, shank, "Knee", side)


def joint_centre(
    proximal: Float[Array, "frame 3"],
    lateral: Float[Array, "frame 3"],
    plane: Float[Array, "frame 3"],
    lever_m: float,
) -> Float[Array, "frame 3"]:
    """Joint centre beside a lateral marker: the "chord function" of the conventional gait model.

    The centre is ``lever_m`` from the lateral marker, sees it and the proximal centre at a right angle, and
    lies in their plane with a third marker, on the other side than that one.

    Args:
        proximal: Proximal joint centre [m].
        lateral: Lateral marker of the joint [m].
        plane: Marker that gives the plane [m].
        lever_m: Distance of the centre from the lateral marker [m].
    """
    along = proximal - lateral
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / length
    aside = _unit(_without(plane - lateral, along))
    share = lever_m / length
    return lateral + lever_m * (share * along - np.sqrt(1 - share**2) * aside)


def _hip_centre(
    markers: MarkerTable, lengths: Mapping[str, float], side: Side, where: str
) -> Float[Array, "frame 3"]:
    left, right = (_path(markers, name, where) for name in ("LASI", "RASI"))
    if "SACR" in markers.names:
        back = _path(markers, "SACR", where)
    else:
        back = (_path(markers, "LPSI", where) + _path(markers, "RPSI", where)) / 2
    origin, across = (left + right) / 2, _unit(right - left)
    forward = _unit(_without(origin - back, across))
    depth = lengths["AsisTrocanterDistance"] + lengths["MarkerRadius"]
    reach = 0.115 * lengths["LegLength"] - 0.0153
    anterior = reach * np.cos(DAVIS_THETA) * np.sin(DAVIS_BETA) - depth * np.cos(DAVIS_BETA)
    lateral = lengths["InterAsisDistance"] / 2 - reach * np.sin(DAVIS_THETA)
    height = -reach * np.cos(DAVIS_THETA) * np.cos(DAVIS_BETA) - depth * np.sin(DAVIS_BETA)
    outward = across if side == "right" else -across
    return origin + anterior * forward + lateral * outward + height * np.cross(across, forward)


def _lengths(measurements: Mapping[str, float], letter: str, where: str) -> dict[str, float]:
    """The measurements that a leg needs [m]; the length of the leg is the mean of both."""
    needed = {"InterAsisDistance": "InterAsisDistance"} | {
        key: letter + key for key in ("AsisTrocanterDistance", "KneeWidth", "AnkleWidth")
    }
    missing = [key for key in (*needed.values(), "LLegLength", "RLegLength") if not measurements.get(key)]
    if missing:
        raise InputError(
            f"the file does not hold the measurement {missing[0]}",
            where=f"{where}, group PROCESSING",
            hint="run Plug-in Gait in Nexus, which writes the subject's measurements into the file",
        )
    lengths = {key: measurements[name] / MM_PER_M for key, name in needed.items()}
    lengths["LegLength"] = (measurements["LLegLength"] + measurements["RLegLength"]) / 2 / MM_PER_M
    lengths["MarkerRadius"] = measurements.get("MarkerDiameter", USUAL_MARKER_MM) / 2 / MM_PER_M
    return lengths


def _path(markers: MarkerTable, name: str, where: str) -> Float[Array, "frame 3"]:
    if name not in markers.names:
        raise InputError(
            f"no marker {name}", where=where, hint="export the raw markers along with the angles"
        )
    return markers.positions[:, markers.names.index(name)]


def _frames(
    up: Float[Array, "frame 3"], lateral: Float[Array, "frame 3"], side: Side
) -> Float[Array, "frame 3 3"]:
    long_axis = _unit(up)
    forward = _unit(np.cross(long_axis, lateral if side == "right" else -lateral))
    return np.stack([forward, long_axis, np.cross(forward, long_axis)], axis=-1)


def _without(vectors: Float[Array, "frame 3"], axis: Float[Array, "frame 3"]) -> Float[Array, "frame 3"]:
    """Vectors less their part along unit axes."""
    return vectors - (vectors * axis).sum(axis=1, keepdims=True) * axis


def _unit(vectors: Float[Array, "frame 3"]) -> Float[Array, "frame 3"]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
