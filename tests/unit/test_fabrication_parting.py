"""Partings: the sheet through the outline, wedges, the choice between them, reliefs, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold, OpType

from fabrication.ends import find_ends
from fabrication.faces import face_normals
from fabrication.mold import Casting
from fabrication.parting import find_parting, graph_parting, limb_axes
from fabrication.removal import collisions
from fabrication.seams import bilinear, fit_graph, pull_axes, silhouette, surface_of
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError
from tests.unit.mold_shells import coupon_case, plain_core, tube_case, tube_of

Y = np.linspace(-40.0, 40.0, 33)
TURN = np.arange(72) / 72 * 2 * np.pi


def leaning(amplitude: float) -> Casting:
    """A round tube whose centre swings sideways: seen sideways, its outline is where its centre is."""
    return tube_of(amplitude * np.sin(Y / 25.0), np.full((72, len(Y)), 30.0), Y)


def toothed(teeth: int, depth: float) -> Casting:
    """A tube with grooves along it."""
    radius = 30.0 + depth * np.cos(teeth * TURN)
    return tube_of(0 * Y, np.repeat(radius[:, None], len(Y), axis=1), Y)


def test_the_sheet_follows_the_outline():
    casting = leaning(6.0)
    core = plain_core(casting)
    surface = surface_of(core.land, find_ends(casting))
    graph = fit_graph(surface, pull_axes(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])), 20.0, 3.0)
    for x in (-30.0, 30.0):
        points = np.stack([np.full(len(Y), x), Y, 6.0 * np.sin(Y / 25.0)], axis=1)[3:-3]
        assert np.abs(graph.above(points)).max() < 1.0


def test_interpolation_on_the_grid_is_exact_for_planes():
    rows, columns = np.meshgrid(np.arange(5.0), np.arange(7.0), indexing="ij")
    places = np.random.default_rng(0).uniform([1, 2], [9, 14], (50, 2))
    weights = bilinear(places, np.array([1.0, 2.0]), 2.0, (5, 7))
    values = 3 * (1 + 2 * rows) - 2 * (2 + 2 * columns)
    np.testing.assert_allclose(weights @ values.reshape(-1), 3 * places[:, 0] - 2 * places[:, 1])


def test_silhouette_of_a_cube_is_the_border_of_its_top():
    cube = Manifold.cube((1, 1, 1)).to_mesh64()
    vertices, triangles = np.asarray(cube.vert_properties)[:, :3], np.asarray(cube.tri_verts).astype(int)
    edges = silhouette(face_normals(vertices, triangles)[0], triangles, np.array([0.0, 0.0, 1.0]))
    assert len(edges) == 4
    assert (vertices[edges][..., 2] == 1.0).all()


@pytest.mark.parametrize("count", [None, 3, 4])
def test_sectors_fill_space_once(count):
    case = tube_case(count) if count != 4 else None
    parting = (
        case.parting if case else find_parting(tube_case().casting, tube_case().core, MoldSettings(shells=4))
    )
    box = Manifold.cube((110, 100, 110), True)
    rooms = [box ^ sector for sector in parting.sectors]
    assert sum(room.volume() for room in rooms) == pytest.approx(box.volume(), rel=1e-9)
    assert Manifold.batch_boolean(rooms, OpType.Add).volume() == pytest.approx(box.volume(), rel=1e-9)


def test_a_bent_limb_parts_beside_the_plane_it_bends_in():
    parting = tube_case().parting
    np.testing.assert_allclose(np.abs(parting.pulls[:, 2]), 1.0, atol=1e-6)
    np.testing.assert_allclose(parting.pulls.sum(axis=0), 0.0, atol=1e-12)
    assert sum(parting.undercut_mm2.values()) == 0.0
    assert set(parting.shell_of) == {0, 1}
    assert parting.undercut_deg.max() < 1.0


def test_pulls_of_wedges_are_even():
    pulls = tube_case(3).parting.pulls
    np.testing.assert_allclose(pulls @ pulls.T, 1.5 * np.eye(3) - 0.5, atol=1e-9)


@pytest.mark.parametrize(
    ("side", "names"), [("left", ("medial", "lateral")), ("right", ("lateral", "medial"))]
)
def test_shells_of_a_leg_are_named_by_its_sides(side, names):
    casting = replace(leaning(0.0), joint="knee", side=side)
    parting = find_parting(casting, plain_core(casting), MoldSettings())
    assert parting.names == tuple(f"shell_{name}" for name in names)
    assert parting.pulls[0, 2] == pytest.approx(1.0)


def test_a_mirrored_limb_has_the_mirrored_outline():
    right, left = leaning(6.0), leaning(-6.0)
    heights = []
    for casting in (right, left):
        parting = graph_parting(
            casting, plain_core(casting), limb_axes(casting)[0], limb_axes(casting)[2], 20.0
        )
        sheet = parting.seams[0].points
        heights.append(sheet[..., 2] if sheet[0, 0, 0] < 0 else sheet[::-1, :, 2])
    inner = heights[0][8:-8, 8:-8] + heights[1][8:-8, 8:-8]
    assert np.abs(inner).max() < 0.5


@settings(max_examples=4, deadline=None)
@given(
    st.floats(-10, 10), st.floats(0.7, 1.0), st.floats(0, np.pi), st.floats(-0.08, 0.08), st.integers(0, 1000)
)
def test_any_smooth_limb_lets_its_shells_go(swing, flat, turned, taper, seed):
    noise = np.random.default_rng(seed).normal(0.0, 0.15, (72, len(Y)))
    oval = 30.0 / np.sqrt(np.cos(TURN - turned) ** 2 + (np.sin(TURN - turned) / flat) ** 2)
    casting = tube_of(swing * np.cos(Y / 30.0), oval[:, None] + taper * Y + noise, Y)
    core = plain_core(casting)
    axes = limb_axes(casting)
    parting = graph_parting(casting, core, axes[0], axes[2], 20.0)
    around = Manifold.cube((110.0, 80.0, 110.0), True) - core.land
    for sector, clearing, pull in zip(parting.sectors, parting.reliefs, parting.pulls, strict=True):
        assert collisions((around ^ sector) - clearing, [core.land], pull).max() < 1e-3


def test_what_hinders_by_a_hair_is_relieved_and_measured():
    rng = np.random.default_rng(3)
    casting = tube_of(0 * Y, 30.0 + rng.normal(0.0, 0.1, (72, len(Y))), Y)
    parting = find_parting(casting, plain_core(casting), MoldSettings(shells=2))
    assert 0.0 < parting.relief_mm3 < 5e-4 * casting.brace.volume()
    assert sum(parting.undercut_mm2.values()) < 2e-2 * parting.sides_mm2


def test_a_gear_is_refused_with_the_area_that_hinders():
    casting = toothed(9, 6.0)
    with pytest.raises(GeometryError, match="do not come off") as caught:
        find_parting(casting, plain_core(casting), MoldSettings())
    for words in ("2 shells", "3 shells", "4 shells", "undercut"):
        assert words in caught.value.where
    assert "mold.shells" in caught.value.hint


def test_a_limb_that_two_shells_cannot_leave_gets_three():
    casting = toothed(3, 12.0)
    core = plain_core(casting)
    with pytest.raises(GeometryError):
        find_parting(casting, core, MoldSettings(shells=2))
    assert len(find_parting(casting, core, MoldSettings()).names) == 3


def test_a_limb_that_ends_with_the_brace_is_refused():
    casting = leaning(0.0)
    casting = replace(casting, beyond=np.zeros_like(casting.beyond))
    with pytest.raises(GeometryError, match="ends with the brace"):
        find_ends(casting)


def test_a_lid_lifts_off_a_flat_casting_and_a_bent_ground_is_refused():
    case = coupon_case()
    np.testing.assert_allclose(case.parting.pulls, [[0.0, 0.0, 1.0]], atol=1e-12)
    x, y, _ = case.casting.vertices.T
    bent = np.stack([12.0 * np.sin(x / 12.0), y, 12.0 * np.cos(x / 12.0)], axis=1)
    with pytest.raises(GeometryError, match="lid"):
        find_parting(replace(case.casting, vertices=bent), case.core, MoldSettings())
