"""A brace's stiffness at the joint from its mesh alone, and how the ends of a mesh are found."""

from __future__ import annotations

import doctest
import sys

import numpy as np
import pytest
import torch
import trimesh

from hilbrace.errors import GeometryError, SolverError
from hilbrace.shell import brace_stiffness, build_shell, end_loops, joint_stiffness, loop_stiffness
from hilbrace.shell.boundary import boundary_loops, enclosed_area
from tests.unit.shell_cases import tube

ORIGIN = np.zeros(3)
UP = np.array([0.0, 1.0, 0.0])


def knee_sleeve():
    """The tube of the measured figures: 300 mm long, 55 to 70 mm wide, narrow at the joint, with a window."""
    around, along = 81, 65
    j, i = np.divmod(np.arange(around * (along + 1)), around)
    angle, z = 2 * np.pi * (i + 0.5 * (j % 2)) / around, 300.0 * j / along
    radius = 55 + 15 * (z / 300) ** 1.3 - 6 * np.exp(-(((z - 150) / 40) ** 2))
    radius += 4 * np.exp(-(((z - 150) / 30) ** 2)) * np.cos(angle)
    vertices = np.stack([radius * np.cos(angle), z - 150.0, -radius * np.sin(angle)], axis=1)
    triangles = tube(around, along, 1.0, 1.0)[1]
    centre = vertices[triangles].mean(axis=1)
    triangles = triangles[(centre[:, 0] < 0) | ((centre[:, 2] / 25) ** 2 + (centre[:, 1] / 32) ** 2 >= 1)]
    used, flat = np.unique(triangles, return_inverse=True)
    return vertices[used], flat.reshape(-1, 3)


SLEEVE = knee_sleeve()


@pytest.mark.parametrize(
    ("thickness", "frontal", "sagittal"), [(3.0, 0.128, 0.110), (4.0, 0.172, 0.148), (5.0, 0.217, 0.187)]
)
def test_solid_sleeve_has_the_stiffness_that_another_program_gave(thickness, frontal, sagittal):
    # A separate implementation, shear factor 5/6, on a jittered mesh of this tube: E = 1.15 MPa, nu = 0.45.
    stiffness = brace_stiffness(*SLEEVE, 1.15, thickness, centre=ORIGIN)
    assert stiffness.frontal_nm_per_deg == pytest.approx(frontal, abs=6e-4)
    assert stiffness.sagittal_nm_per_deg == pytest.approx(sagittal, rel=0.01)  # the window is cut otherwise
    if thickness == 4.0:
        assert stiffness.axial_nm_per_deg == pytest.approx(0.100, abs=6e-4)
        assert stiffness.stretch_n_per_mm == pytest.approx(5.2, abs=0.05)


def test_example_of_the_docstring_runs():
    module = sys.modules["hilbrace.shell.brace_stiffness"]
    (example,) = [test for test in doctest.DocTestFinder().find(module) if test.examples]
    assert doctest.DocTestRunner().run(example).failed == 0
    assert len(example.examples) > 5


def test_four_numbers_are_those_of_the_shell():
    vertices, triangles, upper, lower = tube(14, 10, 40.0, 160.0, waviness=0.1, window=True)
    rng = np.random.default_rng(1)
    modulus, thickness = rng.uniform(0.2, 1.0, len(triangles)), rng.uniform(2.0, 4.0, len(triangles))
    centre = np.array([2.0, 10.0, -3.0])
    stiffness = brace_stiffness(vertices, triangles, modulus, thickness, 0.3, centre=centre)
    shell = build_shell(vertices, triangles, upper, lower, thickness, 0.3)
    between = loop_stiffness(torch.from_numpy(modulus), shell)
    about = np.diag(joint_stiffness(between, shell, np.eye(3), centre).numpy()) * np.pi / 180e3
    ours = (stiffness.frontal_nm_per_deg, stiffness.axial_nm_per_deg, stiffness.sagittal_nm_per_deg)
    assert ours == pytest.approx(tuple(about), rel=1e-12)
    assert stiffness.stretch_n_per_mm == pytest.approx(between[7, 7].item(), rel=1e-12)
    assert set(stiffness.upper_loop) == set(upper)
    assert set(stiffness.lower_loop) == set(lower)


