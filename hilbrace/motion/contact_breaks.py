"""Ground forces that stop or start although the foot stays on the ground: a fault of the recording."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.errors import InputError
from hilbrace.motion.filters import gap_free_runs
from hilbrace.motion.force_plates import FEET, UP, PlateForces

Array = np.ndarray

ABRUPT = 0.25
"""Force at the edge of a contact, as a fraction of the contact's peak, from which the edge is abrupt [-]."""
ABRUPT_N = 100.0
"""The same in newtons; both must be exceeded."""
STILL_S = 0.1
"""Time beyond the edge in which a foot that has really left the ground would have moved [s]."""
STILL_M = 0.02
"""Largest movement of a foot on the ground in that time [m]; a foot that steps off moves ten times as far."""


def check_unbroken(
    plates: PlateForces,
    owner: Int[Array, "sample plate"],
    time: Float[Array, " frame"],
    feet: dict[str, Float[Array, "frame marker 3"]],
) -> None:
    """Refuse a force that breaks off, or sets in, while the foot under it stays where it is.

    A foot that lands or leaves moves before or after; a foot that stays, while its force jumps by more than a
    quarter of its peak from one sample to the next, tells that the forces are cut off.

    Args:
        plates: Loads after `hilbrace.motion.force_plates.unload`.
        owner: Index into `FEET` of the foot on each plate; -1 for none.
        time: The markers' instants [s].
        feet: Markers on each foot by ``"right"`` and ``"left"`` [m].

    Raises:
        InputError: Names foot, time and force.
    """
    for index, foot in enumerate(FEET):
        load = np.where(owner == index, plates.force[:, :, UP], 0.0).sum(axis=1)
        for run in gap_free_runs(np.where(load > 0, load, np.nan)):
            peak = float(load[run].max())
            for sample, outward, verb in (
                (run.start, -1, "sets in at"),
                (run.stop - 1, 1, "breaks off from"),
            ):
                if not 0 <= sample + outward < len(load):
                    continue
                instant, force = float(plates.time[sample]), float(load[sample])
                if force <= max(ABRUPT * peak, ABRUPT_N) or not _stays(feet[foot], time, instant, outward):
                    continue
                part = "before" if outward > 0 else "after"
                raise InputError(
                    f"the force under the {foot} foot {verb} {force:.0f} N within one sample while the foot "
                    "stays on the ground",
                    where=f"{plates.source}, {instant:.3f} s",
                    hint=f"export the forces again, or use the part {part} {instant:.2f} s (motion.window)",
                )


def _stays(
    markers: Float[Array, "frame marker 3"], time: Float[Array, " frame"], instant: float, outward: int
) -> bool:
    """Whether every visible marker of the foot stays within `STILL_M` for `STILL_S` from an instant on."""
    end = instant + outward * STILL_S
    slack = 1e-9
    inside: Bool[Array, " frame"] = (time >= min(instant, end) - slack) & (time <= max(instant, end) + slack)
    covered = time[0] - slack <= min(instant, end) and max(instant, end) <= time[-1] + slack
    paths = markers[inside]
    seen = np.isfinite(paths).all(axis=(0, 2))
    if not covered or inside.sum() < 2 or not seen.any():
        return False
    return bool(np.ptp(paths[:, seen], axis=0).max() < STILL_M)
