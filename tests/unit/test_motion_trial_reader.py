"""Recorded files become a `Trial`, or an error that says where and what mends it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hilbrace.config import MotionSettings, SubjectSettings
from hilbrace.errors import ConfigError, HilbraceError, InputError
from hilbrace.motion.marker_maps import foot_markers, read_marker_map
from hilbrace.motion.opensim_files import read_trc, write_storage, write_trc
from hilbrace.motion.trial import Trial
from hilbrace.motion.trial_reader import read_trial, recorded_files
from hilbrace.run.records import pack
from hilbrace.units import GRAVITY
from tests.unit import motion_files as lab


@pytest.fixture
def files(tmp_path):
    return lab.write_files(tmp_path)


def test_trc_and_mot_become_a_trial(files):
    trial = read_trial(files.settings(cutoff_hz=40.0), SubjectSettings())
    assert (trial.name, trial.origin, trial.rate_hz, trial.feet) == (
        "move",
        "recorded",
        100.0,
        ("right", "left"),
    )
    assert set(trial.marker_names) == set(lab.marker_names())
    order = [trial.marker_names.index(name) for name in lab.marker_names()]
    assert trial.markers[:, order] == pytest.approx(lab.markers(), abs=1e-6)
    assert trial.time == pytest.approx(lab.time())
    vertical = lab.vertical(lab.time())
    for foot in range(2):
        assert trial.ground_force[:, foot, 1] == pytest.approx(vertical, rel=0.01)
        assert trial.ground_force[:, foot, 0] == pytest.approx(0.05 * vertical, rel=0.01)
        centre = lab.CENTRES[trial.feet[foot]]
        assert trial.centre_of_pressure[:, foot] == pytest.approx(np.tile(centre, (lab.FRAMES, 1)), abs=1e-6)
        assert trial.free_torque[:, foot, 1] == pytest.approx(0.01 * vertical, rel=0.01)
    assert trial.mass_kg == pytest.approx(lab.MASS_KG, rel=1e-3)
    assert trial.marker_map == files.settings().marker_map
    assert "stand in for it" in trial.notes[0]


def test_a_c3d_file_becomes_the_same_trial(files):
    lab.write_c3d(files.folder / "move.c3d")
    text = read_trial(files.settings(), SubjectSettings())
    binary = read_trial(files.settings(markers=files.folder / "move.c3d", forces=None), SubjectSettings())
    assert binary.marker_names == text.marker_names
    assert binary.markers == pytest.approx(text.markers, abs=1e-6)
    assert binary.ground_force == pytest.approx(text.ground_force, abs=1.0)
    assert binary.centre_of_pressure == pytest.approx(text.centre_of_pressure, abs=1e-3)
    assert binary.free_torque == pytest.approx(text.free_torque, abs=0.05)


def test_a_z_up_trc_file_is_turned(files):
    table = read_trc(files.folder / "move.trc")
    write_trc(files.folder / "move.trc", table.time, 100.0, table.names, lab.to_lab(table.positions), "mm")
    columns = lab.force_columns(table.time)
    for plate in "123":
        for kind in "vpm":
            stem = f"ground_force_{plate}_{kind}"
            columns |= {f"{stem}y": -columns[f"{stem}z"], f"{stem}z": columns[f"{stem}y"]}
    write_storage(files.folder / "move.mot", table.time, columns, degrees=False)
    turned = read_trial(files.settings(vertical_axis="z"), SubjectSettings())
    assert turned.markers[0, 0] == pytest.approx(read_trial_markers(table, turned), abs=1e-6)
    assert turned.ground_force[:, :, 1].min() > 200
    with pytest.raises(InputError, match="y is not up") as caught:
        read_trial(files.settings(), SubjectSettings())
    assert "motion.vertical_axis" in caught.value.hint


def read_trial_markers(table, trial):
    return table.positions[0, table.names.index(trial.marker_names[0])]


def test_the_same_files_give_the_same_bytes(files):
    first, second = (pack(read_trial(files.settings(), SubjectSettings())) for _ in range(2))
    assert first == second


def test_a_standing_trial_weighs_and_poses_the_subject(files):
    still = lab.time()[:40]
    write_trc(files.folder / "still.trc", still, 100.0, lab.marker_names(), lab.markers()[:40])
    write_storage(files.folder / "still.mot", still, lab.force_columns(still), degrees=False)
    settings = files.settings(static=files.folder / "still.trc", static_forces=files.folder / "still.mot")
    trial = read_trial(settings, SubjectSettings())
    assert trial.mass_kg == pytest.approx(70.0, rel=1e-3)
    order = [trial.static_marker_names.index(name) for name in lab.marker_names()]
    assert trial.static_markers[order] == pytest.approx(lab.markers()[0], abs=1e-6)
    assert trial.height_m == pytest.approx((1.42 - 0.09) / 0.779, abs=2e-3)
    assert recorded_files(settings) == (
        settings.markers, settings.forces, settings.static, settings.static_forces)  # fmt: skip


def test_gaps_stay_gaps_and_are_noted(files):
    positions = lab.markers()
    positions[50:60, 3] = np.nan
    write_trc(files.folder / "move.trc", lab.time(), 100.0, lab.marker_names(), positions)
    trial = read_trial(files.settings(), SubjectSettings())
    name = lab.marker_names()[3]
    hidden = np.isnan(trial.markers).any(axis=2)
    assert np.flatnonzero(hidden[:, trial.marker_names.index(name)]).tolist() == list(range(50, 60))
    assert hidden.sum() == 10
    assert f"{name} is hidden in 10 of 120 frames." in trial.notes


def test_ignored_and_always_hidden_markers_are_left_out_with_a_note(files):
    positions = np.concatenate([lab.markers(), lab.markers()[:, :1]], axis=1)
    names = (*lab.marker_names(), "hip_virtual")
    positions[:, names.index("RLEL")] = np.nan
    write_trc(files.folder / "move.trc", lab.time(), 100.0, names, positions)
    trial = read_trial(files.settings(), SubjectSettings())
    assert "hip_virtual" not in trial.marker_names
    assert "RLEL" not in trial.marker_names
    assert any("hip_virtual" in note for note in trial.notes)
    assert "RLEL is never visible in the motion: left out." in trial.notes


def test_the_window_cuts_the_trial_but_not_its_clock(files):
    whole = read_trial(files.settings(), SubjectSettings())
    part = read_trial(files.settings(window=(0.5, 0.9)), SubjectSettings())
    assert part.time == pytest.approx(np.arange(50, 91) / 100)
    assert part.ground_force == pytest.approx(whole.ground_force[50:91], abs=1e-9)
    assert part.static_markers == pytest.approx(whole.static_markers)


def test_frames_beyond_the_forces_are_cut_with_a_note(files):
    instants = np.arange(500) / 500
    write_storage(files.folder / "move.mot", instants, lab.force_columns(instants), degrees=False)
    trial = read_trial(files.settings(), SubjectSettings())
    assert len(trial.time) == 101
    assert "19 frames without ground reactions were cut off." in trial.notes


def test_nan_points_of_an_unloaded_plate_do_no_harm(files):
    instants = np.arange(600) / 500
    columns = lab.force_columns(instants)
    for axis in "xyz":
        columns[f"ground_force_3_p{axis}"][:] = np.nan
    columns["ground_force_3_vy"][:] = 3.0
    write_storage(files.folder / "move.mot", instants, columns, degrees=False)
    trial = read_trial(files.settings(), SubjectSettings())
    assert np.isfinite(trial.centre_of_pressure).all()


def edit_unit(files):
    table = read_trc(files.folder / "move.trc")
    write_trc(files.folder / "move.trc", table.time, 100.0, table.names, 1000 * table.positions, "m")


def swap_columns(files):
    files.edit("move.mot", "ground_force_1_vy\tground_force_1_vz", "ground_force_1_vz\tground_force_1_vy")


def nan_under_load(files):
    instants = np.arange(600) / 500
    columns = lab.force_columns(instants)
    columns["ground_force_2_pz"][77] = np.nan
    write_storage(files.folder / "move.mot", instants, columns, degrees=False)


def never_still(files):
    sway = 0.1 * np.sin(20 * lab.time())[:, None, None]
    write_trc(files.folder / "move.trc", lab.time(), 100.0, lab.marker_names(), lab.markers() + sway)


def jump(files):
    positions = lab.markers()
    positions[33, 5] += [0.0, 2.0, 0.0]
    write_trc(files.folder / "move.trc", lab.time(), 100.0, lab.marker_names(), positions)


def other_clock(files):
    instants = 100 + np.arange(600) / 500
    write_storage(files.folder / "move.mot", instants, lab.force_columns(instants - 100), degrees=False)


FAULTS = {
    "missing markers": (lambda f: (f.folder / "move.trc").unlink(), {}, "no such file", "move.trc"),
    "missing forces": (lambda f: (f.folder / "move.mot").unlink(), {}, "no such file", "move.mot"),
    "no forces": (lambda f: None, {"forces": None}, "there are no ground reactions", "move.trc"),
    "kind of markers": (lambda f: None, {"markers": "x.csv"}, "'.csv' is no kind of marker file", "x.csv"),
    "kind of forces": (lambda f: None, {"forces": "x.csv"}, "'.csv' is no kind of force file", "x.csv"),
    "no units": (lambda f: f.edit("move.trc", "\tUnits\t", "\t"), {}, "names no units", "line 2"),
    "marker names": (
        lambda f: f.edit("move.trc", "\tLASI\t", "\tL_ASI\t"),
        {},
        "does not know L_ASI; the recording lacks LASI",
        "move.trc",
    ),
    "wrong columns": (
        swap_columns,
        {},
        "forces in the wrong columns: the largest is along z",
        "ground_force_1_vy",
    ),
    "nan under load": (
        nan_under_load,
        {},
        "centre of pressure is no number",
        "sample 78 (0.1540 s), plate 2",
    ),
    "millimetres called metres": (edit_unit, {}, "no person is that size", "move.trc"),
    "empty window": (lambda f: None, {"window": (5.0, 6.0)}, "window 5 to 6 s holds 0 frames", "move.trc"),
    "window backwards": (lambda f: None, {"window": (0.9, 0.2)}, "window 0.9 to 0.2 s", "move.trc"),
    "count of frames": (
        lambda f: f.edit("move.trc", "100\t100\t120", "100\t100\t121"),
        {},
        "121 rows",
        "move.trc",
    ),
    "count of rows": (lambda f: f.edit("move.mot", "nRows=600", "nRows=601"), {}, "601 rows", "move.mot"),
    "no number": (
        lambda f: f.edit("move.mot", "0.004\t", "0.004\tx"),
        {},
        "is no number",
        "line 10, column 2",
    ),
    "never still": (never_still, {}, "mass is unknown: nobody stands still", "move.trc"),
    "a jump": (jump, {}, "jumps 2.00 m", "frame 34 (0.330 s)"),
    "another clock": (other_clock, {}, "forces run from 100 to 101", "move.mot"),
    "swapped feet": (lambda f: None, {"plates": {"1": "left", "2": "right"}}, "given as the left", "plate 1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_bad_recording_is_refused_in_two_lines(files, fault):
    spoil, changes, what, where = FAULTS[fault]
    spoil(files)
    with pytest.raises(InputError) as caught:
        read_trial(files.settings(**changes), SubjectSettings())
    assert what in caught.value.what
    assert where in caught.value.where
    assert caught.value.hint
    assert caught.value.two_lines().count("\n") == 1


def test_metres_called_millimetres_are_recognised(files):
    files.edit("move.trc", "\tm\t", "\tmm\t")
    with pytest.raises(InputError, match="markers span") as caught:
        read_trial(files.settings(), SubjectSettings())
    assert "metres called millimetres" in caught.value.hint


def test_a_mass_that_the_plates_contradict_is_refused(files):
    still = lab.time()[:40]
    write_trc(files.folder / "still.trc", still, 100.0, lab.marker_names(), lab.markers()[:40])
    write_storage(files.folder / "still.mot", still, lab.force_columns(still), degrees=False)
    settings = files.settings(static=files.folder / "still.trc", static_forces=files.folder / "still.mot")
    with pytest.raises(InputError, match=r"subject.mass_kg is 90.0 kg, but the plates weigh 70.0 kg"):
        read_trial(settings, SubjectSettings(mass_kg=90.0))


def test_a_standing_trial_that_moves_or_hides_markers_is_refused(files):
    settings = files.settings(static=files.folder / "still.trc")
    write_trc(files.folder / "still.trc", lab.time(), 100.0, lab.marker_names(), lab.markers())
    with pytest.raises(InputError, match=r"does not stand still: '.*' moves") as caught:
        read_trial(settings, SubjectSettings())
    assert "still.trc" in caught.value.where
    positions = lab.markers()[:30]
    positions[:25, 4] = np.nan
    write_trc(files.folder / "still.trc", lab.time()[:30], 100.0, lab.marker_names(), positions)
    with pytest.raises(InputError, match=r"only 5 frames .* 'LLFC' is hidden in 83 %"):
        read_trial(settings, SubjectSettings())


def test_settings_without_a_recording_are_refused():
    with pytest.raises(ConfigError, match="no recording is named"):
        read_trial(MotionSettings(), SubjectSettings())


def test_a_truncated_c3d_file_is_refused(files):
    path = lab.write_c3d(files.folder / "move.c3d")
    path.write_bytes(path.read_bytes()[:-20_000])
    with pytest.raises(InputError, match="cut short: 120 frames need"):
        read_trial(files.settings(markers=path, forces=None), SubjectSettings())


def test_damaged_text_files_give_a_trial_or_a_named_error(files):
    """150 mutations of the text files: never another exception, never a trial of fewer frames."""
    random = np.random.default_rng(3)
    originals = {name: (files.folder / name).read_bytes() for name in ("move.trc", "move.mot", "map.toml")}
    outcomes = set()
    for k in range(150):
        name = tuple(originals)[k % 3]
        content = bytearray(originals[name])
        for _ in range(int(random.integers(1, 6))):
            at = int(random.integers(0, min(len(content), 4000)))
            inserted = random.integers(9, 127, int(random.integers(0, 3))).astype(np.uint8)
            content[at : at + int(random.integers(0, 3))] = inserted.tobytes()
        (files.folder / name).write_bytes(content)
        try:
            outcome = read_trial(files.settings(), SubjectSettings())
            assert len(outcome.time) == lab.FRAMES
        except HilbraceError as fault:
            outcome = fault
        outcomes.add(type(outcome))
        (files.folder / name).write_bytes(originals[name])
    assert {Trial, InputError} <= outcomes


# --- recorded files -------------------------------------------------------------------------------------


def opencap(folder, name, **changes):
    root = folder / "opencap_subject4"
    values = {
        "markers": root / f"markers/{name}.trc",
        "forces": root / f"grf/{name}_grf.mot",
        "static": root / "markers/static1.trc",
        "static_forces": root / "grf/static1_grf.mot",
        "marker_map": "opencap",
    }
    return MotionSettings(**(values | changes))


GIVEN = {"1": "right", "2": "left", "3": "unused"}


def test_a_drop_jump_as_recorded(shared_data):
    """Without a filter: landing at 1.42 s with 1977 N, take-off at 2.17 s, second landing at 2.57 s."""
    trial = read_trial(opencap(shared_data, "DJ1", plates=GIVEN, cutoff_hz=40.0), SubjectSettings())
    vertical = trial.ground_force[:, :, 1].sum(axis=1)
    changes = trial.time[1:][np.diff((vertical > 0).astype(int)) != 0]
    assert changes == pytest.approx([1.42, 2.17, 2.57], abs=0.011)
    assert vertical[trial.time < 2].max() == pytest.approx(1977, abs=1)
    assert trial.mass_kg == pytest.approx(60.05, abs=0.1)
    assert trial.markers.shape == (269, 47, 3)
    assert len(trial.static_marker_names) == 51


def test_the_filter_lowers_the_impact_and_plates_are_found(shared_data):
    given = read_trial(opencap(shared_data, "DJ1", plates=GIVEN), SubjectSettings())
    found = read_trial(opencap(shared_data, "DJ1"), SubjectSettings())
    for field in dataclasses.fields(given):
        if isinstance(getattr(given, field.name), np.ndarray):
            assert np.array_equal(getattr(given, field.name), getattr(found, field.name), equal_nan=True)
    peak = found.ground_force[found.time < 2][:, :, 1].sum(axis=1).max()
    assert 1200 < peak < 1900


def test_swapped_plates_of_a_recorded_jump_are_refused(shared_data):
    swapped = {"1": "left", "2": "right", "3": "unused"}
    with pytest.raises(InputError, match="plate 1 is given as the left foot's"):
        read_trial(opencap(shared_data, "DJ1", plates=swapped), SubjectSettings())


def gait(folder, stem, name, static):
    root = folder / "c3d_plugin_gait"
    return MotionSettings(
        markers=root / f"{stem}{name}.c3d", static=root / f"{stem}{static}.c3d", marker_map="plug_in_gait"
    )


def knee(folder, name, kind):
    root = folder / "gc5_instrumented_knee"
    files = {"markers": root / f"c3d/PS_ngait_og_{name}.c3d"}
    if kind == "trc":
        files = {
            "markers": root / f"trc/PS_ngait_og_{name}.trc",
            "forces": root / f"grf/PS_ngait_og_{name}_kinetics.mot",
        }
    return MotionSettings(**files, static=root / "trc/Static_for_scaling.trc", marker_map="knee_challenge")


RECORDED = {
    "DJ2": (lambda d: opencap(d, "DJ2"), None, 60.05, (1100, 1250)),
    "squats1": (lambda d: opencap(d, "squats1"), None, 60.05, (380, 460)),
    "walking1": (lambda d: opencap(d, "walking1"), None, 60.05, (650, 760)),
    "straight": (lambda d: gait(d, "mcgill_HC032A/HC032A", "03", "01"), None, 60.3, (650, 690)),
    "turn": (lambda d: gait(d, "mcgill_HC032A/HC032A", "18", "01"), None, 60.3, (620, 660)),
    "HC038A": (lambda d: gait(d, "mcgill_HC038A/HC038A", "11", "01"), None, 56.8, (590, 620)),
    "stairs": (lambda d: gait(d, "stairs_85kg/", "Movement_trial", "Static_trial"), 85.0, 85.0, (1130, 1215)),
    "gc5 ss1 c3d": (lambda d: knee(d, "ss1", "c3d"), 75.0, 75.0, (840, 910)),
    "gc5 ss1 trc": (lambda d: knee(d, "ss1", "trc"), 75.0, 75.0, (840, 910)),
    "gc5 ss3 c3d": (lambda d: knee(d, "ss3", "c3d"), 75.0, 75.0, (840, 890)),
}


@pytest.mark.parametrize("name", RECORDED)
def test_recorded_trials_are_read_whole(shared_data, name):
    settings, mass, weighed, peak = RECORDED[name]
    trial = read_trial(settings(shared_data), SubjectSettings(mass_kg=mass))
    assert trial.mass_kg == pytest.approx(weighed, abs=0.2)
    vertical = trial.ground_force[:, :, 1]
    assert peak[0] < vertical.max() < peak[1]
    assert 1.5 < trial.height_m < 1.9
    for k, foot in enumerate(trial.feet):  # the centre of pressure stays under the foot that it was given to
        names = foot_markers(read_marker_map(trial.marker_map), foot)
        columns = [i for i, marker in enumerate(trial.marker_names) if marker in names]
        firm = vertical[:, k] > 0.2 * trial.mass_kg * GRAVITY
        middle = np.nanmean(trial.markers[firm][:, columns], axis=1)
        assert np.linalg.norm(middle - trial.centre_of_pressure[firm, k], axis=1).max() < 0.27


def test_the_knee_challenge_plates_go_to_the_feet_that_its_readme_names(shared_data):
    """Plate 1 is under the left foot; plates 2 and 3, one after the other, under the right one."""
    settings = knee(shared_data, "ss1", "trc")
    found = read_trial(settings, SubjectSettings(mass_kg=75.0))
    given = {"1": "left", "2": "right", "3": "right"}
    named = read_trial(settings.model_copy(update={"plates": given}), SubjectSettings(mass_kg=75.0))
    assert np.array_equal(found.ground_force, named.ground_force)
    assert np.array_equal(found.centre_of_pressure, named.centre_of_pressure)


def test_a_jump_without_a_standing_trial_is_surveyed(shared_data):
    root = shared_data / "opencap_subject5_raw"
    settings = MotionSettings(markers=root / "DJ1.trc", forces=root / "DJ1_forces.mot", marker_map="opencap")
    trial = read_trial(
        settings.model_copy(update={"window": (1.3, 2.2)}), SubjectSettings(mass_kg=79.4, height_m=1.9)
    )
    assert trial.static_marker_names == ()
    assert trial.surveyed_markers.shape == (200, len(trial.marker_names), 3)
    spread = np.ptp(trial.surveyed_markers[..., 1], axis=0)
    assert (spread >= np.ptp(trial.markers[..., 1], axis=0) - 0.05).all()  # beyond the window, too
    assert any("does not stand still" in note and "in the motion" in note for note in trial.notes)
    with pytest.raises(InputError, match="mass is unknown") as caught:
        read_trial(settings, SubjectSettings())
    assert "subject.mass_kg" in caught.value.hint


def test_forces_at_2000_hz_are_filtered_before_they_are_sampled(shared_data):
    """Subject 5's forces; another subject's standing trial only serves to pass the check for one."""
    root = shared_data / "opencap_subject5_raw"
    files = {"markers": root / "DJ1.trc", "forces": root / "DJ1_forces.mot", "static_forces": None}
    settings = opencap(shared_data, "DJ1", cutoff_hz=20.0, **files)
    trial = read_trial(settings, SubjectSettings(mass_kg=79.4))
    vertical = trial.ground_force[:, :, 1].sum(axis=1)
    landings = trial.time[1:][np.diff((vertical > 0).astype(int)) == 1]
    assert landings == pytest.approx([1.493, 2.766], abs=0.03)
    assert 2000 < vertical.max() < 3394


def test_a_serve_without_plates_is_refused(shared_data):
    path = shared_data / "tennis_serve/kinematics_tennis_serve.c3d"
    with pytest.raises(InputError, match="no ground reactions"):
        read_trial(MotionSettings(markers=path, marker_map="plug_in_gait"), SubjectSettings(mass_kg=75.0))
