"""OpenSim as the oracle of the skeleton: it runs in a process of its own and answers in plain arrays.

The figures stored beside the tests were made from the file that the package's table was transcribed from::

    HILBRACE_RAJAGOPAL_OSIM=Rajagopal2015.osim python -m tests.unit.opensim_oracle
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
STORED = ROOT / "tests" / "data" / "rajagopal_source_poses.npz"
ARMS = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle")


def source_model() -> Path | None:
    """The file that the table was transcribed from: a path in the environment, or nimblephysics' copy."""
    named = os.environ.get("HILBRACE_RAJAGOPAL_OSIM")
    if named:
        return Path(named)
    try:
        files = importlib.metadata.files("nimblephysics") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    found = [Path(str(file.locate())) for file in files if file.name == "Rajagopal2015.osim"]
    return next((path for path in found if path.is_file()), None)


def random_poses(table: Any, count: int, seed: int) -> dict[str, list[float]]:
    """Poses over the whole ranges of the free coordinates; the pelvis moves within a metre."""
    rng = np.random.default_rng(seed)
    driven = {coupler["dependent"] for coupler in table["couplers"]}
    poses: dict[str, list[float]] = {}
    for joint in table["joints"]:
        for item in joint["coordinates"]:
            if item["name"] not in driven:
                low, high = np.clip(item["range"], -2.7, 2.7)
                if item["name"].startswith("pelvis_t") and item["name"] != "pelvis_tilt":
                    low, high = -1.0, 1.0
                poses[item["name"]] = rng.uniform(low, high, count).tolist()
    return poses


def ask(**question: Any) -> dict[str, np.ndarray]:
    """Let OpenSim answer; see `answer` for the question.

    Raises:
        AssertionError: The process failed; an `InputError` there comes back as the answer ``{"error": ..}``.
    """
    with tempfile.TemporaryDirectory() as folder:
        asked, told = Path(folder) / "question.json", Path(folder) / "answer.npz"
        asked.write_text(json.dumps(question, default=_plain), "utf-8")
        command = [sys.executable, "-m", "tests.unit.opensim_oracle", str(asked), str(told)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240, check=False)
        assert done.returncode == 0, done.stderr[-3000:]
        with np.load(told) as answers:
            return dict(answers)


def answer(question: dict[str, Any]) -> dict[str, Any]:
    """Evaluate a model in poses; runs in the child process.

    The question's keys: ``osim`` (path, as it is), ``user_osim`` (path, through `read_model`) or ``table``;
    ``unlock``; ``scales`` and ``mass``; ``poses`` (coordinate: values); ``arms`` (coordinates without their
    side); ``splines`` ([x, y] pairs) with ``at``.
    """
    import opensim as osim

    from hilbrace.biomech import opensim_model
    from hilbrace.errors import InputError

    osim.Logger.setLevelString("Off")
    osim.Logger.removeFileSink()
    answers: dict[str, Any] = {}
    for number, (x, y) in enumerate(question.get("splines", [])):
        spline = osim.SimmSpline()
        for knot, value in zip(x, y, strict=True):
            spline.addPoint(knot, value)
        first = osim.StdVectorInt()
        first.append(0)
        at = [osim.Vector(1, v) for v in question["at"]]
        answers[f"spline_{number}"] = [spline.calcValue(v) for v in at]
        answers[f"slope_{number}"] = [spline.calcDerivative(first, v) for v in at]
    try:
        if "osim" in question:
            model = osim.Model(question["osim"])
        elif "user_osim" in question:
            model = opensim_model.read_model(Path(question["user_osim"]))
        elif "table" in question:
            model = opensim_model.build_model(question["table"], unlock=question.get("unlock", ()))
        else:
            return answers
        if "scales" in question:
            opensim_model.scale_model(model, question["scales"], question["mass"])
    except InputError as fault:
        return {"error": fault.what, "where": fault.where, "hint": fault.hint}
    state = model.initSystem()
    answers.update(_figures(model, state))
    answers.update(_poses(model, state, question.get("poses", {}), question.get("arms", ())))
    return answers


