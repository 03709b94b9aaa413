"""Random designs on knees and ankles: every solid is closed, whole, wide enough and as heavy as promised."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hilbrace.body.build import body_of
from hilbrace.config import BodySettings, DomainSettings, SolidSettings
from hilbrace.domain.build import build_domain
from hilbrace.domain.domain import Domain
from hilbrace.material.tables import FOLDER
from hilbrace.pattern.build import build_pattern, build_solid
from hilbrace.skeleton.table import load_table
from tests.unit.domain_body import bending
from tests.unit.random_patterns import random_task
from tests.unit.sleeve import sleeve_domain

CELLS = tuple(sorted(path.stem for path in FOLDER.glob("*.json")))
REACH = {"knee": (0.2, 0.2), "ankle": (0.3, 0.42)}
SOAK = 200


@cache
def limb_domain(joint: str, flatten: str) -> Domain:
    """A brace of the built-in body with about 2200 triangles."""
    body = body_of({name: np.ones(3) for name in load_table()["bodies"]}, 70.0, 1.7, BodySettings())
    above, below = REACH[joint]
    settings = DomainSettings(
        joint=joint,
        flatten=flatten,
        triangles=2200,
        above=above,
        below=below,
        frames_per_second=100.0,
    )
    return build_domain(body, bending(body, np.linspace(0.0, 20.0, 3), "left"), settings)


def check(seed: int, domain: Domain, cells: tuple[str, ...], struts: tuple[float, float]) -> None:
    """One random design, held to everything that is asked of a solid."""
    settings, material, design = random_task(seed, domain, cells, struts)
    pattern = build_pattern(domain, design, settings, material)
    solid = build_solid(pattern, domain, design, material, SolidSettings())
    assert (solid.watertight, solid.parts, solid.manifold_status) == (True, 1, "NoError"), seed
    assert pattern.strut_width_min_mm >= settings.min_strut_mm, seed
    assert pattern.slit_width_min_mm >= settings.min_slit_mm, seed
    assert solid.folded_triangles == 0, seed
    assert solid.volume_mm3 == pytest.approx(solid.expected_volume_mm3, rel=0.02), seed


@pytest.mark.parametrize(("seed", "flatten"), [(1, "periodic"), (2, "lscm")])
def test_random_designs_give_sound_solids(seed, flatten):
    check(
        seed,
        sleeve_domain(around=40, along=12, height_mm=110.0, flatten=flatten),
        ("sinusoidal", "voronoi_open"),
        (2.6, 3.0),
    )


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(SOAK))
def test_two_hundred_random_designs_on_knees_and_ankles(seed):
    joint = ("knee", "ankle")[seed % 2]
    check(seed, limb_domain(joint, ("periodic", "lscm", "slim")[seed // 2 % 3]), CELLS, (1.8, 3.2))
