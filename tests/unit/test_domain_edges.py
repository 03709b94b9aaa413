from __future__ import annotations

import numpy as np
import pytest

from hilbrace.domain.edges import PRESETS, find_edges
from hilbrace.domain.landmarks import LANDMARKS, find_landmark
from hilbrace.domain.limb import find_limb, limb_skin
from hilbrace.domain.loops import loops_of
from hilbrace.domain.region import cut_region
from hilbrace.errors import ConfigError, GeometryError, HilbraceError
from tests.unit.domain_body import LEFT, domain_settings, synthetic_body


def edges_for(side="right", joint="knee", **keys):
    limb = find_limb(synthetic_body(), joint, side)
    skin = limb_skin(synthetic_body(), limb)
    return skin, limb, find_edges(skin, limb, domain_settings(joint=joint, side=side, **keys))


def refuse(kind: type[HilbraceError], *words: str, **keys):
    with pytest.raises(kind) as caught:
        edges_for(**keys)
    for word in words:
        assert word in caught.value.two_lines()


@pytest.mark.parametrize("joint", ["knee", "ankle"])
def test_presets_lie_at_fractions_of_both_segments(joint):
    _, limb, (upper, lower) = edges_for(joint=joint)
    above, below = PRESETS[joint]
    assert np.isclose(upper.offset, above * np.linalg.norm(limb.upper))
    assert np.isclose(lower.offset, below * limb.lower @ limb.distal)
    _, _, (upper, lower) = edges_for(joint=joint, above=0.3, below=0.5)
    assert np.isclose(upper.offset, 0.3 * np.linalg.norm(limb.upper))
    assert np.isclose(lower.offset, 0.5 * limb.lower @ limb.distal)


def test_an_edge_at_a_landmark_runs_through_it():
    skin, limb, (upper, lower) = edges_for(
        upper_edge={"landmark": "patella", "offset_mm": 70.0},
        lower_edge={"landmark": "tibial_tuberosity", "offset_mm": 40.0},
    )
    for edge, name, offset in ((upper, "patella", 70.0), (lower, "tibial_tuberosity", 40.0)):
        place = find_landmark(skin, limb, name, "here").position
        assert np.isclose(edge.normal @ place + offset, edge.offset)
    region = cut_region(skin, limb, (upper, lower), 15.0)
    loops = loops_of(region, limb)
    assert np.allclose(region.vertices[loops.upper] @ upper.normal, upper.offset)
    assert np.allclose(region.vertices[loops.lower] @ lower.normal, lower.offset)


def test_a_plane_is_given_in_the_rest_frame_on_both_sides():
    plane = {"point_mm": (0.0, 120.0, 10.0), "normal": (0.2, 1.0, 0.1)}
    _, limb, (right, _) = edges_for("right", upper_edge=plane)
    _, _, (left, _) = edges_for(
        "left", upper_edge={"point_mm": (0.0, 120.0, -10.0), "normal": (-0.2, -1.0, 0.1)}
    )
    assert np.allclose(right.normal, left.normal)
    assert np.isclose(right.offset, left.offset)
    assert np.isclose(right.normal @ [0.0, 120.0, 10.0], right.offset)
    assert np.array_equal(limb.rest_frame(np.ones(3)), np.ones(3))
    _, _, (across, _) = edges_for(upper_edge={"point_mm": (0.0, 120.0, 0.0)})
    assert np.allclose(across.normal, limb.proximal)


def test_edges_that_make_no_sense_are_refused_by_key():
    beside = {"point_mm": (0.0, 100.0, 0.0)}
    refuse(ConfigError, "domain.above and domain.upper_edge", "leave one", above=0.3, upper_edge=beside)
    refuse(ConfigError, "domain.below and domain.lower_edge", below=0.3, lower_edge=beside)
    refuse(ConfigError, "by a landmark or by a point", "domain.upper_edge.landmark", upper_edge={})
    both = {"landmark": "patella", **beside}
    refuse(ConfigError, "by a landmark or by a point", upper_edge=both)
    refuse(ConfigError, "domain.lower_edge.normal", lower_edge={**beside, "normal": (0.0, 0.0, 0.0)})
    refuse(ConfigError, "no landmark 'heel'", "patella", upper_edge={"landmark": "heel"})
    refuse(GeometryError, "does not lie above the knee", upper_edge={"landmark": "tibial_tuberosity"})
    refuse(GeometryError, "does not lie below the knee", lower_edge=beside)
    refuse(GeometryError, "domain.upper_edge", upper_edge={**beside, "normal": (1.0, 0.0, 0.0)})


@pytest.mark.parametrize("side", ["right", "left"])
def test_landmarks_lie_on_the_skin_where_their_names_say(side):
    body = synthetic_body()
    for joint, names in LANDMARKS.items():
        limb = find_limb(body, joint, side)
        skin = limb_skin(body, limb)
        for name in names:
            mark = find_landmark(skin, limb, name, "here")
            assert np.linalg.norm(skin.vertices - mark.position, axis=1).min() < 20.0
            assert abs(mark.outward @ mark.upward) < 1e-12
            if name.startswith(("lateral", "medial")):
                place = limb.rest_frame(mark.position) * (1.0 if side == "right" else LEFT)
                assert place[2] * (1.0 if name.startswith("lateral") else -1.0) > 25.0
        marks = {name: find_landmark(skin, limb, name, "here").position for name in names}
        if joint == "knee":
            assert marks["patella"][0] > 40.0 > -30.0 > marks["popliteal_fossa"][0]
            assert marks["tibial_tuberosity"][1] < marks["patella"][1]
        else:
            assert marks["heel"][0] < -35.0
            assert marks["heel"][1] < -35.0
            assert marks["instep"][0] > 20.0


def test_a_landmark_in_a_hole_is_refused():
    body = synthetic_body()
    limb = find_limb(body, "knee", "right")
    skin = limb_skin(body, limb)
    front = skin.vertices[skin.triangles].mean(axis=1)[:, 0] > 0.0
    torn = type(skin)(skin.vertices, skin.triangles[~front])
    with pytest.raises(GeometryError, match="no skin was met where the patella"):
        find_landmark(torn, limb, "patella", "domain.windows[0].at")
