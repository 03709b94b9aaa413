"""One leg of a body, always seen as a right leg with the braced joint at the origin, in mm.

A left leg is mirrored in the sagittal plane on the way in and mirrored back on the way out. Whatever is
done in between is therefore the same for both sides: a mirrored body has exactly the mirrored domain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.body.body import Body
from hilbrace.errors import GeometryError
from hilbrace.units import MM_PER_M

Array = np.ndarray

_GRID = 2.0**20
"""Skin and joint centres are rounded to this part of a millimetre, so that both legs of a symmetric body,
whose figures differ in their last bits, have the same domain bit by bit."""

_OFF_TIE = 0.3819660113
"""Rounding parts numbers here, where figures of single precision never lie (they lie on halves) [-]."""

_MIRROR = np.array([1.0, 1.0, -1.0])

_LATERAL = np.array([0.0, 0.0, 1.0])

_NEIGHBOURS = {"knee": ("hip", "ankle"), "ankle": ("knee", None)}
"""Joints at the far ends of the segments above and below a joint; below the ankle there is the foot."""


@dataclass(frozen=True)
class Surface:
    """A triangle mesh [mm], outward orientation."""

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]


@dataclass(frozen=True)
class Limb:
    """The two segments that meet in a joint, in limb axes: x anterior, y up, z lateral, joint at the origin.

    Attributes:
        name: ``"knee"`` or ``"ankle"``.
        side: ``"left"`` or ``"right"``, the leg this is in the body.
        upper: Far end of the segment above: hip or knee centre [mm].
        lower: Far end of the segment below: ankle centre, or the axis of the foot at the toes' tips [mm].
        distal: Unit normal of sections across the segment below: along the shank, or along the sole [-].
        other: Centre of the same joint of the other leg [mm].
        centre_m: Centre of the joint in the body's axes [m].
    """

    name: str
    side: str
    upper: Float[Array, " xyz"]
    lower: Float[Array, " xyz"]
    distal: Float[Array, " xyz"]
    other: Float[Array, " xyz"]
    centre_m: Float[Array, " xyz"]

    @property
    def joint(self) -> str:
        """Name of the braced joint: ``knee_l``, ``ankle_r``, ..."""
        return f"{self.name}_{self.side[0]}"

    @property
    def proximal(self) -> Float[Array, " xyz"]:
        """Unit normal of sections across the segment above, away from the joint [-]."""
        return self.upper / np.linalg.norm(self.upper)

    def azimuth(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point"]:
        """Angle of points about the limb's axis [rad]: 0 anterior, 90 deg lateral, 180 deg posterior.

        The axis runs from the upper end through the joint to the lower end, prolonged at both. About the
        foot, 0 is dorsal and 180 deg plantar; behind a bent joint the heel goes on from one to the other.
        """
        away, front, corner = self._from_axis(points)
        behind = (away * (_front(self.proximal) + _front(-self.lower))).sum(axis=-1)
        beside = np.copysign(np.linalg.norm(away[..., :2], axis=-1), behind)
        return np.arctan2(away[..., 2], np.where(corner, beside, (away * front).sum(axis=-1)))

    def distance(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point"]:
        """Distance of points to the limb's axis [mm]."""
        return np.linalg.norm(self._from_axis(points)[0], axis=-1)

    def _from_axis(
        self, points: Float[Array, "*point 3"]
    ) -> tuple[Float[Array, "*point 3"], Float[Array, "*point 3"], Bool[Array, "*point"]]:
        """Way from the nearest place of the axis, front of the segment there, and whether it is the joint."""
        ends = (self.proximal, self.lower / np.linalg.norm(self.lower))
        along = [np.maximum(points @ end, 0.0) for end in ends]
        away = [points - reach[..., None] * end for reach, end in zip(along, ends, strict=True)]
        above = (np.linalg.norm(away[0], axis=-1) <= np.linalg.norm(away[1], axis=-1))[..., None]
        corner = (along[0] == 0.0) & (along[1] == 0.0)
        return np.where(above, *away), np.where(above, _front(ends[0]), _front(-ends[1])), corner

    def inwards(self, points_m: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points of the body [m] in limb axes [mm]."""
        points = self.rest_frame((points_m - self.centre_m) * MM_PER_M)
        return np.floor(points * _GRID + _OFF_TIE) / _GRID

    def rest_frame(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points in limb axes in the brace's rest frame, z to the subject's right [mm]; and back again."""
        return points * _MIRROR if self.side == "left" else points

    def winding(self, triangles: Int[Array, "triangle 3"]) -> Int[Array, "triangle 3"]:
        """Triangles turned so that they stay outward when their vertices are mirrored."""
        return np.ascontiguousarray(triangles[:, [0, 2, 1]]) if self.side == "left" else triangles


def find_limb(body: Body, joint: str, side: str) -> Limb:
    """The segments that meet in a joint of a body.

    Args:
        body: The body in the neutral pose.
        joint: ``"knee"`` or ``"ankle"``.
        side: ``"left"`` or ``"right"``.

    Raises:
        GeometryError: The body lacks a joint or a foot, or the joints do not lie above each other.
    """
    letter, opposite = side[0], {"left": "r", "right": "l"}[side]
    above, below = _NEIGHBOURS[joint]
    here = _centre(body, f"{joint}_{letter}", side)
    blank = np.zeros(3)
    frame = Limb(joint, side, blank, blank, blank, blank, here)
    upper = frame.inwards(_centre(body, f"{above}_{letter}", side))
    other = frame.inwards(_centre(body, f"{joint}_{opposite}", side))
    if below is None:
        skin = limb_skin(body, frame)
        lower, distal = _foot(skin.vertices[np.unique(skin.triangles)], other, side)
    else:
        lower = frame.inwards(_centre(body, f"{below}_{letter}", side))
        distal = lower / np.linalg.norm(lower)
    if not (upper[1] > 50.0 and lower[1] < -20.0):
        raise GeometryError(
            f"{above} {upper[1]:.0f} mm above and {below or 'foot'} {-lower[1]:.0f} mm below the {joint} "
            "make no leg",
            where=f"joint centres of the {side} leg",
            hint="give the body in metres, y up, in the neutral pose",
        )
    return Limb(joint, side, upper, lower, distal, other, here)


def limb_skin(body: Body, limb: Limb) -> Surface:
    """The whole skin of a body in limb axes [mm], in an order that does not tell one leg from the other.

    Vertices come by height, then from back to front and from medial to lateral (`skin_order`); triangles
    start at their lowest corner.
    """
    order = skin_order(body, limb)
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    triangles = number[limb.winding(body.triangles.astype(np.int64))]
    turn = (np.argmin(triangles, axis=1)[:, None] + np.arange(3)) % 3
    triangles = np.take_along_axis(triangles, turn, axis=1)
    return Surface(limb.inwards(body.vertices)[order], triangles[np.lexsort(triangles.T[::-1])])


def skin_order(body: Body, limb: Limb) -> Int[Array, " vertex"]:
    """Vertex of the body that each vertex of `limb_skin` is."""
    x, y, z = limb.inwards(body.vertices).T
    return np.lexsort((z, x, y))


def _front(upwards: Float[Array, " xyz"]) -> Float[Array, " xyz"]:
    """Unit direction to the front of a segment, normal to its axis and to the lateral direction."""
    front = np.cross(upwards, _LATERAL)
    return front / np.linalg.norm(front)


def _centre(body: Body, name: str, side: str) -> Float[Array, " xyz"]:
    if name not in body.joint_names:
        raise GeometryError(
            f"the body has no joint {name}",
            where=f"domain.side = {side!r}",
            hint="the body needs the centres of both hips, knees and ankles",
        )
    return np.asarray(body.joint_centres[body.joint_names.index(name)], float)


_SECTION = 0.45
"""Where the middle of the foot is taken, fraction of the way from the ankle to the toes' tips [-]."""


def _foot(
    skin: Float[Array, "vertex 3"], other: Float[Array, " xyz"], side: str
) -> tuple[Float[Array, " xyz"], Float[Array, " xyz"]]:
    """End of the foot's axis at the toes, and the direction of the sole from heel to toes.

    The direction is that from the middle of the heel to the middle of the forefoot, level with the ground;
    the axis leads from the ankle through the middle of the section across the midfoot.
    """
    below = skin[(skin[:, 1] < 0.0) & (skin[:, 2] > other[2] / 2.0) & (np.hypot(*skin[:, [0, 2]].T) < 400.0)]
    if not len(below) or np.ptp(below[:, 0]) < 100.0 or below[:, 0].max() < 80.0:
        raise GeometryError(
            f"the skin has no foot in front of the {side} ankle",
            where="domain.joint = 'ankle'",
            hint="give a body or scan with its feet, toes to the front (x), soles below the ankles (y)",
        )
    start, length = below[:, 0].min(), np.ptp(below[:, 0])
    heel, ball = (
        _middle(below[(below[:, 0] >= start + a * length) & (below[:, 0] <= start + b * length)])
        for a, b in ((0.0, 0.25), (0.55, 0.80))
    )
    sole = np.array([ball[0] - heel[0], 0.0, ball[2] - heel[2]])
    sole /= np.linalg.norm(sole)
    reach = float((below @ sole).max())
    section = below[np.abs(below @ sole - _SECTION * reach) < 0.08 * reach]
    across = np.cross(sole, [0.0, 1.0, 0.0])
    aside, height = _middle(np.stack([section @ across, section[:, 1]], axis=1))
    return (_SECTION * reach * sole + aside * across + height * np.array([0.0, 1.0, 0.0])) / _SECTION, sole


def _middle(points: Float[Array, "point axis"]) -> Float[Array, " axis"]:
    """Middle of the box around points."""
    return (points.min(axis=0) + points.max(axis=0)) / 2.0
