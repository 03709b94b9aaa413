"""One leg of a body, always seen as a right leg with the knee centre at the origin, in mm.

A left leg is mirrored in the sagittal plane on the way in and mirrored back on the way out. Whatever is
done in between is therefore the same for both sides: a mirrored body has exactly the mirrored domain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from hilbrace.body.body import Body
from hilbrace.errors import GeometryError
from hilbrace.units import MM_PER_M

Array = np.ndarray

_MIRROR = np.array([1.0, 1.0, -1.0])


@dataclass(frozen=True)
class Surface:
    """A triangle mesh [mm], outward orientation."""

    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]


@dataclass(frozen=True)
class Limb:
    """Axes of a leg in limb axes: x anterior, y up, z lateral; knee centre at the origin [mm].

    Attributes:
        side: ``"left"`` or ``"right"``, the leg this is in the body.
        hip: Hip centre [mm].
        ankle: Ankle centre [mm].
        other_knee: Centre of the other knee [mm].
        knee_m: Knee centre in the body's axes [m].
    """

    side: str
    hip: Float[Array, " xyz"]
    ankle: Float[Array, " xyz"]
    other_knee: Float[Array, " xyz"]
    knee_m: Float[Array, " xyz"]

    @property
    def joint(self) -> str:
        """Name of the braced joint, ``knee_l`` or ``knee_r``."""
        return f"knee_{self.side[0]}"

    def azimuth(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point"]:
        """Angle of points about the limb's axis [rad]: 0 anterior, 90 deg lateral, 180 deg posterior.

        The axis is the line hip - knee - ankle, prolonged at both ends.
        """
        height = points[..., 1:2]
        axis = np.where(height >= 0.0, self.hip / self.hip[1] * height, self.ankle / self.ankle[1] * height)
        away = points - axis
        return np.arctan2(away[..., 2], away[..., 0])

    def inwards(self, points_m: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points of the body [m] in limb axes [mm]."""
        points = (points_m - self.knee_m) * MM_PER_M
        return points * _MIRROR if self.side == "left" else points

    def rest_frame(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points in limb axes in the brace's rest frame, z to the subject's right [mm]."""
        return points * _MIRROR if self.side == "left" else points

    def winding(self, triangles: Int[Array, "triangle 3"]) -> Int[Array, "triangle 3"]:
        """Triangles turned so that they stay outward when their vertices are mirrored."""
        return np.ascontiguousarray(triangles[:, [0, 2, 1]]) if self.side == "left" else triangles


def find_limb(body: Body, side: str) -> Limb:
    """Axes of one leg of a body.

    Raises:
        GeometryError: The body lacks a joint, or hip, knee and ankle do not lie above each other.
    """
    letter, other = side[0], {"left": "r", "right": "l"}[side]
    names = (f"hip_{letter}", f"knee_{letter}", f"ankle_{letter}", f"knee_{other}")
    missing = [name for name in names if name not in body.joint_names]
    if missing:
        raise GeometryError(
            f"the body has no joint {', '.join(missing)}",
            where=f"domain.side = {side!r}",
            hint="the body needs the centres of both hips, knees and ankles",
        )
    hip, knee, ankle, other_knee = (body.joint_centres[body.joint_names.index(name)] for name in names)
    upright = Limb(side, np.zeros(3), np.zeros(3), np.zeros(3), np.asarray(knee, float))
    limb = Limb(
        side, upright.inwards(hip), upright.inwards(ankle), upright.inwards(other_knee), upright.knee_m
    )
    if not (limb.hip[1] > 50.0 and limb.ankle[1] < -50.0):
        raise GeometryError(
            f"hip {limb.hip[1]:.0f} mm above and ankle {-limb.ankle[1]:.0f} mm below the knee make no leg",
            where=f"joint centres of the {side} leg",
            hint="give the body in metres, y up, in the neutral pose",
        )
    return limb


def limb_skin(body: Body, limb: Limb) -> Surface:
    """The whole skin of a body in limb axes [mm]."""
    return Surface(limb.inwards(body.vertices), limb.winding(body.triangles.astype(np.int64)))
