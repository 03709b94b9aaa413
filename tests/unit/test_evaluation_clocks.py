"""A device's drift from arrival times, under every kind of delay that laboratories make."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.clocks import ClockTracker, fit_clock
from hilbrace.errors import InputError

DRIFT = 80e-6
SECONDS = 10.0


def arrivals(kind: str, seed: int, rate_hz: float = 1000.0) -> tuple[np.ndarray, np.ndarray]:
    """Device clock of every sample and when it arrived [s]; the device's clock is 80 ppm fast."""
    rng = np.random.default_rng(seed)
    true = np.arange(int(SECONDS * rate_hz)) / rate_hz
    delay = 100e-6 + rng.gamma(2.0, 30e-6, len(true))
    if kind == "jitter":
        delay += rng.uniform(0, 1e-3, len(true))
    elif kind == "usb adapter":
        delay = np.ceil((true + delay) / 16e-3) * 16e-3 - true
    elif kind == "busy host":
        for start in np.sort(rng.uniform(0, SECONDS, 50)):
            end = start + rng.exponential(0.03)
            held = (true + delay >= start) & (true + delay < end)
            delay[held] = end - true[held]
    elif kind == "slower later":
        delay[true > 7.0] += 300e-6
    device = np.floor(1e6 * (3.0 + true * (1 + DRIFT))) * 1e-6
    return device, 4711.0 + np.maximum.accumulate(true + delay)


@pytest.mark.parametrize("kind", ["quiet", "jitter", "usb adapter", "busy host", "slower later"])
def test_80_ppm_are_found_within_3_ppm_in_ten_seconds(kind):
    errors = [fit_clock(*arrivals(kind, seed)).drift_ppm - 80.0 for seed in range(12)]
    assert np.abs(errors).max() < 3.0
    assert abs(np.mean(errors)) < 1.0


def test_a_plain_regression_would_not_do():
    """What the floor is for: delays of a busy host pull a regression away by hundreds of ppm."""
    device, host = arrivals("busy host", 1)
    slope = np.polyfit(device - device[0], (host - host[0]) - (device - device[0]), 1)[0]
    assert abs(-1e6 * slope - 80) > 50
    assert abs(fit_clock(device, host).drift_ppm - 80) < 3


@given(st.floats(-400, 400), st.integers(0, 10**6))
@settings(max_examples=15)
def test_without_delay_any_drift_and_offset_is_exact(ppm, seed):
    rng = np.random.default_rng(seed)
    true = np.sort(rng.uniform(0, 20, 2000))
    device, host = 50.0 + true * (1 + 1e-6 * ppm), 1000.0 + true
    clock = fit_clock(device, host)
    assert clock.drift_ppm == pytest.approx(ppm, abs=1e-3)
    np.testing.assert_allclose(clock.to_host(device), host, atol=1e-8)


def test_the_standard_error_says_how_far_off_the_drift_is():
    fits = [fit_clock(*arrivals("jitter", seed)) for seed in range(20)]
    errors = np.array([fit.drift_ppm - 80 for fit in fits])
    stated = np.array([fit.standard_error_ppm for fit in fits])
    assert 0.4 < np.sqrt(np.mean(errors**2)) / stated.mean() < 2.5
    assert all(fit.span_s == pytest.approx(SECONDS, abs=0.5) for fit in fits)


def test_a_tracker_forgets_what_is_old():
    """The drift changes from 200 to 80 ppm: what is asked for is how it runs now."""
    true = np.arange(0, 60, 0.002)
    device = true + 200e-6 * np.minimum(true, 30) + 80e-6 * np.maximum(true - 30, 0)
    tracker = ClockTracker(longest_s=10.0)
    for at, host in zip(device.tolist(), true.tolist(), strict=True):
        tracker.add(at, host)
    clock = tracker.fit()
    assert clock is not None
    assert clock.drift_ppm == pytest.approx(80, abs=0.1)
    assert clock.span_s < 10.5
    tracker.restart()
    assert tracker.fit() is None


def test_too_little_is_refused():
    with pytest.raises(InputError, match="too short to compare clocks"):
        fit_clock(np.arange(10) * 1e-3, np.arange(10) * 1e-3)
