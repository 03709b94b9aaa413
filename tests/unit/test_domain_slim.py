"""Length-keeping flat maps against developable surfaces, and the energy that they lower."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from hilbrace.domain.slim import dirichlet_energy, slim
from hilbrace.errors import GeometryError
from tests.unit.flat_sleeve import flattened, opened_sleeve

RNG = np.random.default_rng(3)
GRID = np.stack(np.meshgrid(np.linspace(0, 3, 16), np.linspace(0, 2, 11), indexing="ij"), -1).reshape(-1, 2)
TRIANGLES = Delaunay(GRID).simplices.astype(np.int64)
SHEET = GRID + RNG.uniform(-0.03, 0.03, GRID.shape)


def tilted(angle: float) -> np.ndarray:
    """The sheet, tilted by an angle."""
    return np.stack([SHEET[:, 0] * np.cos(angle), SHEET[:, 1], SHEET[:, 0] * np.sin(angle)], axis=1)


def area(points: np.ndarray) -> float:
    first, second = (points[TRIANGLES[:, k]] - points[TRIANGLES[:, 0]] for k in (1, 2))
    return float(np.linalg.norm(np.cross(first, second), axis=1).sum() / 2)


def sides(points: np.ndarray) -> np.ndarray:
    corner = points[TRIANGLES]
    return np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_tilted_sheet_comes_back_in_its_own_lengths(angle):
    surface = tilted(angle)
    squeezed = 7.0 * (SHEET * [1.0, 0.5] + [0.0, 0.1] * np.sin(3 * SHEET[:, :1]))
    solution = slim(surface, TRIANGLES, squeezed)
    scale = np.sqrt(area(surface))
    assert sides(solution) * scale == pytest.approx(sides(surface), rel=0.02)
    assert dirichlet_energy(surface / scale, TRIANGLES, solution) == pytest.approx(4.0, abs=1e-3)


def test_the_energy_has_its_closed_form_for_an_even_stretch():
    stretch = np.array([1.3, 0.6])
    expected = (stretch**2 + 1 / stretch**2).sum()
    assert dirichlet_energy(tilted(0.0), TRIANGLES, SHEET * stretch) == pytest.approx(expected, rel=1e-12)


def test_the_map_is_not_turned_against_its_start():
    turn = np.array([[np.cos(1.1), np.sin(1.1)], [-np.sin(1.1), np.cos(1.1)]])
    solution = slim(tilted(0.3), TRIANGLES, SHEET @ turn)
    back = solution @ turn.T
    for axis in (0, 1):
        assert np.corrcoef(back[:, axis], SHEET[:, axis])[0, 1] > 0.9999


@pytest.mark.parametrize("window", [0.0, 26.0])
def test_a_sleeve_keeps_its_areas_better_than_conformally_and_turns_nothing(window):
    domain = opened_sleeve(window)
    _, conformal = flattened(domain, "lscm")
    _, lengths = flattened(domain, "slim")
    assert lengths.flipped_triangles == 0
    spread = [one.map_area_ratio_max / one.map_area_ratio_min for one in (conformal, lengths)]
    assert np.log(spread[1]) < 0.75 * np.log(spread[0])
    assert lengths.quasi_conformal_mean > conformal.quasi_conformal_mean


def test_the_result_is_a_minimum_of_the_energy():
    domain = opened_sleeve(around=40, along=16)
    made, _ = flattened(domain, "slim")
    surface = domain.vertices[domain.weld]
    uv = slim(surface, domain.cut_triangles, made.uv)
    corner = surface[domain.cut_triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    unit = surface / np.sqrt(np.linalg.norm(normal, axis=1).sum() / 2)
    least = dirichlet_energy(unit, domain.cut_triangles, uv)
    rng = np.random.default_rng(0)
    for _ in range(5):
        other = uv + 1e-3 * rng.normal(size=(1, 2)) * np.sin(4 * uv[:, ::-1] + rng.uniform(0, 6))
        assert dirichlet_energy(unit, domain.cut_triangles, other) > least


def test_a_start_that_cannot_be_left_is_refused():
    rng = np.random.default_rng(3)
    sheet = rng.uniform(0, 1, (80, 2)) * [3.0, 2.0]
    needles = Delaunay(sheet).simplices.astype(np.int64)
    squeezed = sheet * [1.0, 0.5] + [0.0, 0.1] * np.sin(3 * sheet[:, :1])
    with pytest.raises(GeometryError, match="no step lowers"):
        slim(np.concatenate([sheet, np.zeros((80, 1))], axis=1), needles, squeezed)


def test_the_same_map_comes_out_every_time():
    domain = opened_sleeve(around=40, along=16)
    first, second = (flattened(domain, "slim")[0].uv for _ in range(2))
    assert np.array_equal(first, second)
