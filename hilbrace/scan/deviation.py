"""How well a fitted skin matches a scan: distances, where they are, girths, and whether it will do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from hilbrace.scan.free_form import FittedSkin
from hilbrace.scan.nearest import Nearest, nearest
from hilbrace.scan.surface_scan import SurfaceScan
from hilbrace.units import MM_PER_M

Array = np.ndarray

GOOD_MEAN, GOOD_95, GOOD_COVER = 1.0, 2.5, 0.9
"""A skin serves for a design where the scan lies on average and at 95 % within these distances [mm] and shows
this part of it [-]. Choices of this program: casts of silicone follow the skin within about a millimetre."""
ELSEWHERE = 30.0
"""Points farther off belong to something else: the other leg, the trunk, a chair [mm]."""
NEAR = 0.006
"""Skin with a point of the scan within this distance was seen [m]."""
REGION = (0.45, 0.45)
"""Parts of thigh and shank, counted from the knee, that a knee brace may cover [-]."""
STUMP_DEPTH = 0.03
"""Part of a limb's end that is looked at [m]."""
STUMP_WIDTH = 0.16
"""An adult's foot is longer than this, the end of a residual limb narrower [m]."""
STUMP_CLOSED = 0.12
"""Part of the end's surface that looks along the limb where it is closed [-]."""
_LEVELS = (("half-way up the thigh", "thigh", 0.5), ("a fifth above the knee", "thigh", 0.2))
_WORDS = ("in front", "lateral", "behind", "medial")


@dataclass(frozen=True)
class Deviation:
    """Distances of a scan from the fitted skin.

    Attributes:
        distance_mm: Signed distance of each point, outside positive [mm].
        counted: Points that belong to the limb.
        mean_mm: Mean of the absolute distances [mm].
        p95_mm: 95 % are below this [mm].
        max_mm: The largest [mm].
        worst: Where that is, in words.
        elsewhere: Points that belong to something else.
        cover: Part of the skin around the knee that the scan shows [-].
        model_mean_mm: Mean distance before the free displacement [mm].
        stump: What says that the limb ends where the model's goes on; empty if it does not.
    """

    distance_mm: Float[Array, " point"]
    counted: Bool[Array, " point"]
    mean_mm: float
    p95_mm: float
    max_mm: float
    worst: str
    elsewhere: int
    cover: float
    model_mean_mm: float
    stump: str

    @property
    def doubts(self) -> list[str]:
        """Why a design should not be made on this skin; nothing if it may."""
        found = [self.stump] if self.stump else []
        if self.mean_mm > GOOD_MEAN:
            found.append(f"mean distance {self.mean_mm:.2f} mm, above {GOOD_MEAN:.1f}")
        if self.p95_mm > GOOD_95:
            found.append(f"95 % of the distances reach {self.p95_mm:.2f} mm, above {GOOD_95:.1f}")
        if self.cover < GOOD_COVER:
            found.append(
                f"the scan shows {100 * self.cover:.0f} % of the skin around the knee, less than"
                f" {100 * GOOD_COVER:.0f}: the rest is the model's guess"
            )
        return found


def deviation(skin: FittedSkin, scan: SurfaceScan) -> Deviation:
    """Hold a scan against the fitted skin.

    Args:
        skin: The fitted skin.
        scan: The scan.
    """
    near = nearest(scan.points, skin.vertices, skin.triangles)
    signed = _signed(near, scan.points)
    before = MM_PER_M * nearest(scan.points, skin.model, skin.triangles).distance
    # What lies beyond the cut edge of the limb's skin is compared with nothing.
    counted = (np.abs(signed) < ELSEWHERE) & ~near.beyond
    if not counted.any():
        counted = np.ones(len(signed), dtype=bool)
    off = np.abs(signed[counted])
    worst = scan.points[counted][off.argmax()]
    return Deviation(
        distance_mm=signed,
        counted=counted,
        mean_mm=float(off.mean()),
        p95_mm=float(np.percentile(off, 95.0)),
        max_mm=float(off.max()),
        worst=place_in_words(skin, worst),
        elsewhere=int((~counted).sum()),
        cover=_cover(skin, scan),
        model_mean_mm=float(np.minimum(before[counted], ELSEWHERE).mean()),
        stump=_stump(skin, scan),
    )


def place_in_words(skin: FittedSkin, point: Float[Array, "3"]) -> str:
    """A place on a leg: how far above or below the knee, and on which side of it."""
    side = min(skin.fit.limb.sides, key=lambda one: np.linalg.norm(point - skin.joints[f"knee_{one}"]))
    knee, axes = skin.joints[f"knee_{side}"], _axes_at(skin, side, point)
    level = float((point - knee) @ axes[1]) * MM_PER_M
    line = _axis_point(skin, side, point)
    ahead, right = (point - line) @ axes[0], (point - line) @ axes[2]
    lateral = right if side == "r" else -right
    strongest = int(np.argmax([ahead, lateral, -ahead, -lateral]))
    height = f"{abs(level):.0f} mm {'above' if level > 0 else 'below'} the knee"
    name = {"r": "right", "l": "left"}[side]
    return f"{name} leg, {height}, {_WORDS[strongest]}"


def girths(skin: FittedSkin) -> dict[str, float]:
    """Girths of each leg by name [mm], across the segment's own axis."""
    found: dict[str, float] = {}
    for side in skin.fit.limb.sides:
        hip, knee, ankle = (skin.joints[f"{joint}_{side}"] for joint in ("hip", "knee", "ankle"))
        for words, _, share in _LEVELS:
            found[f"{words} ({side})"] = _girth(skin, side, knee + share * (hip - knee), hip - knee)
        found[f"knee ({side})"] = _girth(skin, side, knee, hip - ankle)
        below = [
            _girth(skin, side, knee + share * (ankle - knee), knee - ankle)
            for share in np.linspace(0.15, 0.95, 33)
        ]
        found[f"widest of the calf ({side})"] = max(below[:20])
        found[f"narrowest above the ankle ({side})"] = min(below[16:])
    return found


