"""Gray code and phase: inverses of what encodes them, errors as large as predicted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.scan.gray_code import cell_middles, cell_numbers
from hilbrace.scan.phase_shift import phase_and_modulation, place_error, resolved


@given(st.lists(st.integers(0, 2**31 - 1), min_size=1))
def test_codes_are_reflected_binary_numbers(numbers):
    number = np.array(numbers, dtype=np.uint32)
    assert (cell_numbers(number ^ (number >> np.uint32(1))) == number).all()


def test_neighbouring_codes_differ_in_one_bit():
    number = np.arange(1 << 11, dtype=np.uint32)
    code = number ^ (number >> np.uint32(1))
    assert {int(bits) for bits in np.bitwise_count(code[1:] ^ code[:-1])} == {1}


def test_the_middle_of_a_cell():
    assert cell_middles(np.array([0, 1, 3], dtype=np.uint32), 4).tolist() == [1.5, 5.5, 9.5]


@given(
    steps=st.integers(3, 9),
    phase=st.floats(0.0, 6.28),
    strength=st.floats(1.0, 100.0),
    mean=st.floats(0.0, 150.0),
)
def test_the_phase_of_cosines_is_found(steps, phase, strength, mean):
    pictures = (
        np.full((1, 1), mean + strength * np.cos(phase + 2 * np.pi * n / steps), dtype=np.float32)
        for n in range(steps)
    )
    found, modulation = phase_and_modulation(pictures, steps)
    assert np.cos(float(found[0, 0]) - phase) == pytest.approx(1.0, abs=1e-4)
    assert modulation[0, 0] == pytest.approx(strength, rel=1e-3, abs=1e-3)


@given(st.floats(0.0, 1000.0), st.integers(-5, 5))
def test_a_cell_a_quarter_period_off_still_tells_the_period(place, off):
    inside = np.array([np.mod(place, 16.0)], dtype=np.float32)
    assert resolved(inside, np.array([place + off], dtype=np.float32), 16)[0] == pytest.approx(
        place, abs=1e-3
    )


def test_noise_makes_the_error_that_is_predicted():
    random, steps, noise, strength, period = np.random.default_rng(3), 4, 2.0, 40.0, 16
    true = random.uniform(0, 2 * np.pi, (300, 300))
    pictures = (
        (100 + strength * np.cos(true + 2 * np.pi * n / steps) + random.normal(0, noise, true.shape)).astype(
            np.float32
        )
        for n in range(steps)
    )
    phase, modulation = phase_and_modulation(pictures, steps)
    off = np.angle(np.exp(1j * (phase - true))) * period / (2 * np.pi)
    predicted = place_error(modulation, noise, period, steps)
    assert off.std() == pytest.approx(float(predicted.mean()), rel=0.03)
