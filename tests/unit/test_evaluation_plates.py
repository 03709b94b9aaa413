"""Calibration files, zero, centre of pressure and contacts of force plates."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.live.zeroing import empty_plate
from evaluation.plate_calibration import Placement, corner_matrix, load_calibration, plate_info
from evaluation.plate_loads import centre_of_pressure, contacts, without_drift
from evaluation.plate_zero import measure_zero
from evaluation.sources.stream import ground_load
from hilbrace.errors import InputError
from tests.unit.plate_mocks import amti_calibration, raw_plate

RNG = np.random.default_rng(5)
MATRIX = RNG.normal(size=(6, 12))


def rows(matrix: np.ndarray, separator: str = ", ") -> list[str]:
    return [separator.join(f"{v:.12g}" for v in row) for row in matrix]


def test_the_three_forms_of_a_calibration_file_say_the_same(tmp_path):
    table = tmp_path / "plate.toml"
    matrix = "matrix = [" + ",\n".join(f"[{row}]" for row in rows(MATRIX)) + "]\n"
    table.write_text(f'units = "N, N*mm"\nsensor_depth_mm = 41.3\n{matrix}')
    plain = tmp_path / "plate.txt"
    plain.write_text("# AMTI\n" + "\n".join(rows(MATRIX, "\t")) + "\n")
    acl = tmp_path / "plate.acl"
    acl.write_text(
        "SERIAL:0983\n" + "".join(f"COEFFROW{k}:{row},\r\n" for k, row in enumerate(rows(MATRIX, ","), 1))
    )
    found = [
        load_calibration(table),
        load_calibration(plain, "N, N*mm", 41.3),
        load_calibration(acl, "N, N*mm", 41.3),
    ]
    for one in found:
        np.testing.assert_allclose(one.matrix, -MATRIX * np.repeat([1, 1e-3], 3)[:, None], rtol=1e-10)
        assert (one.z_axis, one.surface_z) == ("down", pytest.approx(-0.0413))


def test_pounds_and_inches(tmp_path):
    """The factors of the old sheets: 4.44822 N to the pound, 112.985 N*mm to the inch-pound."""
    path = tmp_path / "plate.csv"
    path.write_text("\n".join(rows(MATRIX)))
    got = load_calibration(path, "lb, in*lb").matrix
    np.testing.assert_allclose(got[:3], -4.44822 * MATRIX[:3], rtol=1e-6)
    np.testing.assert_allclose(got[3:], -0.112985 * MATRIX[3:], rtol=1e-5)


def test_four_corners_weigh_and_find_the_point(tmp_path):
    path = tmp_path / "board.toml"
    path.write_text(
        'name = "board"\nunits = "N, N*m"\n'
        "corners_mm = [[200, 120], [-200, 120], [-200, -120], [200, -120]]\n"
        "newtons_per_count = [0.01, 0.01, 0.01, 0.02]\nsurface_mm = [450, 260]\n"
    )
    board = load_calibration(path)
    counts = np.array([[30000, 10000, 10000, 5000.0], [10000, 10000, 10000, 5000.0]])
    info = plate_info("board", 80.0, ("a", "b", "c", "d"), board, Placement((1.0, 2.0, 0.0)))
    load = ground_load(info, counts)
    forces = counts * [0.01, 0.01, 0.01, 0.02]
    np.testing.assert_allclose(load[:, 2], forces.sum(axis=1))
    places = np.array([[0.2, 0.12], [-0.2, 0.12], [-0.2, -0.12], [0.2, -0.12]])
    expected = forces @ places / forces.sum(axis=1, keepdims=True)
    got = centre_of_pressure(counts @ board.matrix.T, board.surface_z)
    np.testing.assert_allclose(got, expected, atol=1e-12)
    # seen from the laboratory: y of a plate whose z points down is turned
    np.testing.assert_allclose(-load[:, 4] / load[:, 2], 1.0 + expected[:, 0])
    np.testing.assert_allclose(load[:, 3] / load[:, 2], 2.0 - expected[:, 1])


@pytest.mark.parametrize("up", ["z", "y"])
@pytest.mark.parametrize("heading", [0.0, 90.0, 33.0])
def test_a_plate_carries_its_load_into_the_laboratory(up, heading):
    """A vertical force at a point of the surface, whatever way the plate lies."""
    calibration = amti_calibration()
    point, weight = np.array([0.1, -0.05]), 700.0
    placement = Placement((0.4, 0.3, 0.01) if up == "z" else (0.4, 0.01, -0.3), heading, up)
    force = np.array([0.0, 0.0, -weight])  # on the subject, up, where z points down
    place = np.array([*point, calibration.surface_z])
    counts = np.linalg.pinv(calibration.matrix) @ np.concatenate([force, np.cross(place, force)])
    info = plate_info("p", 200.0, tuple("abcdefghijkl"), calibration, placement)
    load = ground_load(info, counts[None])[0]
    c, s = np.cos(np.radians(heading)), np.sin(np.radians(heading))
    x, y = c * point[0] + s * point[1], s * point[0] - c * point[1]
    at = np.array(placement.centre) + ([x, y, 0] if up == "z" else [x, 0, -y])
    vertical = np.array([0, 0, weight]) if up == "z" else np.array([0, weight, 0])
    np.testing.assert_allclose(load[:3], vertical, atol=1e-6)
    np.testing.assert_allclose(load[3:], np.cross(at, vertical), atol=1e-6)
    np.testing.assert_allclose(info.corners.mean(axis=0), placement.centre, atol=1e-12)
    assert np.linalg.det(info.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("a.txt", "1 2 3\n4 5 6\n", "6 rows of equal length"),
        ("a.txt", "\n".join(["1 2 3"] * 5 + ["1 2"]), "6 rows of equal length"),
        ("a.txt", "\n".join(["1 2 x"] * 6), "no number"),
        ("a.txt", "", "6 rows of equal length"),
        ("a.acl", "COEFFROW1:1,2\nCOEFFROW2:1,2\n", "6 rows of equal length"),
        ("a.toml", "matrix = [", "no TOML"),
        ("a.toml", "matrix = [[1]]", "does not say its units"),
        ("a.toml", 'units = "kg"\nmatrix = [[1]]', "units 'kg' are unknown"),
        ("a.toml", 'units = "N, N*m"', "either 'matrix' or 'corners_mm'"),
        ("a.toml", 'units = "N, N*m"\nmatrx = 1', "unknown key 'matrx'"),
        ("a.toml", 'units = "N, N*m"\nmatrix = [[1],[1],[1],[1],[1],["a"]]', "no number"),
        ("a.toml", 'units = "N, N*m"\nmatrix = [[1],[1],[1],[1],[1],[nan]]', "no finite number"),
        ("a.toml", 'units = "N, N*m"\nz_axis = "west"\nmatrix = [[1],[1],[1],[1],[1],[1]]', "z_axis"),
        ("a.toml", 'units = "N, N*m"\nempty_counts=[1, 2]\nmatrix=[[1],[1],[1],[1],[1],[1]]', "empty_counts"),
        ("a.toml", 'units = "N, N*m"\ncorners_mm=[[1, 2]]\nnewtons_per_count=[1]', "1 cells and 1 factors"),
    ],
)  # fmt: skip
def test_a_calibration_file_that_cannot_be_used_says_why(tmp_path, name, text, what):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=what):
        load_calibration(path, "N, N*m" if name != "a.toml" else None)


def test_a_calibration_without_units_or_file_is_refused(tmp_path):
    path = tmp_path / "plate.txt"
    path.write_text("\n".join(rows(MATRIX)))
    with pytest.raises(InputError, match="does not say its units") as caught:
        load_calibration(path)
    assert "N, N*mm" in caught.value.hint
    with pytest.raises(InputError, match="cannot be read"):
        load_calibration(tmp_path / "none.txt", "N, N*m")
    path.write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match="cannot be read"):
        load_calibration(path, "N, N*m")
    with pytest.raises(InputError, match="2 cells"):
        corner_matrix(np.zeros((2, 2)), np.ones(2))


CALIBRATION = replace(amti_calibration(), noise_n=1.0)
PULL = np.linalg.pinv(CALIBRATION.matrix)[:, 2]
"""Counts of one newton upward on the subject along the plate's z axis."""


