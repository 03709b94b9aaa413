"""The table that a domain is judged by: four sizes of mesh, knee and ankle, and ten very different people.

The ankle's map is bent by 120 degrees and drawn over the instep: its own limit is a mean of 1.04.
"""

from __future__ import annotations

import igl
import numpy as np
import pytest

from hilbrace.body.body import Body
from hilbrace.domain.edges import find_edges
from hilbrace.domain.flatten import map_gradients, quasi_conformal
from hilbrace.domain.limb import Surface, find_limb, limb_skin
from hilbrace.domain.loops import loop_length, loops_of
from hilbrace.domain.region import cut_region
from hilbrace.domain.remesh import mesh_quality
from hilbrace.domain.rest import RestDomain, rest_domain
from tests.unit.body_people import person
from tests.unit.domain_body import domain_settings

SIZES = (2000, 4000, 10000, 20000)
CONFORMAL = {"knee": 1.02, "ankle": 1.04}
PEOPLE = (
    (40.0, 1.45),
    (85.0, 1.50),
    (48.0, 1.55),
    (110.0, 1.62),
    (55.0, 1.70),
    (120.0, 1.75),
    (62.0, 1.82),
    (130.0, 1.90),
    (70.0, 1.98),
    (105.0, 2.05),
)
"""Mass [kg] and height [m]: short to tall, thin to heavy."""


def check(body: Body, **keys: object) -> RestDomain:
    wanted = domain_settings(**keys)
    rest = rest_domain(body, wanted)
    quality = mesh_quality(rest.surface)
    assert abs(quality.triangles / wanted.triangles - 1.0) <= 0.03
    assert quality.min_angle_deg >= 15.0
    points = rest.surface.vertices
    opened = points[rest.cut.weld]
    assert np.array_equal(opened[rest.cut.pairs[:, 0]], opened[rest.cut.pairs[:, 1]])
    turned = np.linalg.det(map_gradients(opened, rest.flat.uv, rest.cut.triangles))
    assert (turned > 0.0).all()
    jump = np.diff(rest.flat.uv[rest.cut.pairs], axis=1)[:, 0]
    if wanted.flatten == "periodic":
        assert np.abs(jump - [rest.flat.period_u, 0.0]).max() <= 1e-9
    if wanted.flatten == "lscm":
        ratio = quasi_conformal(opened, rest.flat.uv, rest.cut.triangles)
        assert ratio.mean() <= CONFORMAL[wanted.joint]
    assert igl.euler_characteristic(rest.surface.triangles) == -len(rest.loops.windows)
    return rest


def check_loops(body: Body, rest: RestDomain, joint: str, side: str) -> None:
    """Ends as long as the sections of the skin itself, refined far beyond any of the meshes."""
    limb = find_limb(body, joint, side)
    skin = limb_skin(body, limb)
    fine = cut_region(skin, limb, find_edges(skin, limb, domain_settings(joint=joint, side=side)), 1.0)
    loops = loops_of(fine, limb)
    for made, cut in ((rest.loops.upper, loops.upper), (rest.loops.lower, loops.lower)):
        assert np.isclose(loop_length(rest.surface, made), loop_length(fine, cut), rtol=1e-3)


QUICK = ((2000, "lscm"), (4000, "periodic"))
ALL = [(size, flatten) for size in SIZES for flatten in ("lscm", "periodic")]


@pytest.mark.parametrize("joint", ["knee", "ankle"])
@pytest.mark.parametrize(
    ("triangles", "flatten"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.soak) for case in ALL if case not in QUICK)],
)
def test_domains_of_every_size_keep_their_limits(triangles, joint, flatten):
    body = person()
    rest = check(body, joint=joint, side="right", triangles=triangles, flatten=flatten)
    check_loops(body, rest, joint, "right")


@pytest.mark.parametrize("joint", ["knee", "ankle"])
@pytest.mark.parametrize(
    "who",
    [
        PEOPLE[3],
        *(pytest.param(who, marks=pytest.mark.soak) for who in PEOPLE if who != PEOPLE[3]),
    ],
)
def test_people_short_and_tall_thin_and_heavy_have_mirrored_domains(who, joint):
    body = person(*who)
    windows = [{"at": "patella"}] if joint == "knee" else None
    left, right = (
        check(body, joint=joint, side=side, triangles=2000, flatten="lscm", windows=windows)
        for side in ("left", "right")
    )
    mirror = np.array([1.0, 1.0, -1.0])
    assert np.array_equal(left.surface.vertices * mirror, right.surface.vertices)
    assert np.array_equal(left.surface.triangles[:, [0, 2, 1]], right.surface.triangles)
    assert np.array_equal(left.cut.pairs[:, ::-1], right.cut.pairs)
    assert np.array_equal(left.flat.uv[:, 1], right.flat.uv[:, 1])
    for loop in ("upper", "lower"):
        assert np.array_equal(np.roll(getattr(left.loops, loop)[::-1], 1), getattr(right.loops, loop))
    check_loops(body, right, joint, "right")


def test_meshing_ends_where_no_better_mesh_is_to_be_had():
    """The count decides where count and angles cannot be had together."""
    surface = rest_domain(person(), domain_settings(side="right", triangles=400)).surface
    assert abs(mesh_quality(Surface(surface.vertices, surface.triangles)).triangles / 400 - 1.0) <= 0.03
