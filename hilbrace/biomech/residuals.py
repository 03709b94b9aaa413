"""What the model's pelvis would have to be held with: the misfit between motion, masses and ground forces.

If everything were measured without error, the ground reactions alone would move the model as it moved. What
is missing, the residual wrench at the pelvis, tells how far motion, masses and forces disagree.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from hilbrace.biomech.dynamics import GroundReaction, Momenta, Wrench
from hilbrace.motion.filters import gap_free_runs
from hilbrace.units import GRAVITY

Array = np.ndarray

FORCE_LIMIT = 0.05
"""Largest residual force, as a fraction of the greatest net ground force [-]."""
MOMENT_LIMIT = 0.01
"""Largest residual moment, as a fraction of the same force times the height of the centre of mass [-].

Both are the recommendation of Hicks, Uchida, Seth, Rajagopal & Delp, "Is my model good enough? Best practices
for verification and validation of musculoskeletal models and simulations of movement", J. Biomech. Eng.
137(2), 020905, 2015, for simulations whose residuals were reduced. Nothing is reduced here, so that the
forces at knees and ankles rest on what was measured.
"""
UNMEASURED_BW = 0.5
UNMEASURED_S = 0.15
"""A vertical residual above this [body weights] for this long [s] is a support without a plate."""


def pelvis_residual(
    segments: Momenta, reactions: list[GroundReaction], pelvis: Float[Array, "frame 3"]
) -> Wrench:
    """Force on the pelvis, and moment about a point of it, that would make motion and forces agree.

    Args:
        segments: All segments.
        reactions: Ground reactions on both feet.
        pelvis: Origin of the pelvis [m].

    Returns:
        Force and moment in the ground frame.
    """
    arms = segments.centres - pelvis[:, None]
    force = segments.force.sum(axis=1)
    moment = (np.cross(arms, segments.force) + segments.torque).sum(axis=1)
    for reaction in reactions:
        force = force - reaction.force
        moment = moment - np.cross(reaction.point - pelvis, reaction.force) - reaction.torque
    return Wrench(force, moment)


def unmeasured_support(force: Float[Array, "frame 3"], mass_kg: float, rate_hz: float) -> list[slice]:
    """Stretches in which something without a force plate carries the subject, such as a box before a jump.

    Args:
        force: Residual force at the pelvis [N].
        mass_kg: The subject's mass [kg].
        rate_hz: Frames per second [Hz].
    """
    lifted = force[:, 1] > UNMEASURED_BW * mass_kg * GRAVITY
    runs = gap_free_runs(np.where(lifted, 0.0, np.nan))
    return [run for run in runs if run.stop - run.start > UNMEASURED_S * rate_hz]


def residual_figures(
    time: Float[Array, " frame"],
    residual: Wrench,
    net_ground_force: Float[Array, "frame 3"],
    segments: Momenta,
    left_out: list[slice],
    margin: int = 0,
) -> dict[str, float]:
    """RMS and peak of the residuals, when the peaks are, and the limits of Hicks et al. 2015.

    Args:
        time: Instants [s].
        residual: Residual wrench at the pelvis.
        net_ground_force: Ground reactions of both feet together [N].
        segments: All segments; the floor is at height zero.
        left_out: Stretches that are not judged (`unmeasured_support`).
        margin: Frames at both ends that are not judged either: filter and splines lack neighbours there, so
            that accelerations are guesses.

    Returns:
        ``residual_force_rms_n``, ``residual_force_peak_n``, ``residual_force_peak_s``,
        ``residual_force_limit_n``, the same of ``residual_moment`` in ``nm``, and ``residual_frames``, the
        number of frames judged; only this one where none is.
    """
    judged: Bool[Array, " frame"] = np.ones(len(time), bool)
    judged[:margin] = judged[len(time) - margin :] = False
    for run in left_out:
        judged[run] = False
    if not judged.any():
        return {"residual_frames": 0.0}
    height = float((segments.centres[judged, :, 1] @ segments.masses).mean() / segments.masses.sum())
    ground = float(np.linalg.norm(net_ground_force[judged], axis=1).max())
    limits = {"force": FORCE_LIMIT * ground, "moment": MOMENT_LIMIT * ground * height}
    figures = {"residual_frames": float(judged.sum())}
    for name, unit, vectors in (("force", "n", residual.force), ("moment", "nm", residual.moment)):
        size = np.where(judged, np.linalg.norm(vectors, axis=1), 0.0)
        peak = int(size.argmax())
        figures[f"residual_{name}_rms_{unit}"] = float(np.sqrt((size[judged] ** 2).mean()))
        figures[f"residual_{name}_peak_{unit}"] = float(size[peak])
        figures[f"residual_{name}_peak_s"] = float(time[peak])
        figures[f"residual_{name}_limit_{unit}"] = limits[name]
    return figures


def residual_notes(
    figures: dict[str, float], time: Float[Array, " frame"], left_out: list[slice]
) -> list[str]:
    """What a reader should know about the residuals, one sentence each."""
    notes = [
        f"{time[run.start]:.2f} to {time[run.stop - 1]:.2f} s: something that no force plate "
        "measures carries the subject; forces at knees and ankles are those of hanging legs"
        for run in left_out
    ]
    for name, unit, label in (("force", "n", "N"), ("moment", "nm", "N*m")):
        if f"residual_{name}_limit_{unit}" not in figures:
            continue
        rms, peak, limit = (figures[f"residual_{name}_{kind}_{unit}"] for kind in ("rms", "peak", "limit"))
        verdict = "within" if peak <= limit else "above"
        notes.append(
            f"residual {name} at the pelvis: RMS {rms:.0f} {label}, peak {peak:.0f} {label} at "
            f"{figures[f'residual_{name}_peak_s']:.2f} s, {verdict} the {limit:.0f} {label} that "
            "Hicks et al. 2015 recommend"
        )
    return notes