def _signed(near: Nearest, points: Float[Array, "point 3"]) -> Float[Array, " point"]:
    """Distance of points, outside positive [mm]."""
    outside = ((points - near.place) * near.normal).sum(axis=1)
    return np.where(outside < 0.0, -1.0, 1.0) * near.distance * MM_PER_M


def _cover(skin: FittedSkin, scan: SurfaceScan) -> float:
    tree = cKDTree(scan.points)
    seen, all_of = 0, 0
    for side in skin.fit.limb.sides:
        knee = skin.joints[f"knee_{side}"]
        thigh = skin.joints[f"hip_{side}"] - knee
        shank = skin.joints[f"ankle_{side}"] - knee
        up = (skin.vertices - knee) @ thigh / (thigh @ thigh)
        down = (skin.vertices - knee) @ shank / (shank @ shank)
        own = (up < REGION[0]) & (down < REGION[1]) & _own_side(skin, side)
        gap = tree.query(skin.vertices[own], distance_upper_bound=NEAR)[0]
        seen, all_of = seen + int(np.isfinite(gap).sum()), all_of + int(own.sum())
    return seen / max(1, all_of)


def _own_side(skin: FittedSkin, side: str) -> Bool[Array, " vertex"]:
    first = 1 + 3 * skin.fit.limb.sides.index(side)
    return (skin.part >= first) & (skin.part < first + 3)


def _stump(skin: FittedSkin, scan: SurfaceScan) -> str:
    """The closed end of a limb that has no foot, in words.

    A sole is closed as well, but much longer; the cut end of a scan is open. Which way the leg stands is not
    asked: a stump may have been fitted upside down.
    """
    up = skin.fit.pose.rotation[:, 1]
    for downward in (-up,) if len(skin.fit.limb.sides) > 1 else (-up, up):
        depth = scan.points @ downward
        end = depth > depth.max() - STUMP_DEPTH
        last = scan.points[end] - np.outer(scan.points[end] @ downward, downward)
        centred = last - last.mean(axis=0)
        along = np.linalg.eigh(centred.T @ centred)[1][:, -1]
        length = float(np.ptp(centred @ along))
        facing = np.abs(scan.normals[end] @ downward) > 0.7
        if facing.mean() > STUMP_CLOSED and length < STUMP_WIDTH:
            x, y, z = scan.points[depth.argmax()] * MM_PER_M
            return (
                f"the limb ends in a closed stump {length * MM_PER_M:.0f} mm wide, without a foot"
                f" (at {x:.0f}, {y:.0f}, {z:.0f} mm in the scan's axes): no leg"
                " that the model can be"
            )
    return ""


def _axis_point(skin: FittedSkin, side: str, point: Float[Array, "3"]) -> Float[Array, "3"]:
    """Nearest point of the leg's axis, hip to knee to ankle."""
    knee = skin.joints[f"knee_{side}"]
    end = skin.joints[f"hip_{side}"] if _above(skin, side, point) else skin.joints[f"ankle_{side}"]
    arrow = end - knee
    return knee + np.clip((point - knee) @ arrow / (arrow @ arrow), 0.0, 1.0) * arrow


def _above(skin: FittedSkin, side: str, point: Float[Array, "3"]) -> bool:
    return bool(
        (point - skin.joints[f"knee_{side}"]) @ (skin.joints[f"hip_{side}"] - skin.joints[f"ankle_{side}"])
        > 0
    )


def _axes_at(skin: FittedSkin, side: str, point: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Forward, upward and rightward directions of the segment at a point."""
    knee = skin.joints[f"knee_{side}"]
    up = (
        skin.joints[f"hip_{side}"] - knee
        if _above(skin, side, point)
        else knee - skin.joints[f"ankle_{side}"]
    )
    up = up / np.linalg.norm(up)
    right = skin.fit.pose.rotation[:, 2] - (skin.fit.pose.rotation[:, 2] @ up) * up
    right /= np.linalg.norm(right)
    return np.stack([np.cross(up, right), up, right])


def _girth(skin: FittedSkin, side: str, point: Array, normal: Array) -> float:
    """Length of the cut of one leg's skin by a plane [mm]."""
    height = (skin.vertices - point) @ (normal / np.linalg.norm(normal))
    own = skin.triangles[_own_side(skin, side)[skin.triangles].any(axis=1)]
    levels = height[own]
    cut = own[(levels.min(axis=1) < 0.0) & (levels.max(axis=1) >= 0.0)]
    if not len(cut):
        return 0.0
    corners, levels = skin.vertices[cut], height[cut]
    ends = []
    for first, second in ((0, 1), (1, 2), (2, 0)):
        a, b = levels[:, first], levels[:, second]
        crossed = (a < 0.0) != (b < 0.0)
        share = np.where(crossed, a / np.where(crossed, a - b, 1.0), np.nan)[:, None]
        ends.append(corners[:, first] + share * (corners[:, second] - corners[:, first]))
    stacked = np.stack(ends, axis=1)
    order = np.argsort(np.isnan(stacked[:, :, 0]), axis=1, kind="stable")[:, :2]
    pair = np.take_along_axis(stacked, order[:, :, None], axis=1)
    return float(np.linalg.norm(pair[:, 0] - pair[:, 1], axis=1).sum() * MM_PER_M)
