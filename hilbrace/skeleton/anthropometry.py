"""How large each segment of a person is, from markers on a standing subject.

A factor is the ratio of a distance between two markers on the person to the same distance on the model in its
neutral pose; several pairs, and both sides, are averaged. The rules, first one that has its markers:

========= ======================================================================== ===================
segment   pairs                                                                    factors set
========= ======================================================================== ===================
pelvis    ASIS to ASIS; else PSIS to PSIS                                          x y z
thigh     hip centre to the epicondyles; else ASIS to the epicondyles              x y z, with patella
shank     epicondyles to malleoli, lateral and medial                              x y z
foot      heel to toe and to 5th metatarsal                                        x y z
trunk     C7 and acromia to PSIS; else to ASIS; else clavicle to ASIS              x y
shoulders acromion to acromion; else as the trunk's length                         z
upper arm acromion to the elbow's epicondyles                                      x y z
forearm   elbow's epicondyles to the wrist                                         x y z, with hand
========= ======================================================================== ===================

The hip centre is a landmark (``RHJC``, ``LHJC``) where the recording has one; else it is that of the scaled
pelvis laid on the pelvis markers, so that the thigh fits between the model's hip and the person's knee. The
depth from ASIS to PSIS is not used: soft tissue makes it read long. A segment without markers takes the ratio
of the heights, or the mean of the segments that were measured where the height is unknown.

Without a standing trial the same pairs are measured over a motion. A pair on one bone has its median length;
a pair that spans a joint comes nearest to the neutral pose when its limb is straight, so that it is measured
in the quarter of the frames in which its limb (ASIS to malleolus, acromion to wrist or to ASIS) is longest.
The pelvis, too, is measured where a leg is straight, since a bent hip moves the skin over the ASIS.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.skeleton.kinematics import Skeleton, skeleton_from_table
from hilbrace.skeleton.table import Table

Array = np.ndarray
Landmarks = Mapping[str, Float[Array, "... 3"]]
"""Places [m] of a person's markers by the model's marker names, y up: one each while standing, or one per
frame of a motion. NaN counts as missing."""
Scales = Mapping[str, Float[Array, " 3"]]
"""Factors along x, y, z of each body's frame, by body; a body left out keeps its size."""

MODEL_HEIGHT_M = 1.70
"""Height of the man whom the unscaled model represents [m] (Rajagopal et al. 2016)."""

STRAIGHT = 0.75
"""Quantile of a limb's length from which a frame of a motion counts as straight [-]."""

_PLAUSIBLE = (0.5, 1.6)
_PELVIS = ("RASI", "LASI", "RPSI", "LPSI")
_XYZ = (0, 1, 2)


@dataclass(frozen=True)
class SegmentRule:
    """How one segment is measured.

    Attributes:
        segment: Name for people.
        bodies: Bodies of the model that take the factor; ``{s}`` stands for r and l.
        axes: Axes of the bodies' frames that take it.
        choices: Lists of marker pairs, best first; ``{S}`` stands for R and L.
        limb: Ends of the limb that has to be straight for the pairs to be as in the neutral pose; ``None``
            where a pair lies on one bone. A limb without these markers is taken as long as the pair.
    """

    segment: str
    bodies: tuple[str, ...]
    axes: tuple[int, ...]
    choices: tuple[tuple[tuple[str, str], ...], ...]
    limb: tuple[str, str] | None = None


@dataclass(frozen=True)
class SegmentFactor:
    """What a rule gave.

    Attributes:
        segment: Name for people.
        factor: Size relative to the model [-].
        pairs: Marker pairs that were measured; empty where the factor comes from the height or from the
            other segments.
    """

    segment: str
    factor: float
    pairs: tuple[tuple[str, str], ...]


