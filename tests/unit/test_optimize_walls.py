"""The orthotropic wall of a design, in the shell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.material.strut_width import cell_scale
from hilbrace.optimize.walls import cell_side_mm, orthotropic_section
from hilbrace.shell import brace_stiffness, isotropic
from tests.unit.sleeve import sleeve_design, sleeve_domain

MATERIAL, PATTERN = MaterialSettings(), PatternSettings(scale=0.08)
DOMAIN = sleeve_domain(around=24, along=12)


def stiffness(section, modulus=1.15):
    return brace_stiffness(
        DOMAIN.vertices,
        DOMAIN.triangles,
        modulus,
        thickness_mm=MATERIAL.thickness_mm,
        wall=section,
        centre=np.zeros(3),
        loops=(DOMAIN.upper_loop, DOMAIN.lower_loop),
    )


def test_cells_fill_the_limb():
    side = cell_side_mm(DOMAIN, PATTERN)
    turns = DOMAIN.period_u / cell_scale(PATTERN, DOMAIN)
    around = DOMAIN.vertices[DOMAIN.lower_loop]
    length = np.linalg.norm(np.roll(around, -1, axis=0) - around, axis=1).sum()
    assert turns == pytest.approx(round(turns))
    assert np.median(side) * 2 * turns == pytest.approx(length, rel=0.35)


def test_a_solid_brace_is_the_isotropic_one_to_the_last_digits():
    design = sleeve_design(DOMAIN, PATTERN)
    design = replace(design, rim=np.ones(len(DOMAIN.triangles), dtype=bool))
    section = orthotropic_section(DOMAIN, design, MATERIAL, PATTERN)
    told, plain = stiffness(section), stiffness(isotropic(MATERIAL.poisson))
    scale = np.abs(plain.loop_stiffness).max()
    assert np.abs(told.loop_stiffness - plain.loop_stiffness).max() < 1e-10 * scale


def test_a_firm_brace_is_near_its_scalar_modulus_and_a_soft_one_bends_stiffer():
    ratio = {}
    for firm in (0.0, 1.0):
        design = sleeve_design(DOMAIN, PATTERN, d=0.6, firm=firm)
        whole = stiffness(orthotropic_section(DOMAIN, design, MATERIAL, PATTERN))
        modulus = np.where(design.rim, 1.0, design.youngs_modulus) * 1.15
        plain = stiffness(isotropic(MATERIAL.poisson), modulus)
        ratio[firm] = (
            whole.frontal_nm_per_deg / plain.frontal_nm_per_deg,
            whole.stretch_n_per_mm / plain.stretch_n_per_mm,
            whole.axial_nm_per_deg / plain.axial_nm_per_deg,
        )
    # the open Voronoi cell is nearly isotropic; the waves have a tenth of the shear stiffness of a sheet
    assert ratio[1.0] == pytest.approx((1, 1, 1), abs=0.25)
    assert ratio[0.0][2] < ratio[1.0][2]


def test_the_cells_turn_with_the_map():
    # re-entrant cells laid the other way round: soft where they were stiff
    design = sleeve_design(DOMAIN, PATTERN, d=0.5, firm=1.0)
    material = MATERIAL.model_copy(update={"firm": "honeycomb"})
    section = orthotropic_section(DOMAIN, design, material, PATTERN)
    around = section.directions[:, 1] / np.linalg.norm(section.directions, axis=1)
    assert np.abs(around).mean() < 0.3  # axis 1 runs around the limb, axis 2 along it
    free = ~design.rim
    assert (section.membrane[free, 0, 0] > 2 * section.membrane[free, 1, 1]).all()
    normals = np.cross(
        *(DOMAIN.vertices[DOMAIN.triangles][:, k] - DOMAIN.vertices[DOMAIN.triangles[:, 0]] for k in (1, 2))
    )
    turned = replace(section, directions=np.cross(normals, section.directions))
    assert stiffness(turned).stretch_n_per_mm > 1.5 * stiffness(section).stretch_n_per_mm
