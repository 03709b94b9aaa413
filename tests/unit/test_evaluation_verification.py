"""Angles that Plug-in Gait stored, from its axes and from raw markers; pyCGM as a second opinion."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from evaluation.conventional_gait import joint_centre, knee_angles_from_markers
from evaluation.verification import verify_plug_in_gait
from hilbrace.errors import InputError
from hilbrace.motion.c3d import C3DReader
from hilbrace.motion.c3d_header import check_c3d
from hilbrace.motion.opensim_files import MarkerTable


@pytest.fixture(scope="module")
def walkers(shared_data):
    files = sorted((shared_data / "c3d_plugin_gait").rglob("*.c3d"))
    with C3DReader() as reader:
        return {path.stem: reader.read(path) for path in files}


def test_every_stored_angle_is_reproduced_from_axes_and_from_raw_markers(walkers):
    assert len(walkers) == 7
    for name, recording in walkers.items():
        checks, notes = verify_plug_in_gait(recording, name)
        assert notes == ()
        assert [(check.name, check.source) for check in checks] == [
            ("LKneeAngles", "axes"),
            ("RKneeAngles", "axes"),
            ("LAnkleAngles", "axes"),
            ("RAnkleAngles", "axes"),
            ("LKneeAngles", "markers"),
            ("RKneeAngles", "markers"),
        ]
        for check in checks:
            assert check.frames >= 50
            assert check.largest_deg.max() < 1.5e-4
            assert check.agrees


PEAKS = {
    ("HC032A03", "LKneeAngles"): (59.93, -1.31, -10.29),
    ("HC032A18", "RKneeAngles"): (72.09, -11.32, -4.38),
    ("HC038A11", "LKneeAngles"): (61.49, 8.26, -8.54),
    ("Movement_trial", "LKneeAngles"): (102.63, 43.92, 18.74),
    ("Movement_trial", "RKneeAngles"): (86.97, 54.71, -7.90),
}


@pytest.mark.parametrize("case", PEAKS)
def test_peak_flexion_as_the_data_sheet_lists_it(walkers, case):
    trial, joint = case
    for check in verify_plug_in_gait(walkers[trial], trial)[0]:
        if check.name == joint:
            frame = int(np.nanargmax(check.computed_deg[:, 0]))
            assert check.computed_deg[frame] == pytest.approx(PEAKS[case], abs=0.006)


def test_a_wrong_axis_or_marker_is_noticed(walkers):
    recording = walkers["HC032A03"]
    positions = recording.markers.positions.copy()
    positions[:, recording.markers.names.index("LTIA")] += 0.001
    positions[:, recording.markers.names.index("RKNE")] += 0.001
    changed = replace(recording, markers=replace(recording.markers, positions=positions))
    checks, _ = verify_plug_in_gait(changed, "changed")
    assert {(check.name, check.source): check.agrees for check in checks} == {
        ("LKneeAngles", "axes"): False,
        ("RKneeAngles", "axes"): True,
        ("LAnkleAngles", "axes"): False,
        ("RAnkleAngles", "axes"): True,
        ("LKneeAngles", "markers"): True,
        ("RKneeAngles", "markers"): False,
    }


def test_what_a_file_does_not_allow_is_said(walkers):
    recording = walkers["HC032A03"]
    turned = replace(recording, measurements=recording.measurements | {"LThighRotation": 0.1})
    checks, notes = verify_plug_in_gait(turned, "turned")
    assert len(checks) == 5
    assert notes == ("LKneeAngles from raw markers: the model was run with LThighRotation = 0.1.",)
    bare = replace(recording, measurements={})
    with pytest.raises(InputError, match="does not hold the measurement InterAsisDistance"):
        knee_angles_from_markers(bare.markers, bare.measurements, "left", "bare")
    table = recording.markers
    keep = [k for k, name in enumerate(table.names) if name != "LKNE"]
    fewer = MarkerTable(tuple(table.names[k] for k in keep), table.time, 100.0, table.positions[:, keep])
    with pytest.raises(InputError, match="no marker LKNE"):
        knee_angles_from_markers(fewer, recording.measurements, "left", "fewer")


@pytest.mark.parametrize("step", [0.01, 0.1])
def test_a_file_of_whole_numbers_is_held_to_what_it_can_tell(walkers, step):
    """Millimetres and degrees in steps, as older exports store them."""
    recording = walkers["HC032A03"]
    markers = replace(
        recording.markers, positions=np.round(recording.markers.positions * 1000 / step) * step / 1000
    )
    outputs = {name: np.round(values / step) * step for name, values in recording.outputs.items()}
    coarse = replace(recording, markers=markers, outputs=outputs, step=step)
    checks, notes = verify_plug_in_gait(coarse, "coarse")
    assert "whole numbers, in steps of" in notes[0]
    assert all(check.agrees for check in checks)
    assert not any(check.agrees for check in verify_plug_in_gait(replace(coarse, step=0.0), "floats")[0])
    outputs["LKneeAngles"] = outputs["LKneeAngles"] + 2 * step
    assert not verify_plug_in_gait(coarse, "shifted")[0][0].agrees


def test_a_file_without_segment_axes_says_so_and_is_checked_from_its_markers(walkers):
    recording = walkers["HC032A03"]
    table = recording.markers
    axes = {side + segment + point for side in "LR" for segment in ("FE", "TI", "FO") for point in "OALP"}
    keep = [k for k, name in enumerate(table.names) if name not in axes]
    names = tuple(table.names[k] for k in keep)
    bare = replace(recording, markers=replace(table, names=names, positions=table.positions[:, keep]))
    checks, notes = verify_plug_in_gait(bare, "bare")
    assert [(check.name, check.source) for check in checks] == [
        ("LKneeAngles", "markers"),
        ("RKneeAngles", "markers"),
    ]
    assert notes == (
        "The segment axes behind LKneeAngles, RKneeAngles, LAnkleAngles, RAnkleAngles are not stored.",
    )
    with pytest.raises(InputError, match="does not hold the measurement InterAsisDistance"):
        verify_plug_in_gait(replace(bare, measurements={}), "bare")


def test_a_side_that_was_not_captured_is_named_and_not_called_different(walkers):
    """Plug-in Gait writes the labels of both sides, and nothing but gaps under those of the hidden one."""
    recording = walkers["HC032A03"]
    outputs = {
        name: np.full_like(values, np.nan) if name.startswith("R") else values
        for name, values in recording.outputs.items()
    }
    checks, notes = verify_plug_in_gait(replace(recording, outputs=outputs), "left leg")
    assert {check.name for check in checks} == {"LKneeAngles", "LAnkleAngles"}
    assert all(check.agrees for check in checks)
    assert "RKneeAngles from axes: no frame holds both." in notes
    nothing = {name: np.full_like(values, np.nan) for name, values in outputs.items()}
    with pytest.raises(InputError, match="no frame holds both"):
        verify_plug_in_gait(replace(recording, outputs=nothing), "nothing")


def test_a_file_without_stored_angles_is_refused(shared_data):
    path = shared_data / "c3d_cluster_protocol/2022_01_0401.c3d"
    with C3DReader() as reader, pytest.raises(InputError, match="no Plug-in Gait angles"):
        verify_plug_in_gait(reader.read(path), str(path))


def test_the_chord_function_keeps_its_three_promises():
    rng = np.random.default_rng(5)
    proximal, lateral, plane = rng.normal(0, 0.3, (3, 50, 3))
    centre = joint_centre(proximal, lateral, plane, 0.05)
    assert np.linalg.norm(centre - lateral, axis=1) == pytest.approx(np.full(50, 0.05))
    assert ((centre - lateral) * (centre - proximal)).sum(axis=1) == pytest.approx(np.zeros(50), abs=1e-12)
    normal = np.cross(proximal - lateral, plane - lateral)
    assert ((centre - lateral) * normal).sum(axis=1) == pytest.approx(np.zeros(50), abs=1e-12)
    away = np.cross(np.cross(proximal - lateral, plane - lateral), proximal - lateral)
    assert (((plane - lateral) * away).sum(axis=1) * ((centre - lateral) * away).sum(axis=1) < 0).all()


PYCGM = """
import json, sys, warnings
warnings.simplefilter("ignore")
out, sys.stdout = sys.stdout, sys.stderr
import numpy as np
from pyCGM_Single import pycgmCalc, pycgmIO, pycgmStatic
folder = sys.argv[1]
moving, still = (pycgmIO.loadData(f"{folder}/{name}_trial.c3d") for name in ("Movement", "Static"))
subject = pycgmStatic.getStatic(still, pycgmIO.loadVSK(f"{folder}/Test.vsk", dict=False), flat_foot=False)
rows = pycgmCalc.calcAngles(moving, vsk=subject, splitAnglesAxis=False, formatData=False)
angles = np.asarray(rows)[:, :57].reshape(-1, 19, 3)
json.dump({"right": angles[:, 3].tolist(), "left": angles[:, 4].tolist()}, out)
"""
"""Knee angles by pyCGM 1.0, an independent program, in a process of its own (it loads ezc3d)."""


def test_raw_markers_give_what_pycgm_gives(walkers, shared_data):
    if importlib.util.find_spec("pyCGM_Single") is None:
        pytest.skip("pycgm is not installed (extra dev)")
    folder = shared_data / "c3d_plugin_gait/stairs_85kg"
    done = subprocess.run(
        [sys.executable, "-c", PYCGM, str(folder)], capture_output=True, text=True, check=True, timeout=120
    )
    theirs = json.loads(done.stdout)
    recording = walkers["Movement_trial"]
    for side in ("left", "right"):
        ours = knee_angles_from_markers(recording.markers, recording.measurements, side, "stairs")
        assert np.abs(ours - np.array(theirs[side])).max() < 1e-3


def test_the_step_of_whole_numbers_is_read_from_the_header(shared_data):
    assert check_c3d(shared_data / "c3d_force_plates/TYPE-2.C3D").step == pytest.approx(0.166829, abs=1e-6)
    assert check_c3d(shared_data / "c3d_plugin_gait/mcgill_HC038A/HC038A01.c3d").step == 0.0
