"""The low-pass filter against its definition and against scipy's own double pass."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, filtfilt

from hilbrace.errors import InputError
from hilbrace.motion.filters import gap_free_runs, lowpass

RATE = 200.0


@pytest.mark.parametrize("cutoff", [3.0, 6.0, 12.0, 25.0])
def test_the_gain_at_the_cutoff_is_one_over_root_two(cutoff):
    time = np.arange(2000) / RATE
    filtered = lowpass(np.sin(2 * np.pi * cutoff * time), RATE, cutoff)
    middle = slice(600, 1400)
    wave = np.exp(2j * np.pi * cutoff * time[middle])
    gain = 2 * (filtered[middle] * wave.conj()).mean()
    assert abs(gain) == pytest.approx(1 / np.sqrt(2), rel=2e-3)
    assert np.degrees(np.angle(gain * 1j)) == pytest.approx(0.0, abs=0.2)  # no lag


def test_it_is_scipys_double_pass_with_the_corrected_cutoff():
    signal = np.random.default_rng(0).normal(size=400).cumsum()
    corrected = np.arctan(np.tan(np.pi * 6 / RATE) / (np.sqrt(2) - 1) ** 0.25) * RATE / np.pi
    b, a = butter(2, corrected, fs=RATE)
    oracle = filtfilt(b, a, signal, padlen=100)
    assert lowpass(signal, RATE, 6.0) == pytest.approx(oracle, abs=1e-6)


def test_a_straight_line_passes_unchanged():
    line = np.linspace(-3.0, 7.0, 300)
    assert lowpass(line, RATE, 6.0) == pytest.approx(line, abs=1e-12)


def test_a_cutoff_near_half_the_rate_changes_nothing():
    signal = np.random.default_rng(1).normal(size=50)
    assert np.array_equal(lowpass(signal, 100.0, 40.0), signal)


def test_gaps_are_not_bridged_and_do_not_reach_their_neighbours():
    signal = np.random.default_rng(2).normal(size=(300, 2, 3)).cumsum(axis=0)
    gappy = signal.copy()
    gappy[100:120, 0] = np.nan
    filtered = lowpass(gappy, RATE, 10.0)
    assert np.array_equal(np.isnan(filtered), np.isnan(gappy))
    assert np.array_equal(filtered[:, 1], lowpass(signal, RATE, 10.0)[:, 1])
    assert filtered[:100, 0] == pytest.approx(lowpass(signal[:100, 0], RATE, 10.0), abs=1e-12)
    assert filtered[120:, 0] == pytest.approx(lowpass(signal[120:, 0], RATE, 10.0), abs=1e-12)


def test_a_run_shorter_than_the_transient_passes_unfiltered():
    signal = np.full(100, np.nan)
    signal[50:55] = [1.0, 5.0, -2.0, 4.0, 0.0]
    assert np.array_equal(lowpass(signal, RATE, 6.0), signal, equal_nan=True)


@given(st.lists(st.booleans(), min_size=1, max_size=80), st.floats(1.0, 90.0))
@settings(max_examples=60, deadline=None)
def test_gaps_stay_where_they_were(hidden, cutoff):
    signal = np.where(hidden, np.nan, np.linspace(0, 1, len(hidden)))
    filtered = lowpass(signal, RATE, cutoff)
    assert np.array_equal(np.isnan(filtered), np.isnan(signal))
    assert np.nanmax(np.abs(filtered - signal), initial=0.0) < 1e-9  # every run is a straight line


@given(st.lists(st.booleans(), max_size=40))
def test_runs_cover_exactly_what_is_known(hidden):
    values = np.where(hidden, np.nan, 1.0) if hidden else np.zeros(0)
    seen = np.zeros(len(hidden), bool)
    for run in gap_free_runs(values):
        assert run.stop > run.start
        seen[run] = True
    assert np.array_equal(seen, ~np.array(hidden, bool))


@pytest.mark.parametrize(("rate", "cutoff"), [(0.0, 6.0), (100.0, 0.0), (100.0, -1.0)])
def test_rates_that_are_not_positive_are_refused(rate, cutoff):
    with pytest.raises(InputError, match="cannot filter"):
        lowpass(np.zeros(10), rate, cutoff)
