"""Segmentation and flat maps of the standard designs: the built-in subject's knees in serve and gait."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hilbrace.body.build import body_of
from hilbrace.config import BodySettings, DomainSettings
from hilbrace.domain.build import build_domain
from hilbrace.domain.distortion import advice, map_distortion
from hilbrace.domain.domain import Domain
from hilbrace.material.blending import blend_map
from hilbrace.material.neo_hookean import worst_energy_density
from hilbrace.material.segmentation import MOST_PATCHES, dual_edges, patches, segment
from hilbrace.motion.synthetic import generate
from hilbrace.pattern.clip import triangle_areas
from hilbrace.skeleton.table import load_table
from tests.unit.domain_body import bending


@cache
def standard_domain(motion: str, side: str, triangles: int) -> Domain:
    """The domain of a built-in motion, from its true coordinates."""
    made = generate(motion, rate_hz=100.0)
    body = body_of(
        {name: np.ones(3) for name in load_table()["bodies"]}, made.mass_kg, made.height_m, BodySettings()
    )
    knee = f"knee_angle_{side[0]}"
    others = {name: values for name, values in made.coordinates.items() if name != knee}
    loads = bending(body, np.rad2deg(made.coordinates[knee]), side, **others)
    return build_domain(body, loads, DomainSettings(side=side, triangles=triangles))


def check_segmentation(domain: Domain) -> None:
    areas = triangle_areas(domain.vertices, domain.triangles)
    pairs = dual_edges(domain.triangles)[1]
    for lame in ("plane_stress", "plane_strain"):
        energy = worst_energy_density(domain.deformation, 0.45, lame)
        for method, low, high in (("graphcut", 0.05, 0.35), ("spectral", 0.4, 0.6)):
            firm = segment(energy, areas, domain.triangles, domain.vertices, method)
            assert np.bincount(patches(firm, pairs)[1], minlength=2).max() <= MOST_PATCHES
            assert low < (areas * ~firm).sum() / areas.sum() < high
            assert np.average(energy[~firm], weights=areas[~firm]) > 3 * np.average(
                energy[firm], weights=areas[firm]
            )
            _, share = blend_map(domain.vertices, domain.triangles, firm, 30.0)
            assert (areas * share).sum() == pytest.approx((areas * firm).sum(), rel=0.05)


@pytest.mark.parametrize(("motion", "side"), [("serve", "left"), ("gait", "right")])
def test_few_patches_on_standard_designs(motion, side):
    check_segmentation(standard_domain(motion, side, 4000))


@pytest.mark.soak
@pytest.mark.parametrize("motion", ["serve", "gait"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_few_patches_on_all_standard_designs_at_full_size(motion, side):
    check_segmentation(standard_domain(motion, side, 10_000))


def test_the_periodic_map_of_a_standard_design_keeps_its_limits():
    domain = standard_domain("serve", "left", 4000)
    found = map_distortion(domain)
    assert found.flipped_triangles == 0
    assert found.quasi_conformal_mean <= 1.02
    assert found.seam_gap <= 1e-9
    assert advice(found, domain.flatten) == ()