def test_stiffness_does_not_depend_on_how_the_brace_lies_in_space():
    vertices, triangles, _, _ = tube(14, 10, 40.0, 160.0, waviness=0.1, window=True)
    here = brace_stiffness(vertices, triangles, 1.0, 3.0, centre=np.array([1.0, 2.0, 3.0]))
    turn, _ = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    moved = [10.0, 20.0, 5.0]
    centre = turn @ [1.0, 2.0, 3.0] + moved
    there = brace_stiffness(vertices @ turn.T + moved, triangles, 1.0, 3.0, centre=centre, axes=turn.T)
    for name in ("frontal_nm_per_deg", "sagittal_nm_per_deg", "axial_nm_per_deg", "stretch_n_per_mm"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), rel=1e-9)


# --- the ends


def test_window_is_no_end():
    vertices, triangles, upper, lower = tube(24, 16, 40.0, 160.0, window=True)
    assert len(boundary_loops(triangles)) == 3
    above, below = end_loops(vertices, triangles, UP)
    assert set(above) == set(upper)
    assert set(below) == set(lower)
    above, below = end_loops(vertices, triangles, -UP)
    assert set(above) == set(lower)


def test_loops_follow_the_edges_and_enclose_the_cross_section():
    vertices, triangles, upper, lower = tube(64, 6, 40.0, 60.0)
    loops = boundary_loops(triangles)
    assert sorted(len(loop) for loop in loops) == [len(lower), len(upper)]
    for loop in loops:
        steps = np.linalg.norm(vertices[loop] - vertices[np.roll(loop, -1)], axis=1)
        assert steps.max() < 1.01 * 2 * np.pi * 40 / 64
        area = enclosed_area(vertices, loop)
        assert np.linalg.norm(area) == pytest.approx(np.pi * 40**2, rel=2e-3)
        np.testing.assert_allclose(area[[0, 2]], 0.0, atol=1e-9)


def test_ends_can_be_named():
    vertices, triangles, upper, lower = tube(14, 10, 40.0, 160.0)
    free = brace_stiffness(vertices, triangles, 1.0, 3.0, centre=ORIGIN)
    named = brace_stiffness(vertices, triangles, 1.0, 3.0, centre=ORIGIN, loops=(upper, lower))
    np.testing.assert_allclose(named.loop_stiffness, free.loop_stiffness, rtol=1e-9, atol=1e-6)


def disc():
    ring = np.arange(8)
    angle = 2 * np.pi * ring / 8
    vertices = np.vstack([np.stack([np.cos(angle), 0 * angle, np.sin(angle)], 1), [[0, 0, 0]]])
    return vertices, np.stack([ring, (ring + 1) % 8, np.full(8, 8)], axis=1)


def wide_window():
    """A ring cut in a short tube so that its window encloses as much as the ends."""
    vertices, triangles, _, _ = tube(24, 20, 10.0, 300.0)
    centre = vertices[triangles].mean(axis=1)
    triangles = triangles[(centre[:, 0] < 0) | (np.abs(centre[:, 1]) > 100)]
    used, flat = np.unique(triangles, return_inverse=True)
    return vertices[used], flat.reshape(-1, 3)


def touching_windows():
    vertices, triangles, _, _ = tube(10, 6, 30.0, 80.0)
    first, *others = np.flatnonzero((triangles == 25).any(axis=1))
    across = next(k for k in others if len(set(triangles[k]) & set(triangles[first])) == 1)
    return vertices, np.delete(triangles, [first, across], axis=0)


@pytest.mark.parametrize(
    ("mesh", "named"), [(disc, "1 open loops"), (wide_window, "window"), (touching_windows, "separate")]
)
def test_meshes_without_two_clear_ends_are_refused(mesh, named):
    with pytest.raises(GeometryError, match=named):
        brace_stiffness(*mesh(), 1.0, 3.0, centre=ORIGIN)


