"""OpenSim's own tools as oracles of muscle and contact forces, in a process of their own.

``python -m tests.unit.muscle_oracle question.npz answer.npz`` answers one question in a folder of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
ROOT_ACTUATORS = {"pelvis_tx": 1000.0, "pelvis_ty": 1000.0, "pelvis_tz": 1000.0}
ROOT_ACTUATORS |= dict.fromkeys(("pelvis_tilt", "pelvis_list", "pelvis_rotation"), 500.0)


def ask(**question: Any) -> dict[str, np.ndarray]:
    """Let OpenSim's tools answer in plain arrays.

    Question: ``model`` (path), ``names``, ``time``, ``coordinates`` (frame, name), ``reactions`` (frame,
    foot, 9: force, point, torque; right, left), ``first`` and ``last`` frame, ``reserves`` (0 or 1: whether
    to go on to static optimisation and joint reactions).

    Answer: ``moments`` (frame, name); ``muscles``, ``forces`` (frame, muscle), ``seconds`` that the static
    optimisation took of the processor, ``knee_forces`` (frame, side, 3) on the tibia in its frame.
    """
    with tempfile.TemporaryDirectory() as folder:
        asked, answered = Path(folder, "question.npz"), Path(folder, "answer.npz")
        np.savez(asked, **question)
        done = subprocess.run(
            [sys.executable, "-m", "tests.unit.muscle_oracle", str(asked), str(answered)],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            timeout=280,
        )
        assert answered.exists(), done.stderr + done.stdout
        with np.load(answered) as archive:
            return dict(archive)


def _write(path: str, time_s: np.ndarray, columns: dict[str, np.ndarray]) -> None:
    lines = [
        path,
        "version=1",
        f"nRows={len(time_s)}",
        f"nColumns={len(columns) + 1}",
        "inDegrees=no",
        "endheader",
    ]
    lines.append("\t".join(["time", *columns]))
    table = np.column_stack([time_s, *columns.values()]).tolist()
    lines += ["\t".join(f"{value:.17g}" for value in row) for row in table]
    Path(path).write_text("\n".join(lines) + "\n")


def _read(path: Path) -> dict[str, np.ndarray]:
    lines = path.read_text().splitlines()
    start = next(k for k, line in enumerate(lines) if line.strip() == "endheader")
    names = lines[start + 1].split("\t")
    values = np.array([[float(x) for x in line.split("\t")] for line in lines[start + 2 :] if line.strip()])
    return {name.strip(): values[:, k] for k, name in enumerate(names)}


def _external_loads() -> str:
    forces = "".join(
        f"<ExternalForce name='{side}'><applied_to_body>calcn_{side}</applied_to_body>"
        "<force_expressed_in_body>ground</force_expressed_in_body>"
        "<point_expressed_in_body>ground</point_expressed_in_body>"
        f"<force_identifier>{side}_v</force_identifier><point_identifier>{side}_p</point_identifier>"
        f"<torque_identifier>{side}_t</torque_identifier></ExternalForce>"
        for side in "rl"
    )
    return (
        "<?xml version='1.0'?><OpenSimDocument Version='30000'><ExternalLoads name='loads'><objects>"
        f"{forces}</objects><groups/><datafile>{Path('forces.mot').resolve()}</datafile>"
        "</ExternalLoads></OpenSimDocument>"
    )


def _inputs(question: dict[str, np.ndarray]) -> None:
    names, values = question["names"].tolist(), question["coordinates"]
    columns = {name: values[:, k] for k, name in enumerate(names)}
    columns |= {f"knee_angle_{side}_beta": columns[f"knee_angle_{side}"] for side in "rl"}
    _write("coordinates.mot", question["time"], columns)
    reactions = question["reactions"]
    labels = [f"{kind}{axis}" for kind in ("v", "p", "t") for axis in "xyz"]
    loads = {f"{s}_{n}": reactions[:, f, k] for f, s in enumerate("rl") for k, n in enumerate(labels)}
    _write("forces.mot", question["time"], loads)
    Path("loads.xml").write_text(_external_loads())


def inverse_dynamics(question: dict[str, np.ndarray]) -> np.ndarray:
    """Generalised forces by InverseDynamicsTool; what the kneecaps need is added to the knees."""
    import opensim as osim

    tool = osim.InverseDynamicsTool()
    tool.setModelFileName(str(question["model"]))
    tool.setCoordinatesFileName("coordinates.mot")
    tool.setExternalLoadsFileName("loads.xml")
    tool.setLowpassCutoffFrequency(-1.0)
    tool.setStartTime(float(question["time"][0]))
    tool.setEndTime(float(question["time"][-1]))
    tool.setResultsDir(".")
    tool.setOutputGenForceFileName("moments.sto")
    excluded = osim.ArrayStr()
    excluded.append("Muscles")
    tool.setExcludedForces(excluded)
    tool.run()
    found = _read(Path("moments.sto"))
    for side in "rl":
        found[f"knee_angle_{side}_moment"] += found[f"knee_angle_{side}_beta_force"]
    names = question["names"].tolist()
    return np.stack([found.get(f"{n}_moment", found.get(f"{n}_force")) for n in names], axis=1)


def _with_reserves(path: str) -> None:
    import opensim as osim

    model = osim.Model(path)
    coordinates = model.getCoordinateSet()
    actuated = set()
    for k in range(model.getForceSet().getSize()):
        actuator = osim.CoordinateActuator.safeDownCast(model.getForceSet().get(k))
        if actuator is not None:
            actuated.add(actuator.get_coordinate())
    names = [coordinates.get(k).getName() for k in range(coordinates.getSize())]
    locked = {name for name in names if coordinates.get(name).getDefaultLocked()}
    for name in names:
        if name in actuated | locked or name.endswith("_beta"):
            continue
        actuator = osim.CoordinateActuator(name)
        actuator.setName(f"{name}_reserve")
        cheap = 100.0 if name.startswith(("knee_adduction", "knee_rotation")) else 1.0
        actuator.setOptimalForce(ROOT_ACTUATORS.get(name, cheap))
        actuator.setMinControl(-1e6)
        actuator.setMaxControl(1e6)
        model.addForce(actuator)
    model.finalizeConnections()
    model.printToXML("reserves.osim")


def _analyze(name: str, analysis: Any, question: dict[str, np.ndarray], model: Any) -> None:
    """Run an AnalyzeTool through its setup file, which is the reliable way."""
    import opensim as osim

    start, end = (float(question["time"][int(question[k])]) for k in ("first", "last"))
    analysis.setStartTime(start)
    analysis.setEndTime(end)
    tool = osim.AnalyzeTool()
    tool.setName(name)
    tool.setModelFilename("reserves.osim")
    tool.setCoordinatesFileName("coordinates.mot")
    tool.setLowpassCutoffFrequency(-1.0)
    tool.setExternalLoadsFileName("loads.xml")
    tool.setStartTime(start)
    tool.setFinalTime(end)
    tool.setResultsDir(".")
    tool.setReplaceForceSet(False)
    tool.updAnalysisSet().cloneAndAppend(analysis)
    tool.printToXML(f"{name}.xml")
    osim.AnalyzeTool(f"{name}.xml", True).run()


def static_optimization(question: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Muscle forces by StaticOptimization, contact forces of the knees by JointReaction."""
    import opensim as osim

    _with_reserves(str(question["model"]))
    analysis = osim.StaticOptimization()
    analysis.setName("StaticOptimization")
    analysis.setStepInterval(1)
    analysis.setUseModelForceSet(True)
    analysis.setActivationExponent(2)
    analysis.setUseMusclePhysiology(True)
    begun = time.process_time()
    _analyze("so", analysis, question, None)
    seconds = time.process_time() - begun
    forces = _read(Path("so_StaticOptimization_force.sto"))
    reaction = osim.JointReaction()
    reaction.setName("JointReaction")
    for setter, word in (("setJointNames", "ALL"), ("setOnBody", "child"), ("setInFrame", "child")):
        array = osim.ArrayStr()
        array.append(word)
        getattr(reaction, setter)(array)
    reaction.setForcesFileName("so_StaticOptimization_force.sto")
    _analyze("jr", reaction, question, None)
    loads = _read(Path("jr_JointReaction_ReactionLoads.sto"))
    model = osim.Model("reserves.osim")
    muscles = [model.getMuscles().get(k).getName() for k in range(model.getMuscles().getSize())]
    knees = [[loads[f"walker_knee_{s}_on_tibia_{s}_in_tibia_{s}_f{axis}"] for axis in "xyz"] for s in "rl"]
    return {
        "muscles": np.array(muscles),
        "so_time": forces["time"],
        "forces": np.stack([forces[name] for name in muscles], axis=1),
        "knee_forces": np.moveaxis(np.array(knees), 2, 0),
        "seconds": np.array(seconds),
    }


def main() -> None:
    """Answer the question of the command line."""
    import opensim as osim

    osim.Logger.setLevelString("Off")
    osim.Logger.removeFileSink()
    with np.load(sys.argv[1]) as archive:
        question = dict(archive)
    _inputs(question)
    answer = {"moments": inverse_dynamics(question)}
    if int(question["reserves"]):
        answer |= static_optimization(question)
    np.savez(sys.argv[2], **answer)


if __name__ == "__main__":
    main()
