"""C3D files: the header is checked, ezc3d runs apart, and nothing cut short or damaged slips through."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.motion import c3d as c3d_module
from hilbrace.motion.c3d import C3DReader, read_c3d
from hilbrace.motion.c3d_header import check_c3d
from hilbrace.motion.opensim_files import read_storage
from tests.unit import motion_files as lab


@pytest.fixture(scope="module")
def reader():
    with C3DReader() as reader:
        yield reader


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A file of 30 frames, 21 markers, 2 plates."""
    folder = tmp_path_factory.mktemp("c3d")
    return lab.write_c3d(folder / "small.c3d", positions=lab.markers()[:30])


def changed(path: Path, folder: Path, **edits: bytes) -> Path:
    """A copy with bytes replaced at offsets named ``at_12``."""
    content = bytearray(path.read_bytes())
    for key, value in edits.items():
        at = int(key.removeprefix("at_"))
        content[at : at + len(value)] = value
    copy = folder / "changed.c3d"
    copy.write_bytes(content)
    return copy


def test_markers_and_forces_come_back_in_si(small, reader):
    content = reader.read(small)
    assert content.markers.names == lab.marker_names()
    assert content.markers.rate_hz == 100.0
    assert content.markers.time == pytest.approx(np.arange(30) / 100)
    assert content.markers.positions == pytest.approx(lab.to_lab(lab.markers()[:30]), abs=1e-6)
    plates = content.plates
    assert plates is not None
    assert plates.rate_hz == 400.0
    for k, foot in enumerate(("right", "left")):
        load = lab.vertical(plates.time)
        force = lab.to_lab(load[:, None] * np.array([0.05, 1.0, -0.1]))
        assert plates.force[:, k] == pytest.approx(force, abs=1e-3)
        arm = lab.to_lab(np.array(lab.CENTRES[foot])) - plates.point[0, k]
        about_middle = np.cross(arm, force) + np.column_stack([0 * load, 0 * load, 0.01 * load])
        assert plates.torque[:, k] == pytest.approx(about_middle, abs=1e-3)
    assert content.notes == ()


def test_forces_on_the_plate_are_turned_with_a_note(tmp_path, reader):
    content = reader.read(lab.write_c3d(tmp_path / "turned.c3d", sign=1.0))
    assert content.plates is not None
    assert (content.plates.force[:, :, 2] > 0).all()
    assert "sign was changed" in content.notes[0]


def test_hidden_unlabelled_and_prefixed_markers(tmp_path, reader):
    positions = lab.markers()[:30].copy()
    positions[5:9, 0] = np.nan
    positions[12, 1] = 0.0
    names = (*(f"Anna:{name}" for name in lab.marker_names()[:-1]), "*7")
    content = reader.read(lab.write_c3d(tmp_path / "gaps.c3d", names, positions))
    assert content.markers.names == lab.marker_names()[:-1]
    hidden = np.isnan(content.markers.positions).any(axis=2)
    assert np.flatnonzero(hidden[:, 0]).tolist() == [5, 6, 7, 8]
    assert np.flatnonzero(hidden[:, 1]).tolist() == [12]
    assert not hidden[:, 2:].any()
    assert "1 unlabelled" in content.notes[0]


def test_two_subjects_are_refused(tmp_path, reader):
    names = ("Anna:LASI", "Ben:LASI", *lab.marker_names()[2:])
    with pytest.raises(InputError, match="markers share a name: LASI"):
        reader.read(lab.write_c3d(tmp_path / "two.c3d", names))


def test_no_truncation_is_accepted(small, tmp_path, reader):
    whole = small.read_bytes()
    needed = check_c3d(small).expected_bytes
    path = tmp_path / "cut.c3d"
    lengths = {*range(0, needed, 997), needed - 1, needed - 100, 511, 512, 1024}
    for length in sorted(lengths):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError) as caught:
            reader.read(path)
        assert str(path) in caught.value.where
    path.write_bytes(whole[: needed - 1])
    with pytest.raises(InputError, match="cut short: 30 frames need"):
        reader.read(path)