@pytest.mark.malformed
def test_bad_numbers_are_refused():
    vertices, triangles, _, _ = tube(10, 6, 30.0, 80.0)
    with pytest.raises(SolverError, match="triangle 0"):
        brace_stiffness(vertices, triangles, -1.0, 3.0, centre=ORIGIN)
    with pytest.raises(GeometryError, match="thickness"):
        brace_stiffness(vertices, triangles, 1.0, 0.0, centre=ORIGIN)
    with pytest.raises(GeometryError, match="unit vectors"):
        brace_stiffness(vertices, triangles, 1.0, 3.0, centre=ORIGIN, axes=2 * np.eye(3))
    with pytest.raises(GeometryError, match="unit vectors"):
        brace_stiffness(vertices, triangles, 1.0, 3.0, centre=ORIGIN, axes=np.eye(3)[:2])
    with pytest.raises(GeometryError, match="no point"):
        brace_stiffness(vertices, triangles, 1.0, 3.0, centre=np.array([0.0, np.nan, 0.0]))
    for_vertices = np.full(len(vertices), 3.0)
    with pytest.raises(GeometryError, match="thickness of shape"):
        brace_stiffness(vertices, triangles, 1.0, for_vertices, centre=ORIGIN)
    with pytest.raises(SolverError, match="modulus of shape"):
        brace_stiffness(vertices, triangles, for_vertices, 3.0, centre=ORIGIN)


# --- meshes as they come from other programs


def slim_cone(window):
    """60 mm wide above and 21 mm below, with a window of a given radius [mm] above the middle."""
    vertices, triangles, upper, lower = tube(40, 40, 60.0, 200.0)
    slimmer = np.interp(vertices[:, 1], [-100.0, 100.0], [0.35, 1.0])
    vertices = vertices * np.stack([slimmer, np.ones_like(slimmer), slimmer], axis=1)
    centre = vertices[triangles].mean(axis=1)
    inside = ((centre[:, 2] / window) ** 2 + ((centre[:, 1] - 40.0) / window) ** 2 < 1) & (centre[:, 0] > 0)
    used, flat = np.unique(triangles[~inside], return_inverse=True)
    return vertices[used], flat.reshape(-1, 3), np.searchsorted(used, upper), np.searchsorted(used, lower)


def test_window_wider_than_a_slim_end_is_not_taken_for_it():
    vertices, triangles, upper, lower = slim_cone(15.0)
    above, below = end_loops(vertices, triangles, UP)
    assert (set(above), set(below)) == (set(upper), set(lower))
    for window in (25.0, 33.0, 42.0):
        vertices, triangles, upper, lower = slim_cone(window)
        with pytest.raises(GeometryError, match="outermost") as caught:
            brace_stiffness(vertices, triangles, 1.0, 2.0, centre=ORIGIN)
        assert "loops" in caught.value.hint
        named = brace_stiffness(vertices, triangles, 1.0, 2.0, centre=ORIGIN, loops=(upper, lower))
        assert 0.0 < named.frontal_nm_per_deg < 0.04


def test_cone_twists_as_the_shear_flow_of_its_rings_says():
    # Torque T: shear flow T / (2 pi r^2), so that the twist per length of the wall is T / (2 pi r^3 t G).
    vertices, triangles, _, _ = tube(64, 60, 60.0, 200.0)
    radius = np.interp(vertices[:, 1], [-100.0, 100.0], [40.0, 60.0])
    vertices = vertices * np.stack([radius / 60, np.ones_like(radius), radius / 60], axis=1)
    cone = brace_stiffness(vertices, triangles, 1.15, 2.0, 0.3, centre=ORIGIN)
    slant = np.hypot(200.0, 20.0)
    shear = 1.15 / 2.6
    expected = 2 * np.pi * 2.0 * shear / (slant / 20.0 * (40.0**-2 - 60.0**-2) / 2) * np.pi / 180e3
    assert cone.axial_nm_per_deg == pytest.approx(expected, rel=5e-3)


def test_bent_sleeve_with_two_windows_shows_its_ends():
    # A quarter of a torus, from the shank above to the foot in front, windows at heel and instep.
    vertices, triangles, upper, lower = tube(40, 48, 35.0, 220.0)
    bend = np.clip((60.0 - vertices[:, 1]) / 120.0, 0.0, 1.0) * np.pi / 2
    reach = 240.0 / np.pi
    along = np.where(vertices[:, 1] > 60, vertices[:, 1] - 60, np.minimum(vertices[:, 1] + 60, 0.0))
    out = reach - vertices[:, 0]
    vertices = np.stack(
        [
            reach - out * np.cos(bend) - np.where(along < 0, along, 0.0),
            -out * np.sin(bend) + np.where(along > 0, along, 0.0),
            vertices[:, 2],
        ],
        axis=1,
    )
    heel, instep = (
        np.linalg.norm(vertices[triangles].mean(axis=1) - np.array(at), axis=1) < 14.0
        for at in ([-2.0, -79.0, 0.0], [47.0, -30.0, 0.0])
    )
    used, flat = np.unique(triangles[~(heel | instep)], return_inverse=True)
    ends = end_loops(vertices[used], flat.reshape(-1, 3), UP)
    assert len(boundary_loops(flat.reshape(-1, 3))) == 4
    assert [set(used[end]) for end in ends] == [set(upper), set(lower)]
    given = brace_stiffness(vertices[used], flat.reshape(-1, 3), 1.0, 3.0, centre=ORIGIN)
    assert 0.0 < given.sagittal_nm_per_deg < given.frontal_nm_per_deg * 3