def resting(newtons: np.ndarray, offset: float = 0.0) -> np.ndarray:
    """Counts while the plate's vertical force is this."""
    return offset + np.outer(newtons, PULL)


def test_the_zero_of_an_empty_plate_is_its_mean():
    noise = np.random.default_rng(1).normal(0, 1.0, 300)
    zero = measure_zero(raw_plate("p", 200.0, CALIBRATION), resting(noise, 17.0), 99)
    np.testing.assert_allclose(zero.counts, 17.0 + noise.mean() * PULL)
    assert zero.noise_n == pytest.approx(noise.std(), rel=1e-9)
    assert (zero.samples, zero.host_time_ns) == (300, 99)


def test_a_plate_that_is_not_empty_and_still_is_not_zeroed():
    rng = np.random.default_rng(2)
    quiet = rng.normal(0, 1.0, 400)
    at = np.arange(400) / 200
    with pytest.raises(InputError, match="too short"):
        measure_zero(raw_plate("p", 200.0, CALIBRATION), resting(quiet[:150]), 0)
    for loaded in (-700 + 6 * np.sin(7 * at), quiet - 10 * at, np.where(at > 1.9, -400.0, 0) + quiet):
        with pytest.raises(InputError, match=r"not empty and still.*varies by") as caught:
            measure_zero(raw_plate("p", 200.0, CALIBRATION), resting(loaded), 0)
        assert "step off" in caught.value.hint
    first = measure_zero(raw_plate("p", 200.0, CALIBRATION), resting(quiet), 0)
    measure_zero(raw_plate("p", 200.0, CALIBRATION), resting(quiet - 15.0), 0, first)
    with pytest.raises(InputError, match="differs by -25 N from the zero before"):
        measure_zero(raw_plate("p", 200.0, CALIBRATION), resting(quiet - 25.0), 0, first)
    known = replace(CALIBRATION, empty=np.zeros(12))
    with pytest.raises(InputError, match="differs by -650 N from its calibration"):
        measure_zero(raw_plate("p", 200.0, known), resting(quiet - 650.0), 0)


