"""The shell against the published tables of its element: displacements over their reference values.

Columns "MITC3+" of Ko, Lee, Lee & Bathe 2017, Computers & Structures 193:187-206, tables 2-19, and how near
we come: printed figures have four digits, so that 5e-5 or, from one upwards, 5e-4 of it is rounding.
"""

from __future__ import annotations

from functools import partial

import pytest

from tests.unit import shell_benchmarks as cases

TABLES = {
    "clamped plate 1/100": (
        partial(cases.plate, thickness=1e-2, clamped=True),
        {4: 0.9321, 8: 0.9817, 16: 0.9947, 32: 0.9980},
        1e-4,
    ),
    "clamped plate 1/10000": (
        partial(cases.plate, thickness=1e-4, clamped=True),
        {4: 0.9230, 8: 0.9806, 16: 0.9942, 32: 0.9976},
        1e-4,
    ),
    "supported plate 1/100": (
        partial(cases.plate, thickness=1e-2, clamped=False),
        {4: 0.9690, 8: 0.9963, 16: 1.002, 32: 1.002},
        5e-4,
    ),
    "supported plate 1/10000": (partial(cases.plate, thickness=1e-4, clamped=False), {16: 1.001}, 5e-4),
    "Scordelis-Lo": (
        cases.scordelis_lo,
        {4: 0.6695, 8: 0.8577, 16: 0.9550, 32: 0.9851, 64: 0.9932},
        1e-4,
    ),
    "Scordelis-Lo, distorted": (
        partial(cases.scordelis_lo, distorted=True),
        {4: 0.7982, 8: 0.9223, 16: 0.9757, 32: 0.9909, 64: 0.9948},
        1e-4,
    ),
    "pinched cylinder": (
        cases.pinched_cylinder,
        {4: 0.4074, 8: 0.7681, 16: 0.9308, 32: 0.9847, 64: 1.002},
        5e-4,
    ),
    "pinched cylinder, distorted": (
        partial(cases.pinched_cylinder, distorted=True),
        {4: 0.4088, 8: 0.7237, 16: 0.8986, 32: 0.9734, 64: 0.9992},
        5e-4,
    ),
    "hemisphere with a hole 4/1000": (
        partial(cases.hemisphere, thickness=0.04),
        {4: 1.099, 8: 1.027, 16: 1.004, 32: 1.003},
        7e-4,
    ),
    "hemisphere with a hole 4/10000": (
        partial(cases.hemisphere, thickness=0.004),
        {4: 1.096, 8: 1.026, 16: 0.9979, 32: 0.9863},
        5e-4,
    ),
    "full hemisphere 4/1000": (
        partial(cases.full_hemisphere, thickness=0.04),
        {8: 1.019, 16: 0.9994, 32: 0.9965, 64: 0.9992},
        8e-4,
    ),
    "hook": (cases.hook, {2: 0.9896, 4: 0.9794, 8: 0.9800, 16: 0.9877, 32: 0.9952}, 5e-4),
    "hyperbolic paraboloid 1/1000": (
        partial(cases.hyperbolic_paraboloid, thickness=1e-3),
        {4: 0.9533, 8: 0.9589, 16: 0.9728, 32: 0.9868, 64: 0.9951},
        1e-4,
    ),
    "hyperbolic paraboloid 1/10000": (
        partial(cases.hyperbolic_paraboloid, thickness=1e-4),
        {16: 0.9828},
        1e-4,
    ),
    "twisted beam, in plane": (
        partial(cases.twisted_beam, thickness=0.32, direction="in"),
        {2: 0.9810, 4: 0.9899, 8: 0.9947},
        1.05e-3,
    ),
    "twisted beam, out of plane": (
        partial(cases.twisted_beam, thickness=0.32, direction="out"),
        {2: 0.8329, 4: 0.9233, 8: 0.9740},
        5e-4,
    ),
    "thin twisted beam, in plane": (
        partial(cases.twisted_beam, thickness=0.0032, direction="in"),
        {2: 1.000, 4: 0.9881, 8: 0.9932},
        1e-3,
    ),
    "thin twisted beam, out of plane": (
        partial(cases.twisted_beam, thickness=0.0032, direction="out"),
        {2: 0.9901, 4: 0.9898, 8: 0.9951},
        1e-3,
    ),
}
ROWS = [
    pytest.param(problem, n, published, tolerance, id=f"{name}, N = {n}")
    for name, (problem, row, tolerance) in TABLES.items()
    for n, published in row.items()
]


@pytest.mark.parametrize(("problem", "n", "published", "tolerance"), ROWS)
def test_displacement_is_the_published_one(problem, n, published, tolerance):
    assert problem(n) == pytest.approx(published, abs=tolerance)


def test_coarsest_full_hemisphere_comes_as_near_as_its_inner_vertices_are_known():
    # The published mesh of three patches is drawn, not given: 0.3 % at two elements a side, less from there.
    assert cases.full_hemisphere(4, 0.04) == pytest.approx(1.056, abs=3.2e-3)
