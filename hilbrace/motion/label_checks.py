"""Labels that cannot be right: sides exchanged, or two markers that change places in the motion."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import MarkerMap, file_name_of, segment_of, some_names
from hilbrace.motion.opensim_files import MarkerTable

Array = np.ndarray

WRONG_SIDE_M = 0.05
"""How far a marker's median may lie on the other side of the body's middle [m]."""
LEAST_JUMP_M = 0.03
"""Distance of two markers from which an exchange counts [m]."""
HIT = 0.25
"""How near each marker must come to the other's last place, as a fraction of their distance [-]."""
_LEG = ("femur", "tibia", "talus", "calcn", "toes")


def check_labels(table: MarkerTable, marker_map: MarkerMap, where: str) -> None:
    """Refuse markers whose labels are exchanged, right for left or one for another during the motion.

    Args:
        table: Known markers, y up.
        marker_map: Meaning of their names.
        where: The file, for messages.

    Raises:
        InputError: Names the markers, and the frame where two change places.
    """
    _check_sides(table, marker_map, where)
    _check_exchanges(table, marker_map, where)


def _check_sides(table: MarkerTable, marker_map: MarkerMap, where: str) -> None:
    to_right = _to_the_right(table, marker_map)
    if to_right is None:
        return
    segments = segment_of(marker_map)
    named = {s: [k for k, n in enumerate(table.names) if _leg_side(segments[n]) == s] for s in "rl"}
    if not named["r"] or not named["l"]:
        return
    wrong = []
    for bone in _LEG:
        columns = {s: [k for k in named[s] if segments[table.names[k]] == f"{bone}_{s}"] for s in "rl"}
        if not columns["r"] or not columns["l"]:
            continue
        across = np.einsum("fmi,fi->fm", table.positions[:, columns["r"] + columns["l"]], to_right)
        right, left = across[:, : len(columns["r"])], across[:, len(columns["r"]) :]
        middle = (_row_median(right) + _row_median(left)) / 2.0
        for s, side in (("r", right - middle[:, None]), ("l", middle[:, None] - left)):
            for k, path in zip(columns[s], side.T, strict=True):
                known = path[np.isfinite(path)]
                if len(known) and np.median(known) < -WRONG_SIDE_M:
                    wrong.append(table.names[k])
    if wrong:
        raise InputError(
            f"right and left are exchanged: {some_names(wrong)} on the other side of the body",
            where=where,
            hint="exchange their labels in the recording, or their meanings in the marker map",
        )


def _to_the_right(table: MarkerTable, marker_map: MarkerMap) -> Float[Array, "frame 3"] | None:
    """Horizontal unit vector to the subject's right: across the way that pelvis and feet face.

    Front and back do not depend on the labels' sides, so that they tell right from left.
    """
    place = {name: table.positions[:, k] for k, name in enumerate(table.names)}

    def mean(landmarks: tuple[str, ...]) -> Float[Array, "frame 3"] | None:
        files = [file_name_of(marker_map, landmark) for landmark in landmarks]
        paths = [place[name] for name in files if name in place]
        return np.mean(paths, axis=0) if len(paths) == len(landmarks) else None

    pairs = ((("RASI", "LASI"), ("RPSI", "LPSI")), (("RMT5", "LMT5"), ("RCAL", "LCAL")))
    for front, back in pairs:
        ahead, behind = mean(front), mean(back)
        if ahead is None or behind is None:
            continue
        forward = (ahead - behind) * np.array([1.0, 0.0, 1.0])
        length = np.linalg.norm(forward, axis=1, keepdims=True)
        forward = forward / np.where(length > 1e-6, length, np.nan)
        return np.column_stack([-forward[:, 2], 0.0 * forward[:, 1], forward[:, 0]])
    return None


def _row_median(values: Float[Array, "frame marker"]) -> Float[Array, " frame"]:
    """Median of each row over what is visible; NaN where nothing is."""
    rows = np.isfinite(values).any(axis=1)
    found = np.full(len(values), np.nan)
    found[rows] = np.nanmedian(values[rows], axis=1)
    return found


def _leg_side(segment: str) -> str | None:
    bone, _, side = segment.partition("_")
    return side if bone in _LEG else None


def _check_exchanges(table: MarkerTable, marker_map: MarkerMap, where: str) -> None:
    segments = segment_of(marker_map)
    columns = [
        k for k, n in enumerate(table.names) if _leg_side(segments[n]) is not None or segments[n] == "pelvis"
    ]
    paths = table.positions[:, columns]
    for frame in range(1, len(paths)):
        before, after = paths[frame - 1], paths[frame]
        apart = np.linalg.norm(before[:, None] - before[None], axis=2)
        reach = np.linalg.norm(after[:, None] - before[None], axis=2)
        near: Bool[Array, "marker marker"] = (reach < HIT * apart) & (apart > LEAST_JUMP_M)
        both = near & near.T & (np.diag(reach)[:, None] > (1.0 - HIT) * apart)
        if both.any():
            first, second = (table.names[columns[int(k)]] for k in np.argwhere(both)[0])
            raise InputError(
                f"'{first}' and '{second}' change places",
                where=f"{where}, frame {frame + 1} ({table.time[frame]:.3f} s)",
                hint="correct their labels from there on, or leave these frames out with motion.window",
            )
