"""Shells: even walls, sound pieces, no gap and no overlap; distances and level sets against closed forms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold, OpType
from scipy.spatial import KDTree

from fabrication.bodies import body_of, mesh_of
from fabrication.faces import face_normals, vertex_normals
from fabrication.level_set import level_surface
from fabrication.offsets import surroundings, thick_body
from fabrication.shells import FLANGE_THICKNESS_MM, flange_thickness, one_part
from fabrication.thickness import thinnest_wall
from hilbrace.config.mold import MoldSettings
from hilbrace.errors import GeometryError
from tests.unit.mold_shells import coupon_case, tube_case


@pytest.mark.parametrize("count", [None, 3])
def test_each_shell_is_one_sound_body(count):
    for shell in tube_case(count).shells:
        parts = shell.solid.decompose()
        assert len(parts) == 1
        assert parts[0].volume() > 0
        assert shell.solid.genus() == 0
        assert shell.kind == "shell"


@pytest.mark.parametrize("count", [None, 3])
def test_shells_touch_and_do_not_overlap(count):
    case = tube_case(count)
    for first, second in itertools.combinations(case.shells, 2):
        assert abs((first.solid ^ second.solid).volume()) < 1e-6
    for shell in case.shells:
        assert abs((shell.solid ^ case.core.land).volume()) < 1e-6


def test_shells_leave_no_gap_between_them():
    case = tube_case()
    wall = thick_body(surroundings(case.core.land, 1.5), 5.0)
    for end in case.parting.ends:
        wall = end.trim(wall)
    together = Manifold.batch_boolean([shell.solid for shell in case.shells], OpType.Add)
    gap = wall - case.core.land - together
    assert gap.volume() < case.parting.relief_mm3 + 1e-3


def test_walls_are_as_thick_as_wanted():
    case = tube_case()
    for shell in case.shells:
        assert (
            thinnest_wall(shell.solid, 12.0, rays=4000)
            > min(case.settings.wall_mm, FLANGE_THICKNESS_MM) - 0.2
        )


def test_flanges_reach_as_far_as_wanted():
    case = tube_case()
    reach = KDTree(mesh_of(case.core.land.refine_to_length(1.5))[0])
    for shell in case.shells:
        away = reach.query(mesh_of(shell.solid)[0])[0]
        assert away.max() == pytest.approx(case.settings.wall_mm + case.settings.flange_mm, abs=0.3)


def test_shells_end_inside_the_core():
    case = tube_case()
    low, high = np.split(np.asarray(case.core.land.bounding_box()), 2)
    for shell in case.shells:
        y = mesh_of(shell.solid)[0][:, 1]
        assert low[1] + 0.4 < y.min() < low[1] + 1.0
        assert high[1] - 1.0 < y.max() < high[1] - 0.4


def test_a_lid_is_a_plate_on_the_casting():
    case = coupon_case()
    (lid,) = case.shells
    size = np.diff(np.reshape(lid.solid.bounding_box(), (2, 3)), axis=0)[0]
    np.testing.assert_allclose(size[2], case.settings.wall_mm)
    assert lid.solid.volume() == pytest.approx(float(np.prod(size)), rel=1e-9)
    assert abs((lid.solid ^ case.core.land).volume()) < 1e-6


def test_crumbs_are_dropped_and_broken_shells_refused():
    block = Manifold.cube((10, 10, 10))
    crumb = Manifold.cube((0.1, 0.1, 0.1)).translate((20, 0, 0))
    assert one_part(block + crumb, "a").volume() == pytest.approx(1000.0)
    with pytest.raises(GeometryError, match="falls into 2 parts"):
        one_part(block + block.translate((20, 0, 0)), "a")
    with pytest.raises(GeometryError, match="empty"):
        one_part(Manifold(), "a")


def test_the_body_around_a_box_has_the_volume_of_steiner():
    size, radius = np.array([30.0, 20.0, 12.0]), 6.0
    around = surroundings(Manifold.cube(tuple(size)), 0.7)
    body = thick_body(around, radius, 1.5)
    a, b, c = size
    steiner = (
        a * b * c
        + 2 * radius * (a * b + b * c + c * a)
        + np.pi * radius**2 * (a + b + c)
        + 4 / 3 * np.pi * radius**3
    )
    assert body.volume() == pytest.approx(steiner, rel=4e-3)
    assert len(body.decompose()) == 1


def test_distances_tell_inside_from_outside():
    around = surroundings(Manifold.cube((20, 20, 20), True), 1.0)
    places = np.array([[0.0, 0, 0], [0, 0, 9], [0, 0, 13], [13, 13, 13], [30, 1, 9.9]])
    distance = around.distance(places)
    assert (np.sign(distance) == [-1, -1, 1, 1, 1]).all()
    np.testing.assert_allclose(np.abs(distance)[[1, 2]], [1.0, 3.0], atol=0.15)


def test_level_set_of_a_ball():
    low = np.full(3, -12.3)
    grid = np.stack(np.meshgrid(*[np.arange(26)] * 3, indexing="ij"), axis=-1) + low
    vertices, triangles = level_surface(np.linalg.norm(grid, axis=-1), 9.0, low, 1.0)
    ball = body_of(vertices, triangles)
    assert ball.volume() == pytest.approx(4 / 3 * np.pi * 9.0**3, rel=1e-2)
    assert ball.genus() == 0
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 9.0, atol=0.05)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.booleans())
def test_level_sets_of_noise_are_closed(seed, coarse):
    rng = np.random.default_rng(seed)
    values = np.full((8, 9, 7), 9.0)
    noise = rng.normal(size=(6, 7, 5))
    values[1:-1, 1:-1, 1:-1] = np.sign(noise) * (noise > -0.5) if coarse else noise
    values[3, 3, 3] = -1.0
    body = body_of(*level_surface(values, 0.0, np.zeros(3), 1.0))
    assert body.volume() > 0


def test_vertex_normals_of_a_box_point_out_of_its_corners():
    vertices, triangles = mesh_of(Manifold.cube((2, 3, 4), True))
    expected = np.sign(vertices) / np.sqrt(3)
    np.testing.assert_allclose(vertex_normals(vertices, triangles), expected, atol=1e-12)
    assert face_normals(vertices, triangles)[1].sum() == pytest.approx(52.0)


@pytest.mark.parametrize(("bolt_mm", "nut_mm"), [(4.0, 3.2), (5.0, 4.7), (6.0, 5.2)])
def test_flanges_are_thick_enough_for_their_nuts(bolt_mm, nut_mm):
    """Heights of nuts after ISO 4032."""
    thickness = flange_thickness(MoldSettings(bolt_mm=bolt_mm))
    assert thickness == FLANGE_THICKNESS_MM or thickness > nut_mm + 1.0
    assert thickness >= max(FLANGE_THICKNESS_MM, nut_mm + 1.0)