RULES = (
    SegmentRule(
        "pelvis", ("pelvis",), _XYZ, ((("RASI", "LASI"),), (("RPSI", "LPSI"),)), ("{S}ASI", "{S}LMAL")
    ),
    SegmentRule(
        "thigh",
        ("femur_{s}", "patella_{s}"),
        _XYZ,
        ((("{S}HJC", "{S}LFC"), ("{S}HJC", "{S}MFC")), (("{S}ASI", "{S}LFC"), ("{S}ASI", "{S}MFC"))),
        ("{S}ASI", "{S}LMAL"),
    ),
    SegmentRule(
        "shank",
        ("tibia_{s}",),
        _XYZ,
        ((("{S}LFC", "{S}LMAL"), ("{S}MFC", "{S}MMAL")),),
        ("{S}ASI", "{S}LMAL"),
    ),
    SegmentRule(
        "foot",
        ("talus_{s}", "calcn_{s}", "toes_{s}"),
        _XYZ,
        ((("{S}CAL", "{S}TOE"), ("{S}CAL", "{S}MT5")),),
    ),
    SegmentRule(
        "trunk",
        ("torso",),
        (0, 1),
        (
            (("C7", "{S}PSI"), ("{S}ACR", "{S}PSI")),
            (("C7", "{S}ASI"), ("{S}ACR", "{S}ASI")),
            (("CLAV", "{S}ASI"),),
        ),
        ("{S}ACR", "{S}ASI"),
    ),
    SegmentRule("shoulders", ("torso",), (2,), ((("RACR", "LACR"),),)),
    SegmentRule(
        "upper arm",
        ("humerus_{s}",),
        _XYZ,
        ((("{S}ACR", "{S}LEL"), ("{S}ACR", "{S}MEL")),),
        ("{S}ACR", "{S}FAradius"),
    ),
    SegmentRule(
        "forearm",
        ("ulna_{s}", "radius_{s}", "hand_{s}"),
        _XYZ,
        (
            (
                ("{S}LEL", "{S}FAradius"),
                ("{S}LEL", "{S}FAulna"),
                ("{S}MEL", "{S}FAradius"),
                ("{S}MEL", "{S}FAulna"),
            ),
        ),
        ("{S}ACR", "{S}FAradius"),
    ),
)


def segment_scales(
    landmarks: Landmarks, table: Table, height_m: float = 0.0
) -> dict[str, Float[Array, " 3"]]:
    """Scale factors of all bodies of the model, from the landmarks of a standing or moving person.

    Args:
        landmarks: Places of markers [m], named as the model's; one each, or one per frame of a motion.
        table: Figures of the unscaled model.
        height_m: Height of the person [m]; 0 where unknown.

    Returns:
        Factors along x, y, z by body.

    Raises:
        InputError: Nothing can be measured, or a segment comes out implausibly large or small.
    """
    scales = {body: np.ones(3) for body in table["bodies"]}
    for rule, measured in zip(RULES, measure_segments(landmarks, table, height_m), strict=True):
        for template in rule.bodies:
            for side in "rl":
                scales[template.format(s=side)][list(rule.axes)] = measured.factor
    return scales


def measure_segments(landmarks: Landmarks, table: Table, height_m: float = 0.0) -> tuple[SegmentFactor, ...]:
    """The factor of each segment and where it came from, in the order of `RULES`.

    Args:
        landmarks: Places of markers [m], named as the model's; one each, or one per frame of a motion.
        table: Figures of the unscaled model.
        height_m: Height of the person [m]; 0 where unknown.

    Raises:
        InputError: Nothing can be measured, or a segment comes out implausibly large or small.
    """
    skeleton = skeleton_from_table(table)
    paths = {n: np.asarray(p, dtype=float).reshape(-1, 3) for n, p in landmarks.items()}
    seen = {n: p for n, p in paths.items() if np.isfinite(p).all(axis=1).any()}
    model = dict(zip(skeleton.marker_body, skeleton.markers(skeleton.forward({}))[0], strict=True))
    pelvis = _measure(RULES[0], seen, model)
    if pelvis is not None:
        seen = {**hip_centres(seen, skeleton, pelvis.factor), **seen}
    measured = [pelvis, *(_measure(rule, seen, model) for rule in RULES[1:])]
    shoulders, trunk = _index("shoulders"), _index("trunk")
    trunk_factor = measured[trunk]
    if measured[shoulders] is None and trunk_factor is not None:
        measured[shoulders] = SegmentFactor("shoulders", trunk_factor.factor, ())
    common = _common_factor([item.factor for item in measured if item is not None], height_m)
    return tuple(
        SegmentFactor(rule.segment, common, ()) if item is None else item
        for rule, item in zip(RULES, measured, strict=True)
    )


