"""Stored solutions of `hilbrace.motion.synthetic.optimise`: a few hundred numbers per motion."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float

from hilbrace.run import records

Array = np.ndarray


@dataclass(frozen=True)
class StoredCoefficients:
    """Coefficients of the root's channels of one synthetic motion.

    Attributes:
        motion: Name of the motion.
        values: Coefficients, in the order of `hilbrace.motion.synthetic.plan.CHANNELS`.
    """

    motion: str
    values: Float[Array, "coefficient 6"]


def stored_coefficients(name: str) -> Float[Array, "coefficient 6"]:
    """The coefficients that come with the package.

    Raises:
        InputError: The installation lacks the file, or it is damaged.
    """
    return records.load(StoredCoefficients, _path(name)).values


def store_coefficients(name: str, values: Float[Array, "coefficient 6"], path: Path | None = None) -> None:
    """Write coefficients, rounded to 1e-9, to ``path`` or into the package."""
    records.save(StoredCoefficients(name, np.round(values, 9)), _path(name) if path is None else path)


def _path(name: str) -> Path:
    return Path(str(resources.files("hilbrace.motion.synthetic.coefficients"))) / f"{name}.npz"
