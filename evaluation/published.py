"""The values that the paper printed, to lay beside one's own."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True)
class PublishedRow:
    """One row of the paper's table.

    Attributes:
        key: Name by which a study refers to it.
        title: Name in the paper, made unique.
        squared: Squared degrees: bending and landing, sagittal and frontal [deg^2].
    """

    key: str
    title: str
    squared: Float[Array, "2 2"]


@cache
def published_rows() -> dict[str, PublishedRow]:
    """The paper's table by row."""
    text = resources.files("evaluation").joinpath("published_table.toml").read_text("utf-8")
    rows = tomllib.loads(text)["rows"]
    return {
        row["key"]: PublishedRow(
            row["key"],
            row["title"],
            np.array(
                [
                    [row[f"{event}_{plane}"] for plane in ("sagittal", "frontal")]
                    for event in ("bending", "landing")
                ]
            ),
        )
        for row in rows
    }