def test_a_first_zero_in_the_laboratory_knows_the_calibration_s_noise_and_its_empty_plate():
    still = np.random.default_rng(3).normal(0, 0.4, 400)
    known = raw_plate("p", 200.0, replace(CALIBRATION, noise_n=0.4, empty=np.full(12, 17.0)))
    np.testing.assert_allclose(empty_plate(known, resting(still, 17.0), None), 17.0 + still.mean() * PULL)
    with pytest.raises(InputError, match="differs by -650 N from its calibration"):
        empty_plate(known, resting(still - 650.0, 17.0), None)
    with pytest.raises(InputError, match=r"varies by 1\.6 N.*1\.2 N are allowed"):
        empty_plate(known, resting(4 * still, 17.0), None)


@given(
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
    st.floats(-0.1, 0.1),
    st.floats(-200, 200),
    st.floats(25, 2000),
)
def test_the_centre_of_pressure_is_where_the_force_was_put(x, y, surface, shear, weight):
    force = np.array([shear, -0.3 * shear, weight])
    free = np.array([0.0, 0.0, 7.0])
    for sign in (1, -1):
        load = sign * np.concatenate([force, np.cross([x, y, surface], force) + free])
        np.testing.assert_allclose(centre_of_pressure(load[None], surface)[0], [x, y], atol=1e-9)
    assert np.isnan(centre_of_pressure(load[None] * 1e-3, surface)).all() == (1e-3 * weight < 20)


def contacts_one_by_one(vertical: np.ndarray) -> list[tuple[int, int]]:
    """The rule as a loop."""
    found, start = [], None
    for k, f in enumerate(vertical):
        if start is None and f >= 20:
            start = k
        elif start is not None and not f >= 15:
            found.append((start, k))
            start = None
    return found + ([(start, len(vertical))] if start is not None else [])


@given(st.lists(st.sampled_from([0.0, 14.9, 15.0, 17.0, 19.9, 20.0, 400.0, float("nan")]), max_size=40))
def test_contacts_begin_at_the_onset_and_end_below_the_hysteresis(values):
    vertical = np.array(values, float)
    assert [(c.start, c.stop) for c in contacts(vertical)] == contacts_one_by_one(vertical)


def test_contacts_cut_by_an_end_or_a_gap_are_not_whole():
    vertical = np.array([50, 0, 30, 30, 0, 40, np.nan, 40, 40, 0, 60])
    assert [c.whole for c in contacts(vertical)] == [False, True, False, False, False]


def test_drift_between_unloaded_phases_goes():
    at = np.arange(1000)
    load = np.zeros((1000, 6))
    load[:, 2] = np.where((at > 300) & (at < 600), 700.0, 0.0)
    drift = np.outer(at - 150.0, np.arange(1.0, 7.0)) * 1e-2
    unloaded = load[:, 2] == 0
    got = without_drift(load + drift + 3.0, unloaded)
    middles = [150.0, 799.5]
    inside = (at >= middles[0]) & (at <= middles[1])
    np.testing.assert_allclose(got[inside], load[inside], atol=1e-9)
    np.testing.assert_array_equal(without_drift(load, np.zeros(1000, bool)), load)
