"""Places where air stays in a cavity, and the port."""

import numpy as np
import pytest
from manifold3d import Manifold, OpType

from fabrication.bodies import mesh_of
from fabrication.filling import cylinder, find_maxima

UP = np.array([0.0, 0.0, 1.0])


def tower(x: float, height: float) -> Manifold:
    """A square tower with a pointed roof at x."""
    return Manifold.hull_points(
        [(x - 2, -2, 0), (x + 2, -2, 0), (x - 2, 2, 0), (x + 2, 2, 0), (x, 0, height)]
    )


def crown(*heights: float) -> Manifold:
    """Pointed towers in a row on a common plinth whose top is at z = 1."""
    plinth = Manifold.cube((10 * len(heights) + 6, 6, 2)).translate((-3, -3, -1))
    towers = [tower(10 * k + 2, height) for k, height in enumerate(heights)]
    return Manifold.batch_boolean([plinth, *towers], OpType.Add)


def test_every_spike_is_a_maximum_with_its_height_over_the_saddle():
    found = find_maxima(*mesh_of(crown(9.0, 7.0, 12.0)), UP)
    assert [round(float(each.point[2]), 6) for each in found] == [12.0, 9.0, 7.0]
    assert np.isinf(found[0].persistence)
    assert found[1].persistence == pytest.approx(8.0)
    assert found[2].persistence == pytest.approx(6.0)


def test_shallow_spikes_are_left_out():
    found = find_maxima(*mesh_of(crown(9.0, 1.3, 12.0)), UP, persistence_mm=0.4)
    assert len(found) == 2


def test_what_climbs_to_an_opening_is_free():
    vertices, triangles = mesh_of(crown(9.0, 7.0, 12.0))
    opened = vertices[:, 2] > 11.9
    found = find_maxima(vertices, triangles, UP, opened)
    assert [round(float(each.point[2]), 6) for each in found] == [9.0, 7.0]
    higher_but_closed = vertices[:, 2] > 11.9
    opened = np.isclose(vertices[:, 2], 7.0)
    found = find_maxima(vertices, triangles, UP, opened)
    assert [each.vertex for each in found] == [int(np.flatnonzero(higher_but_closed)[0]), found[1].vertex]


def test_floors_hold_no_air():
    """The rim of a pit's floor is no ceiling: turned over, the crown has no maximum but its plinth."""
    found = find_maxima(*mesh_of(crown(9.0, 7.0, 12.0)), -UP)
    assert [round(float(each.point[2]), 6) for each in found] == [-1.0]


def test_a_drill_goes_its_way():
    way = np.array([0.6, 0.0, 0.8])
    drill = cylinder(np.array([1.0, 2.0, 3.0]), way, 10.0, 0.8)
    vertices, _ = mesh_of(drill)
    along = (vertices - [1.0, 2.0, 3.0]) @ way
    assert along.min() == pytest.approx(0.0, abs=1e-9)
    assert along.max() == pytest.approx(10.0)
    across = np.linalg.norm(vertices - [1.0, 2.0, 3.0] - along[:, None] * way, axis=1)
    assert across.max() == pytest.approx(0.8)
