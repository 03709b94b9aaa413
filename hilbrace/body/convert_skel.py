"""Convert the user's own SKEL file, a pickle, into the plain arrays that runs read.

Once for each file::

    python -m hilbrace.body.convert_skel skel_male.pkl skel_male.npz

The pickle is opened once, here, by a reader that builds arrays, sparse matrices and plain containers and
nothing else: whatever other class or function the file names is replaced by an inert stand-in. The library
body-models (extra ``skel``) then evaluates the model's zero pose from a copy that holds these arrays alone.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import pickle
import tempfile
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float
from scipy import sparse

from hilbrace.body.segments import BONES, SIDES
from hilbrace.body.skel import SkelBody
from hilbrace.errors import ConfigError, HilbraceError, InputError
from hilbrace.run import records
from hilbrace.units import MM_PER_M

Array = np.ndarray

VERSION = "1.1.1"
"""Version of the SKEL files that is understood."""
COEFFICIENTS = 10
TRIALS = 8
"""Random persons on whom the linear model is compared with SKEL's own skin."""

ARRAYS = (
    "skin_template_v",
    "skin_template_f",
    "shapedirs",
    "posedirs",
    "osim_kintree_table",
    "skel_template_v",
    "skel_template_f",
    "apose_rel_transfo",
    "per_joint_rot",
)
MATRICES = ("skin_weights", "J_regressor_osim", "J_regressor", "skel_weights", "skel_weights_rigid")

_SIDED = ("scapula", "humerus", "ulna", "radius", "hand")
_LEG = ("femur", "tibia", "talus", "calcn", "toes")
SKEL_BONES = (
    "pelvis",
    *(f"{bone}_{side}" for side in SIDES for bone in _LEG),
    *("lumbar_body", "thorax", "head"),
    *(f"{bone}_{side}" for side in SIDES for bone in _SIDED),
)
"""SKEL's bones in the order of its kinematic tree."""

_JOINT_BONES = {
    "hip": "femur",
    "knee": "tibia",
    "ankle": "talus",
    "shoulder": "humerus",
    "elbow": "ulna",
    "wrist": "hand",
}
_TRUNK = {"lumbar_body": 0.5, "thorax": 1.0, "head": 1.0, "scapula_r": 1.0, "scapula_l": 1.0}
"""Share of the trunk in the bones of the spine; the pelvis has the rest."""

_PLAIN = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    ("collections", "OrderedDict"): OrderedDict,
    ("builtins", "set"): set,
    ("builtins", "frozenset"): frozenset,
    ("builtins", "complex"): complex,
}
_NUMPY_MAKERS = {"_reconstruct", "scalar", "_frombuffer"}
_PROGRAMS = {"builtins", "os", "posix", "nt", "subprocess", "sys", "shutil", "socket", "importlib", "runpy"}


class _Inert:
    """Stands for an object of a class that is not loaded; keeps its state and does nothing."""

    def __init__(self, *_: object) -> None:
        self.state: object = None

    def __setstate__(self, state: object) -> None:
        self.state = state

    def __setitem__(self, key: object, value: object) -> None: ...

    def append(self, value: object) -> None: ...

    def extend(self, values: object) -> None: ...


class _ArrayReader(pickle.Unpickler):
    """Unpickler that knows arrays, sparse matrices and plain containers."""

    def find_class(self, module: str, name: str, /) -> Any:
        module = {"__builtin__": "builtins"}.get(module, module)
        if (module, name) in _PLAIN:
            return _PLAIN[module, name]
        if (module, name) == ("_codecs", "encode"):
            return _encoded
        if module.split(".")[0] == "numpy" and name in _NUMPY_MAKERS:
            source = "numeric" if name == "_frombuffer" else "multiarray"
            return getattr(importlib.import_module(f"numpy._core.{source}"), name)
        if module.split(".")[0] in _PROGRAMS:
            raise pickle.UnpicklingError(f"it asks to run {module}.{name}")
        return type(name, (_Inert,), {"origin": f"{module}.{name}"})


def _encoded(text: str, encoding: str = "latin1") -> bytes:
    return text.encode("latin1" if encoding == "latin1" else "utf-8")


def convert(source: Path, output: Path, gender: str | None = None) -> SkelBody:
    """Read a SKEL pickle and write it as a `SkelBody`.

    Args:
        source: The user's file, ``skel_male.pkl`` or ``skel_female.pkl``.
        output: ``.npz`` file to write.
        gender: ``"male"`` or ``"female"``, where neither the file nor its name tells it.

    Raises:
        InputError: The file is no SKEL file of the version that is understood.
        ConfigError: The gender is unknown or another than the file's, or body-models is not installed.
    """
    content = read_skel_pickle(source)
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    told = _gender_of(content, source, gender)
    body = linear_skel(content, told, f"{source.name} sha256:{digest[:16]}")
    records.save(body, output)
    return body


