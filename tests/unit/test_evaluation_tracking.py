"""Clusters, gaps, calibration and tracking against a leg whose angles are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evaluation.calibration import calibrate
from evaluation.cross_talk import thigh_turn, turn_thigh
from evaluation.gaps import bridge, fill_cluster
from evaluation.protocol import MarkerLabels
from evaluation.quality import compare_standing, judge
from evaluation.rigid_fit import fit_rigid, width_over_length
from evaluation.tracking import track
from hilbrace.errors import ConfigError, InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.recording import Recording, read_recording
from mocks import synthetic_limb as limb
from tests.unit.evaluation_leg import calibrated, moving, protocol, table

POSE = moving()
MIRROR = np.diag([1.0, 1.0, -1.0])


def errors(motion, pose=POSE):
    return motion.knee_deg - pose.knee_deg


def root_mean_square(values):
    return np.sqrt((values**2).mean(axis=0))


# --- rigid fit ------------------------------------------------------------------------------------------


def cloud(seed, markers=4):
    rng = np.random.default_rng(seed)
    template = rng.normal(0, 0.1, (markers, 3))
    rotation = Rotation.random(20, random_state=seed).as_matrix()
    shift = rng.normal(0, 1, (20, 3))
    return template, rotation, shift, np.einsum("fij,mj->fmi", rotation, template) + shift[:, None]


@pytest.mark.parametrize("seed", range(5))
def test_a_rigid_motion_comes_back_exactly(seed):
    template, rotation, shift, observed = cloud(seed)
    fit = fit_rigid(template, observed)
    assert np.abs(fit.rotation - rotation).max() < 1e-13
    assert np.abs(fit.translation - shift).max() < 1e-13
    assert fit.residual.max() < 1e-14
    assert fit.markers.tolist() == [4] * 20
    assert np.abs(fit.carry(template[2]) - observed[:, 2]).max() < 1e-13


def test_noise_is_fitted_as_scipy_fits_it():
    template, _, _, observed = cloud(7)
    observed = observed + np.random.default_rng(1).normal(0, 0.01, observed.shape)
    weights = np.array([1.0, 2.0, 0.5, 3.0])
    fit = fit_rigid(template, observed, weights)
    share = weights / weights.sum()
    for frame in range(20):
        one, other = observed[frame] - share @ observed[frame], template - share @ template
        expected, rms = Rotation.align_vectors(one, other, weights)
        assert fit.rotation[frame] == pytest.approx(expected.as_matrix(), abs=1e-9)
        assert fit.residual[frame] == pytest.approx(rms / np.sqrt(weights.sum()), rel=1e-6)


def test_hidden_markers_are_left_out_of_the_fit():
    template, rotation, _, observed = cloud(3)
    observed[4:9, 1] = np.nan
    observed[8, 0] = np.nan
    fit = fit_rigid(template, observed)
    assert np.flatnonzero(np.isnan(fit.residual)).tolist() == [8]
    assert np.isnan(fit.rotation[8]).all()
    assert np.abs(fit.rotation[4:8] - rotation[4:8]).max() < 1e-12
    assert fit.markers[[3, 5, 8]].tolist() == [4, 3, 2]


def test_three_visible_markers_on_a_line_give_nothing():
    template = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0.001, 0], [0.1, 0.1, 0]])
    observed = np.tile(template, (3, 1, 1))
    observed[1, 3] = np.nan
    assert width_over_length(template[:3]) < 0.05
    assert np.isnan(fit_rigid(template, observed).residual).tolist() == [False, True, False]


def test_flat_clusters_are_not_mirrored():
    template = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0.0]])
    rotation = Rotation.random(100, random_state=2).as_matrix()
    fit = fit_rigid(template, np.einsum("fij,mj->fmi", rotation, template))
    assert np.linalg.det(fit.rotation) == pytest.approx(np.ones(100))
    assert fit.rotation == pytest.approx(rotation, abs=1e-12)


# --- gaps -----------------------------------------------------------------------------------------------


def test_a_hidden_marker_moves_with_its_cluster():
    whole = table(POSE).positions[:, 3:7]
    template = limb.stacked(limb.markers(limb.standing(1), "left"))[0, 3:7]
    gappy = whole.copy()
    gappy[100:700, 1] = np.nan
    gappy[:50, 2] = np.nan
    filled = fill_cluster(template, gappy, longest_gap=10)
    assert np.abs(filled.positions - whole).max() < 1e-12
    assert (filled.by_cluster, filled.by_spline, filled.left) == (650, 0, 0)


def test_filling_makes_no_step_when_a_marker_sits_elsewhere_than_calibrated():
    whole = table(POSE).positions[:, 3:7].copy()
    template = whole[0] + np.array([[0, 0, 0], [0.008, 0, 0], [0, 0, 0], [0, 0, 0]])
    gappy = whole.copy()
    gappy[300:600, 1] = np.nan
    assert np.abs(fill_cluster(template, gappy, 10).positions - whole).max() < 1e-9


def test_two_hidden_markers_wait_for_a_spline_and_long_gaps_stay():
    whole = table(POSE).positions[:, 3:7]
    gappy = whole.copy()
    gappy[100:108, :2] = np.nan
    gappy[500:600, :2] = np.nan
    filled = fill_cluster(whole[0], gappy, longest_gap=10)
    assert (filled.by_cluster, filled.by_spline, filled.left) == (0, 16, 200)
    assert np.abs(filled.positions[100:108] - whole[100:108]).max() < 1e-6
    assert np.isnan(filled.positions[500:600, :2]).all()


def test_gaps_at_the_ends_are_not_bridged():
    path = np.sin(np.linspace(0, 3, 90)).reshape(30, 3)
    path[:3], path[-2:] = np.nan, np.nan
    assert np.array_equal(bridge(path, 10), path, equal_nan=True)


# --- the leg --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["left", "right"])
def test_angles_of_a_leg_without_noise(side):
    rules = protocol(side, foot=True)
    calibration = calibrated(rules)
    motion = track(table(POSE, side), calibration, rules.processing, "trial")
    assert np.abs(errors(motion)).max() < 1e-6
    assert np.abs(motion.ankle_deg - POSE.ankle_deg).max() < 1e-6
    assert motion.residual_mm.max() < 1e-9
    assert motion.knee_gap_mm.max() < 1e-9
    assert np.abs(motion.hip - POSE.hip).max() < 1e-12
    assert np.abs(calibration.knee_deg).max() < 1e-9


def noisy(millimetres, seed=5):
    plain = table(POSE)
    noise = np.random.default_rng(seed).normal(0, millimetres / 1000, plain.positions.shape)
    return replace(plain, positions=plain.positions + noise)


def test_noise_of_a_third_of_a_millimetre():
    rules = protocol(cutoff_hz=6.0)
    motion = track(noisy(0.3), calibrated(rules), rules.processing, "trial")
    assert (root_mean_square(errors(motion)) < [0.1, 0.15, 0.3]).all()
    raw = track(noisy(0.3), calibrated(rules), protocol().processing, "trial")
    assert (root_mean_square(errors(raw)) > 2 * root_mean_square(errors(motion))).all()


def test_the_mirror_image_of_a_right_leg_is_a_left_leg():
    right = noisy(2.0)
    left = replace(right, positions=right.positions @ MIRROR)
    angles = {}
    for side, trial in (("right", left), ("left", right)):
        rules = protocol(side, cutoff_hz=6.0)
        angles[side] = track(trial, calibrated(rules), rules.processing, side).knee_deg
    assert np.abs(angles["left"] - angles["right"]).max() < 1e-9


def test_turning_the_laboratory_about_the_vertical_and_tilting_the_trial_changes_nothing():
    rules = protocol(cutoff_hz=6.0)
    calibration = calibrated(rules)
    plain = noisy(2.0)
    turn = Rotation.from_euler("xyz", [0.4, -1.1, 0.3]).as_matrix()
    turned = replace(plain, positions=plain.positions @ turn.T + np.array([3.0, -2.0, 1.0]))
    one = track(plain, calibration, rules.processing, "plain").knee_deg
    other = track(turned, calibration, rules.processing, "turned").knee_deg
    assert np.abs(one - other).max() < 1e-9


def test_one_marker_lost_costs_little_and_two_lost_leave_a_gap():
    rules = protocol()
    trial = noisy(0.3)
    trial.positions[100:300, trial.names.index("TH2")] = np.nan
    trial.positions[500:700, trial.names.index("TH2")] = np.nan
    trial.positions[550:650, trial.names.index("TH1")] = np.nan
    motion = track(trial, calibrated(rules), rules.processing, "trial")
    assert np.flatnonzero(np.isnan(motion.knee_deg[:, 0])).tolist() == list(range(550, 650))
    assert (root_mean_square(errors(motion)[100:300]) < [0.5, 1.0, 1.2]).all()
    assert motion.left_open == 200
    assert motion.visible[[0, 150, 600], 0].tolist() == [4, 3, 2]


def test_a_marker_that_the_file_lacks_is_a_gap_and_three_lacking_are_refused():
    rules = protocol()
    names = tuple(name for name in limb.NAMES if name != "TH3")
    motion = track(table(POSE, names=names), calibrated(rules), rules.processing, "trial")
    assert np.abs(errors(motion)).max() < 1e-6
    few = tuple(name for name in names if name != "TH1")
    with pytest.raises(InputError, match="the thigh has 2 of its markers"):
        track(table(POSE, names=few), calibrated(rules), rules.processing, "trial")


# --- cross-talk -----------------------------------------------------------------------------------------


def test_a_misplaced_knee_marker_bends_the_frontal_angle_and_one_turn_mends_most_of_it():
    """Figures of a sensitivity study: 10 mm forward give about 5 degrees of error at 75 of flexion."""
    rules = protocol()
    calibration = calibrated(rules, {"KNM": (0.010, 0.0, 0.0)})
    motion = track(table(POSE), calibration, rules.processing, "trial")
    deepest = int(np.argmin(POSE.knee_deg[:, 0]))
    assert abs(errors(motion)[deepest, 1]) == pytest.approx(5.6, abs=0.3)
    turn = thigh_turn(calibration, motion.knee_deg, "trial")
    mended = track(table(POSE), turn_thigh(calibration, turn), rules.processing, "trial")
    assert root_mean_square(errors(mended))[1] < 1.5 < 2 * root_mean_square(errors(motion))[1] / 2
    assert mended.knee_deg[:, 1].var() < motion.knee_deg[:, 1].var()


def test_the_turn_is_a_turn_of_the_thighs_frame():
    """Without true frontal motion the best turn is exactly the opposite of the misplacement."""
    pose = replace(POSE, knee_deg=POSE.knee_deg * [1, 0, 0])
    rules = protocol("right")
    calibration = calibrated(rules)
    wrong = turn_thigh(calibration, 7.0)
    motion = track(table(pose, "right"), wrong, rules.processing, "trial")
    assert thigh_turn(wrong, motion.knee_deg, "trial") == pytest.approx(-7.0, abs=1e-4)
    assert turn_thigh(wrong, -7.0).thigh.frame == pytest.approx(calibration.thigh.frame, abs=1e-12)
    assert wrong.cross_talk_deg == 7.0


def test_a_stiff_movement_cannot_calibrate_the_knee_axis():
    pose = replace(POSE, knee_deg=POSE.knee_deg * [0.2, 1, 1])
    rules = protocol()
    motion = track(table(pose), calibrated(rules), rules.processing, "trial")
    with pytest.raises(InputError, match="bends over less than 30 deg"):
        thigh_turn(calibrated(rules), motion.knee_deg, "trial")


# --- quality and refusals -------------------------------------------------------------------------------


def test_quality_of_a_clean_trial():
    rules = protocol()
    calibration = calibrated(rules)
    quality = judge(track(noisy(0.3), calibration, rules.processing, "t"), calibration, "t")
    assert quality.flags == ()
    assert quality.known == 1.0
    assert 0.2 < quality.residual_mm["thigh"] < 0.6


def test_a_cluster_that_was_moved_is_refused_by_name():
    rules = protocol()
    trial = table(POSE)
    trial.positions[:, trial.names.index("SH2")] += 0.05
    motion = track(trial, calibrated(rules), rules.processing, "t.c3d")
    with pytest.raises(
        InputError, match=r"shank cluster does not have its standing shape: residual \d+"
    ) as e:
        judge(motion, calibrated(rules), "t.c3d")
    assert e.value.where == "t.c3d"
    assert "standing.c3d" in e.value.hint


def test_a_cluster_that_was_moved_as_a_whole_pulls_the_knee_apart():
    rules = protocol()
    trial = table(POSE)
    for name in limb.CLUSTERS["thigh"]:
        trial.positions[:, trial.names.index(name)] += POSE.thigh @ np.array([0.0, 0.1, 0.0])
    with pytest.raises(InputError, match="carry the knee to places 100 mm apart"):
        judge(track(trial, calibrated(rules), rules.processing, "t"), calibrated(rules), "t")


def test_flags_name_the_gaps_and_the_implausible():
    rules = protocol()
    pose = replace(POSE, knee_deg=POSE.knee_deg * [1, 9, 1])
    trial = table(pose)
    trial.positions[10:40, :8] = np.nan
    quality = judge(track(trial, calibrated(rules), rules.processing, "t"), calibrated(rules), "t")
    assert any("30 of 2000 frames" in flag for flag in quality.flags)
    assert any("Implausible adduction" in flag for flag in quality.flags)


def test_a_second_standing_trial_with_a_moved_landmark_is_noticed():
    rules = protocol()
    assert compare_standing(calibrated(rules), calibrated(rules)) == ()
    sentences = compare_standing(calibrated(rules), calibrated(rules, {"KNM": (0.012, 0, 0)}))
    assert len(sentences) == 1
    assert "internal rotation differs" in sentences[0]


@pytest.mark.parametrize(
    ("labels", "kind", "what"),
    [
        ({"knee_medial": "NONE"}, InputError, "lacks NONE"),
        ({"knee_medial": "KNL"}, ConfigError, "'KNL' is named twice"),
        ({"thigh": ("TH1", "TH2", "TH2")}, ConfigError, "named twice"),
        ({"foot": ("HEE", "TOE", "MT5")}, ConfigError, "needs the foot's direction"),
        ({"ankle_lateral": "KNL", "knee_lateral": "ANL"}, InputError, "would be"),
    ],
)
def test_wrong_labels_are_refused(labels, kind, what):
    rules = protocol().model_copy(update={"markers": MarkerLabels(**labels)})
    standing = Recording(table(limb.standing(50)), None, ())
    with pytest.raises(kind, match=what):
        calibrate(standing, rules, "standing.c3d")


# --- recorded clusters ----------------------------------------------------------------------------------

LABELS = MarkerLabels(
    thigh=("LTH1", "LTH2", "LTH3", "LTH4"), shank=("LSH1", "LSH2", "LSH3", "LSH4"), hip=None,
    knee_lateral="LLKN", knee_medial="LMKN", ankle_lateral="LLAK", ankle_medial="LMAK",
    foot=("LCAL", "LTOE", "LMT5", "LCUN"), heel="LCAL", toe="LTOE",
    left_asis="LASI", right_asis="RASI", left_psis="LPSI", right_psis="RPSI",
)  # fmt: skip


@pytest.fixture(scope="module")
def recorded(shared_data):
    folder = shared_data / "c3d_cluster_protocol"
    with C3DReader() as reader:
        return {
            name: read_recording(folder / f"2022_01_{name}.c3d", None, None, reader)
            for name in ("0401", "0403")
        }


def recorded_rules():
    return protocol(hip={"model": "harrington"}, cutoff_hz=6.0).model_copy(update={"markers": LABELS})


def test_frames_built_from_a_recording_track_it(recorded):
    rules = recorded_rules()
    calibration = calibrate(recorded["0401"], rules, "0401")
    motion = track(recorded["0401"].markers, calibration, rules.processing, "0401")
    quality = judge(motion, calibration, "0401")
    assert quality.known > 0.99
    assert quality.residual_mm["thigh"] < 6.0
    assert quality.residual_mm["shank"] < 2.0
    assert quality.knee_gap_mm < 20.0
    assert -130 < np.nanmin(motion.knee_deg[:, 0]) < -90


def test_frames_of_one_recording_are_refused_for_the_other(recorded):
    rules = recorded_rules()
    calibration = calibrate(recorded["0401"], rules, "0401")
    motion = track(recorded["0403"].markers, calibration, rules.processing, "0403")
    with pytest.raises(
        InputError, match=r"thigh cluster does not have its standing shape: residual 2\d\.\d mm"
    ):
        judge(motion, calibration, "0403")


def test_tracked_angles_agree_with_those_of_the_landmarks_themselves(recorded):
    """Hip, knee and ankle centres in every frame, from markers that the tracking does not use."""
    rules = recorded_rules()
    calibration = calibrate(recorded["0401"], rules, "0401")
    motion = track(recorded["0401"].markers, calibration, rules.processing, "0401")
    markers = recorded["0401"].markers
    positions = dict(zip(markers.names, markers.positions.transpose(1, 0, 2), strict=True))
    knee = (positions["LLKN"] + positions["LMKN"]) / 2
    ankle = (positions["LLAK"] + positions["LMAK"]) / 2
    thigh, shank = motion.hip - knee, knee - ankle
    cosine = (thigh * shank).sum(1) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
    plain = np.rad2deg(np.arccos(cosine))
    known = np.isfinite(plain) & np.isfinite(motion.knee_deg[:, 0])
    difference = plain[known] + motion.knee_deg[known, 0]
    assert np.corrcoef(plain[known], -motion.knee_deg[known, 0])[0, 1] > 0.99
    assert difference.std() < 4.0


# --- what other laboratories' files hold ----------------------------------------------------------------


def test_a_foot_that_is_never_seen_costs_only_the_ankle():
    rules = protocol(foot=True)
    calibration = calibrated(rules)
    trial = table(moving(200))
    trial.positions[:, trial.names.index("HEE")] = np.nan
    motion = track(trial, calibration, rules.processing, "t")
    quality = judge(motion, calibration, "t")
    assert np.isnan(motion.ankle_deg).all()
    assert quality.known == 1.0
    assert quality.flags == ("The foot never shows three markers at once.",)


def test_the_wrong_side_is_refused_by_name():
    """Calibrated as the other leg, in and out are exchanged and the knee seems to bend backwards."""
    rules = protocol("right")
    standing = Recording(table(limb.standing(50), "left"), None, ())
    calibration = calibrate(standing, rules, "standing.c3d")
    motion = track(table(moving(400), "left"), calibration, rules.processing, "t")
    with pytest.raises(InputError, match="the knee extends by 75 deg and hardly bends") as caught:
        judge(motion, calibration, "t")
    assert "protocol.side" in caught.value.hint


def test_all_landmarks_are_taken_from_the_same_still_second():
    """The hip marker belongs to the second that calibrates, not to the walk before it."""
    rules = protocol()
    still, walk = limb.markers(limb.standing(300), "left"), limb.markers(moving(900), "left")
    positions = np.concatenate([limb.stacked(walk), limb.stacked(still)])
    both = replace(table(limb.standing(1200)), positions=positions)
    calibration = calibrate(Recording(both, None, ()), rules, "standing.c3d")
    assert calibration.thigh.proximal == pytest.approx([0.0, 0.9, 0.0], abs=1e-9)
    assert calibration.knee_deg == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_laboratory_with_another_vertical_is_noticed():
    rules = protocol()
    standing = table(limb.standing(50))
    assert calibrate(Recording(standing, None, ()), rules, "s").notes == ()
    lying = replace(standing, positions=standing.positions[:, :, [0, 2, 1]] * [1.0, 1.0, -1.0])
    notes = calibrate(Recording(lying, None, ()), rules, "s").notes
    assert "leans by 90 deg" in notes[0]
    assert "protocol.vertical_axis" in notes[0]
