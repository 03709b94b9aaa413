"""Measured curves: what is read, what is fitted and how surely, and what is refused by name and row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.errors import ConfigError, InputError
from hilbrace.pattern.coupon.calibration import calibrate, run_file_lines
from hilbrace.pattern.coupon.curve import TensileCurve, read_curve

GAUGE = 120.0
STIFFNESS = 0.25


def curve(length, force):
    return TensileCurve("made.csv", tuple(range(2, len(length) + 2)), np.asarray(length), np.asarray(force))


def written(path, text):
    file = path / "curve.csv"
    file.write_text(text, "utf-8")
    return file


def table(count=20, header="extension [mm],force [N]", length=1.0, force=1.0, mark=","):
    rows = [f"{length * x:.6g}{mark}{force * 0.3 * x:.6g}" for x in np.linspace(0, 12, count)]
    return "\n".join([header, *rows]) + "\n"


@given(st.floats(0.05, 20.0), st.floats(-5.0, 5.0))
def test_a_straight_line_gives_its_modulus_exactly(modulus, offset):
    length = np.linspace(0, 13, 60)
    found = calibrate(curve(length, modulus * STIFFNESS * length + offset), STIFFNESS, GAUGE)
    assert found.youngs_modulus_mpa == pytest.approx(modulus, rel=1e-9)
    assert found.offset_n == pytest.approx(offset, abs=1e-9)
    assert found.half_width_mpa < 1e-6 * max(modulus, abs(offset))
    assert 0.02 <= found.strain[0] < found.strain[1] <= 0.10
    assert found.bend == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("alike", [0.0, 0.9])
def test_the_interval_covers_the_truth_as_often_as_it_says(alike):
    """White noise, and noise whose neighbours are alike, which a plain fit trusts too much."""
    rng = np.random.default_rng(0)
    length = np.linspace(0, 13, 200)
    covered = 0
    for _ in range(300):
        noise = rng.normal(0, 0.05, 200)
        for k in range(1, 200):
            noise[k] = alike * noise[k - 1] + np.sqrt(1 - alike**2) * noise[k]
        found = calibrate(curve(length, 1.2 * STIFFNESS * length + noise), STIFFNESS, GAUGE)
        covered += abs(found.youngs_modulus_mpa - 1.2) <= found.half_width_mpa
    assert 0.85 < covered / 300 <= 0.99


def test_toe_return_and_stiffening_are_left_out():
    length = np.concatenate([np.linspace(0, 40, 400), np.linspace(40, 0, 400)])
    strain = length / GAUGE
    toe = np.where(strain < 0.015, 0.2 * (strain / 0.015 - 1.0), 0.0)
    force = 1.1 * STIFFNESS * length + toe + 40 * np.maximum(strain - 0.12, 0) ** 2
    force[400:] *= 0.7
    found = calibrate(curve(length, force), STIFFNESS, GAUGE)
    assert found.youngs_modulus_mpa == pytest.approx(1.1, rel=1e-6)
    assert found.rows[1] <= 401


def test_bend_says_how_the_slope_changes():
    length = np.linspace(0, 13, 200)
    found = calibrate(curve(length, 0.3 * length + 0.01 * length**2), STIFFNESS, GAUGE)
    assert found.bend > 0.1


@pytest.mark.parametrize(
    ("header", "length", "force", "mark"),
    [
        ("extension [mm],force [N]", 1.0, 1.0, ","),
        ("Force_N,Extension_mm", 1.0, 1.0, ","),
        ("time [s],Load (kN),Displacement (m)", 1e-3, 1e-3, ","),
        ('"Extension","Load"\n"(mm)","(N)"', 1.0, 1.0, ","),
        ("elongation [cm];force [mN]", 0.1, 1e3, ";"),
        ("strain [%]\tforce [N]", 100.0 / GAUGE, 1.0, "\t"),
    ],
)
def test_headers_and_units(tmp_path, header, length, force, mark):
    x = np.linspace(0, 12, 20)
    columns = []
    for name in header.splitlines()[0].split(mark):
        low = name.lower()
        if "time" in low:
            columns.append(x)
        else:
            columns.append(0.3 * x * force if "force" in low or "load" in low else x * length)
    rows = [mark.join(f"{value:.8g}" for value in row) for row in zip(*columns, strict=True)]
    if mark == ";":
        rows = [row.replace(".", ",") for row in rows]
    read = read_curve(written(tmp_path, "\n".join([header, *rows])), GAUGE)
    assert read.lengthening_mm == pytest.approx(x, abs=1e-6)
    assert read.force_n == pytest.approx(0.3 * x, abs=1e-6)
    assert read.row[0] == len(header.splitlines()) + 1


@pytest.mark.parametrize(
    ("text", "what", "where"),
    [
        ("", "empty", "curve.csv"),
        ("1,2\n3,4\n", "no names", "row 1"),
        (table(header="extension,force [N]"), "'extension' has no unit", "header"),
        (table(header="extension [furlong],force [N]"), "unknown unit 'furlong'", "header"),
        (table(header="way [mm],force [N]"), "no columns of the extension", "header"),
        (table(header="extension [mm],tension [N]"), "no columns of the force", "header"),
        (table(header="force [N],force 2 [N]"), "2 columns of the force", "header"),
        (table(count=5), "5 rows", "curve.csv"),
        (table() + "13.0,broken\n", "'broken' in column 'force", "row 22"),
        (table() + "13.0,nan\n", "'nan' in column 'force", "row 22"),
        (table() + "13.0\n", "'' in column 'force", "row 22"),
    ],
)
def test_bad_files_are_refused_by_name_and_row(tmp_path, text, what, where):
    with pytest.raises(InputError, match=r"curve\.csv") as error:
        read_curve(written(tmp_path, text), GAUGE)
    assert what in error.value.what
    assert where in error.value.where


def test_files_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "curve.csv").write_bytes(bytes([0xFF, 0xFE, 0x00, 0x81]))
    for name in ("curve.csv", "absent.csv"):
        with pytest.raises(InputError, match="cannot be read"):
            read_curve(tmp_path / name, GAUGE)


@pytest.mark.parametrize(
    ("length", "sign", "what"),
    [(12_000.0, 1.0, "tears any rubber"), (0.012, 1.0, "0 samples"), (12.0, -1.0, "force falls")],
)
def test_curves_that_cannot_be_right_are_refused_with_their_rows(length, sign, what):
    x = np.linspace(0, length, 100)
    with pytest.raises(InputError, match=r"made\.csv, row") as error:
        calibrate(curve(x, sign * 0.3 * x), STIFFNESS, GAUGE)
    assert what in error.value.what


def test_a_window_must_rise():
    with pytest.raises(ConfigError, match="--from"):
        calibrate(curve(np.arange(20.0), np.arange(20.0)), STIFFNESS, GAUGE, (0.1, 0.05))


def test_the_lines_for_the_run_file_are_read_back():
    import tomllib

    x = np.linspace(0, 13, 60)
    found = calibrate(curve(x, 1.234 * STIFFNESS * x), STIFFNESS, GAUGE)
    assert tomllib.loads(run_file_lines(found)) == {"material": {"youngs_modulus_mpa": 1.234}}
