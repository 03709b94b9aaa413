"""The processing returns what was planted: 24 cells, 20 seeds, intervals that keep their promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.calibration import calibrate
from evaluation.comparison import METHODS
from evaluation.measure import MeasuredStudy, measure_trial
from evaluation.results import evaluate
from evaluation.study import EventSettings, Study, StudySettings, TrialFile
from mocks import synthetic_study as made_up

SEEDS = 20
REPEATS = 5


def result(seed: int):
    """A study evaluated without going through files."""
    scatter = made_up.Scatter()
    settings = StudySettings.model_validate(made_up.study_document(REPEATS))
    calibration = calibrate(made_up.standing_recording(seed, scatter), settings.protocol, "standing")
    files, trials = [], []
    for k, recordings in enumerate(made_up.study_recordings(seed, scatter, 3.5, REPEATS).values()):
        for number, recording in enumerate(recordings):
            files.append(TrialFile(k, Path(f"{k}_{number}.c3d"), EventSettings()))
            trials.append(measure_trial(recording, files[-1], calibration, settings.protocol))
    study = Study(settings, tuple(files), Path())
    return evaluate(MeasuredStudy(study, calibration, None, tuple(trials), ()))


@pytest.mark.slow
def test_planted_squares_lie_within_their_intervals():
    truth = made_up.planted_squares()
    inside = {method: [] for method in METHODS}
    errors = []
    for seed in range(SEEDS):
        found = result(seed)
        assert all(event.found_by == "plates" for event in found.events)
        for method, table in found.tables.items():
            inside[method].append((table.squared_low <= truth) & (truth <= table.squared_high))
        planted = np.stack(list(made_up.planted_angles().values()))
        errors.append(found.tables["per_trial"].angle_deg - planted)
    for method, cells in inside.items():
        assert 0.90 <= np.mean(cells) <= 0.99, method
        assert np.mean(cells, axis=0).min() >= 0.75, method
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.3
