"""Written C3D files come back whole through ezc3d, an independent reader, and through ours."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from evaluation.c3d_writer import write_c3d, z_up
from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.c3d_header import check_c3d
from hilbrace.motion.force_plates import PlateForces
from hilbrace.motion.opensim_files import MarkerTable, read_trc, write_trc
from hilbrace.motion.recording import Recording, from_z_up, read_recording


def recording(frames=200, markers=13, per_frame=5, plates=2):
    rng = np.random.default_rng(4)
    names = tuple(f"M{k}" for k in range(markers))
    positions = rng.normal(0, 0.5, (frames, markers, 3))
    positions[rng.random((frames, markers)) < 0.1] = np.nan
    table = MarkerTable(names, np.arange(frames) / 200.0, 200.0, positions)
    samples = frames * per_frame
    loads = PlateForces(
        "made up",
        tuple(str(k + 1) for k in range(plates)),
        tuple(f"plate {k + 1}" for k in range(plates)),
        np.arange(samples) / (200.0 * per_frame),
        200.0 * per_frame,
        rng.uniform(100, 900, (samples, plates, 3)) * [0.1, 1.0, -0.1],
        np.tile(rng.uniform(-0.5, 0.5, (1, plates, 3)), (samples, 1, 1)),
        rng.normal(0, 20, (samples, plates, 3)),
    )
    return Recording(table, loads if plates else None, ())


@pytest.fixture(scope="module")
def reader():
    with C3DReader() as reader:
        yield reader


@pytest.mark.parametrize("plates", [0, 1, 3])
def test_everything_comes_back(tmp_path, reader, plates):
    path = tmp_path / "out.c3d"
    wanted = recording(plates=plates)
    write_c3d(path, wanted, prefix="Anna")
    found = read_recording(path, None, None, reader)
    assert found.notes == ()
    assert found.markers.names == wanted.markers.names
    assert found.markers.rate_hz == 200.0
    assert np.array_equal(np.isnan(found.markers.positions), np.isnan(wanted.markers.positions))
    assert np.nanmax(np.abs(found.markers.positions - wanted.markers.positions)) < 1e-7
    assert (found.plates is None) == (plates == 0)
    if plates:
        assert found.plates.rate_hz == 1000.0
        assert np.abs(found.plates.force - wanted.plates.force).max() < 1e-3
        assert np.abs(found.plates.point - wanted.plates.point).max() < 1e-6
        assert np.abs(found.plates.torque - wanted.plates.torque).max() < 1e-3


def test_ezc3d_sees_labels_units_and_plates(tmp_path):
    """In a process of its own, as ezc3d always runs."""
    write_c3d(tmp_path / "out.c3d", recording(), plate_size_m=(0.6, 0.4), prefix="Anna")
    program = (
        "import ezc3d, sys\n"
        "c = ezc3d.c3d(sys.argv[1], extract_forceplat_data=True)\n"
        "p = c['parameters']\n"
        "assert p['POINT']['LABELS']['value'][0] == 'Anna:M0', p['POINT']['LABELS']\n"
        "assert p['POINT']['UNITS']['value'] == ['mm']\n"
        "assert p['ANALOG']['LABELS']['value'][:7] == ['Fx1', 'Fy1', 'Fz1', 'Mx1', 'My1', 'Mz1', 'Fx2']\n"
        "assert p['FORCE_PLATFORM']['TYPE']['value'].tolist() == [2, 2]\n"
        "corners = c['data']['platform'][0]['corners']\n"
        "assert abs(corners[0].max() - corners[0].min() - 600) < 0.1, corners\n"
        "assert abs(corners[1].max() - corners[1].min() - 400) < 0.1\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path / "out.c3d")], check=False)
    assert done.returncode == 0


def test_the_header_keeps_its_promises(tmp_path):
    path = tmp_path / "out.c3d"
    write_c3d(path, recording(frames=31))
    header = check_c3d(path)
    assert (header.frames, header.points, header.analog_per_frame) == (31, 13, 5)
    assert path.stat().st_size % 512 == 0
    path.write_bytes(path.read_bytes()[:-512])
    with pytest.raises(InputError, match="cut short"):
        check_c3d(path)


def test_more_labels_than_one_parameter_holds(tmp_path, reader):
    wanted = recording(frames=4, markers=300, plates=0)
    write_c3d(tmp_path / "many.c3d", wanted)
    assert read_recording(tmp_path / "many.c3d", None, None, reader).markers.names == wanted.markers.names


def test_the_same_recording_gives_the_same_bytes(tmp_path):
    write_c3d(tmp_path / "a.c3d", recording())
    write_c3d(tmp_path / "b.c3d", recording())
    assert (tmp_path / "a.c3d").read_bytes() == (tmp_path / "b.c3d").read_bytes()


def test_c3d_and_trc_agree(tmp_path, reader):
    wanted = recording(plates=0).markers
    write_c3d(tmp_path / "out.c3d", Recording(wanted, None, ()))
    write_trc(tmp_path / "out.trc", wanted.time, wanted.rate_hz, wanted.names, wanted.positions)
    trc = read_trc(tmp_path / "out.trc").positions
    c3d = read_recording(tmp_path / "out.c3d", None, None, reader).markers.positions
    assert np.array_equal(np.isnan(trc), np.isnan(c3d))
    assert np.nanmax(np.abs(trc - c3d)) < 1e-6


def test_forces_that_do_not_fit_the_frames_are_refused(tmp_path):
    wanted = recording()
    loads = wanted.plates
    arrays = {key: getattr(loads, key)[:-1] for key in ("time", "force", "point", "torque")}
    fewer = replace(loads, **arrays)
    with pytest.raises(InputError, match="999 force samples do not fit 200 frames"):
        write_c3d(tmp_path / "out.c3d", replace(wanted, plates=fewer))


def test_what_a_c3d_file_cannot_hold_is_refused(tmp_path):
    wanted = recording(frames=2, plates=0)
    strange = replace(wanted.markers, names=("Hüfte", *wanted.markers.names[1:]))
    with pytest.raises(InputError, match="'Hüfte' cannot be a label"):
        write_c3d(tmp_path / "out.c3d", Recording(strange, None, ()))
    long = MarkerTable(("A",), np.arange(70_000) / 100, 100.0, np.zeros((70_000, 1, 3)))
    with pytest.raises(InputError, match="70000 frames do not fit"):
        write_c3d(tmp_path / "out.c3d", Recording(long, None, ()))
    assert not (tmp_path / "out.c3d").exists()


def test_z_up_is_the_inverse_of_y_up():
    vectors = np.random.default_rng(0).normal(size=(5, 3))
    assert from_z_up(z_up(vectors)).tolist() == vectors.tolist()


@pytest.mark.parametrize(
    "name",
    [
        "c3d_force_plates/vicon_type2_walking2.c3d",
        "c3d_sprint_8plates/JA1Gait35.c3d",
        "c3d_cluster_protocol/2022_01_0401.c3d",
    ],
)
def test_recorded_files_survive_writing(shared_data, tmp_path, reader, name):
    wanted = read_recording(shared_data / name, None, None, reader)
    write_c3d(tmp_path / "copy.c3d", wanted)
    found = read_recording(tmp_path / "copy.c3d", None, None, reader)
    assert np.nanmax(np.abs(found.markers.positions - wanted.markers.positions)) < 1e-7
    assert np.array_equal(np.isnan(found.markers.positions), np.isnan(wanted.markers.positions))
    if wanted.plates is not None:
        assert np.abs(found.plates.force - wanted.plates.force).max() < 1e-4
        assert np.abs(found.plates.torque - wanted.plates.torque).max() < 1e-4


def test_a_plate_that_nobody_stepped_on_is_written_unloaded(tmp_path, reader):
    """Force files give NaN as the point of an unloaded plate."""
    wanted = recording(plates=2)
    wanted.plates.force[:, 1], wanted.plates.torque[:, 1] = 0.0, 0.0
    wanted.plates.point[:, 1] = np.nan
    path = tmp_path / "out.c3d"
    write_c3d(path, wanted)
    found = read_recording(path, None, None, reader)
    assert not found.plates.force[:, 1].any()
    assert np.abs(found.plates.force[:, 0] - wanted.plates.force[:, 0]).max() < 1e-3
