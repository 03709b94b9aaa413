"""Segment factors from landmarks: models of known size, and recorded standing trials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilbrace.errors import InputError
from hilbrace.motion.synthetic.generate import generate
from hilbrace.skeleton.anthropometry import (
    MODEL_HEIGHT_M,
    RULES,
    SegmentFactor,
    hip_centres,
    measure_segments,
    rigid_fit,
    segment_scales,
)
from hilbrace.skeleton.kinematics import Skeleton, skeleton_from_table
from hilbrace.skeleton.scaling import scaled_table
from hilbrace.skeleton.table import load_table
from tests.unit.opensim_oracle import ask

TABLE = load_table()
MEASURED_LANDMARKS = tuple(n for n in TABLE["markers"] if not n.endswith(("HJC", "KJC", "AJC", "EJC", "SJC")))


def landmarks_of(skeleton: Skeleton) -> dict[str, np.ndarray]:
    places = skeleton.markers(skeleton.forward({}), MEASURED_LANDMARKS)[0]
    return dict(zip(MEASURED_LANDMARKS, places, strict=True))


STANDING = landmarks_of(skeleton_from_table(TABLE))


def by_segment(factors: tuple[SegmentFactor, ...]) -> dict[str, float]:
    return {item.segment: item.factor for item in factors}


@settings(deadline=None, max_examples=40)
@given(st.floats(0.6, 1.5), st.integers(0, 1000))
def test_a_person_of_the_same_build_is_measured_exactly(factor, seed):
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    seen = {name: turn @ (factor * place) + shift for name, place in STANDING.items()}
    scales = segment_scales(seen, TABLE)
    assert list(scales) == list(TABLE["bodies"])
    np.testing.assert_allclose(list(scales.values()), factor, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_person_of_another_build_is_found_again(seed):
    """Pairs that span a joint take in a little of the neighbour; the knee line gives the most, 2 %."""
    rng = np.random.default_rng(seed)
    wanted = segment_scales(STANDING, TABLE)
    for bodies in (("pelvis",), ("femur", "patella"), ("tibia",), ("talus", "calcn", "toes"), ("torso",)):
        factor = rng.uniform(0.88, 1.12)
        for body in bodies:
            for name in (body, f"{body}_r", f"{body}_l"):
                if name in wanted:
                    wanted[name] = np.full(3, factor)
    person = skeleton_from_table(scaled_table(TABLE, wanted, 70.0))
    found = segment_scales(landmarks_of(person), TABLE)
    for body, limit in (("pelvis", 1e-9), ("femur_r", 0.01), ("tibia_l", 0.02), ("calcn_r", 1e-9)):
        np.testing.assert_allclose(found[body], wanted[body], rtol=limit, err_msg=body)


def test_left_and_right_share_one_factor():
    seen = dict(STANDING)
    seen["RLMAL"] = seen["RLMAL"] - [0.0, 0.02, 0.0]
    scales = segment_scales(seen, TABLE)
    np.testing.assert_array_equal(scales["tibia_r"], scales["tibia_l"])
    assert 1.005 < scales["tibia_r"][1] < 1.02


def test_a_hip_centre_that_was_recorded_is_used():
    skeleton = skeleton_from_table(TABLE)
    hips = {f"{s}HJC": skeleton.forward({})[f"femur_{s.lower()}"].origin[0] for s in "RL"}
    assert by_segment(measure_segments({**STANDING, **hips}, TABLE))["thigh"] == pytest.approx(1.0, rel=1e-9)
    raised = {name: place + np.array([0.0, 0.04, 0.0]) for name, place in hips.items()}
    assert by_segment(measure_segments({**STANDING, **raised}, TABLE))["thigh"] == pytest.approx(
        1.1, abs=0.005
    )


def test_missing_markers_fall_back_in_the_written_order():
    def without(*gone: str) -> dict[str, SegmentFactor]:
        seen = {n: 1.1 * p for n, p in STANDING.items() if not n.endswith(gone)}
        return {item.segment: item for item in measure_segments(seen, TABLE)}

    lateral_only = without("MFC", "MMAL", "MEL")
    assert lateral_only["shank"].pairs == (("RLFC", "RLMAL"), ("LLFC", "LLMAL"))
    assert lateral_only["thigh"].pairs == (("RHJC", "RLFC"), ("LHJC", "LLFC"))
    no_asis = without("ASI")
    assert no_asis["pelvis"].pairs == (("RPSI", "LPSI"),)
    two_pelvis_markers = without("PSI")
    assert ("RASI", "RLFC") in two_pelvis_markers["thigh"].pairs
    assert ("C7", "RASI") in two_pelvis_markers["trunk"].pairs
    no_shoulders = without("ACR")
    assert no_shoulders["shoulders"].pairs == ()
    assert no_shoulders["upper arm"].pairs == ()
    for found in (lateral_only, no_asis, two_pelvis_markers, no_shoulders):
        assert [item.factor for item in found.values()] == pytest.approx([1.1] * len(RULES), rel=1e-9)


def test_a_gap_counts_as_missing():
    seen = {**STANDING, "RMFC": np.full(3, np.nan), "LTOE": np.array([np.nan, 0.0, 0.0])}
    assert by_segment(measure_segments(seen, TABLE)) == pytest.approx(
        dict.fromkeys((rule.segment for rule in RULES), 1.0), rel=1e-9
    )


def test_without_markers_the_height_decides():
    scales = segment_scales({}, TABLE, height_m=1.87)
    np.testing.assert_allclose(list(scales.values()), 1.87 / MODEL_HEIGHT_M, rtol=1e-12)
    legs = {n: 0.9 * STANDING[n] for n in ("RLFC", "RLMAL", "RASI", "LASI", "RPSI", "LPSI")}
    found = by_segment(measure_segments(legs, TABLE, height_m=1.53))
    assert found["shank"] == pytest.approx(0.9, rel=1e-9)
    assert found["forearm"] == pytest.approx(1.53 / MODEL_HEIGHT_M)
    assert by_segment(measure_segments(legs, TABLE))["forearm"] == pytest.approx(0.9, rel=1e-9)


def test_nothing_to_measure_is_an_error_with_its_mend():
    with pytest.raises(InputError, match="no segment can be measured") as raised:
        segment_scales({"RLFC": np.zeros(3)}, TABLE)
    assert "height_m" in raised.value.hint


def test_millimetres_and_mistaken_markers_are_noticed():
    with pytest.raises(InputError, match="pelvis measures 1000"):
        segment_scales({name: 1000 * place for name, place in STANDING.items()}, TABLE)
    mistaken = {**STANDING, "RLMAL": STANDING["RLFC"], "RMMAL": STANDING["RMFC"]}
    one_leg = {name: place for name, place in mistaken.items() if name not in ("LLMAL", "LMMAL")}
    with pytest.raises(InputError, match="shank measures") as raised:
        segment_scales(one_leg, TABLE)
    assert raised.value.where == "RLFC-RLMAL, RMFC-RMMAL"


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1000))
def test_a_rigid_motion_is_recovered(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(4, 3))
    turn, shift = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    rotation, moved = rigid_fit(points, points @ turn.T + shift)
    np.testing.assert_allclose(rotation, turn, atol=1e-9)
    np.testing.assert_allclose(moved, shift, atol=1e-9)


def read_static(path: Path, names: dict[str, str]) -> dict[str, np.ndarray]:
    """Mean marker positions of a standing trial in a TRC file [m]."""
    lines = path.read_text("utf-8").splitlines()
    unit = 0.001 if lines[2].split("\t")[4] == "mm" else 1.0
    header = [name for name in lines[3].split("\t")[2:] if name]
    rows = [[float(word or "nan") for word in line.split("\t")[2:]] for line in lines[5:] if line.strip()]
    frames = np.array([row[: 3 * len(header)] for row in rows if len(row) >= 3 * len(header)])
    means = unit * np.nanmean(frames.reshape(len(frames), -1, 3), axis=0)
    return {ours: means[header.index(theirs)] for ours, theirs in names.items()}


OPENCAP = {
    f"{side}{ours}": theirs.format(s=small)
    for side, small in (("R", "r"), ("L", "L"))
    for ours, theirs in {
        "ASI": "{s}.ASIS",
        "PSI": "{s}.PSIS",
        "LFC": "{s}_knee",
        "MFC": "{s}_mknee",
        "LMAL": "{s}_ankle",
        "MMAL": "{s}_mankle",
        "CAL": "{s}_calc",
        "TOE": "{s}_toe",
        "MT5": "{s}_5meta",
    }.items()
}
GRAND_CHALLENGE = {
    "RASI": "RAsis",
    "LASI": "LAsis",
    "RPSI": "RPsis",
    "LPSI": "LPsis",
    "RLFC": "RKneeLateral",
    "RMFC": "RKneeMedial",
    "LLFC": "LKneeLateral",
    "LMFC": "LKneeMedial",
    "RLMAL": "RAnkleLateral",
    "RMMAL": "RankleMedial",
    "LLMAL": "LAnkleLateral",
    "LMMAL": "LAnkleMedial",
}


@pytest.mark.parametrize(
    ("trial", "names", "reference", "limit"),
    [
        (
            "opencap_subject4/markers/static1.trc",
            OPENCAP,
            "opencap_subject4/models/manually_scaled.osim",
            (0.02, 0.02),
        ),
        (
            "gc5_instrumented_knee/trc/Static_for_scaling.trc",
            GRAND_CHALLENGE,
            "gc5_instrumented_knee/models/Rajagopal2015-scaled.osim",
            (0.04, 0.05),
        ),
    ],
)
def test_thigh_and_shank_of_recorded_people_agree_with_their_published_models(
    shared_data, trial, names, reference, limit
):
    """The published lengths are means of both sides; experts differ among themselves by 4 % here."""
    scales = segment_scales(read_static(shared_data / trial, names), TABLE)
    pose = skeleton_from_table(scaled_table(TABLE, scales, 70.0)).forward({})
    straight = {f"{c}_{s}": [0.0] for c in ("hip_flexion", "knee_angle", "ankle_angle") for s in "rl"}
    told = ask(osim=str(shared_data / reference), poses=straight)
    places = dict(zip(told["bodies"].tolist(), told["position"][0], strict=True))

    def length(upper: str, lower: str) -> tuple[float, float]:
        ours = np.linalg.norm(pose[f"{upper}_r"].origin[0] - pose[f"{lower}_r"].origin[0])
        theirs = [np.linalg.norm(places[f"{upper}_{s}"] - places[f"{lower}_{s}"]) for s in "rl"]
        return float(ours), float(np.mean(theirs))

    for (upper, lower), allowed in zip((("femur", "tibia"), ("tibia", "talus")), limit, strict=True):
        ours, theirs = length(upper, lower)
        assert ours == pytest.approx(theirs, rel=allowed), upper


def test_a_person_is_measured_in_a_motion_where_limbs_are_straight():
    """Squats of a person of known build: the standing factors come back from the straight frames alone."""
    truth = generate("squat", rate_hz=50.0)
    names = {n: k for k, n in enumerate(truth.marker_names) if n in load_table()["markers"]}
    moving = {n: 1.07 * truth.true_markers[:, k] for n, k in names.items()}
    hidden = moving["RLFC"].copy()
    hidden[::3] = np.nan
    factors = measure_segments(moving | {"RLFC": hidden}, load_table())
    for item in factors:
        arm = item.segment in (
            "upper arm",
            "forearm",
        )  # raised in squats: the acromion moves less than they do
        assert item.factor == pytest.approx(1.07, abs=0.02 if arm else 0.012), item.segment
    assert {item.segment for item in factors if item.pairs} >= {"pelvis", "thigh", "shank", "foot", "trunk"}


def test_hip_centres_follow_the_pelvis_frame_by_frame():
    truth = generate("squat", rate_hz=50.0)
    skeleton = skeleton_from_table(load_table())
    pose = skeleton.forward(truth.coordinates)
    column = {n: k for k, n in enumerate(truth.marker_names)}
    pelvis = {n: truth.true_markers[:, column[n]].copy() for n in ("RASI", "LASI", "RPSI", "LPSI")}
    pelvis["RPSI"][7] = np.nan
    found = hip_centres(pelvis, skeleton, 1.0)["LHJC"]
    seen = np.arange(len(found)) != 7
    assert np.isnan(found[7]).all()
    assert np.allclose(found[seen], pose["femur_l"].origin[seen], atol=1e-9)