FAULTS = {
    "no C3D file": ({"at_1": b"\x51"}, "not a C3D file"),
    "more frames": ({"at_8": struct.pack("<H", 31)}, "header counts 31 frames, the parameters 30"),
    "fewer frames": ({"at_8": struct.pack("<H", 20)}, "header counts 20 frames, the parameters 30"),
    "no frames": ({"at_6": struct.pack("<2H", 5, 3)}, "frames run from 5 to 3"),
    "fewer points": ({"at_2": struct.pack("<H", 20)}, "header counts 20 points, the parameters 21"),
    "other analog count": ({"at_4": struct.pack("<H", 40)}, "40 analog values a frame"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_header_that_contradicts_the_file_is_refused(small, tmp_path, reader, fault):
    edits, what = FAULTS[fault]
    with pytest.raises(InputError, match=what):
        reader.read(changed(small, tmp_path, **edits))


def test_more_frames_than_the_header_can_count_are_refused(tmp_path):
    positions = np.ones((66_000, 2, 3))
    path = lab.write_c3d(tmp_path / "long.c3d", ("A", "B"), positions, per_frame=1)
    with pytest.raises(InputError, match="holds more than the 65535 frames"):
        check_c3d(path)


def test_a_missing_file_and_a_text_file_are_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_c3d(tmp_path / "absent.c3d")
    (tmp_path / "text.c3d").write_text("hello" * 1000)
    with pytest.raises(InputError, match="not a C3D file"):
        read_c3d(tmp_path / "text.c3d")


def test_150_mutations_never_harm_the_caller(small, tmp_path, reader):
    """Bytes changed at random: a recording of all frames or an `InputError`, whatever ezc3d makes of it."""
    random = np.random.default_rng(11)
    whole = np.frombuffer(small.read_bytes(), np.uint8)
    start = (int(whole[0]) - 1) * 512
    data = (int(struct.unpack_from("<H", whole.tobytes(), 16)[0]) - 1) * 512
    regions = ((0, 512), (start, data), (data, len(whole)))
    path = tmp_path / "mutant.c3d"
    accepted = 0
    for k in range(150):
        content = whole.copy()
        low, high = regions[k % 3]
        for _ in range(int(random.integers(1, 9))):
            at = int(random.integers(low, high))
            content[at : at + int(random.integers(1, 5))] = random.integers(0, 256)
        path.write_bytes(content.tobytes())
        refusal = ""
        try:
            assert len(reader.read(path).markers.time) == 30
            accepted += 1
        except InputError as fault:
            refusal = fault.two_lines()
        assert not refusal or (str(path) in refusal and refusal.count("\n") == 1)
    assert 10 < accepted < 140


def test_a_reader_that_dies_is_replaced(small, tmp_path, monkeypatch):
    source = Path(c3d_module.__file__).with_name("c3d_worker.py").read_text()
    crash = "    if 'deadly' in path:\n        os.abort()\n"
    fragile = source.replace("    content = ezc3d", crash + "    content = ezc3d")
    assert fragile != source
    (tmp_path / "c3d_worker.py").write_text(fragile)
    monkeypatch.setattr(c3d_module, "__file__", str(tmp_path / "c3d.py"))
    deadly = tmp_path / "deadly.c3d"
    deadly.write_bytes(small.read_bytes())
    with C3DReader() as reader:
        assert len(reader.read(small).markers.time) == 30
        with pytest.raises(InputError, match="died on this file"):
            reader.read(deadly)
        assert len(reader.read(small).markers.time) == 30


def test_a_reader_that_hangs_is_stopped(small, tmp_path, monkeypatch):
    source = Path(c3d_module.__file__).with_name("c3d_worker.py").read_text()
    slow = source.replace("    content = ezc3d", "    import time\n\n    time.sleep(60)\n    content = ezc3d")
    (tmp_path / "c3d_worker.py").write_text(slow)
    monkeypatch.setattr(c3d_module, "__file__", str(tmp_path / "c3d.py"))
    monkeypatch.setattr(c3d_module, "SECONDS_PER_FILE", 0.2)
    with C3DReader() as reader, pytest.raises(InputError, match="still reading after 0 s"):
        reader.read(small)


def test_the_reader_leaves_no_process_behind(small):
    with C3DReader() as reader:
        reader.read(small)
        process = reader._process
    assert process is not None
    assert process.poll() is not None


def test_ezc3d_is_not_imported_by_the_caller(small):
    program = (
        "import sys; from pathlib import Path; from hilbrace.motion.c3d import read_c3d; "
        f"read_c3d(Path({str(small)!r})); sys.exit('ezc3d' in sys.modules)"
    )
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", program], cwd=root, env=os.environ, check=False)
    assert done.returncode == 0


# --- recorded files -------------------------------------------------------------------------------------


def z_up_cop(plates, k):
    force, torque = plates.force[:, k], plates.torque[:, k]
    shift = np.column_stack([-torque[:, 1], torque[:, 0], 0 * torque[:, 0]]) / force[:, [2]]
    return plates.point[:, k] + shift


def test_plates_of_type_2_equal_opensims_own_reading(shared_data, reader):
    """`std_cop_walking2_grfs.sto` is what OpenSim reads from the same file, in N, mm and N*mm."""
    folder = shared_data / "c3d_force_plates"
    plates = reader.read(folder / "vicon_type2_walking2.c3d").plates
    oracle = read_storage(folder / "std_cop_walking2_grfs.sto")
    rows = np.searchsorted(plates.time, oracle.time - 1e-6)
    for k in range(2):
        force, centre, torque = (
            np.column_stack([oracle.columns[f"{kind}{k + 1}_{axis}"] for axis in "123"]) for kind in "fpm"
        )
        assert plates.force[rows, k] == pytest.approx(force, abs=1e-5)
        loaded = np.abs(force[:, 2]) > 20
        cop = z_up_cop(plates, k)[rows]
        assert 1000 * cop[loaded] == pytest.approx(centre[loaded], abs=1e-3)
        lever = np.cross(plates.point[rows, k] - cop, plates.force[rows, k])
        free = (plates.torque[rows, k] + lever)[loaded]
        assert 1000 * free[:, 2] == pytest.approx(torque[loaded, 2], abs=0.05)


PEAKS = {
    "TYPE-2.C3D": [397.9],
    "TYPE-4.C3D": [390.5],
    "qualisys_type3_2frames.c3d": [886.7, 1.1],
    "qualisys_type2_walk.c3d": [808.4, 839.7],
    "qualisys_type4_JH_01.c3d": [735.6, 403.9],
}


@pytest.mark.parametrize("name", PEAKS)
def test_plates_of_types_2_3_and_4_push_up(shared_data, reader, name):
    content = reader.read(shared_data / "c3d_force_plates" / name)
    assert content.plates.force[:, :, 2].max(axis=0) == pytest.approx(PEAKS[name], abs=0.06)
    assert any("sign" in note for note in content.notes) == (name == "qualisys_type4_JH_01.c3d")


def test_a_plate_without_samples_is_noted(shared_data, reader):
    content = reader.read(shared_data / "c3d_force_plates/sample28_type1.C3D")
    assert content.plates is None
    assert content.notes == (
        "sample28_type1.C3D stores analog values of no channel or rate: force plates are not read.",
    )
    step = np.linalg.norm(np.diff(content.markers.positions, axis=0), axis=2)
    assert np.nanmedian(step) < 0.02


def test_eight_plates_of_a_sprint(shared_data, reader):
    content = reader.read(shared_data / "c3d_sprint_8plates/JA1Gait35.c3d")
    peaks = content.plates.force[:, :, 2].max(axis=0)
    assert peaks == pytest.approx([0, 2445.8, 0, 2190.6, 0, 0, 2360.4, 2162.3], abs=0.06)
    assert (content.markers.rate_hz, content.plates.rate_hz) == (250.0, 1500.0)


def test_metres_prefixes_and_gaps_of_a_tennis_serve(shared_data, reader):
    folder = shared_data / "tennis_serve"
    whole = reader.read(folder / "kinematics_tennis_serve.c3d").markers
    gappy = reader.read(folder / "kinematics_tennis_serve_nan.c3d").markers
    assert "LKNE" in whole.names
    assert 1.2 < np.nanmedian(whole.positions[:, whole.names.index("C7"), 2]) < 1.7
    assert np.isnan(gappy.positions).sum() > np.isnan(whole.positions).sum()


def test_every_recorded_file_passes_the_header_check(shared_data):
    files = sorted(path for path in shared_data.rglob("*") if path.suffix.lower() == ".c3d")
    assert len(files) >= 21
    for path in files:
        assert check_c3d(path).expected_bytes <= path.stat().st_size
