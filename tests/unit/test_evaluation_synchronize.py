"""A common clock for repeats: closed forms, the smear of the paper's method, registration that undoes it."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.synchronize import (
    Repeat,
    has_gap_at_peak,
    peaks_of_mean,
    peaks_of_repeats,
    register_both_peaks,
    shift_to_bending,
)
from hilbrace.errors import InputError

RATE = 200.0


def repeat(bending=0.7, landing=1.55, depth=(70.0, 60.0), frontal=(-1.0, -4.0), seconds=2.4, name="t"):
    """Two Gaussian bends."""
    time = np.arange(round(seconds * RATE)) / RATE
    shapes = [np.exp(-0.5 * ((time - at) / width) ** 2) for at, width in ((bending, 0.14), (landing, 0.1))]
    sagittal = -sum(d * s for d, s in zip(depth, shapes, strict=True))
    front = sum(f * s for f, s in zip(frontal, shapes, strict=True))
    return Repeat(name, time, np.column_stack([sagittal, front, 0 * time]), bending, landing)


def mean(ensemble):
    count = len(ensemble.curves)
    return peaks_of_mean(ensemble, np.full((1, count), 1 / count))[0]


def test_equal_repeats_have_their_own_curve_as_mean():
    repeats = [repeat(bending=at, landing=at + 0.85) for at in (0.6, 0.7, 0.8)]
    ensemble = shift_to_bending(repeats, RATE)
    assert ensemble.time[0] == pytest.approx(-0.6)
    assert ensemble.landing_s == pytest.approx(0.85)
    assert ensemble.spread.max() < 1e-9
    assert mean(ensemble)[0] == pytest.approx([-70, -1, 0], abs=0.05)
    assert mean(ensemble)[1] == pytest.approx([-60, -4, 0], abs=0.05)


def test_all_methods_agree_on_repeats_of_one_pace():
    repeats = [repeat(depth=(d, d - 10)) for d in (66.0, 70.0, 74.0)]
    expected = peaks_of_repeats(repeats).mean(axis=0)
    assert expected[0, 0] == pytest.approx(-70, abs=0.05)
    for together in (shift_to_bending, register_both_peaks):
        assert mean(together(repeats, RATE)) == pytest.approx(expected, abs=0.01)


def test_the_shift_smears_landing_where_the_pace_differs_and_registration_does_not():
    """The sketch's figure: about 4 degrees at a jitter of 50 ms."""
    paces = 0.85 + 0.05 * np.array([-1.4, -0.7, 0.0, 0.7, 1.4])
    repeats = [repeat(landing=0.7 + pace) for pace in paces]
    shallow = mean(shift_to_bending(repeats, RATE))[1, 0] + 60
    assert 2.5 < shallow < 8.0
    assert mean(register_both_peaks(repeats, RATE))[1, 0] == pytest.approx(-60, abs=0.1)
    assert peaks_of_repeats(repeats)[:, 1, 0] == pytest.approx([-60] * 5, abs=0.1)
    assert mean(shift_to_bending(repeats, RATE))[0, 0] == pytest.approx(-70, abs=0.05)


def test_the_frontal_angle_is_read_at_the_sagittal_peak():
    one = repeat()
    late = np.exp(-0.5 * ((one.time - 1.65) / 0.1) ** 2)
    moved = Repeat("t", one.time, np.column_stack([one.angles_deg[:, 0], -9 * late, 0 * late]), 0.7, 1.55)
    assert mean(shift_to_bending([moved], RATE))[1, 1] == pytest.approx(-9 * np.exp(-0.5), abs=0.3)


def test_weights_are_resampled_repeats():
    repeats = [repeat(depth=(d, d - 10)) for d in (60.0, 70.0, 80.0)]
    ensemble = shift_to_bending(repeats, RATE)
    found = peaks_of_mean(ensemble, np.array([[1.0, 0, 0], [0, 0, 1.0], [0.5, 0.5, 0]]))
    assert found[:, 0, 0] == pytest.approx([-60, -80, -65], abs=0.05)


def test_a_gap_makes_no_mean_and_is_named_at_a_peak():
    gappy = repeat()
    gappy.angles_deg[300:320] = np.nan
    ensemble = shift_to_bending([repeat(), gappy], RATE)
    assert np.isnan(ensemble.mean[ensemble.time.searchsorted(1.55 - 0.7)]).all()
    assert has_gap_at_peak(gappy)
    assert not has_gap_at_peak(repeat())
    away = repeat()
    away.angles_deg[220:240] = np.nan
    assert not has_gap_at_peak(away)
    assert mean(shift_to_bending([repeat(), away], RATE)) == pytest.approx(
        mean(shift_to_bending([repeat()], RATE)), abs=1e-9
    )


def test_repeats_without_common_time_are_refused():
    with pytest.raises(InputError, match="no common time"):
        shift_to_bending([repeat(), repeat(bending=2.5, landing=2.6)], RATE)
    with pytest.raises(InputError, match="landing peak comes before"):
        register_both_peaks([repeat(), Repeat("x", repeat().time, repeat().angles_deg, 1.5, 0.7)], RATE)
    cut = repeat(seconds=1.2)
    with pytest.raises(InputError, match="no instant within"):
        mean(shift_to_bending([repeat(), cut], RATE))
