"""Joint functions against OpenSim, cubics they must reproduce, and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.errors import InputError
from hilbrace.skeleton.splines import Linear, joint_function, simm_spline
from hilbrace.skeleton.table import load_source_table
from tests.unit.opensim_oracle import ask

numbers = st.floats(-3, 3)


def splines_of_the_model() -> list[list[list[float]]]:
    table = load_source_table()
    axes = [axis for joint in table["joints"] for axis in joint.get("transform", [])]
    return [axis["function"]["spline"] for axis in axes if "spline" in axis["function"]]


def test_equal_to_opensim_inside_and_outside_the_knots():
    rng = np.random.default_rng(3)
    made = [[[0.0, 1.0], [2.0, -1.0]], [[0.0, 0.4, 1.0], [0.0, 1.0, -1.0]]]
    for count in (4, 5, 9):
        made.append([np.cumsum(rng.uniform(0.1, 0.6, count)).tolist(), rng.normal(size=count).tolist()])
    at = np.linspace(-1.0, 4.0, 101)
    curves = [*splines_of_the_model(), *made]
    told = ask(splines=curves, at=at)
    for number, (x, y) in enumerate(curves):
        spline = simm_spline(x, y)
        np.testing.assert_allclose(spline(at), told[f"spline_{number}"], atol=1e-12)
        inside = (at > x[0]) & (at < x[-1])
        np.testing.assert_allclose(spline.slope(at)[inside], told[f"slope_{number}"][inside], atol=1e-11)


@given(
    st.tuples(numbers, numbers, numbers, numbers),
    st.lists(st.floats(0.05, 1.0), min_size=3, max_size=8),
)
def test_a_cubic_is_reproduced(coefficients, widths):
    cubic = np.polynomial.Polynomial(coefficients)
    knots = np.concatenate([[0.0], np.cumsum(widths)])
    spline = simm_spline(knots.tolist(), cubic(knots).tolist())
    x = np.linspace(0.0, knots[-1], 30)
    np.testing.assert_allclose(spline(x), cubic(x), atol=1e-8 * (1 + np.abs(cubic(x)).max()))


def test_it_goes_through_its_points_and_on_along_its_tangents():
    x, y = splines_of_the_model()[0]
    spline = simm_spline(x, y)
    np.testing.assert_allclose(spline(np.array(x)), y, atol=1e-14)
    for end, step in ((x[0], -0.3), (x[-1], 0.3)):
        ends = np.array([end, end + step])
        value, beyond = spline(ends)
        np.testing.assert_allclose(beyond, value + step * spline.slope(ends)[0], atol=1e-14)
        assert spline.slope(ends)[0] == pytest.approx(spline.slope(ends)[1], abs=1e-14)


def test_slopes_agree_with_finite_differences():
    x = np.linspace(-0.5, 2.6, 97)
    step = 1e-6
    for points in splines_of_the_model():
        spline = simm_spline(*points)
        finite = (spline(x + step) - spline(x - step)) / (2 * step)
        np.testing.assert_allclose(spline.slope(x), finite, atol=1e-8)


def test_constants_and_lines():
    x = np.array([0.0, 2.0])
    constant = joint_function({"constant": 1.5})
    np.testing.assert_array_equal(constant(x), [1.5, 1.5])
    np.testing.assert_array_equal(constant.slope(x), [0.0, 0.0])
    assert joint_function({"linear": [2, 1]}) == Linear(2.0, 1.0)
    np.testing.assert_array_equal(Linear(2.0, 1.0)(x), [1.0, 5.0])


@pytest.mark.parametrize(
    ("x", "y"), [([0.0], [1.0]), ([0.0, 0.0], [1.0, 2.0]), ([1.0, 0.0], [1.0, 2.0]), ([0.0, 1.0], [1.0])]
)
def test_points_that_make_no_spline_are_refused(x, y):
    with pytest.raises(InputError, match="no spline"):
        simm_spline(x, y)


def test_an_unknown_function_is_refused():
    with pytest.raises(InputError, match="unknown joint function"):
        joint_function({"sine": 1.0})
