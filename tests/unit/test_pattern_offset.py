"""The outer face in a hollow: it neither folds nor runs into itself, and says what it cost."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from hilbrace.errors import GeometryError
from hilbrace.pattern.offset import LEAST_SHARE, SLOPE, area_ratio, offset_volume, safe_offset
from hilbrace.pattern.refine import vertex_normals
from hilbrace.pattern.thicken import folded_triangles, manifold, thicken
from tests.unit.elbow import TUBE_MM, elbow_domain
from tests.unit.sleeve import sleeve_domain

WIDE, NARROW = elbow_domain(20.0), elbow_domain(4.0, around=60, step_mm=3.0)


def _edges(domain):
    return np.concatenate([domain.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])


def test_area_ratio_is_that_of_a_torus():
    """Outwards by t from principal curvatures -1/20 and 1/30 areas grow by (1 - t/20)(1 + t/30)."""
    fine = elbow_domain(20.0, around=120, step_mm=1.5)
    ratio = area_ratio(fine.vertices, fine.triangles, 6.0 * vertex_normals(fine))
    assert ratio.min() == pytest.approx((1 - 6 / 20) * (1 + 6 / TUBE_MM), rel=0.02)


def test_a_shallow_hollow_keeps_normals_and_thickness():
    offset = safe_offset(WIDE, 5.0)
    assert np.array_equal(offset.thickness, np.full(len(WIDE.vertices), 5.0))
    assert np.array_equal(offset.direction, vertex_normals(WIDE))


def test_a_tight_hollow_is_mended_where_normals_alone_would_fold():
    normals = vertex_normals(NARROW)
    assert folded_triangles(NARROW.vertices, normals, NARROW.triangles, 6.0) > 100
    offset = safe_offset(NARROW, 6.0)
    args = NARROW.vertices, offset.direction, NARROW.triangles, offset.thickness
    assert folded_triangles(*args) == 0
    assert area_ratio(NARROW.vertices, NARROW.triangles, offset.vector).min() > 0.2
    # the hollow's radius is 4 mm: less fits there, and the full thickness elsewhere
    assert LEAST_SHARE * 6.0 <= offset.thickness.min() < 4.0
    assert np.median(offset.thickness) == 6.0
    # thickness changes gently
    a, b = _edges(NARROW).T
    length = np.linalg.norm(NARROW.vertices[a] - NARROW.vertices[b], axis=1)
    assert (np.abs(offset.thickness[a] - offset.thickness[b]) <= SLOPE * length + 1e-9).all()
    # directions stay outward
    p = NARROW.vertices[NARROW.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert (np.einsum("tkx,tx->tk", offset.direction[NARROW.triangles], face) > 0).all()


def _clearance(vector):
    """Distance of outer points from the skin over their thickness, the least."""
    corners = (NARROW.vertices + vector)[NARROW.triangles]
    outer = np.concatenate([corners.mean(axis=1), *np.moveaxis(corners, 1, 0)])
    squared = igl.point_mesh_squared_distance(outer, NARROW.vertices, NARROW.triangles)[0]
    length = np.linalg.norm(vector, axis=1)[NARROW.triangles]
    return (np.sqrt(squared) / np.concatenate([length.mean(axis=1), *length.T])).min()


def test_the_outer_face_does_not_come_back_to_the_skin():
    """In a hollow of 4 mm, 6 mm along the normal end about 4 mm from the legs beyond it."""
    assert _clearance(6.0 * vertex_normals(NARROW)) < 0.7
    assert _clearance(safe_offset(NARROW, 6.0).vector) > 0.95


def test_too_thick_for_the_hollow_is_refused_by_name():
    with pytest.raises(
        GeometryError, match="a brace 15 mm thick folds where the skin bends inwards"
    ) as fault:
        safe_offset(NARROW, 15.0)
    assert fault.value.where == "material.thickness_mm"
    assert "mm" in fault.value.what


def test_volume_of_the_offset_is_that_of_the_body():
    domain = sleeve_domain(around=40, along=20)
    offset = safe_offset(domain, 4.0)
    body = manifold(*thicken(domain.vertices, offset.direction, domain.triangles, offset.thickness))
    whole = offset_volume(domain, offset, np.ones(len(domain.triangles)))
    assert body.volume() == pytest.approx(whole, rel=2e-3)