def read_skel_pickle(path: Path) -> dict[str, Any]:
    """The arrays of a SKEL file, without running anything that it holds.

    Returns:
        `ARRAYS` as double or integer arrays, `MATRICES` as sparse ones, ``version``, and ``gender`` or "".

    Raises:
        InputError: The file is missing, damaged, of another kind or of another version.
    """
    try:
        with path.open("rb") as stream:
            content = _unpickled(stream)
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), hint="name your own SKEL file") from None
    except (
        pickle.UnpicklingError,
        EOFError,
        AttributeError,
        ValueError,
        TypeError,
        IndexError,
        KeyError,
    ) as fault:
        raise InputError(
            f"no readable SKEL file: {fault}",
            where=str(path),
            hint="download the file again from SKEL's authors",
        ) from fault
    if not isinstance(content, dict):
        raise InputError("holds no dictionary", where=str(path), hint="name a SKEL file (skel_male.pkl)")
    missing = [key for key in (*ARRAYS, *MATRICES) if key not in content]
    if missing:
        other = "an SMPL file" if "v_template" in content else "no SKEL file, or an older one"
        raise InputError(
            f"lacks {', '.join(missing[:4])}{' ...' if len(missing) > 4 else ''}: it is {other}",
            where=str(path),
            hint=f"name skel_male.pkl or skel_female.pkl of SKEL {VERSION}",
        )
    version = str(content.get("version", "unknown"))
    if version != VERSION:
        raise InputError(
            f"SKEL file of version {version}, and {VERSION} is understood",
            where=str(path),
            hint=f"download skel_models_v{VERSION} from SKEL's authors",
        )
    read: dict[str, Any] = {key: _array(content[key], key, path) for key in ARRAYS}
    read |= {key: _matrix(content[key], key, path) for key in MATRICES}
    _check_shapes(read, path)
    gender = content.get("gender", "")
    return read | {"version": version, "gender": gender if isinstance(gender, str) else ""}


def linear_skel(content: dict[str, Any], gender: str, source: str) -> SkelBody:
    """The model's zero pose as a linear function of its shape coefficients, evaluated by body-models.

    Raises:
        ConfigError: body-models is not installed.
        InputError: The joints do not make a standing person.
    """
    model = _library_model(content, gender)
    shapes = np.concatenate([np.zeros((1, COEFFICIENTS)), np.eye(COEFFICIENTS)])
    vertices, joints = _zero_pose(model, shapes)
    rotation = _opensim_axes(joints[0])
    vertices, joints = vertices @ rotation.T, joints @ rotation.T
    names = [f"{joint}_{side}" for side in SIDES for joint in _JOINT_BONES]
    rows = [SKEL_BONES.index(f"{bone}_{side}") for side in SIDES for bone in _JOINT_BONES.values()]
    shares = np.array([_shares(bone) for bone in SKEL_BONES])
    weights = content["skin_weights"].toarray() @ shares
    random = np.random.default_rng(0).normal(size=(TRIALS, COEFFICIENTS))
    directions = vertices[1:] - vertices[0]
    miss = _zero_pose(model, random)[0] @ rotation.T - vertices[0] - np.tensordot(random, directions, 1)
    return SkelBody(
        gender=gender,
        version=content["version"],
        template=vertices[0],
        directions=directions,
        triangles=content["skin_template_f"].astype(np.int64),
        coefficient_names=tuple(f"beta{k + 1:02d}" for k in range(COEFFICIENTS)),
        joint_names=tuple(names),
        joint_template=joints[0, rows],
        joint_directions=joints[1:, rows] - joints[0, rows],
        weights=weights / weights.sum(axis=1, keepdims=True),
        linear_error_mm=round(float(np.linalg.norm(miss, axis=-1).max()) * MM_PER_M, 3),
        source=source,
    )


def _unpickled(stream: BinaryIO) -> Any:
    return _ArrayReader(stream, encoding="latin1").load()


def _array(value: Any, key: str, path: Path) -> Array:
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf" or not np.isfinite(value).all():
        raise InputError(
            f"'{key}' is no array of numbers",
            where=str(path),
            hint="download the file again from SKEL's authors",
        )
    return value


def _matrix(value: Any, key: str, path: Path) -> sparse.csc_matrix:
    """A sparse matrix from the state of one that scipy pickled, in whichever version."""
    state = value.state if isinstance(value, _Inert) else None
    if isinstance(state, dict) and {"data", "indices", "indptr"} <= state.keys():
        kind = sparse.csr_matrix if "csr" in type(value).__name__ else sparse.csc_matrix
        parts = tuple(_array(state[name], key, path) for name in ("data", "indices", "indptr"))
        shape = state.get("_shape", state.get("shape"))
        return sparse.csc_matrix(kind(parts, shape=shape))
    return sparse.csc_matrix(_array(value, key, path))


