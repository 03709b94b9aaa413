from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.domain.domain import Domain
from hilbrace.domain.limb import Surface
from hilbrace.domain.loops import loops_of
from hilbrace.domain.rim import loop_distance, rim_band
from hilbrace.errors import GeometryError
from tests.unit.domain_body import sleeve, upright_limb


def cylinder_domain(height=200.0):
    vertices, triangles = sleeve(60.0, 60.0, height, around=48, along=40)
    loops = loops_of(Surface(vertices, triangles), upright_limb())
    return Domain(
        joint="knee_l",
        vertices=vertices,
        triangles=triangles,
        upper_loop=loops.upper,
        lower_loop=loops.lower,
        cut_triangles=triangles,
        weld=np.arange(len(vertices)),
        uv=np.zeros((len(vertices), 2)),
        seam_pairs=np.zeros((0, 2), int),
        flatten="lscm",
        period_u=0.0,
        time=np.zeros(0),
        posed=np.zeros((0, len(vertices), 3)),
        deformation=np.zeros((0, len(triangles), 2, 2)),
        quasi_conformal=np.ones(len(triangles)),
    )


@settings(max_examples=20, deadline=None)
@given(width=st.floats(2.0, 90.0))
def test_on_a_cylinder_the_distance_is_the_height_to_the_nearer_edge(width):
    domain = cylinder_domain()
    band = rim_band(domain, width)
    height = domain.vertices[:, 1]
    assert np.allclose(band.vertex_distance, np.minimum(height, 200.0 - height), atol=1e-9)
    centre = domain.vertices[domain.triangles].mean(axis=1)[:, 1]
    # Centres lie up to a chord's sag inside the edge's polygon, so their distance is a little longer.
    inside = np.minimum(centre, 200.0 - centre)
    assert band.triangles[inside < width - 0.1].all()
    assert not band.triangles[inside > width].any()
    assert band.width_mm == width


def test_distance_to_a_square():
    square = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], float)
    points = np.array([[1, 1, 0], [1, 0, 3], [-1, -1, 0], [0, 1, 0]], float)
    assert np.allclose(loop_distance(points, square), [1.0, 3.0, np.sqrt(2.0), 0.0])


def test_bands_that_leave_no_room_are_refused():
    with pytest.raises(GeometryError, match="cover the whole brace"):
        rim_band(cylinder_domain(30.0), 20.0)