def test_mesh_that_stands_on_another_axis_is_refused_unless_its_axes_are_given():
    vertices, triangles, _, _ = tube(14, 10, 40.0, 160.0, waviness=0.1, window=True)
    standing = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    turned = vertices @ standing
    with pytest.raises(GeometryError, match="90 degrees to the upward axis"):
        brace_stiffness(turned, triangles, 1.0, 3.0, centre=ORIGIN)
    here = brace_stiffness(vertices, triangles, 1.0, 3.0, centre=ORIGIN)
    there = brace_stiffness(turned, triangles, 1.0, 3.0, centre=ORIGIN, axes=standing)
    assert there.axial_nm_per_deg == pytest.approx(here.axial_nm_per_deg, rel=1e-9)
    assert there.stretch_n_per_mm == pytest.approx(here.stretch_n_per_mm, rel=1e-9)


def test_mesh_file_with_separate_triangles_is_refused_with_the_way_to_weld_it(tmp_path):
    vertices, triangles, _, _ = tube(14, 10, 40.0, 160.0, window=True)
    trimesh.Trimesh(vertices, triangles, process=False).export(tmp_path / "brace.stl")
    apart = trimesh.load(tmp_path / "brace.stl", process=False)
    with pytest.raises(SolverError, match="pieces") as caught:
        brace_stiffness(apart.vertices, apart.faces, 1.0, 3.0, centre=ORIGIN)
    assert "weld" in caught.value.hint
    apart.merge_vertices()
    welded = brace_stiffness(apart.vertices, apart.faces, 1.0, 3.0, centre=ORIGIN)
    ours = brace_stiffness(vertices, triangles, 1.0, 3.0, centre=ORIGIN)
    assert welded.stretch_n_per_mm == pytest.approx(ours.stretch_n_per_mm, rel=1e-5)


@pytest.mark.malformed
@pytest.mark.parametrize("of", [np.float32, np.int64, list])
def test_numbers_of_any_kind_will_do(of):
    vertices, triangles, _, _ = tube(14, 10, 40.0, 160.0)
    rounded = np.round(vertices)
    given = rounded.tolist() if of is list else rounded.astype(of)
    corners = triangles.tolist() if of is list else triangles.astype(np.uint32)
    found = brace_stiffness(given, corners, 1.0, 3.0, centre=[0, 0, 0])
    expected = brace_stiffness(rounded, triangles, 1.0, 3.0, centre=ORIGIN)
    assert np.array_equal(found.loop_stiffness, expected.loop_stiffness)


def faulty(fault):
    vertices, triangles, _, _ = tube(14, 10, 40.0, 160.0, window=True)
    if fault == "position":
        vertices[50] = np.nan
    if fault == "index":
        triangles[50, 1] = len(vertices)
    if fault == "inverted":
        triangles[50] = triangles[50, ::-1]
    if fault == "doubled":
        triangles = np.vstack([triangles, triangles[50]])
    if fault == "none":
        triangles = triangles[:0]
    if fault == "floats":
        triangles = triangles.astype(float)
    return vertices, triangles


@pytest.mark.malformed
@pytest.mark.parametrize(
    ("fault", "named"),
    [
        ("position", "vertex 50"),
        ("index", "triangle 50"),
        ("inverted", "triangle 50 against"),
        ("doubled", "repeats triangle 50"),
        ("none", "mesh of the shell"),
        ("floats", "mesh of the shell"),
    ],
)
def test_faults_of_the_mesh_are_named_before_its_ends_are_sought(fault, named):
    with pytest.raises(GeometryError, match=named):
        brace_stiffness(*faulty(fault), 1.0, 3.0, centre=ORIGIN)
