import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fabrication.fixtures.place import Place, frame

vectors = st.tuples(*[st.floats(-10, 10)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(vectors, vectors)
def test_a_frame_is_a_rotation_that_takes_z_along_the_direction(direction, outward):
    turn = frame(np.array([1.0, 2, 3]), direction, outward)
    assert turn[:, 3] == pytest.approx([1, 2, 3])
    np.testing.assert_allclose(turn[:, :3] @ turn[:, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn[:, :3]) == pytest.approx(1)
    np.testing.assert_allclose(turn[:, 2] * np.linalg.norm(direction), direction, atol=1e-9)


def test_x_points_outward_as_far_as_the_direction_lets_it():
    place = Place(np.zeros(3), np.array([0.0, 0, 1]), np.array([3.0, 0, 4]), ("a", "b"), 6.0)
    np.testing.assert_allclose(place.frame[:, :3], np.eye(3), atol=1e-12)


def test_an_outward_along_the_direction_still_gives_a_frame():
    turn = frame(np.zeros(3), np.array([0.0, 1, 0]), np.array([0.0, 2, 0]))
    assert np.linalg.det(turn[:, :3]) == pytest.approx(1)
