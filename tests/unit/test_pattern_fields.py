"""Values at the vertices of what is drawn, and what shows them."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh

from hilbrace.config import MaterialSettings, PatternSettings, SolidSettings
from hilbrace.errors import InputError
from hilbrace.pattern.axis import StrutAxis, strut_axis
from hilbrace.pattern.build import build_pattern, build_solid
from hilbrace.pattern.clip import cut_out, zero_line
from hilbrace.pattern.export import ply_bytes
from hilbrace.pattern.fields import local_widths, places_on
from hilbrace.pattern.picture import strut_width_colours, strut_width_histogram
from hilbrace.pattern.refine import refine
from tests.unit.sleeve import sleeve_design, sleeve_domain

DOMAIN = sleeve_domain(around=36, along=10, height_mm=90.0)
SETTINGS = PatternSettings(min_strut_mm=3.0, scale=0.12)
MATERIAL = MaterialSettings()


@pytest.fixture(scope="module")
def drawn():
    design = sleeve_design(DOMAIN, SETTINGS)
    pattern = build_pattern(DOMAIN, design, SETTINGS, MATERIAL)
    return design, pattern, build_solid(pattern, DOMAIN, design, MATERIAL, SolidSettings())


def test_places_give_linear_functions_back():
    rng = np.random.default_rng(0)
    triangle = rng.integers(len(DOMAIN.triangles), size=500)
    weight = rng.dirichlet([1, 1, 1], 500)
    points = np.einsum("pk,pkx->px", weight, DOMAIN.vertices[DOMAIN.triangles[triangle]])
    places = places_on(DOMAIN, points)
    assert places.value(DOMAIN.triangles, DOMAIN.vertices) == pytest.approx(points, abs=1e-9)
    height = DOMAIN.vertices[DOMAIN.weld][:, 1]
    assert places.value(DOMAIN.cut_triangles, height) == pytest.approx(points[:, 1], abs=1e-9)


def test_local_width_is_that_of_the_largest_disc_that_holds_a_point():
    """A wedge about the x axis, 0.2 x wide to both sides: near the axis the width is the local one."""
    x = np.linspace(5, 50, 901)
    axis = StrutAxis(np.stack([x, 0 * x, 0 * x], axis=1), 0.2 * x)
    points = np.array([[20.0, 0.0, 0.0], [40.0, 0.0, 0.0], [30.0, 5.9, 0.0], [4.0, 3.0, 0.0]])
    width = local_widths(axis, points)
    assert width[:2] == pytest.approx([8.0, 16.0], rel=0.03)
    assert width[2] == pytest.approx(12.0, rel=0.03)
    assert width[3] == pytest.approx(2.0, rel=0.1)


def test_hoops_have_the_same_width_everywhere():
    skin = refine(DOMAIN, 1.2)
    y = skin.vertices[:, 1]
    line = zero_line(skin, 1.5 - np.abs(np.mod(y + 5.0, 10.0) - 5.0))
    piece = cut_out(skin, line)
    inner = np.abs(piece.vertices[:, 1]) < 15
    width = local_widths(strut_axis(skin, line), piece.vertices)[inner]
    # the flanks slope a little against the y axis, so widths along the skin are a little larger
    assert np.median(width) == pytest.approx(3.0, rel=0.08)
    assert np.percentile(width, 99) / np.percentile(width, 1) < 1.25


def test_pattern_and_solid_carry_the_design(drawn):
    design, pattern, solid = drawn
    assert pattern.d.min() >= design.d_vertex.min() - 1e-9
    assert pattern.d.max() <= design.d_vertex.max() + 1e-9
    assert np.percentile(pattern.strut_width_mm, 0.1) >= 0.9 * SETTINGS.min_strut_mm
    for values in solid.fields.values():
        assert len(values) == len(solid.vertices)
        assert np.isfinite(values).all()
    assert set(np.unique(solid.label)) == {0.0, 1.0}
    assert solid.local_thickness_mm == pytest.approx(MATERIAL.thickness_mm)
    upper = solid.vertices[:, 1] > 30
    assert solid.label[upper].mean() > 0.95


def test_ply_carries_the_fields(drawn):
    solid = drawn[2]
    content = ply_bytes(solid.vertices, solid.triangles, solid.fields)
    for name in ("d", "label", "strut_width_mm", "thickness_mm"):
        assert f"property float {name}\n".encode() in content
    mesh = trimesh.load(io.BytesIO(content), file_type="ply", process=False)
    assert np.array_equal(mesh.faces, solid.triangles)
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert raw["d"] == pytest.approx(solid.d.astype("f4"))
    assert raw["strut_width_mm"] == pytest.approx(solid.strut_width_mm.astype("f4"))


def test_histogram_and_map_show_the_widths(drawn):
    _, pattern, solid = drawn
    axes = strut_width_histogram(pattern, SETTINGS.min_strut_mm).axes[0]
    shown = sum(patch.get_height() for patch in axes.patches)
    assert shown == pytest.approx(100.0, abs=3.0)
    assert axes.get_xlabel().endswith("[mm]")
    colours = strut_width_colours(solid, SETTINGS.min_strut_mm)
    assert colours.shape == (len(solid.triangles), 3)
    width = solid.strut_width_mm[solid.triangles].mean(axis=1)
    assert colours[width > 2.8 * 3.0].mean() != pytest.approx(colours[width < 1.1 * 3.0].mean(), abs=0.02)


@pytest.mark.malformed
def test_fields_of_another_mesh_are_refused(drawn):
    solid = drawn[2]
    with pytest.raises(InputError, match="'d' has 3 values for"):
        ply_bytes(solid.vertices, solid.triangles, {"d": np.zeros(3)})
