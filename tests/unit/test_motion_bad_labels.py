"""Recordings with exchanged labels, forces cut off, or plates under the wrong foot: recognised and explained.

Real recordings, each with one fault put in, through the public reader.
"""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.biomech.analysis import compute_joint_loads
from hilbrace.body.build import build_body
from hilbrace.config import BiomechSettings, BodySettings, MotionSettings, SubjectSettings
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.opensim_files import read_storage, read_trc, write_storage, write_trc
from hilbrace.motion.trial_reader import read_trial
from tests.unit import motion_files as lab

SUBJECT = SubjectSettings(mass_kg=62.6)


@pytest.fixture
def jump(shared_data, tmp_path):
    """A recorded drop jump whose markers, standing markers and forces can be changed before they are read."""
    root = shared_data / "opencap_subject4"

    def read(markers=None, static=None, forces=None, **changes):
        paths = {}
        for kind, path, change in (
            ("markers", root / "markers/DJ1.trc", markers),
            ("static", root / "markers/static1.trc", static),
        ):
            paths[kind] = path
            if change is not None:
                table = read_trc(path)
                names, positions = change(list(table.names), table.positions.copy(), table.time)
                paths[kind] = tmp_path / path.name
                write_trc(paths[kind], table.time, table.rate_hz, tuple(names), positions)
        paths["forces"] = root / "grf/DJ1_grf.mot"
        if forces is not None:
            storage = read_storage(paths["forces"])
            columns = {name: column.copy() for name, column in storage.columns.items()}
            forces(columns, storage.time)
            paths["forces"] = tmp_path / "DJ1_grf.mot"
            write_storage(paths["forces"], storage.time, columns, degrees=False)
        return read_trial(MotionSettings(marker_map="opencap", **paths, **changes), SUBJECT)

    return read


def other_side(name: str) -> str:
    pairs = {"r_": "L_", "R_": "L_", "r.": "L.", "L.": "r."}
    if name[:2] in pairs:
        return pairs[name[:2]] + name[2:]
    upper = f"R_{name[2:]}"
    return upper if upper in {"R_Shoulder", "R_Sternum", "R_humerus", "R_forearm"} else f"r_{name[2:]}"


LEGS = ("knee", "ankle", "calc", "toe", "5meta", "shank_antsup", "sh2", "sh3", "mknee", "mankle")


def swapped(*wanted):
    """A change of labels: the named markers of both sides exchange theirs."""

    def change(names, positions, time):
        renamed = [other_side(n) if n[2:] in wanted and other_side(n) in names else n for n in names]
        return renamed, positions

    return change


def test_sides_exchanged_everywhere_below_the_hips_are_named(jump):
    with pytest.raises(InputError, match="right and left are exchanged") as refused:
        jump(markers=swapped(*LEGS))
    assert "r_knee" in refused.value.what
    assert "DJ1.trc" in refused.value.where
    assert "marker map" in refused.value.hint


def test_one_pair_exchanged_in_the_standing_trial_is_named(jump):
    with pytest.raises(InputError, match=r"right and left are exchanged: .*L_knee") as refused:
        jump(static=swapped("knee"))
    assert "r_ankle" not in refused.value.what
    assert "static1.trc" in refused.value.where


def test_labels_that_change_places_in_the_motion_are_named_with_the_frame(jump):
    def change(names, positions, time):
        a, b = names.index("r_thigh1"), names.index("r_thigh3")
        positions[150:, [a, b]] = positions[150:, [b, a]]
        return names, positions

    with pytest.raises(InputError, match=r"'r_thigh[13]' and 'r_thigh[13]' change places") as refused:
        jump(markers=change)
    assert "frame 151 (1.500 s)" in refused.value.where
    assert "motion.window" in refused.value.hint


def test_too_few_markers_on_a_segment_are_named(jump):
    """The reader notes them; the fit, which knows the segments, refuses."""

    def change(names, positions, time):
        positions[:, [k for k, n in enumerate(names) if n.startswith(("L_sh", "L_ankle"))]] = np.nan
        return names, positions

    trial = jump(markers=change, window=(1.4, 1.6))
    assert any(note.startswith("L_ankle is never visible") for note in trial.notes)
    settings = MotionSettings(), BiomechSettings()
    with pytest.raises(InputError, match="the left shank has 0 of the 2 markers needed") as refused:
        compute_joint_loads(trial, build_body(trial, BodySettings()), read_marker_map("opencap"), *settings)
    assert "'DJ1'" in refused.value.where


def test_a_force_cut_off_mid_stance_is_refused_with_its_time(jump):
    def cut(columns, time):
        for axis in "xyz":
            columns[f"ground_force_1_v{axis}"][time > 1.80] = 0.0

    with pytest.raises(InputError, match=r"force under the right foot breaks off from \d+ N") as refused:
        jump(forces=cut)
    assert "1.800 s" in refused.value.where
    assert "motion.window" in refused.value.hint
    before = jump(forces=cut, window=(1.2, 1.78))
    assert before.time[-1] == pytest.approx(1.78)


def test_a_force_that_sets_in_mid_stance_is_refused(jump):
    def late(columns, time):
        for axis in "xyz":
            columns[f"ground_force_2_v{axis}"][time < 1.80] = 0.0

    with pytest.raises(InputError, match="force under the left foot sets in at"):
        jump(forces=late)


def test_plates_under_the_wrong_feet_are_found_or_refused(jump):
    def exchanged(columns, time):
        for kind in "vpm":
            for axis in "xyz":
                first, second = f"ground_force_1_{kind}{axis}", f"ground_force_2_{kind}{axis}"
                if first in columns:
                    columns[first], columns[second] = columns[second], columns[first]

    trial = jump(forces=exchanged)
    assert any(note.startswith("Plate 1: left foot 1.42 to 2.1") for note in trial.notes)
    assert np.array_equal(trial.ground_force, jump().ground_force)
    with pytest.raises(InputError, match="plate 1 is given as the right foot's") as refused:
        jump(forces=exchanged, plates={"1": "right", "2": "left"})
    assert "leave it out to have plates found" in refused.value.hint


def test_sound_recordings_pass(shared_data):
    """No false alarm; test_motion_trial_reader has walks, stairs, turns and squats of other people."""
    root = shared_data / "opencap_subject4"
    for name in ("DJ2", "DJAsym1"):
        settings = MotionSettings(
            markers=root / f"markers/{name}.trc",
            forces=root / f"grf/{name}_grf.mot",
            static=root / "markers/static1.trc",
            marker_map="opencap",
        )
        assert read_trial(settings, SUBJECT).time[0] == 0.0


def test_a_mirrored_laboratory_person_is_recognised(tmp_path):
    """Small synthetic files: every label on the other side."""
    files = lab.write_files(tmp_path)
    names = tuple(("L" if n[0] == "R" else "R") + n[1:] if n[0] in "LR" else n for n in lab.marker_names())
    write_trc(tmp_path / "move.trc", lab.time(), lab.RATE_HZ, names, lab.markers())
    with pytest.raises(InputError, match="right and left are exchanged"):
        read_trial(files.settings(), SubjectSettings(mass_kg=lab.MASS_KG))
