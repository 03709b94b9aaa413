"""OpenSim's own tools as oracles of the biomechanics stage, each in a process of its own.

``python -m tests.unit.biomech_oracle TASK question.npz answer.npz`` answers one question.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
CHAIN = ("tibia", "talus", "calcn", "toes")


def ask(task: str, **question: np.ndarray) -> dict[str, np.ndarray]:
    """Let OpenSim answer a question in plain arrays."""
    with tempfile.TemporaryDirectory() as folder:
        asked, answered = Path(folder, "question.npz"), Path(folder, "answer.npz")
        np.savez(asked, **question)
        done = subprocess.run(
            [sys.executable, "-m", "tests.unit.biomech_oracle", task, str(asked), str(answered)],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=200,
        )
        assert done.returncode == 0, done.stderr
        with np.load(answered) as archive:
            return dict(archive)


def _model(question: dict[str, np.ndarray]) -> Any:
    from hilbrace.biomech import opensim_model
    from hilbrace.skeleton.table import load_table

    model = opensim_model.build_model(load_table())
    coordinates = model.updCoordinateSet()
    for k in range(coordinates.getSize()):
        coordinates.get(k).setDefaultClamped(False)
        coordinates.get(k).setDefaultLocked(False)
    return opensim_model.scale_model(model, {}, float(question["mass_kg"]))


def reactions(question: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Reactions on tibia and talus of a model without muscles whose coordinates are all prescribed.

    Question: ``mass_kg``, ``names``, ``time``, ``coordinates`` (frame, name), ``frames`` wanted.
    Answer: ``force``, ``moment`` (wanted frame, joint, 3) at the child's joint frame in the ground, and
    ``inertia`` (wanted frame, name, name) by the multibody code.
    """
    import opensim as osim
    from scipy.interpolate import make_interp_spline

    model = _model(question)
    names, time, values = question["names"].tolist(), question["time"], question["coordinates"]
    for k, name in enumerate(names):
        spline = osim.GCVSpline()
        spline.setDegree(5)
        for instant, value in zip(time.tolist(), values[:, k].tolist(), strict=True):
            spline.addPoint(instant, value)
        coordinate = model.updCoordinateSet().get(name)
        coordinate.setPrescribedFunction(spline)
        coordinate.setDefaultIsPrescribed(True)
    for k in range(model.getForceSet().getSize()):
        model.updForceSet().get(k).set_appliesForce(False)
    state = model.initSystem()
    speeds = make_interp_spline(time, values, k=5).derivative()(time)
    variables = osim.createStateVariableNamesInSystemOrder(model)
    order = [name.split("/")[-2] for name in variables if name.endswith("/speed")]
    answer: dict[str, list[Any]] = {"force": [], "moment": [], "inertia": []}
    for frame in question["frames"].tolist():
        state.setTime(float(time[frame]))
        model.assemble(state)
        for k, name in enumerate(names):
            model.getCoordinateSet().get(name).setSpeedValue(state, float(speeds[frame, k]))
        for side in "rl":
            speed = float(speeds[frame, names.index(f"knee_angle_{side}")])
            model.getCoordinateSet().get(f"knee_angle_{side}_beta").setSpeedValue(state, speed)
        model.realizeAcceleration(state)
        force, moment = [], []
        for joint in ("walker_knee_r", "walker_knee_l", "ankle_r", "ankle_l"):
            reaction = model.getJointSet().get(joint).calcReactionOnChildExpressedInGround(state)
            moment.append(reaction.get(0).to_numpy())
            force.append(reaction.get(1).to_numpy())
        matrix = osim.Matrix()
        model.getMatterSubsystem().calcM(state, matrix)
        rows = [order.index(name) for name in names]
        answer["inertia"].append(matrix.to_numpy()[np.ix_(rows, rows)])
        answer["force"].append(force)
        answer["moment"].append(moment)
    return {key: np.array(value) for key, value in answer.items()}


