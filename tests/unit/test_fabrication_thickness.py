"""Thickness of walls along rays, against bodies whose walls are known."""

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.thickness import thinnest_wall, wall_thickness


def test_a_plate_is_as_thick_as_it_is():
    walls, _ = wall_thickness(Manifold.cube((30, 20, 3)), reach_mm=10, rays=2000)
    assert walls == pytest.approx(np.full(len(walls), 3.0), abs=1e-9)
    assert len(walls) > 1400


def test_the_thinnest_of_two_walls_counts():
    part = Manifold.cube((30, 20, 3)) + Manifold.cube((1.2, 20, 15)).translate((10, 0, 0))
    assert thinnest_wall(part, reach_mm=10, rays=2000) == pytest.approx(1.2, abs=1e-9)


def test_a_tube_is_as_thick_as_its_radii_differ():
    tube = Manifold.cylinder(40, 20, 20, 256) - Manifold.cylinder(42, 18.5, 18.5, 256).translate((0, 0, -1))
    assert thinnest_wall(tube, reach_mm=10) == pytest.approx(1.5, abs=0.01)


def test_sharp_edges_are_no_walls_and_thick_bodies_reach_the_limit():
    wedge = Manifold.hull_points([(0, 0, 0), (10, 0, 0), (0, 10, 0), (0, 0, 20), (10, 0, 20), (0, 10, 20)])
    assert thinnest_wall(wedge, reach_mm=4.0) == 4.0


def test_a_speck_is_no_wall():
    """A fin of a tenth of a millimetre and 2 mm^2 is a speck, one of 200 mm^2 is a wall."""
    block = Manifold.cube((60, 60, 20))
    speck = Manifold.cube((0.1, 2, 1)).translate((30, 30, 20))
    fin = Manifold.cube((0.1, 20, 10)).translate((30, 30, 20))
    assert thinnest_wall(block + speck, reach_mm=10, rays=5000) == 10
    assert thinnest_wall(block + fin, reach_mm=10, rays=5000) == pytest.approx(0.1, abs=1e-9)
