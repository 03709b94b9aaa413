import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.mold import Piece
from fabrication.print_pose import best_pose, pose, pose_pieces, printing_costs
from fabrication.printers import profile
from hilbrace.config import MoldSettings

MK4 = profile(MoldSettings())
Z = np.array([0.0, 0, 1])


def piece(solid, kind="shell", pull=Z):
    return Piece("p", "P", kind, solid, np.asarray(pull, float), np.eye(3), (1.0, 1.0, 1.0))


def test_a_cube_on_the_bed_needs_no_support():
    found = pose(Manifold.cube((20, 30, 40)), Z, MK4)
    assert found.overhang_mm2 == 0
    assert found.contact_mm2 == pytest.approx(600)
    assert sorted(found.size[:2]) == pytest.approx([20, 30])
    assert found.size[2] == pytest.approx(40)
    assert found.fits


@pytest.mark.parametrize(("slope_deg", "supported"), [(40, True), (50, False)])
def test_a_cone_upside_down_needs_support_where_it_is_flatter_than_45_degrees(slope_deg, supported):
    # side of slope s to the bed: radius grows by height / tan(s); lateral area pi (r1 + r2) slant
    low, height = 10.0, 12.0
    high = low + height / np.tan(np.radians(slope_deg))
    cone = Manifold.cylinder(height, low, high, 720)
    area = np.pi * (low + high) * np.hypot(height, high - low)
    found = pose(cone, Z, MK4)
    assert found.overhang_mm2 == pytest.approx(area if supported else 0, rel=1e-3)
    assert found.contact_mm2 == pytest.approx(np.pi * low**2, rel=1e-3)
    assert pose(cone, -Z, MK4).overhang_mm2 == 0


def test_resin_prints_what_beads_do_not():
    cone = Manifold.cylinder(10, 10, 10 + 10 / np.tan(np.radians(30)), 90)
    resin = profile(MoldSettings(printer="formlabs_form3"))
    assert pose(cone, Z, MK4).overhang_mm2 > 1000
    assert pose(cone, Z, resin).overhang_mm2 == 0


def test_a_long_piece_fits_across_the_bed():
    rod = Manifold.cube((290, 10, 10))
    found = pose(rod, Z, MK4)
    assert found.fits
    turned = rod.transform(np.column_stack([found.rotation, np.zeros(3)]))
    box = np.reshape(turned.bounding_box(), (2, 3))
    np.testing.assert_allclose(np.ptp(box, axis=0), found.size, atol=1e-9)
    assert not pose(Manifold.cube((330, 10, 10)), Z, MK4).fits


def test_a_bowl_lies_on_its_rim_or_stands_as_it_needs_least_support():
    pot = Manifold.cylinder(40, 30, 30, 90) - Manifold.cylinder(40, 25, 25, 90).translate((0, 0, 5))
    found = best_pose(piece(pot), MK4, Z)
    np.testing.assert_allclose(found.rotation[2], Z, atol=1e-12)
    assert found.overhang_mm2 == 0
    upside_down = best_pose(piece(pot.rotate((180, 0, 0))), MK4, Z)
    np.testing.assert_allclose(upside_down.rotation[2], -Z, atol=1e-12)


def test_a_half_pipe_stands_on_its_end():
    pipe = Manifold.cylinder(100, 40, 40, 180) - Manifold.cylinder(100, 34, 34, 180)
    half = pipe.split_by_plane((1, 0, 0), 0)[0]
    found = best_pose(piece(half, pull=(1, 0, 0)), MK4, Z)
    assert abs(found.rotation[2] @ Z) == pytest.approx(1)
    assert found.overhang_mm2 == 0


def test_a_half_pipe_too_tall_for_the_bed_lies_down():
    pipe = Manifold.cylinder(230, 40, 40, 90) - Manifold.cylinder(230, 34, 34, 90)
    half = pipe.split_by_plane((1, 0, 0), 0)[0]
    found = best_pose(piece(half, pull=(1, 0, 0)), MK4, Z)
    assert found.fits
    assert abs(found.rotation[2, 0]) == pytest.approx(1)


def test_the_core_stands_upright_and_costs_are_those_of_the_poses_taken():
    up = np.array([0.0, 1, 0])
    core = piece(Manifold.cylinder(60, 20, 20, 90).rotate((-90, 0, 0)), kind="core")
    (posed,) = pose_pieces([core], MK4, up)
    np.testing.assert_allclose(posed.printing[2], up, atol=1e-12)
    (cost,) = printing_costs([posed], MK4)
    assert cost.name == "p"
    assert cost.volume_ml == pytest.approx(np.pi * 400 * 60 / 1000, rel=1e-2)
    assert cost.pose.size[2] == pytest.approx(60)
    assert cost.pose.fits
    assert cost.pose.overhang_mm2 == 0
    (lying,) = printing_costs([core], MK4)
    assert lying.pose.size[1] == pytest.approx(60)
    assert lying.pose.overhang_mm2 > 1000
