"""The ``skel`` body: the user's own SKEL file, converted once by `hilbrace.body.convert_skel`.

SKEL (Keller et al., "From skin to skeleton", ACM TOG 42(6), 2023) comes under the licence of its authors;
none of it is contained here. A converted file holds the skin and the joints of SKEL's zero pose, linear in
its shape coefficients, so that a run needs neither the pickle nor the library that read it. The skeleton
moves that skin, and its knees have three rotations where SKEL's have one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import ConfigError, InputError
from hilbrace.run import records

Array = np.ndarray

CONVERT = "python -m hilbrace.body.convert_skel skel_male.pkl skel_male.npz"
"""What converts a SKEL file."""


@dataclass(frozen=True)
class SkelBody:
    """A SKEL model in its zero pose, OpenSim axes and metres.

    Attributes:
        gender: ``"male"`` or ``"female"``.
        version: Version of the SKEL file.
        template: Mean skin.
        directions: Change of the skin per unit of each coefficient [m].
        triangles: Closed skin, outward.
        coefficient_names: ``beta01``...
        joint_names: Joint centres by name and side.
        joint_template: Those of the mean person.
        joint_directions: Their change per unit of each coefficient [m].
        weights: Skinning weights in the order of `hilbrace.body.segments.BONES`.
        linear_error_mm: Largest distance to SKEL's own skin over random persons [mm].
        source: Name and digest of the file it was converted from.
    """

    gender: str
    version: str
    template: Float[Array, "vertex 3"]
    directions: Float[Array, "coefficient vertex 3"]
    triangles: Int[Array, "triangle 3"]
    coefficient_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    joint_template: Float[Array, "joint 3"]
    joint_directions: Float[Array, "coefficient joint 3"]
    weights: Float[Array, "vertex bone"]
    linear_error_mm: float
    source: str

    @property
    def name(self) -> str:
        """Name of the model, as the body's record keeps it."""
        return "skel"

    @property
    def spread(self) -> Float[Array, " coefficient"]:
        """SKEL's coefficients are in units of their standard deviation."""
        return np.ones(len(self.coefficient_names))

    def vertices(self, shape: Float[Array, " coefficient"]) -> Float[Array, "vertex 3"]:
        """Skin of one person in SKEL's zero pose [m]."""
        return self.template + np.tensordot(shape, self.directions[: len(shape)], 1)

    def joints(self, shape: Float[Array, " coefficient"]) -> dict[str, Float[Array, " 3"]]:
        """Joint centres of one person by name and side [m]."""
        places = self.joint_template + np.tensordot(shape, self.joint_directions[: len(shape)], 1)
        return dict(zip(self.joint_names, places, strict=True))

    def joint_moves(self) -> dict[str, Float[Array, "coefficient 3"]]:
        """Change of the joint centres per unit of each coefficient [m]."""
        return {name: self.joint_directions[:, k] for k, name in enumerate(self.joint_names)}

    def bone_weights(self) -> Float[Array, "vertex bone"]:
        """Skinning weights on the skeleton's bodies."""
        return self.weights


def load_skel(path: Path | None, gender: str | None = None) -> SkelBody:
    """Read a converted SKEL file.

    Args:
        path: The ``.npz`` file.
        gender: Gender that it must have; any if left out.

    Raises:
        ConfigError: No file is named, or it has the other gender.
        InputError: The file is missing, damaged, or still the pickle.
    """
    if path is None:
        raise ConfigError(
            "no SKEL file is named", where="body.model_file", hint=f"convert your own file once: {CONVERT}"
        )
    if path.suffix.lower() in {".pkl", ".pickle"}:
        raise InputError(
            "a pickle can run any code, so that no run opens one",
            where=str(path),
            hint=f"convert it once: {CONVERT}",
        )
    if not path.is_file():
        raise InputError("no such file", where=str(path), hint=f"convert your own SKEL file once: {CONVERT}")
    body = records.load(SkelBody, path)
    if gender is not None and gender != body.gender:
        raise ConfigError(
            f"the SKEL file is {body.gender} and body.gender asks for {gender}",
            where=str(path),
            hint="name the file of the other gender, or leave body.gender out",
        )
    return body