def _figures(model: Any, state: Any) -> dict[str, Any]:
    bodies, muscles = _items(model.getBodySet()), _items(model.getMuscles())
    coordinates = _items(model.getCoordinateSet())
    cylinders = [w for b in bodies for w in _items(b.getWrapObjectSet())]
    return {
        "mass": model.getTotalMass(state),
        "bodies": [b.getName() for b in bodies],
        "body_mass": [b.getMass() for b in bodies],
        "body_com": [_array(b.getMassCenter()) for b in bodies],
        "body_inertia": [[b.get_inertia().get(i) for i in range(6)] for b in bodies],
        "coordinates": [c.getName() for c in coordinates],
        "locked": [c.getDefaultLocked() for c in coordinates],
        "ranges": [[c.getRangeMin(), c.getRangeMax()] for c in coordinates],
        "muscles": [m.getName() for m in muscles],
        "fibres": [[m.getOptimalFiberLength(), m.getTendonSlackLength()] for m in muscles],
        "max_force": [m.getMaxIsometricForce() for m in muscles],
        "markers": [m.getName() for m in _items(model.getMarkerSet())],
        "wraps": [w.getName() for w in cylinders],
        "wrap_size": [_cylinder_size(w) for w in cylinders],
    }


def _poses(model: Any, state: Any, poses: dict[str, Any], arms: Any) -> dict[str, Any]:
    bodies, muscles = _items(model.getBodySet()), _items(model.getMuscles())
    coordinates, markers = model.getCoordinateSet(), _items(model.getMarkerSet())
    told: dict[str, list[Any]] = {
        name: [] for name in ("position", "rotation", "com", "marker", "length", "arm")
    }
    frames = len(next(iter(poses.values()))) if poses else 0
    for frame in range(frames):
        for name, values in poses.items():
            coordinate = coordinates.get(name)
            coordinate.setLocked(state, False)
            coordinate.setValue(state, values[frame], False)
        for side in "rl":
            driven = f"knee_angle_{side}_beta"
            if coordinates.getIndex(driven) >= 0 and driven not in poses:
                coordinates.get(driven).setValue(state, poses[f"knee_angle_{side}"][frame], False)
        model.realizePosition(state)
        told["position"].append([_array(b.getPositionInGround(state)) for b in bodies])
        told["rotation"].append([_matrix(b.getTransformInGround(state)) for b in bodies])
        told["com"].append(_array(model.calcMassCenterPosition(state)))
        told["marker"].append([_array(m.getLocationInGround(state)) for m in markers])
        told["length"].append([m.getLength(state) for m in muscles])
        told["arm"].append(
            [
                [m.computeMomentArm(state, coordinates.get(f"{c}_{m.getName()[-1]}")) for c in arms]
                for m in muscles
            ]
        )
    return told


def _items(collection: Any) -> list[Any]:
    return [collection.get(i) for i in range(collection.getSize())]


def _array(vector: Any) -> list[float]:
    return [vector.get(i) for i in range(3)]


def _matrix(transform: Any) -> list[list[float]]:
    rotation = transform.R()
    return [[rotation.get(i, j) for j in range(3)] for i in range(3)]


def _cylinder_size(wrap: Any) -> list[float]:
    import opensim as osim

    cylinder = osim.WrapCylinder.safeDownCast(wrap)
    return [np.nan, np.nan] if cylinder is None else [cylinder.get_radius(), cylinder.get_length()]


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else str(value)


def store() -> None:
    """Store what OpenSim says of the source file in ten poses."""
    from hilbrace.skeleton.table import load_source_table

    source = source_model()
    assert source is not None, "name the source by HILBRACE_RAJAGOPAL_OSIM"
    poses = random_poses(load_source_table(), 10, seed=2016)
    told = answer({"osim": str(source), "poses": poses, "arms": ARMS})
    kept = ("mass", "bodies", "position", "rotation", "com", "markers", "marker", "muscles", "length", "arm")
    rounded = {name: np.asarray(told[name]) for name in kept}
    for name, values in rounded.items():
        if values.dtype == float:
            rounded[name] = np.round(values, 9)
    STORED.parent.mkdir(exist_ok=True)
    np.savez_compressed(STORED, coordinates=list(poses), poses=np.array(list(poses.values())), **rounded)


if __name__ == "__main__":
    if len(sys.argv) == 3:
        np.savez(sys.argv[2], **answer(json.loads(Path(sys.argv[1]).read_text("utf-8"))))
    else:
        store()