def hip_centres(
    landmarks: Landmarks, skeleton: Skeleton, pelvis_factor: float
) -> dict[str, Float[Array, "... 3"]]:
    """Hip centres of the scaled pelvis laid on the pelvis markers by least squares, frame by frame.

    Args:
        landmarks: Places of markers [m]; at least three of RASI, LASI, RPSI, LPSI.
        skeleton: The unscaled model.
        pelvis_factor: Size of the person's pelvis relative to the model's [-].

    Returns:
        ``{"RHJC": place, "LHJC": place}`` [m]; empty with fewer markers.
    """
    names = [name for name in _PELVIS if name in landmarks]
    if len(names) < 3:
        return {}
    source = np.stack([skeleton.marker_location[name] for name in names]) * pelvis_factor
    hips = {side: skeleton.joints[f"femur_{side.lower()}"].parent_origin for side in "RL"}
    paths = np.stack([landmarks[name] for name in names], axis=-2)
    frames = paths.reshape(-1, len(names), 3)
    found = {side: np.full((len(frames), 3), np.nan) for side in hips}
    for frame in np.flatnonzero(np.isfinite(frames).all(axis=(1, 2))):
        rotation, shift = rigid_fit(source, frames[frame])
        for side, hip in hips.items():
            found[side][frame] = rotation @ (hip * pelvis_factor) + shift
    return {f"{side}HJC": place.reshape(*paths.shape[:-2], 3) for side, place in found.items()}


def rigid_fit(
    source: Float[Array, "point 3"], target: Float[Array, "point 3"]
) -> tuple[Float[Array, "3 3"], Float[Array, " 3"]]:
    """Rotation and shift that carry points onto others with least squared distance (Kabsch 1976).

    Args:
        source: At least three points that are not on one line.
        target: Where they shall go, in the same order.

    Returns:
        Rotation matrix R and shift t with R @ source + t close to target.
    """
    middle_source, middle_target = source.mean(axis=0), target.mean(axis=0)
    left, _, right = np.linalg.svd((target - middle_target).T @ (source - middle_source))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ proper @ right
    return rotation, middle_target - rotation @ middle_source


def _measure(rule: SegmentRule, seen: Landmarks, model: Landmarks) -> SegmentFactor | None:
    for choice in rule.choices:
        pairs = dict.fromkeys((a.format(S=s), b.format(S=s), s) for s in "RL" for a, b in choice)
        lengths = {(a, b): _length(rule, a, b, side, seen) for a, b, side in pairs}
        ratios = {
            (a, b): length / float(np.linalg.norm(model[a] - model[b]))
            for (a, b), length in lengths.items()
            if np.isfinite(length)
        }
        if not ratios:
            continue
        factor = float(np.mean(list(ratios.values())))
        if not _PLAUSIBLE[0] <= factor <= _PLAUSIBLE[1]:
            raise InputError(
                f"the {rule.segment} measures {factor:.2f} times the model's",
                where=", ".join(f"{a}-{b}" for a, b in ratios),
                hint="check the unit of the markers, the marker map, and left against right",
            )
        return SegmentFactor(rule.segment, factor, tuple(ratios))
    return None


def _length(rule: SegmentRule, first: str, second: str, side: str, seen: Landmarks) -> float:
    """Median distance of two markers over the frames in which the limb is straight [m]; NaN if unseen."""
    own = _distances(first, second, seen)
    if not np.isfinite(own).any():
        return float("nan")
    chosen = np.isfinite(own)
    if rule.limb is not None:
        start, end = (name.format(S=side) for name in rule.limb)
        limb = np.where(chosen, _distances(start, end, seen), np.nan)
        limb = limb if np.isfinite(limb).any() else own
        chosen = limb >= np.nanquantile(limb, STRAIGHT)
    return float(np.median(own[chosen]))


def _distances(first: str, second: str, seen: Landmarks) -> Float[Array, " frame"]:
    if first not in seen or second not in seen:
        return np.full(1, np.nan)
    return np.linalg.norm(seen[first] - seen[second], axis=-1)


def _common_factor(measured: list[float], height_m: float) -> float:
    if height_m > 0:
        return height_m / MODEL_HEIGHT_M
    if not measured:
        raise InputError(
            "no segment can be measured from the static markers",
            where="segment_scales",
            hint="map pelvis, knee and ankle markers, or give subject.height_m",
        )
    return float(np.mean(measured))


def _index(segment: str) -> int:
    return next(i for i, rule in enumerate(RULES) if rule.segment == segment)