def inverse_kinematics(question: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Poses by OpenSim's own solver, all markers at weight 1, locked coordinates locked.

    Question: ``mass_kg``, ``locked``, ``markers`` (names of the model), ``measured`` (frame, marker, 3),
    ``start_names``, ``start``. Answer: ``names``, ``coordinates`` (frame, name).
    """
    import opensim as osim

    model = _model(question)
    for name in question["locked"].tolist():
        model.updCoordinateSet().get(name).setDefaultLocked(True)
    table = osim.TimeSeriesTableVec3()
    labels = osim.StdVectorString()
    for name in question["markers"].tolist():
        labels.append(name)
    for frame, places in enumerate(question["measured"]):
        row = osim.RowVectorVec3(len(places))
        for k, place in enumerate(places.tolist()):
            row[k] = osim.Vec3(*place)
        table.appendRow(0.01 * frame, row)
    table.setColumnLabels(labels)
    references = osim.MarkersReference(table, osim.SetMarkerWeights())
    state = model.initSystem()
    for name, value in zip(question["start_names"].tolist(), question["start"].tolist(), strict=True):
        model.getCoordinateSet().get(name).setValue(state, value, False)
    model.assemble(state)
    solver = osim.InverseKinematicsSolver(model, references, osim.SimTKArrayCoordinateReference())
    solver.setAccuracy(1e-8)
    names = [model.getCoordinateSet().get(k).getName() for k in range(model.getCoordinateSet().getSize())]
    found = []
    for frame in range(len(question["measured"])):
        state.setTime(0.01 * frame)
        solver.assemble(state) if frame == 0 else solver.track(state)
        found.append([model.getCoordinateSet().get(name).getValue(state) for name in names])
    return {"names": np.array(names), "coordinates": np.array(found)}


def inverse_kinematics_tool(question: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Poses by OpenSim's InverseKinematicsTool, with a weight for each marker and files as it reads them.

    Question: as of `inverse_kinematics`, and ``weights``. Answer: ``names``, ``coordinates`` (frame, name).
    """
    import opensim as osim

    from hilbrace.motion.opensim_files import coordinates_rad, read_storage, write_trc

    model = _model(question)
    for name, value in zip(question["start_names"].tolist(), question["start"].tolist(), strict=True):
        model.updCoordinateSet().get(name).setDefaultValue(value)
    for name in question["locked"].tolist():
        model.updCoordinateSet().get(name).setDefaultLocked(True)
    for k in range(model.getForceSet().getSize()):
        model.updForceSet().get(k).set_appliesForce(False)
    model.finalizeConnections()
    model.printToXML("model.osim")
    names = tuple(question["markers"].tolist())
    measured = question["measured"]
    write_trc(Path("markers.trc"), 0.01 * np.arange(len(measured)), 100.0, names, measured)
    tool = osim.InverseKinematicsTool()
    tasks = tool.upd_IKTaskSet()
    for name, weight in zip(names, question["weights"].tolist(), strict=True):
        task = osim.IKMarkerTask()
        task.setName(name)
        task.setApply(True)
        task.setWeight(weight)
        tasks.cloneAndAppend(task)
    tool.set_model_file("model.osim")
    tool.set_marker_file("markers.trc")
    tool.set_accuracy(1e-9)
    tool.set_report_errors(False)
    tool.setStartTime(0.0)
    tool.setEndTime(0.01 * (len(measured) - 1))
    tool.setOutputMotionFileName("found.mot")
    assert tool.run()
    found = coordinates_rad(read_storage(Path("found.mot")))
    return {"names": np.array(list(found)), "coordinates": np.array(list(found.values())).T}


if __name__ == "__main__":
    with np.load(sys.argv[2]) as _archive:
        _question = dict(_archive)
    np.savez(
        sys.argv[3],
        **{
            "reactions": reactions,
            "inverse_kinematics": inverse_kinematics,
            "inverse_kinematics_tool": inverse_kinematics_tool,
        }[sys.argv[1]](_question),
    )
