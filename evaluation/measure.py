"""Measure every trial of a study: read, calibrate once, track, judge."""

from __future__ import annotations

from dataclasses import dataclass, replace

from evaluation.calibration import LimbCalibration, calibrate
from evaluation.cross_talk import thigh_turn, turn_thigh
from evaluation.events import Events, find_events
from evaluation.protocol import Protocol
from evaluation.quality import Quality, compare_standing, cross_talk_correlation, judge
from evaluation.study import EventSettings, Study, TrialFile
from evaluation.tracking import LimbMotion, track
from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.recording import Recording, read_recording
from hilbrace.run.progress import Report, silent


@dataclass(frozen=True)
class MeasuredTrial:
    """One repeat, tracked.

    Attributes:
        name: Name of its file without the ending; with its folders where another trial has the same.
        condition: Index of its condition.
        motion: Angles over time.
        quality: What the markers say about it.
        plates: Loads on force plates, if the file has them.
        by_hand: Events that the study file sets.
        notes: What the reader noticed, one sentence each.
    """

    name: str
    condition: int
    motion: LimbMotion
    quality: Quality
    plates: PlateForces | None
    by_hand: EventSettings
    notes: tuple[str, ...]


@dataclass(frozen=True)
class MeasuredStudy:
    """Every repeat of a study, tracked with one calibration.

    Attributes:
        study: The study.
        calibration: The standing leg; with the cross-talk correction if the study asks for it.
        cross_talk_deg: Turn of the thigh's frame that the calibration movement suggests [deg]; ``None``
            without such a movement.
        trials: The repeats, condition by condition.
        notes: What was noticed about the study as a whole, one sentence each.
    """

    study: Study
    calibration: LimbCalibration
    cross_talk_deg: float | None
    trials: tuple[MeasuredTrial, ...]
    notes: tuple[str, ...]


def measure_study(study: Study, progress: Report = silent) -> MeasuredStudy:
    """Track every trial of a study.

    Args:
        study: The study with its files.
        progress: Called with (trials done, trials).

    Raises:
        InputError: A file or its markers cannot be used; the message says where and what mends it.
        ConfigError: The study lacks what its hip model or its cross-talk correction needs.
    """
    settings, protocol = study.settings, study.settings.protocol
    with C3DReader() as reader:
        standing = read_recording(settings.standing, None, protocol.vertical_axis, reader)
        plain = calibrate(standing, protocol, str(settings.standing))
        calibration, turn, notes = _cross_talk(study, plain, reader)
        notes += [f"{condition}: {note}" for condition, note in _other_standing(study, plain, reader)]
        progress(0, len(study.trials))
        trials = []
        for file in study.trials:
            recording = read_recording(file.path, None, protocol.vertical_axis, reader)
            trials.append(measure_trial(recording, file, calibration, protocol))
            progress(len(trials), len(study.trials))
    return MeasuredStudy(study, calibration, turn, tuple(trials), (*plain.notes, *notes))


def measure_trial(
    recording: Recording, file: TrialFile, calibration: LimbCalibration, protocol: Protocol
) -> MeasuredTrial:
    """Track one trial.

    Args:
        recording: The trial, y up.
        file: Its file and condition.
        calibration: The standing leg.
        protocol: Filter and gaps.

    Raises:
        InputError: Clusters are missing or have another shape than while standing.
    """
    motion = track(recording.markers, calibration, protocol.processing, str(file.path))
    quality = judge(motion, calibration, str(file.path))
    return MeasuredTrial(
        file.name, file.condition, motion, quality, recording.plates, file.events, recording.notes
    )


def events_of(trial: MeasuredTrial) -> Events:
    """Events of a trial: those set by hand, the others found.

    Raises:
        InputError: They cannot be found, or one set by hand lies outside the trial.
    """
    given = {name: value for name, value in trial.by_hand if value is not None}
    for name, value in given.items():
        if not trial.motion.time[0] <= value <= trial.motion.time[-1]:
            raise InputError(
                f"{name} = {value:g} lies outside the trial, which ends at {trial.motion.time[-1]:.2f} s",
                where=trial.name,
                hint="correct it under [events] in the study file",
            )
    if "bending_s" in given and "landing_s" in given:
        return Events(given["bending_s"], given.get("touchdown_s", float("nan")), given["landing_s"], "hand")
    found = find_events(trial.motion, trial.plates, trial.name)
    return replace(found, **given, found_by="hand" if given else found.found_by)


def _cross_talk(
    study: Study, plain: LimbCalibration, reader: C3DReader
) -> tuple[LimbCalibration, float | None, list[str]]:
    settings, protocol = study.settings, study.settings.protocol
    if settings.movement is None:
        if protocol.processing.cross_talk:
            raise ConfigError(
                "a cross-talk correction needs a calibration movement",
                where="movement",
                hint="name a trial of squats as 'movement', or leave protocol.processing.cross_talk off",
            )
        return plain, None, []
    recording = read_recording(settings.movement, None, protocol.vertical_axis, reader)
    where = str(settings.movement)
    motion = track(recording.markers, plain, protocol.processing, where)
    judge(motion, plain, where)
    turn = thigh_turn(plain, motion.knee_deg, where)
    correlation = cross_talk_correlation(motion.knee_deg)
    applied = protocol.processing.cross_talk
    note = (
        f"In the calibration movement the frontal angle varies least with the thigh's frame turned by "
        f"{turn:+.1f} deg (correlation with flexion {correlation:+.2f} before); "
        + ("this turn is applied to all conditions." if applied else "not applied.")
    )
    return (turn_thigh(plain, turn) if applied else plain), turn, [note]


def _other_standing(study: Study, plain: LimbCalibration, reader: C3DReader) -> list[tuple[str, str]]:
    """Sentences about standing trials of single conditions."""
    found = []
    for condition in study.settings.conditions:
        if condition.standing is not None:
            protocol = study.settings.protocol
            recording = read_recording(condition.standing, None, protocol.vertical_axis, reader)
            other = calibrate(recording, protocol, str(condition.standing))
            found += [(condition.name, sentence) for sentence in compare_standing(plain, other)]
    return found
