"""The synthetic laboratory's files hold what was generated, and a laboratory's readers find it there."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from hilbrace.errors import InputError
from hilbrace.motion.opensim_files import coordinates_rad, read_storage, read_trc
from hilbrace.motion.synthetic import SyntheticMotion, generate, write_recording
from hilbrace.motion.synthetic.forces import FootForces
from hilbrace.motion.synthetic.laboratory import ANALOG_PER_FRAME, to_laboratory
from hilbrace.units import GRAVITY

NAMES = ("serve", "gait", "squat")
KINDS = {"c3d", "static_c3d", "trc", "static_trc", "grf", "static_grf", "truth"}


@functools.cache
def motion(name: str) -> SyntheticMotion:
    return generate(name, rate_hz=100.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Path]]:
    return {name: write_recording(motion(name), tmp_path_factory.mktemp(name)) for name in NAMES}


def contents(path: Path) -> dict:
    return ezc3d.c3d(str(path), extract_forceplat_data=True)


@pytest.mark.parametrize("name", NAMES)
def test_c3d_holds_markers_and_rates(name: str, written: dict[str, dict[str, Path]]) -> None:
    case = motion(name)
    for kind, markers in (("c3d", case.markers), ("static_c3d", case.static.markers)):
        data = contents(written[name][kind])
        points = data["data"]["points"][:3].transpose(2, 1, 0)
        assert np.abs(points - 1000 * to_laboratory(markers)).max() < 2e-4
        assert tuple(data["parameters"]["POINT"]["LABELS"]["value"]) == case.marker_names
        assert data["header"]["points"]["frame_rate"] == 100.0
        assert data["header"]["analogs"]["frame_rate"] == 100.0 * ANALOG_PER_FRAME
        assert set(data["parameters"]["FORCE_PLATFORM"]["TYPE"]["value"]) == {2}


def test_laboratory_frame_is_z_up_and_right_handed() -> None:
    forward, up, right = to_laboratory(np.eye(3))
    assert np.array_equal(up, [0, 0, 1])
    assert np.array_equal(forward, [1, 0, 0])
    assert np.array_equal(right, [0, -1, 0])
    assert np.array_equal(np.cross(right, forward), np.array([0, 0, 1]))


@pytest.mark.parametrize("name", NAMES)
def test_plates_read_back_as_upward_reactions(name: str, written: dict[str, dict[str, Path]]) -> None:
    """Force, centre of pressure and free moment by ezc3d's own type-2 evaluation."""
    case = motion(name)
    for kind, forces, plates in (
        ("c3d", case.forces, case.plates),
        ("static_c3d", case.static.forces, case.static.plates),
    ):
        platforms = contents(written[name][kind])["data"]["platform"]
        assert len(platforms) == len(plates)
        total = sum(platform["force"][:, ::ANALOG_PER_FRAME].T for platform in platforms)
        assert np.abs(total - to_laboratory(forces.force.sum(axis=1))).max() < 1e-3
        for platform, plate in zip(platforms, plates, strict=True):
            check_plate(platform, "rl".index(plate.foot), forces)


def check_plate(platform: dict, foot: int, forces: FootForces) -> None:
    loaded = platform["force"][2, ::ANALOG_PER_FRAME] > 20.0
    centre = platform["center_of_pressure"][:, ::ANALOG_PER_FRAME].T[loaded]
    expected = 1000 * to_laboratory(forces.centre_of_pressure[loaded, foot])
    assert np.abs(centre - expected).max() < 1e-2
    free = platform["Tz"][2, ::ANALOG_PER_FRAME][loaded] / 1000
    assert np.abs(free - forces.free_moment[loaded, foot]).max() < 1e-4
    assert platform["force"][2].min() > -1e-3


@pytest.mark.parametrize("name", NAMES)
def test_text_files_hold_the_same(name: str, written: dict[str, dict[str, Path]]) -> None:
    case, paths = motion(name), written[name]
    table = read_trc(paths["trc"])
    assert table.names == case.marker_names
    assert np.abs(table.positions - case.markers).max() < 1e-6
    still = read_trc(paths["static_trc"])
    assert np.abs(still.positions.mean(axis=0) - case.static_markers).max() < 1e-6
    ground = read_storage(paths["grf"])
    for k, side in enumerate("rl"):
        force = np.stack([ground.columns[f"ground_force_{side}_v{axis}"] for axis in "xyz"], axis=1)
        point = np.stack([ground.columns[f"ground_force_{side}_p{axis}"] for axis in "xyz"], axis=1)
        assert np.abs(force - case.forces.force[:, k]).max() < 1e-5
        assert np.abs(point - case.forces.centre_of_pressure[:, k]).max() < 1e-8
        assert np.abs(ground.columns[f"ground_torque_{side}_y"] - case.forces.free_moment[:, k]).max() < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_truth_is_in_degrees_but_kneecaps_are_in_radians(
    name: str, written: dict[str, dict[str, Path]]
) -> None:
    case = motion(name)
    truth = read_storage(written[name]["truth"])
    assert truth.degrees
    assert truth.columns["knee_angle_r"].max() > 30
    assert truth.columns["knee_angle_r_beta"].max() < 3
    angles = coordinates_rad(truth)
    assert set(angles) == set(case.coordinates)
    for label, values in case.coordinates.items():
        assert np.abs(angles[label] - values).max() < 1e-8, label


def test_standing_forces_weigh_the_subject(written: dict[str, dict[str, Path]]) -> None:
    ground = read_storage(written["gait"]["static_grf"])
    weight = ground.columns["ground_force_r_vy"] + ground.columns["ground_force_l_vy"]
    assert weight == pytest.approx(np.full(100, motion("gait").mass_kg * GRAVITY), rel=1e-6)


def test_every_file_says_that_it_is_synthetic(written: dict[str, dict[str, Path]]) -> None:
    for paths in written.values():
        assert set(paths) == KINDS
        for kind in ("grf", "static_grf", "truth"):
            assert paths[kind].read_text("utf-8").startswith("synthetic ")
        for kind in ("c3d", "static_c3d"):
            parameters = contents(paths[kind])["parameters"]
            assert parameters["SUBJECTS"]["NAMES"]["value"] == ["synthetic"]
            assert "not a measurement" in parameters["MANUFACTURER"]["COMPANY"]["value"][0]


def test_same_seed_writes_the_same_bytes(tmp_path: Path, written: dict[str, dict[str, Path]]) -> None:
    again = write_recording(generate("gait", rate_hz=100.0), tmp_path / "deep" / "folder")
    for kind, path in again.items():
        before = hashlib.sha256(written["gait"][kind].read_bytes()).hexdigest()
        assert hashlib.sha256(path.read_bytes()).hexdigest() == before, kind


def test_a_file_in_the_folders_place_is_refused(tmp_path: Path) -> None:
    blocked = tmp_path / "taken"
    blocked.write_text("not a folder")
    with pytest.raises(InputError, match="folder"):
        write_recording(motion("squat"), blocked)
