"""What cannot be drawn is refused before anything is drawn, by the name of what is wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hilbrace.config import MaterialSettings, PatternSettings
from hilbrace.errors import ConfigError, InputError
from hilbrace.pattern.build import build_pattern
from hilbrace.pattern.inputs import COARSEST_MM, FINEST_STRUT, resolution
from tests.unit.sleeve import sleeve_design, sleeve_domain

DOMAIN = sleeve_domain(around=24, along=10, height_mm=110.0)
LSCM = sleeve_domain(around=24, along=10, height_mm=110.0, flatten="lscm")
SETTINGS = PatternSettings(min_strut_mm=3.0, scale=0.15)
MATERIAL = MaterialSettings()
DESIGN = sleeve_design(DOMAIN, SETTINGS)


@pytest.mark.parametrize("name", ["width_vertex", "d_vertex", "firm_vertex", "volume_fraction_triangle"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_no_numbers(name, value):
    broken = getattr(DESIGN, name).copy()
    broken[[3, 8]] = value
    with pytest.raises(InputError, match=f"'{name}' has 2 of {len(broken)} values that are no numbers, .* 3"):
        build_pattern(DOMAIN, dataclasses.replace(DESIGN, **{name: broken}), SETTINGS, MATERIAL)


def test_a_design_of_another_domain():
    other = sleeve_domain(around=30, along=10, height_mm=110.0)
    with pytest.raises(InputError, match="has 341 values where the domain has 275"):
        build_pattern(DOMAIN, sleeve_design(other, SETTINGS), SETTINGS, MATERIAL)


@pytest.mark.parametrize("domain", [DOMAIN, LSCM])
def test_cells_larger_than_the_brace(domain):
    wide = PatternSettings(scale=0.45, min_strut_mm=3.0)
    with pytest.raises(
        ConfigError, match=r"one period of the cells is \d+ mm long, the brace only \d+"
    ) as fault:
        build_pattern(domain, sleeve_design(domain, SETTINGS), wide, MATERIAL)
    assert fault.value.where == "pattern.scale"


def test_struts_wider_than_the_cells():
    wide = PatternSettings(min_strut_mm=9.0, scale=0.06)
    with pytest.raises(ConfigError, match=r"struts of 9 mm leave no holes in cells of \d+\.\d mm") as fault:
        build_pattern(DOMAIN, DESIGN, wide, MATERIAL)
    assert fault.value.where == "pattern.min_strut_mm"
    room = float(fault.value.hint.split("below ")[1].split(",")[0])
    assert 2.0 < room < 9.0


def test_resolution_follows_the_struts_and_is_never_coarser():
    assert resolution(PatternSettings(min_strut_mm=1.5)) == pytest.approx(FINEST_STRUT * 1.5)
    assert resolution(PatternSettings(min_strut_mm=4.0)) == COARSEST_MM
    assert resolution(PatternSettings(min_strut_mm=1.5, resolution_mm=0.4)) == 0.4
    with pytest.raises(ConfigError, match=r"edges of 1 mm cannot show struts of 1.5 mm") as fault:
        resolution(PatternSettings(min_strut_mm=1.5, resolution_mm=1.0))
    assert fault.value.where == "pattern.resolution_mm"
