"""TRC, MOT and STO: what is written is read, and what is damaged is refused with its place."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hilbrace.errors import InputError
from hilbrace.motion.opensim_files import coordinates_rad, read_storage, read_trc, write_storage, write_trc

NAMES = st.lists(
    st.text(st.characters(categories=("L", "N"), include_characters="._- #"), min_size=1, max_size=12)
    .map(str.strip)
    .filter(bool),
    min_size=1,
    max_size=5,
    unique=True,
)
LIVE = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def trc(folder: Path, frames: int = 4) -> Path:
    path = folder / "m.trc"
    markers = np.arange(1.0, 1 + frames * 6).reshape(frames, 2, 3) / 7
    write_trc(path, np.arange(frames) / 100, 100.0, ("LASI", "RASI"), markers)
    return path


def mot(folder: Path) -> Path:
    path = folder / "s.mot"
    write_storage(path, np.arange(5) / 10, {"a": np.arange(5) / 7, "b": -np.arange(5.0)}, degrees=False)
    return path


def edit(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@LIVE
@given(st.data())
def test_trc_round_trip(tmp_path, data):
    names = tuple(data.draw(NAMES))
    frames = data.draw(st.integers(2, 6))
    rate = data.draw(st.sampled_from([50.0, 100.0, 120.0, 200.0, 59.94]))
    units = data.draw(st.sampled_from(["m", "cm", "mm"]))
    cells = st.floats(-20, 20).filter(lambda value: abs(value) > 1e-6)
    flat = data.draw(st.lists(cells, min_size=frames * len(names) * 3, max_size=frames * len(names) * 3))
    markers = np.array(flat).reshape(frames, len(names), 3)
    seen = st.lists(st.booleans(), min_size=frames * len(names), max_size=frames * len(names))
    hidden = np.array(data.draw(seen)).reshape(frames, len(names))
    markers[hidden] = np.nan
    path = tmp_path / "m.trc"
    write_trc(path, 3.5 + np.arange(frames) / rate, rate, names, markers, units)
    table = read_trc(path)
    assert table.names == names
    assert table.rate_hz == rate
    assert table.time == pytest.approx(3.5 + np.arange(frames) / rate, abs=1e-7)
    assert np.array_equal(np.isnan(table.positions), np.isnan(markers))
    assert np.nanmax(np.abs(table.positions - markers), initial=0.0) <= 1.01e-7


@LIVE
@given(st.data())
def test_storage_round_trip(tmp_path, data):
    names = [name for name in data.draw(NAMES) if name.lower() != "time"] or ["a"]
    rows = data.draw(st.integers(2, 6))
    numbers = st.floats(allow_infinity=False, width=32)
    columns = {n: np.array(data.draw(st.lists(numbers, min_size=rows, max_size=rows))) for n in names}
    degrees = data.draw(st.booleans())
    path = tmp_path / "s.sto"
    write_storage(path, np.arange(rows) / 1000, columns, degrees)
    storage = read_storage(path)
    assert list(storage.columns) == names
    assert storage.degrees is degrees
    for name in names:
        np.testing.assert_allclose(storage.columns[name], columns[name], rtol=1e-9, atol=0)


def test_units_of_the_header_are_metres_in_memory(tmp_path):
    path = edit(trc(tmp_path), "\tm\t", "\tmm\t")
    assert read_trc(path).positions[0, 0, 0] == pytest.approx(1e-3 / 7, abs=1e-9)


def test_hidden_markers_read_as_nan(tmp_path):
    path = trc(tmp_path, 3)
    lines = path.read_text().split("\n")
    lines[6] = "1\t0.0\t0\t0\t0\t1\t2\t3"
    lines[7] = "2\t0.01\t\t\t\t1\t\t3"
    lines[8] = "3\t0.02\tNaN\tnan\tNaN\t1\t2\t3"
    path.write_text("\n".join(lines) + "\n")
    hidden = np.isnan(read_trc(path).positions).all(axis=2)
    assert hidden.tolist() == [[True, False], [True, True], [True, False]]


def test_unnamed_trajectories_get_a_star(tmp_path):
    path = edit(trc(tmp_path), "Time\tLASI\t\t\tRASI\t\t", "Time\tLASI\t\t\t\t\t")
    assert read_trc(path).names == ("LASI", "*2")


def test_rounded_instants_become_even_ones(tmp_path):
    path = tmp_path / "m.trc"
    write_trc(path, np.round(np.arange(50) / 120, 3), 120.0, ("A",), np.ones((50, 1, 3)))
    assert read_trc(path).time == pytest.approx(np.arange(50) / 120, abs=1e-12)


TRC_FAULTS = {
    "no units": ("\tUnits\t", "\t", "names no units", "line 2"),
    "unknown units": ("\tm\t", "\tinch\t", "units 'inch' are not", "line 3"),
    "rate zero": ("100\t100\t", "0\t100\t", "no positive number", "line 3"),
    "count of frames": ("100\t100\t4\t", "100\t100\t5\t", "promises 5 rows.*holds 4", "m.trc"),
    "count of markers": ("\t4\t2\tm", "\t4\t3\tm", "promises 3 markers, line 4 names 2", "line 4"),
    "not a TRC file": ("PathFileType", "Path", "not a TRC file", "line 2"),
    "no number": ("0.1428571", "0.14x8571", "'0.14x8571' is no number", "line 7, column 3 'LASI.x'"),
    "decimal comma": ("0.1428571", "0,1428571", "'0,1428571' is no number", "line 7, column 3 'LASI.x'"),
    "infinite": ("0.1428571", "inf", "infinite", "data row 1, column 'LASI.x'"),
    "short row": ("\t0.2857143", "", "7 cells where the header names 8", "line 7"),
    "lost time": ("\t0.02000000\t", "\t0.09000000\t", "not evenly spaced", "row 3"),
    "wrong rate": ("100\t100\t4", "250\t250\t4", "0.01 s apart, the header says 250 Hz", "m.trc"),
    "same name": ("RASI", "LASI", "names 1", "line 4"),
}  # fmt: skip


@pytest.mark.parametrize("fault", TRC_FAULTS)
def test_a_damaged_trc_file_is_refused_with_its_place(tmp_path, fault):
    old, new, what, where = TRC_FAULTS[fault]
    with pytest.raises(InputError, match=what) as caught:
        read_trc(edit(trc(tmp_path), old, new))
    assert where in caught.value.where
    assert caught.value.hint
    assert caught.value.two_lines().count("\n") == 1


def test_a_decimal_comma_is_named_in_the_hint(tmp_path):
    with pytest.raises(InputError) as caught:
        read_trc(edit(trc(tmp_path), "0.1428571", "0,1428571"))
    assert "point" in caught.value.hint


STORAGE_FAULTS = {
    "count of rows": ("nRows=5", "nRows=6", "promises 6 rows.*holds 5", "s.mot"),
    "no end of header": ("endheader", "", "no line 'endheader'", "s.mot"),
    "no time": ("time\ta", "frame\ta", "do not start with 'time'", "line 7"),
    "same name": ("time\ta\tb", "time\ta\ta", "repeat", "line 7"),
    "no number": ("0.1428571429", "abc", "'abc' is no number", "line 9, column 2 'a'"),
    "time goes back": ("0.2\t", "0.05\t", "time does not increase", "data row 3"),
    "short row": ("\t-3", "", "2 cells where the header names 3", "line 11"),
    "header no number": ("nRows=5", "nRows=five", "five", "header"),
}


@pytest.mark.parametrize("fault", STORAGE_FAULTS)
def test_a_damaged_storage_is_refused_with_its_place(tmp_path, fault):
    old, new, what, where = STORAGE_FAULTS[fault]
    with pytest.raises(InputError, match=what) as caught:
        read_storage(edit(mot(tmp_path), old, new))
    assert where in caught.value.where


@pytest.mark.parametrize("reader", [read_trc, read_storage])
def test_a_missing_file_and_a_folder_are_named(tmp_path, reader):
    with pytest.raises(InputError, match="no such file"):
        reader(tmp_path / "absent.trc")
    with pytest.raises(InputError, match="cannot be read"):
        reader(tmp_path)


@pytest.mark.parametrize(("make", "reader"), [(trc, read_trc), (mot, read_storage)])
def test_no_truncation_is_accepted(tmp_path, make, reader):
    whole = make(tmp_path).read_bytes()
    path = tmp_path / "cut"
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError):
            reader(path)


def test_old_storages_and_padded_columns_are_read(tmp_path):
    path = tmp_path / "old.mot"
    header = "name old\ndatacolumns 3\ndatarows 2\nrange 0 1\nendheader\n\n"
    path.write_text(header + "   time\t  f1 \t f2\n 0.0 \t 1.0\t 2\n 0.5 3 4\n")
    assert read_storage(path).columns["f2"].tolist() == [2.0, 4.0]


def test_windows_line_ends_and_byte_order_marks_do_no_harm(tmp_path):
    path = trc(tmp_path)
    before = read_trc(path)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert np.array_equal(read_trc(path).positions, before.positions)


def test_coordinates_leave_translations_and_betas_alone(tmp_path):
    path = tmp_path / "q.mot"
    column = np.array([90.0, 180.0])
    names = ("knee_angle_r", "pelvis_tx", "knee_angle_r_beta")
    write_storage(path, np.array([0.0, 1.0]), dict.fromkeys(names, column), degrees=True)
    found = coordinates_rad(read_storage(path))
    assert found["knee_angle_r"] == pytest.approx([np.pi / 2, np.pi])
    assert np.array_equal(found["pelvis_tx"], column)
    assert np.array_equal(found["knee_angle_r_beta"], column)


@pytest.mark.parametrize("names", [("a", "a"), ("a\tb", "c"), ("", "c")])
def test_names_that_no_file_can_hold_are_refused(tmp_path, names):
    with pytest.raises(InputError, match="names must differ"):
        write_trc(tmp_path / "m.trc", np.arange(2.0), 1.0, names, np.ones((2, 2, 3)))


@pytest.mark.malformed
def test_shapes_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(InputError, match="does not fit"):
        write_trc(tmp_path / "m.trc", np.arange(2.0), 1.0, ("a",), np.ones((2, 2, 3)))
    with pytest.raises(InputError, match="column 'a' does not fit"):
        write_storage(tmp_path / "s.mot", np.arange(2.0), {"a": np.ones(3)}, degrees=False)


def test_recorded_files_have_what_their_readme_says(shared_data):
    table = read_trc(shared_data / "opencap_subject4/markers/DJ1.trc")
    assert (table.positions.shape, table.rate_hz) == ((269, 51, 3), 100.0)
    forces = read_storage(shared_data / "opencap_subject4/grf/DJ1_grf.mot")
    total = sum(v for name, v in forces.columns.items() if re.fullmatch(r"ground_force_\d_vy", name))
    first = total[forces.time < 2.0]
    assert first.max() == pytest.approx(1977, abs=1)
    assert forces.time[np.argmax(first > 20)] == pytest.approx(1.42, abs=0.005)
    walk = read_trc(shared_data / "rajagopal_walk/markers_walk.trc")
    assert (len(walk.names), walk.rate_hz) == (41, 100.0)


def test_a_published_file_whose_time_is_ten_times_too_long_is_refused(shared_data):
    with pytest.raises(InputError, match="header says 250 Hz"):
        read_trc(shared_data / "c3d_force_plates/std_walking2_markers.trc")
