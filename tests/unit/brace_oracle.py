"""OpenSim integrates a braced leg forward in time: an independent check of the joint's linear response.

Every coordinate follows the recording but knee adduction and rotation of one leg, which are free. They feel
the ground's forces, weight and inertia by OpenSim's own multibody equations, the moments of inverse dynamics
as feed-forward, a passive spring and damper about the recorded motion, and a brace, which is OpenSim's
bushing between the joint's two frames.

``python -m tests.unit.brace_oracle question.npz answer.npz`` answers one question.
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
STEP_S = 0.01


def braced_motion(**question: np.ndarray) -> np.ndarray:
    """Let OpenSim integrate; see `simulate` for the question. Returns (instant, free coordinate) [rad]."""
    with tempfile.TemporaryDirectory() as folder:
        asked, answered = Path(folder, "question.npz"), Path(folder, "answer.npz")
        np.savez(asked, **question)
        done = subprocess.run(
            [sys.executable, "-m", "tests.unit.brace_oracle", str(asked), str(answered)],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=250,
        )
        assert done.returncode == 0, done.stderr
        with np.load(answered) as archive:
            return archive["angles"]


class _Splines:
    """Splines, kept alive: OpenSim does not keep what it is handed from Python."""

    def __init__(self, time: np.ndarray) -> None:
        self._time, self._kept = time, []

    def through(self, values: np.ndarray, degree: int = 5) -> Any:
        import opensim as osim

        spline = osim.GCVSpline()
        spline.setDegree(degree)
        for instant, value in zip(self._time.tolist(), values.tolist(), strict=True):
            spline.addPoint(instant, value)
        self._kept.append(spline)
        return spline


def simulate(question: dict[str, np.ndarray]) -> np.ndarray:
    """Integrate the free coordinates over the instants asked for.

    Question: ``mass_kg``, ``scaled`` (bodies) and ``scales``; ``time``, ``names``, ``coordinates`` (frame,
    name); ``side``; ``feedforward`` (frame, 2) [N*m]; ``passive`` and ``viscosity`` (2) of adduction and
    rotation [N*m/rad, N*m*s/rad]; ``brace`` (2) [N*m/rad]; ``start`` (2) offset of the first angles [rad];
    ``feet``, ``force``, ``point``, ``torque`` (frame, foot, 3) of the ground; ``instants``.
    """
    import opensim as osim

    side, time = str(question["side"]), question["time"]
    splines = _Splines(time)
    model = _model(question)
    free = [f"knee_adduction_{side}", f"knee_rotation_{side}"]
    paths = dict(zip(question["names"].tolist(), question["coordinates"].T, strict=True))
    for name, values in paths.items():
        if name not in free:
            coordinate = model.updCoordinateSet().get(name)
            coordinate.setPrescribedFunction(splines.through(values))
            coordinate.setDefaultIsPrescribed(True)
    kept: list[Any] = []
    controller = osim.PrescribedController()
    for k, name in enumerate(free):
        stiffness, viscosity = float(question["passive"][k]), float(question["viscosity"][k])
        spring = osim.SpringGeneralizedForce(name)
        spring.setName(f"passive_{name}")
        spring.setStiffness(stiffness)
        spring.setViscosity(viscosity)
        spring.setRestLength(0.0)
        motor = osim.CoordinateActuator(name)
        motor.setName(f"motor_{name}")
        motor.setOptimalForce(1.0)
        model.addForce(spring)
        model.addForce(motor)
        speed = np.gradient(paths[name], time)
        wanted = question["feedforward"][:, k] + stiffness * paths[name] + viscosity * speed
        controller.addActuator(motor)
        controller.prescribeControlForActuator(motor.getName(), splines.through(wanted))
        kept += [spring, motor]
    model.addController(controller)
    adduction, rotation = question["brace"].tolist()
    if adduction > 0:
        joint = f"/jointset/walker_knee_{side}"
        none = osim.Vec3(0)
        brace = osim.BushingForce(
            "brace",
            f"{joint}/femur_{side}_offset",
            f"{joint}/tibia_{side}_offset",
            none,
            osim.Vec3(0.0, rotation, adduction),
            none,
            none,
        )
        model.addForce(brace)
        kept.append(brace)
    for k, foot in enumerate(question["feet"].tolist()):
        kept.append(_ground(model, splines, f"calcn_{foot[0]}", question, k))
    model.finalizeConnections()
    return _integrate(model, question, free, paths)


def _model(question: dict[str, np.ndarray]) -> Any:
    from hilbrace.biomech import opensim_model
    from hilbrace.skeleton.table import load_table

    model = opensim_model.build_model(load_table())
    scales = dict(zip(question["scaled"].tolist(), question["scales"], strict=True))
    opensim_model.scale_model(model, scales, float(question["mass_kg"]))
    for k in range(model.getCoordinateSet().getSize()):
        model.updCoordinateSet().get(k).setDefaultClamped(False)
        model.updCoordinateSet().get(k).setDefaultLocked(False)
    for k in range(model.getForceSet().getSize()):
        model.updForceSet().get(k).set_appliesForce(False)
    return model


def _ground(model: Any, splines: _Splines, body: str, question: dict[str, np.ndarray], foot: int) -> Any:
    import opensim as osim

    push = osim.PrescribedForce(f"ground_{body}", model.getBodySet().get(body))
    push.setForceIsInGlobalFrame(True)
    push.setPointIsInGlobalFrame(True)
    for what, setter in (
        ("force", push.setForceFunctions),
        ("point", push.setPointFunctions),
        ("torque", push.setTorqueFunctions),
    ):
        setter(*(splines.through(question[what][:, foot, axis], degree=1) for axis in range(3)))
    model.addForce(push)
    return push


def _integrate(
    model: Any, question: dict[str, np.ndarray], free: list[str], paths: dict[str, np.ndarray]
) -> np.ndarray:
    import opensim as osim

    time, instants = question["time"], question["instants"]
    state = model.initSystem()
    state.setTime(float(instants[0]))
    for name, offset in zip(free, question["start"].tolist(), strict=True):
        coordinate = model.getCoordinateSet().get(name)
        coordinate.setValue(state, float(np.interp(instants[0], time, paths[name])) + offset, False)
        speed = np.interp(instants[0], time, np.gradient(paths[name], time))
        coordinate.setSpeedValue(state, float(speed))
    model.assemble(state)
    manager = osim.Manager(model)
    manager.setIntegratorAccuracy(1e-3)
    manager.setIntegratorMaximumStepSize(STEP_S)
    manager.initialize(state)
    found = [[model.getCoordinateSet().get(name).getValue(state) for name in free]]
    for instant in instants[1:].tolist():
        state = manager.integrate(instant)
        found.append([model.getCoordinateSet().get(name).getValue(state) for name in free])
    return np.array(found)


if __name__ == "__main__":
    import opensim

    opensim.Logger.setLevelString("Off")
    opensim.Logger.removeFileSink()
    with np.load(sys.argv[1]) as _archive:
        _question = dict(_archive)
    np.savez(sys.argv[2], angles=simulate(_question))
