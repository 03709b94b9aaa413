"""The renderer: what is seen, where, and what hides what."""

import numpy as np
import pytest
from manifold3d import Manifold

from fabrication.bodies import mesh_of
from fabrication.render import Drawn, draw, view_from

FRONT = view_from(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
WINDOW = (-20.0, 20.0, -20.0, 20.0)


def drawn(solid: Manifold, colour: tuple[float, float, float]) -> Drawn:
    return Drawn(*mesh_of(solid), np.array([colour], dtype=float))


def test_a_view_is_right_handed():
    view = view_from(np.array([1.0, 0.2, 0.4]), np.array([0.0, 1.0, 0.0]))
    turn = np.stack([view.right, view.up, view.near])
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_a_disc_covers_its_area():
    image = draw([drawn(Manifold.sphere(10.0, 128), (1, 1, 1))], FRONT, WINDOW, 10.0)
    assert image.shape == (400, 400, 4)
    assert image[..., 3].sum() / 100 == pytest.approx(np.pi * 100, rel=0.03)
    assert image[0, 0, 3] == 0.0
    assert image[200, 200, 3] == 1.0


def test_what_is_near_hides_what_is_far():
    near = drawn(Manifold.cube((10, 10, 2), True).translate((0, 0, 8)), (1.0, 0.0, 0.0))
    far = drawn(Manifold.cube((30, 30, 2), True), (0.0, 0.0, 1.0))
    for bodies in ([near, far], [far, near]):
        image = draw(bodies, FRONT, WINDOW, 4.0)
        assert image[80, 80, 0] > 0.3
        assert image[80, 80, 2] == 0.0
        assert image[80, 30, 2] > 0.3
        assert image[80, 30, 0] == 0.0


def test_up_on_paper_is_up():
    high = drawn(Manifold.sphere(3.0, 32).translate((5, 12, 0)), (1, 1, 1))
    image = draw([high], FRONT, WINDOW, 4.0)
    rows, columns = np.nonzero(image[..., 3])
    assert rows.mean() == pytest.approx((20 - 12) * 4 - 0.5, abs=0.6)
    assert columns.mean() == pytest.approx((20 + 5) * 4 - 0.5, abs=0.6)


def test_large_and_small_triangles_leave_no_holes():
    plate = Manifold.cube((36, 36, 1), True)
    fine = plate.refine(40)
    for solid in (plate, fine):
        image = draw([drawn(solid, (1, 1, 1))], FRONT, WINDOW, 3.0)
        assert (image[8:-8, 8:-8, 3] == 1.0).all()