def _check_shapes(read: dict[str, Any], path: Path) -> None:
    count, bones = len(read["skin_template_v"]), len(SKEL_BONES)
    wanted = {
        "skin_template_v": (count, 3),
        "skin_weights": (count, bones),
        "J_regressor_osim": (bones, count),
        "osim_kintree_table": (2, bones),
        "apose_rel_transfo": (bones, 4, 4),
        "per_joint_rot": (bones, 3, 3),
    }
    for key, shape in wanted.items():
        if read[key].shape != shape:
            raise InputError(
                f"'{key}' has shape {read[key].shape}, not {shape}", where=str(path), hint="name a SKEL file"
            )
    directions = read["shapedirs"].shape
    if directions[:2] != (count, 3) or directions[2] < COEFFICIENTS:
        raise InputError(
            f"'shapedirs' has shape {directions}, not ({count}, 3, {COEFFICIENTS} or more)",
            where=str(path),
            hint="name a SKEL file",
        )


def _gender_of(content: dict[str, Any], source: Path, asked: str | None) -> str:
    """Gender that the file tells, or its name, or the caller."""
    named = next((g for g in ("female", "male") if g in source.stem.lower()), "")
    told = content["gender"] or named
    if asked is not None and told and asked != told:
        raise ConfigError(
            f"the file is {told} and {asked} is asked for",
            where=str(source),
            hint="name the file of that gender",
        )
    gender = told or asked
    if gender not in ("male", "female"):
        raise ConfigError(
            "neither the file nor its name tells the gender",
            where=str(source),
            hint="add --gender male or female",
        )
    return gender


def _library_model(content: dict[str, Any], gender: str) -> Any:
    """The model in body-models' hands, from a pickle that we wrote ourselves of arrays alone."""
    try:
        library = importlib.import_module("body_models.skel.numpy")
    except ImportError as fault:
        raise ConfigError(
            f"SKEL needs the library body-models ({fault})",
            where="convert_skel",
            hint="pip install 'hilbrace[skel]'",
        ) from fault
    plain = {key: content[key] for key in (*ARRAYS, *MATRICES)} | {"bone_names": list(SKEL_BONES)}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / f"skel_{gender}.pkl"
        copy.write_bytes(pickle.dumps(plain))
        return library.SKEL(model_path=copy, gender=gender)


def _zero_pose(
    model: Any, shapes: Float[Array, "person coefficient"]
) -> tuple[Float[Array, "person vertex 3"], Float[Array, "person joint 3"]]:
    """Skin and joints of persons with all joint angles zero [m]."""
    count = len(shapes)
    pose = {
        "body_pose": np.zeros((count, model.NUM_BODY_POSE_COEFFS), np.float32),
        "head_pose": np.zeros((count, model.NUM_HEAD_POSE_COEFFS), np.float32),
        "shape": shapes.astype(np.float32),
    }
    vertices, frames = model.forward_vertices(**pose), model.forward_skeleton(**pose)
    return np.asarray(vertices, np.float64), np.asarray(frames, np.float64)[..., :3, 3]


def _opensim_axes(joints: Float[Array, "joint 3"]) -> Float[Array, "3 3"]:
    """Rows: forward, up and right in the file's axes, each the nearest of its six axis directions."""
    at = {name: joints[k] for k, name in enumerate(SKEL_BONES)}
    up = at["femur_r"] + at["femur_l"] - at["talus_r"] - at["talus_l"]
    right = at["femur_r"] - at["femur_l"]
    forward = at["toes_r"] + at["toes_l"] - at["talus_r"] - at["talus_l"]
    rotation = np.zeros((3, 3))
    for row, direction in enumerate((forward - forward @ up / (up @ up) * up, up, right)):
        largest = int(np.abs(direction).argmax())
        rotation[row, largest] = np.sign(direction[largest])
    if not np.isclose(np.linalg.det(rotation), 1.0):
        raise InputError(
            "hips, ankles and toes make no standing person",
            where="SKEL file",
            hint="name an unchanged SKEL file",
        )
    return rotation


def _shares(bone: str) -> Float[Array, " bone"]:
    """Shares of one of SKEL's bones in the skeleton's bodies that carry skin."""
    share = np.zeros(len(BONES))
    if bone in _TRUNK:
        share[BONES.index("torso")], share[BONES.index("pelvis")] = _TRUNK[bone], 1.0 - _TRUNK[bone]
    else:
        share[BONES.index(bone.replace("talus", "calcn"))] = 1.0
    return share


def main(arguments: Sequence[str] | None = None) -> None:
    """Convert the file named on the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m hilbrace.body.convert_skel", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("source", type=Path, help="your own skel_male.pkl or skel_female.pkl")
    parser.add_argument("output", type=Path, help="npz file to write, for body.model_file")
    parser.add_argument("--gender", choices=("male", "female"), help="where the file's name does not tell it")
    asked = parser.parse_args(arguments)
    try:
        body = convert(asked.source, asked.output, asked.gender)
    except HilbraceError as fault:
        parser.exit(fault.exit_code, fault.two_lines() + "\n")
    parser.exit(
        message=f"{asked.output}: SKEL {body.version}, {body.gender}, {len(body.template)} vertices, "
        f"linear within {body.linear_error_mm} mm\n"
    )


if __name__ == "__main__":
    main()
