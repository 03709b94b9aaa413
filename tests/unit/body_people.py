"""People for the tests of the body: uniformly scaled skeletons with a height and a mass."""

from __future__ import annotations

from functools import cache

import numpy as np

from hilbrace.body.body import Body
from hilbrace.body.build import body_of
from hilbrace.config import BodySettings
from hilbrace.skeleton.table import load_table

MODEL_HEIGHT = 1.70


def scales_of(height_m: float) -> dict[str, np.ndarray]:
    return {name: np.full(3, height_m / MODEL_HEIGHT) for name in load_table()["bodies"]}


@cache
def person(mass_kg: float = 75.0, height_m: float = 1.75, smoothing_mm: float | None = None) -> Body:
    return body_of(scales_of(height_m), mass_kg, height_m, BodySettings(weight_smoothing_mm=smoothing_mm))


def mirror_of(points: np.ndarray) -> np.ndarray:
    """Index of each point's mirror image about the sagittal plane, in a set that is exactly symmetric."""
    key = {tuple(np.round(p * [1, 1, -1], 6) + 0.0): i for i, p in enumerate(points)}
    return np.array([key[tuple(np.round(p, 6) + 0.0)] for p in points])
