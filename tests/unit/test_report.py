"""The report's parts: views, key frames, lighter meshes, and the shading of what is painted."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from matplotlib.figure import Figure

from hilbrace.pattern.pattern import Solid
from hilbrace.report import figures
from hilbrace.report.light_solid import TOLERANCE_MM, lighter
from hilbrace.report.paint import BACK, FRONT, LEFT, RIGHT, paint, screen_axes
from tests.unit.knee_tube import knee_loads


@pytest.mark.parametrize(
    ("towards", "right"), [(FRONT, (0, 0, -1)), (BACK, (0, 0, 1)), (RIGHT, (1, 0, 0)), (LEFT, (-1, 0, 0))]
)
def test_views_are_those_of_a_person_in_front_of_the_subject(towards, right):
    """From the front the subject's right hand is on the left of the picture, as on a photograph."""
    along, up, near = screen_axes(towards)
    np.testing.assert_allclose(along, right, atol=1e-12)
    np.testing.assert_allclose(up, (0, 1, 0), atol=1e-12)
    np.testing.assert_allclose(np.cross(along, up), near, atol=1e-12)


def test_painted_triangles_lie_where_they_are_seen():
    vertices = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, -1.0]])
    axes = Figure().add_subplot()
    paint(axes, vertices, np.array([[0, 1, 2]]), towards=FRONT, shift=(5.0, 0.0))
    path = axes.collections[0].get_paths()[0].vertices
    np.testing.assert_allclose(path[:3], [[5, 0], [5, 1], [6, 0]], atol=1e-12)


def test_what_faces_away_is_darker():
    vertices = np.array([[0.0, 0, 0], [0, 1, 0], [0, 0, -1.0]])
    shades = []
    for order in ([0, 1, 2], [0, 2, 1]):
        axes = Figure().add_subplot()
        paint(axes, vertices, np.array([order]), (1.0, 1.0, 1.0), FRONT)
        shades.append(axes.collections[0].get_facecolor()[0, 0])
    assert max(shades) > min(shades) + 0.2


def test_key_frames_hold_the_peaks_and_the_ends():
    loads = knee_loads(61)
    frames = figures.key_instants(loads, "knee_l")
    assert frames[0] == 0
    assert frames[-1] == 60
    assert 30 in frames
    assert frames == sorted(set(frames))
    assert len(frames) == 6


def test_a_short_motion_has_as_many_key_frames_as_frames():
    assert figures.key_instants(knee_loads(3), "knee_l") == [0, 1, 2]


def _solid(mesh: trimesh.Trimesh) -> Solid:
    return Solid(
        vertices=np.asarray(mesh.vertices, dtype=float),
        triangles=np.asarray(mesh.faces, dtype=np.int64),
        thickness_mm=4.0,
        volume_mm3=float(mesh.volume),
        mass_g=1.0,
        parts=1,
        watertight=True,
        manifold_status="NoError",
        genus=0,
        expected_volume_mm3=1.0,
        thickness_p01_mm=4.0,
        folded_triangles=0,
    )


def test_lighter_meshes_stay_near_and_closed():
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=60.0)
    heavy = _solid(mesh)
    light = lighter(heavy)
    assert len(light.triangles) < 0.5 * len(heavy.triangles)
    closed = trimesh.Trimesh(light.vertices, light.triangles)
    assert closed.is_watertight
    assert np.abs(np.linalg.norm(light.vertices, axis=1) - 60.0).max() < 2 * TOLERANCE_MM


def test_lighter_meshes_keep_the_fields_of_the_nearest_vertices():
    heavy = _solid(trimesh.creation.icosphere(subdivisions=5, radius=60.0))
    heights = heavy.vertices[:, 1].copy()
    light = lighter(
        dataclasses.replace(
            heavy, d=heights, label=heights, strut_width_mm=heights, local_thickness_mm=heights
        )
    )
    np.testing.assert_allclose(light.strut_width_mm, light.vertices[:, 1], atol=4.0)


def test_the_contact_figure_shows_parts_and_the_strongest_muscles_or_says_that_there_are_none():
    loads = knee_loads()
    left, right = figures.contact_force(loads, "knee_l").axes
    assert "no muscles" in left.texts[0].get_text()
    frames, joint = len(loads.time), loads.joints.index("knee_l")
    pull = np.zeros((frames, len(loads.joints), 2, 3))
    pull[:, joint, 1, 1] = 1.0
    force = np.zeros((frames, len(loads.joints), 3))
    force[:, joint, 1] = -1000.0
    half = np.full((frames, len(loads.joints)), 500.0)
    with_muscles = dataclasses.replace(
        loads,
        muscle_names=("soleus_l", "vasti_l"),
        muscle_max_force=np.ones(2),
        muscle_optimal_length=np.ones(2),
        muscle_slack_length=np.ones(2),
        muscle_activation=np.ones((frames, 2)),
        muscle_force=np.full((frames, 2), 300.0),
        muscle_arms=np.zeros((frames, len(loads.joints), 3, 2)),
        muscle_pull=pull,
        contact_force=force,
        contact_medial=half,
        contact_lateral=half,
    )
    left, right = figures.contact_force(with_muscles, "knee_l").axes
    shown = {line.get_label() for line in left.lines}
    assert {"magnitude", "medial", "lateral", "acting force"} <= shown
    assert [line.get_label() for line in right.lines] == ["vasti_l"]


@pytest.mark.parametrize(
    ("joint", "names"),
    [("knee_l", ["flexion", "adduction", "rotation"]), ("ankle_l", ["dorsiflexion", "inversion"])],
)
def test_angles_are_shown_by_the_names_of_the_joint(joint, names):
    legend = figures.joint_angles(knee_loads(), joint).axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == names
