"""The skin under the brace: closed forms of beams and bars on elastic foundations, and statics."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.errors import GeometryError
from hilbrace.shell import (
    Foundation,
    LoadPattern,
    NodalLoads,
    build_shell,
    displacements,
    joint_line_shares,
    lay_on_skin,
    loop_stiffness,
    pose_shell,
    shell_response,
    skin,
    skin_reaction,
    wrenches_at,
)
from hilbrace.shell.directors import triangle_normals
from hilbrace.shell.model import unit_stiffness
from tests.unit.shell_cases import global_stiffness, tube

RADIUS, LENGTH, THICKNESS, MODULUS = 40.0, 120.0, 2.0, 1.15
TUBE = build_shell(*tube(40, 48, RADIUS, LENGTH), THICKNESS, 0.0)
UNIFORM = np.full(len(TUBE.triangles), MODULUS)

KNEE = build_shell(*tube(12, 8, 30.0, 90.0, waviness=0.1, window=True), 3.0, 0.45)
SHARES = joint_line_shares(KNEE.vertices, KNEE.triangles, 30.0)
BORNE = lay_on_skin(KNEE, skin(KNEE.vertices, 0.05, 0.2))


def tributary(shell):
    _, area = triangle_normals(shell.vertices, shell.triangles)
    return np.bincount(shell.triangles.ravel(), np.repeat(area / 3, 3), minlength=len(shell.vertices))


def uniform_load(shell, direction, per_area):
    return NodalLoads(torch.from_numpy(per_area * (tributary(shell)[:, None] * direction)[None]))


def radial(shell):
    across = shell.vertices * [1.0, 0.0, 1.0]
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def some_modulus(seed=0):
    return torch.from_numpy(np.random.default_rng(seed).uniform(0.1, 1.0, len(KNEE.triangles)))


def some_load(frames=3):
    return LoadPattern(SHARES, torch.from_numpy(np.random.default_rng(1).standard_normal((frames, 3))))


# --- closed forms, E = 1.15 MPa, Poisson's ratio 0


def test_pressed_tube_is_a_beam_on_an_elastic_foundation():
    # D w'''' + (E t / R^2 + k) w = p with clamped ends; D = E t^3 / 12.
    # The wall's shear, which the beam does not have, adds 1.4 % near the ends.
    spring, pressure, radius, length, thickness = 2e-3, 1e-3, 60.0, 40.0, 1.0
    wide = build_shell(*tube(80, 32, radius, length), thickness, 0.0)
    borne = lay_on_skin(wide, Foundation(spring, 0.0, np.zeros(len(wide.vertices))))
    uniform = np.full(len(wide.triangles), MODULUS)
    moves = displacements(uniform, borne, uniform_load(wide, radial(wide), pressure))[0]
    whole = MODULUS * thickness / radius**2 + spring
    beta = (whole / (4 * MODULUS * thickness**3 / 12)) ** 0.25
    at = beta * wide.vertices[:, 1]
    end = beta * length / 2
    c, s = np.cos(end) * np.cosh(end), np.sin(end) * np.sinh(end)
    slope_c = np.cos(end) * np.sinh(end) - np.sin(end) * np.cosh(end)
    slope_s = np.sin(end) * np.cosh(end) + np.cos(end) * np.sinh(end)
    even, odd = np.linalg.solve([[c, s], [slope_c, slope_s]], [-1.0, 0.0])
    expected = pressure / whole * (1 + even * np.cos(at) * np.cosh(at) + odd * np.sin(at) * np.sinh(at))
    ours = (moves * radial(wide)).sum(axis=1)
    assert spring / whole > 0.7  # the skin takes most of the pressure
    np.testing.assert_allclose(ours, expected, atol=0.02 * expected.max())
    np.testing.assert_allclose(moves[:, 1], 0.0, atol=0.01 * expected.max())


def test_pulled_tube_is_a_bar_on_an_elastic_foundation():
    # E t u'' = k u - q, clamped ends.
    spring, pull = 0.002, 1e-3
    borne = lay_on_skin(TUBE, Foundation(0.0, spring, np.zeros(len(TUBE.vertices))))
    up = np.tile([0.0, 1.0, 0.0], (len(TUBE.vertices), 1))
    moves = displacements(UNIFORM, borne, uniform_load(TUBE, up, pull))[0]
    reach = np.sqrt(MODULUS * THICKNESS / spring)
    shape = 1 - np.cosh(TUBE.vertices[:, 1] / reach) / np.cosh(LENGTH / 2 / reach)
    np.testing.assert_allclose(moves[:, 1], pull / spring * shape, atol=0.005 * pull / spring)


def test_stiff_skin_takes_the_whole_load_where_it_acts():
    # The limit of a rigid limb: pressure on the skin is the pressure on the brace, and loops hold nothing.
    stiff = lay_on_skin(KNEE, skin(KNEE.vertices, 1e4, 1.0))
    taken = skin_reaction(some_modulus().numpy(), stiff, some_load())
    applied = SHARES[None, :, None] * some_load().forces.numpy()[:, None, :]
    free = KNEE.numbering.equation[::5] >= 0
    np.testing.assert_allclose(taken.forces[:, free], -applied[:, free], atol=1e-3 * np.abs(applied).max())
    response = shell_response(some_modulus(), stiff, some_load())
    bare = shell_response(some_modulus(), KNEE, some_load())
    assert (response.compliance < 1e-4 * bare.compliance).all()


def test_soft_skin_is_none():
    gone = lay_on_skin(KNEE, skin(KNEE.vertices, 1e-12, 0.2))
    response, bare = (shell_response(some_modulus(), one, some_load()) for one in (gone, KNEE))
    torch.testing.assert_close(response.compliance, bare.compliance, rtol=1e-7, atol=0)
    torch.testing.assert_close(response.reactions, bare.reactions, rtol=1e-6, atol=1e-7)


# --- statics


def test_loops_skin_and_loads_are_in_balance():
    load = some_load()
    response = shell_response(some_modulus(), BORNE, load)
    held = wrenches_at(response.reactions, BORNE, np.zeros(3)).numpy().reshape(-1, 2, 2, 3).sum(axis=1)
    applied = load.forces.numpy()
    np.testing.assert_allclose(held[:, 0], -applied, atol=1e-10 * np.abs(applied).max())
    moment = np.cross(SHARES @ KNEE.vertices, applied)
    np.testing.assert_allclose(held[:, 1], -moment, atol=1e-10 * np.abs(moment).max())


def test_loops_hold_what_the_skin_does_not_take():
    modulus, load = some_modulus(), some_load()
    response, taken = shell_response(modulus, BORNE, load), skin_reaction(modulus.numpy(), BORNE, load)
    dense = global_stiffness(KNEE, modulus.numpy())
    moves = np.zeros((len(dense), 3)).reshape(-1, 5, 3)
    moves[:, :3] = displacements(modulus.numpy(), BORNE, load).transpose(1, 2, 0)
    turned = displacements_with_turns(modulus, load)
    np.testing.assert_allclose(moves[:, :3], turned.reshape(-1, 5, 3)[:, :3], atol=1e-9 * np.abs(moves).max())
    applied = np.zeros_like(moves)
    applied[:, :3] = SHARES[:, None, None] * load.forces.numpy().T
    at_loops = KNEE.motions.T @ (dense @ turned - applied.reshape(-1, 3))
    np.testing.assert_allclose(
        response.reactions.numpy() - taken.wrenches, at_loops.T, atol=1e-8 * np.abs(at_loops).max()
    )


def displacements_with_turns(modulus, load):
    """Dense solve of all degrees of freedom, springs added vertex by vertex."""
    dense = global_stiffness(KNEE, modulus.numpy())
    normals = BORNE.ground.springs
    for vertex, spring in enumerate(normals):
        part = slice(5 * vertex, 5 * vertex + 3)
        dense[part, part] += spring
    applied = np.zeros((len(KNEE.vertices), 5, len(load.forces)))
    applied[:, :3] = SHARES[:, None, None] * load.forces.numpy().T
    applied = applied.reshape(-1, len(load.forces))
    free = KNEE.numbering.free
    moves = np.zeros_like(applied)
    moves[free] = np.linalg.solve(dense[np.ix_(free, free)], applied[free])
    return moves


def test_springs_are_area_times_stiffness_across_and_along_the_surface():
    springs = BORNE.ground.springs
    stiffness = np.linalg.eigvalsh(springs)
    area = tributary(KNEE)
    free = KNEE.numbering.equation[::5] >= 0
    np.testing.assert_allclose(stiffness[free, 2], 0.05 * area[free], rtol=1e-12)
    np.testing.assert_allclose(stiffness[free, :2], 0.01 * area[free, None] * np.ones(2), rtol=1e-12)
    assert not springs[~free].any()


def test_brace_and_limb_move_together_at_no_cost():
    stiffness = loop_stiffness(some_modulus(), BORNE).numpy()
    values = np.linalg.eigvalsh(stiffness)
    assert np.abs(values[:6]).max() < 1e-11 * values[-1]
    bare = loop_stiffness(some_modulus(), KNEE).numpy()
    gain = np.linalg.eigvalsh(stiffness - bare)
    assert gain[-1] > 1e-3 * values[-1]
    assert gain[0] > -1e-9 * values[-1]


def test_skin_follows_the_shape():
    bent = KNEE.vertices + np.column_stack(
        [0.002 * KNEE.vertices[:, 1] ** 2, np.zeros((len(KNEE.vertices), 2))]
    )
    posed = pose_shell(BORNE, bent)
    built = lay_on_skin(pose_shell(KNEE, bent), BORNE.foundation)
    assert np.array_equal(posed.ground.springs, built.ground.springs)
    assert np.array_equal(unit_stiffness(posed), unit_stiffness(built))


@pytest.mark.parametrize(("stiffness", "share"), [(-1.0, 0.0), (np.nan, 0.0), (1.0, -0.1), (np.inf, 0.0)])
def test_skin_of_no_sense_is_refused(stiffness, share):
    with pytest.raises(GeometryError, match="no skin"):
        skin(KNEE.vertices, stiffness, share)


def test_skin_of_another_mesh_is_refused():
    with pytest.raises(GeometryError, match="foundation of"):
        lay_on_skin(KNEE, skin(KNEE.vertices[:-1], 1.0))
    with pytest.raises(GeometryError, match="lies on no skin"):
        skin_reaction(some_modulus().numpy(), KNEE, some_load())


def test_skin_that_follows_the_wrong_loops_is_refused():
    vertices, triangles, upper, lower = tube(12, 8, 30.0, 90.0)
    swapped = build_shell(vertices, triangles, lower, upper, 3.0, 0.45)
    with pytest.raises(GeometryError, match="follows the upper one"):
        lay_on_skin(swapped, skin(vertices, 0.05))
    lay_on_skin(swapped, skin(vertices, 0.05, axis=np.array([0.0, -1.0, 0.0])))


def test_skin_on_one_side_of_the_joint_line_is_refused():
    centre = np.array([0.0, 500.0, 0.0])
    with pytest.raises(GeometryError, match="other side"):
        skin(KNEE.vertices + centre, 0.05)
    skin(KNEE.vertices + centre, 0.05, centre=centre)


@pytest.mark.parametrize(
    ("normal", "tangential", "share"),
    [(-1.0, 0.0, 0.5), (0.1, np.nan, 0.5), (0.1, 0.0, np.nan), (0.1, 0.0, 2.0)],
)
def test_foundation_of_no_sense_is_refused(normal, tangential, share):
    lower = np.full(len(KNEE.vertices), 0.5)
    lower[17] = share
    with pytest.raises(GeometryError, match=r"no skin|vertex 17"):
        lay_on_skin(KNEE, Foundation(normal, tangential, lower))
