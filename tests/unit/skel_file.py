"""A file in the layout of SKEL 1.1.1 whose content is the embedded body, so that its answers are known."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.convert_skel import SKEL_BONES
from hilbrace.body.segments import BONES

TO_SMPL = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""SMPL's axes: x to the subject's left, y up, z forward."""

PARENTS = (-1, 0, 1, 2, 3, 4, 0, 6, 7, 8, 9, 0, 11, 12, 12, 14, 15, 16, 17, 12, 19, 20, 21, 22)
HEADS = {
    **{"femur": "upperleg01", "tibia": "lowerleg01", "talus": "foot", "calcn": "foot", "toes": "toe2-1"},
    **{"scapula": "clavicle", "humerus": "upperarm01", "ulna": "lowerarm01", "radius": "lowerarm02"},
    **{"hand": "wrist", "pelvis": "root", "lumbar_body": "spine04", "thorax": "spine02", "head": "head"},
}
SHAPES = 10


@cache
def skel_content() -> dict[str, Any]:
    """The dictionary that a SKEL file pickles."""
    model = load_anny_lite()
    template, moves = model.template @ TO_SMPL.T, model.directions[:SHAPES] @ TO_SMPL.T
    count = len(template)
    regressor = joint_regressor()
    joints = regressor @ template
    parents = np.array(PARENTS)
    relative = np.tile(np.eye(4), (24, 1, 1))
    relative[:, :3, 3] = joints - np.where(parents[:, None] < 0, 0.0, joints[parents])
    own = model.bone_weights()
    weights = np.zeros((count, 24))
    for k, name in enumerate(BONES):
        weights[:, SKEL_BONES.index("thorax" if name == "torso" else name)] = own[:, k]
    return {
        "version": "1.1.1",
        "skin_template_v": template,
        "skin_template_f": np.asarray(model.triangles),
        "shapedirs": np.moveaxis(moves, 0, 2),
        "posedirs": np.zeros((count, 3, 207), np.float32),
        "skin_weights": sparse.csc_matrix(weights),
        "J_regressor_osim": sparse.csc_matrix(regressor),
        "J_regressor": sparse.csr_matrix(regressor),
        "osim_kintree_table": np.array([PARENTS, range(24)]),
        "skel_template_v": template[:30],
        "skel_template_f": np.array([[0, 1, 2]]),
        "skel_weights": sparse.csc_matrix(weights[:30]),
        "skel_weights_rigid": sparse.csc_matrix(weights[:30]),
        "apose_rel_transfo": relative,
        "per_joint_rot": np.tile(np.eye(3), (24, 1, 1)),
        "bone_names": list(SKEL_BONES),
    }


def joint_regressor() -> np.ndarray:
    """Weights of the vertices around each joint that give its centre for every shape."""
    model = load_anny_lite()
    rows = np.zeros((24, len(model.template)))
    for k, name in enumerate(SKEL_BONES):
        stem, _, side = name.partition("_")
        stem, side = (name, "") if name == "lumbar_body" else (stem, f".{side.upper()}" if side else "")
        bone = model.bone_names.index(HEADS[stem] + side)
        head = np.concatenate(
            [model.head_template[bone], model.head_directions[:SHAPES, bone].ravel(), [1.0]]
        )
        near = np.argsort(np.linalg.norm(model.template - model.head_template[bone], axis=1))[:150]
        known = np.concatenate(
            [
                model.template[near].T,
                np.moveaxis(model.directions[:SHAPES, near], 1, 2).reshape(-1, len(near)),
                np.ones((1, len(near))),
            ]
        )
        rows[k, near] = np.linalg.lstsq(known, head, rcond=None)[0]
    return rows


def write_skel(path: Path, **changes: Any) -> Path:
    """Pickle a SKEL file; a change to ``None`` leaves the key out."""
    content = {k: v for k, v in (skel_content() | changes).items() if v is not None}
    path.write_bytes(pickle.dumps(content, protocol=2))
    return path
