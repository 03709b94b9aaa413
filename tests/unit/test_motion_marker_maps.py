"""Marker maps: every built-in map fits the skeleton, and names that do not match are listed both ways."""

from __future__ import annotations

import pytest

from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.marker_maps import (
    MarkerMap,
    builtin_maps,
    file_name_of,
    foot_markers,
    match_markers,
    read_marker_map,
    segment_of,
)
from hilbrace.motion.opensim_files import read_trc
from hilbrace.motion.synthetic.markers import synthetic_markers
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.table import load_table

SMALL = MarkerMap("small", {"LASI": "LASI", "r.knee": "RLFC"}, {"T1": "femur_l"}, ("*_HJC",), ("T?",))


def test_the_builtin_maps():
    assert builtin_maps() == ("hilbrace", "knee_challenge", "opencap", "plug_in_gait", "rajagopal2016")


@pytest.mark.parametrize("name", builtin_maps())
def test_a_builtin_map_fits_the_skeleton(name):
    marker_map = read_marker_map(name)
    table = load_table()
    assert set(marker_map.landmarks.values()) <= set(table["markers"])
    assert set(marker_map.clusters.values()) <= set(table["bodies"])
    assert marker_map.name == name
    for side in ("right", "left"):
        assert len(foot_markers(marker_map, side)) >= 2
    assert sum(segment == "pelvis" for segment in segment_of(marker_map).values()) >= 3


@pytest.mark.parametrize("name", builtin_maps())
def test_sides_are_not_mixed_up(name):
    """A name that says left stands for a marker or segment of the left side, and the other way round."""
    marker_map = read_marker_map(name)
    for key, target in (marker_map.landmarks | marker_map.clusters).items():
        if target in ("torso", "pelvis", "C7", "CLAV"):
            continue
        side = key[0].upper()
        assert side in "LR"
        assert target.endswith(f"_{side.lower()}") or target.startswith(side)


def test_the_default_map_names_exactly_the_synthetic_markers():
    markers = synthetic_markers(skeleton_from_table(load_table()))
    marker_map = read_marker_map("hilbrace")
    assert set(marker_map.known()) == set(markers.names)
    assert segment_of(marker_map) == dict(zip(markers.names, markers.bodies, strict=True))


def test_matching_names_pass_and_optional_ones_may_lack():
    matched = match_markers(SMALL, ["r.knee", "LASI", "L_HJC"], "x.trc")
    assert matched.known() == ("LASI", "r.knee")
    assert matched.clusters == {}


def test_unmatched_names_are_listed_both_ways_with_the_nearest():
    with pytest.raises(InputError) as caught:
        match_markers(SMALL, ["LASIS", "r.knee", "T1", "Nose"], "x.trc")
    assert "does not know LASIS, Nose; the recording lacks LASI" in caught.value.what
    assert "LASIS for LASI" in caught.value.hint
    assert caught.value.where == "x.trc"


def test_a_wholly_different_set_suggests_other_maps(shared_data):
    names = read_trc(shared_data / "opencap_subject4/markers/DJ1.trc").names
    with pytest.raises(InputError, match="and 38 more") as caught:
        match_markers(read_marker_map("plug_in_gait"), names, "DJ1.trc")
    assert "opencap" in caught.value.hint
    assert match_markers(read_marker_map("opencap"), names, "DJ1.trc").landmarks["L_knee"] == "LLFC"


def test_an_unknown_map_is_a_configuration_error():
    with pytest.raises(ConfigError, match="no marker map 'opncap'") as caught:
        read_marker_map("opncap")
    assert "opencap" in caught.value.hint


def test_landmarks_are_found_by_their_name_on_the_skeleton():
    assert file_name_of(SMALL, "RLFC") == "r.knee"
    assert file_name_of(SMALL, "RMFC") is None


FAULTS = {
    "[landmarks\n": "not valid TOML",
    'extra = 1\n[landmarks]\nA = "LASI"': "unknown key 'extra'",
    '[clusters]\nA = "femur_l"': "a section is missing",
    "[landmarks]\nA = 3": "a section is missing or holds something else",
    '[landmarks]\nA = "LASIS"': "'A' stands for 'LASIS', which is no marker of the skeleton",
    '[landmarks]\nA = "LASI"\n[clusters]\nB = "femur"': "'B' stands for 'femur', which is no segment",
    '[landmarks]\nA = "LASI"\nB = "LASI"': "'LASI' is given twice",
    '[landmarks]\nA = "LASI"\n[clusters]\nA = "pelvis"': "'A' is given twice",
    'ignored = "x"\n[landmarks]\nA = "LASI"': "holds something else than names",
}


@pytest.mark.parametrize("text", FAULTS)
def test_a_wrong_map_file_is_refused(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=FAULTS[text]) as caught:
        read_marker_map(str(path))
    assert str(path) in caught.value.where


def test_a_near_name_is_suggested(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('[landmarks]\nA = "LASIS"')
    with pytest.raises(InputError) as caught:
        read_marker_map(str(path))
    assert caught.value.hint == "did you mean 'LASI'?"


def test_a_missing_map_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="no readable marker map"):
        read_marker_map(str(tmp_path / "absent.toml"))


def test_the_knee_challenge_map_takes_sets_without_some_trunk_and_tracking_markers():
    """Its laboratories differ there; the landmarks that place the legs stay required."""
    whole = read_marker_map("knee_challenge")
    absent = {"Neck", "Xiphoid", "LThighInferior", "RShankLateral", "LShoulder"}
    kept = match_markers(whole, [name for name in whole.known() if name not in absent], "walk.trc")
    assert set(kept.known()) == set(whole.known()) - absent
    with pytest.raises(InputError, match="LAsis"):
        match_markers(whole, [name for name in whole.known() if name != "LAsis"], "walk.trc")
