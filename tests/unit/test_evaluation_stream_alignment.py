"""Markers and plates on one clock: triggers, heel stomps, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.stream_alignment import align, force_onsets, heel_strikes
from hilbrace.errors import InputError

FRAME = 0.005
STOMPS = np.array([1.234, 2.011, 15.4502, 16.9273])


def foot(times: np.ndarray, stomps: np.ndarray) -> np.ndarray:
    """Height of a heel that falls 0.1 m at up to 2 m/s, stops dead, and rises again [m]."""
    height = np.full(len(times), 0.03)
    for at in stomps:
        fall = np.clip((at - times) / 0.05, 0, 2)
        rise = np.clip((times - at - 0.25) / 0.5, 0, 1)
        up = 0.1 * np.where(times < at, np.minimum(fall, 1) * (at - times < 0.6), np.sin(np.pi * rise) * 0.3)
        height = np.maximum(height, 0.03 + np.where((times > at - 0.55) & (times < at + 0.75), up, 0))
    return height


def force(times: np.ndarray, stomps: np.ndarray) -> np.ndarray:
    """Vertical force of stomps: up to 900 N in 10 ms, 0.2 s long [N]."""
    since = times[:, None] - stomps
    return 900 * np.clip(np.where((since > 0) & (since < 0.2), since / 0.01, 0), 0, 1).max(axis=1)


def seen(drift: float, offset: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Events as both devices see them; the plate's clock is `drift` fast."""
    rng = np.random.default_rng(seed)
    times = np.arange(0, 19, FRAME)
    heel = heel_strikes(times, foot(times, STOMPS) + rng.normal(0, 2e-4, len(times)))
    true = np.arange(0, 19, 1e-3)
    noisy = force(true, STOMPS) + rng.normal(0, 2, len(true))
    return heel, force_onsets((true + offset) * (1 + drift), noisy)


def test_stomps_are_found_between_frames_and_samples():
    heel, onset = seen(0.0, 0.0, 1)
    assert len(heel) == len(onset) == len(STOMPS)
    np.testing.assert_allclose(heel, STOMPS, atol=0.5 * FRAME)
    np.testing.assert_allclose(onset, STOMPS, atol=0.6e-3)


@pytest.mark.parametrize("drift", [0.0, 80e-6, -200e-6])
def test_stomps_give_offset_and_drift_with_their_residual(drift):
    heel, onset = seen(drift, 7.5, 3)
    found = align(heel, onset, FRAME, "heel stomps")
    true = np.linspace(0, 19, 50)
    np.testing.assert_allclose(found.to_marker_time((true + 7.5) * (1 + drift)), true, atol=0.5 * FRAME)
    assert found.residual_s < 0.5 * FRAME
    assert found.events == 4
    assert found.drift_ppm == pytest.approx(1e6 * drift, abs=120)  # two milliseconds in 15 s


@given(st.floats(-300e-6, 300e-6), st.floats(-100, 100), st.integers(0, 10**6))
@settings(max_examples=25)
def test_triggers_are_exact_although_either_device_misses_some(drift, offset, seed):
    rng = np.random.default_rng(seed)
    true = np.cumsum(rng.uniform(0.5, 4.0, 14))
    marker = np.delete(true, rng.integers(0, 14))
    plate = np.sort(np.append(np.delete(true, rng.integers(0, 14)), rng.uniform(0, true[-1])))
    plate = (plate + offset) * (1 + drift)
    found = align(marker, plate, FRAME, "trigger")
    assert found.events >= 12
    np.testing.assert_allclose(found.to_marker_time((true + offset) * (1 + drift)), true, atol=1.2e-3)


def test_one_stomp_at_each_end_is_enough_but_tells_no_disagreement():
    found = align(np.array([1.0, 21.0]), np.array([101.0, 121.002]), FRAME, "trigger")
    assert found.drift_ppm == pytest.approx(100.0, abs=0.1)
    assert found.events == 2
    short = align(np.array([1.0, 3.0]), np.array([101.0, 103.002]), FRAME, "trigger")
    assert short.drift_ppm == 0.0
    assert short.residual_s == pytest.approx(1e-3)


def test_a_residual_of_more_than_a_frame_is_refused():
    marker = np.array([1.0, 2.3, 15.0, 16.9])
    plate = marker + np.array([0.0, 9.5e-3, -9.5e-3, 0.0])
    with pytest.raises(InputError, match="ms only, one frame is 5 ms"):
        align(marker, plate, 0.005, "heel stomps")


def test_events_that_do_not_belong_together_are_refused():
    with pytest.raises(InputError, match="no two agree within 5 ms") as caught:
        align(np.array([1.0, 2.0]), np.array([1.0, 2.5]), FRAME, "heel stomps")
    assert "uneven rhythm" in caught.value.hint
    with pytest.raises(InputError, match="of 0 events of the markers"):
        align(np.zeros(0), np.array([1.0, 2.5]), FRAME, "heel stomps")


def test_an_even_rhythm_is_refused_when_one_event_was_missed():
    with pytest.raises(InputError, match="fit 3 events alike"):
        align(np.arange(4.0), 50 + np.arange(3.0), FRAME, "heel stomps")


def test_gaps_and_slow_steps_are_no_stomps():
    times = np.arange(0, 19, FRAME)
    height = foot(times, STOMPS)
    height[(times > 1.2) & (times < 1.25)] = np.nan
    assert len(heel_strikes(times, height)) == 3
    assert len(heel_strikes(times, 0.1 + 0.05 * np.sin(2 * times))) == 0
    assert len(heel_strikes(times[:2], height[:2])) == 0
    assert len(force_onsets(times, np.full(len(times), 500.0))) == 0
