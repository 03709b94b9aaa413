"""The fit of the shape: closed forms, slopes against finite differences, figures that come back."""

from __future__ import annotations

import igl
import numpy as np
import pytest

from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.fit import enclosed_volume, fit_shape, measure

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_TRIANGLES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


def test_volume_of_a_moved_box():
    volume, _ = enclosed_volume(CUBE * [1.0, 2.0, 3.0] + [5.0, -4.0, 1.0], CUBE_TRIANGLES)
    assert volume == pytest.approx(6.0)


def test_gradient_of_the_volume_matches_finite_differences():
    vertices = CUBE + np.random.default_rng(0).normal(0.0, 0.1, CUBE.shape)
    _, gradient = enclosed_volume(vertices, CUBE_TRIANGLES)
    step = 1e-6
    for i, k in np.ndindex(vertices.shape):
        moved = np.zeros_like(vertices)
        moved[i, k] = step
        ends = [enclosed_volume(vertices + s * moved, CUBE_TRIANGLES)[0] for s in (1, -1)]
        assert gradient[i, k] == pytest.approx((ends[0] - ends[1]) / (2 * step), abs=1e-8)


def test_slopes_of_all_figures_match_finite_differences():
    model = load_anny_lite()
    shape = np.random.default_rng(1).normal(0.0, 0.3, len(model.coefficient_names))
    figures = measure(model, shape)
    step = 1e-5
    for column in (0, 2, 7, 16, 23, 31, 37, 40):
        move = np.eye(len(shape))[column] * step
        more, less = measure(model, shape + move), measure(model, shape - move)
        for name, figure in figures.items():
            slope = (more[name].value - less[name].value) / (2 * step)
            assert figure.slope[column] == pytest.approx(slope, abs=1e-7), (name, column)


def test_breadths_lie_on_the_skin_at_the_joints():
    """Across the right knee and ankle of the mean adult, against rays through the joint centres."""
    model = load_anny_lite()
    figures = measure(model, np.zeros(41))
    heads = {n: model.head_template[model.bone_names.index(n)] for n in ("lowerleg01.R", "foot.R")}
    legs = model.triangles[(model.template[model.triangles][:, :, 2] > 0.02).all(axis=1)]
    points = igl.upsample(np.array(model.template), legs, 2)[0]
    for name, head in (("knee breadth", heads["lowerleg01.R"]), ("ankle breadth", heads["foot.R"])):
        slab = points[(np.abs(points[:, 1] - head[1]) < 0.01) & (np.abs(points[:, 2] - head[2]) < 0.1)]
        assert figures[name].value == pytest.approx(np.ptp(slab[:, 2]), abs=0.006)


def test_figures_of_a_known_body_are_met_by_the_fit():
    model = load_anny_lite()
    truth = np.zeros(41)
    truth[:4] = [0.8, -0.6, 0.5, 0.3]
    wanted = {name: figure.value for name, figure in measure(model, truth).items()}
    found = measure(model, fit_shape(model, wanted))
    for name, goal in wanted.items():
        assert found[name].value == pytest.approx(goal, abs=0.003), name


def test_a_figure_left_out_follows_the_rest():
    model = load_anny_lite()
    wanted = {name: figure.value for name, figure in measure(model, np.array([1.5])).items()}
    tall = wanted.pop("height")
    found = measure(model, fit_shape(model, wanted))["height"].value
    mean = measure(model, np.zeros(41))["height"].value
    assert found == pytest.approx(tall, abs=0.25 * abs(tall - mean))


def test_without_figures_the_shape_is_the_mean():
    model = load_anny_lite()
    lengths = {name: f.value for name, f in measure(model, np.zeros(41)).items()}
    np.testing.assert_allclose(fit_shape(model, lengths), 0.0, atol=1e-9)
