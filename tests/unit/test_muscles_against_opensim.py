"""Muscle and contact forces of a recorded walk against OpenSim's own tools on the same input."""

from __future__ import annotations

import numpy as np
import pytest

from hilbrace.biomech import contact, dynamics
from hilbrace.biomech.analysis import joints_of_model
from hilbrace.biomech.engine import Engine
from hilbrace.biomech.muscles import MuscleFigures, balanced_coordinates, recruit
from hilbrace.units import GRAVITY
from tests.unit import muscle_oracle
from tests.unit.rajagopal_walk import RATE_HZ, read_walk

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

FIRST, LAST = 36, 47
"""Frames of late right stance, with forces at their largest."""


@pytest.fixture(scope="module")
def ours(shared_data, tmp_path_factory):
    with Engine() as engine:
        walk = read_walk(engine, shared_data, tmp_path_factory.mktemp("walk"))
        joints = joints_of_model(walk.figures)
        rows, _ = balanced_coordinates(walk.figures.coordinates, walk.coordinates)
        found = {
            "walk": walk,
            "rows": rows,
            "joints": joints,
            "figures": MuscleFigures(**engine.call("muscle_figures")),
            "poses": engine.call("poses", coordinates=walk.coordinates),
            "moments": engine.call(
                "inverse_dynamics",
                coordinates=walk.coordinates,
                speeds=walk.speeds,
                accelerations=walk.accelerations,
                loads=walk.loads,
            ),
            "paths": engine.call(
                "muscle_paths",
                coordinates=walk.coordinates[FIRST : LAST + 1],
                speeds=walk.speeds[FIRST : LAST + 1],
                rows=rows,
                parts=[joint.below for joint in joints],
            ),
        }
    return found


@pytest.fixture(scope="module")
def theirs(ours):
    walk = ours["walk"]
    return muscle_oracle.ask(
        model=str(walk.model),
        names=np.array(walk.figures.coordinates),
        time=walk.time,
        coordinates=walk.coordinates,
        reactions=walk.reactions,
        first=FIRST,
        last=LAST,
        reserves=1,
    )


def knee_contact(ours, tension, side: int) -> np.ndarray:
    """Contact force on a tibia in its frame by Newton-Euler, kneecap as a pulley [N]."""
    walk, joint = ours["walk"], ours["joints"][side]
    figures, poses = walk.figures, ours["poses"]
    body = figures.bodies.index(joint.distal)
    rotation, origin = poses["rotations"][:, body], poses["origins"][:, body]
    centre = origin + rotation @ figures.joint_centres[joint.distal]
    segments = dynamics.momenta(
        poses["rotations"], poses["origins"], figures.masses, figures.centres, figures.inertias, RATE_HZ
    )
    reaction = dynamics.GroundReaction(*np.split(walk.reactions[:, side], 3, axis=1))
    net = dynamics.net_load(segments, figures.rows(joint.below), centre, [reaction])
    force = np.einsum("fji,fj->fi", rotation, net.force)[FIRST : LAST + 1]
    across = contact.crossing(
        ours["paths"]["pulls"][:, side], rotation[FIRST : LAST + 1], centre[FIRST : LAST + 1]
    )
    return force - np.einsum("fmi,fm->fi", across.pull, tension)


def test_inverse_dynamics_is_the_tools(ours, theirs):
    """Equal to 1e-6 of the largest moment or force of each coordinate that carries any."""
    size = np.abs(theirs["moments"]).max(axis=0)
    carrying = size > 1.0
    assert carrying.sum() > 20
    assert (np.abs(ours["moments"] - theirs["moments"])[:, carrying] <= 1e-6 * size[carrying]).all()


def test_muscle_forces_are_those_of_static_optimization(ours, theirs):
    moments = ours["moments"][FIRST : LAST + 1]
    columns = [ours["walk"].figures.coordinates.index(name) for name in ours["rows"]]
    paths, figures = ours["paths"], ours["figures"]
    found = recruit(paths["capacity"], paths["arms"], moments[:, columns], ours["rows"], {}, figures)
    assert figures.names == tuple(theirs["muscles"].tolist())
    assert found.tension.shape == theirs["forces"].shape
    correlation = np.corrcoef(found.tension.ravel(), theirs["forces"].ravel())[0, 1]
    assert correlation > 0.999
    weight = ours["walk"].figures.mass_kg * GRAVITY
    for side in (0, 1):
        apart = knee_contact(ours, found.tension, side) - theirs["knee_forces"][:, side]
        assert np.sqrt((apart**2).sum(axis=1).mean()) < 0.03 * weight


def test_contact_forces_are_those_of_joint_reaction(ours, theirs):
    """With the tool's own muscle forces the Newton-Euler result is the same to a hundredth of a newton."""
    for side in (0, 1):
        found = knee_contact(ours, theirs["forces"], side)
        assert np.abs(found - theirs["knee_forces"][:, side]).max() < 0.01
        assert np.linalg.norm(found, axis=1).max() > 500.0
