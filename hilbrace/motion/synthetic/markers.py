"""The 96 markers of the synthetic laboratory.

The model's own landmark markers (Rajagopal et al. 2016) without its joint centres, which are no skin
markers; on each leg the clusters of the 13-marker protocol (four on the thigh, four on the shank, one on
the hip; its lateral and medial knee and ankle are the model's LFC, MFC, LMAL, MMAL); and landmarks of the
head, trunk, hands and feet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.skeleton.kinematics import Pose, Skeleton

Array = np.ndarray

_TIBIAL_PLATEAU = ("R_tibial_plateau", "L_tibial_plateau")

_ONE_SIDE: dict[str, tuple[str, tuple[float, float, float]]] = {
    "thigh_c1": ("femur", (0.055, -0.12, 0.045)),
    "thigh_c2": ("femur", (0.065, -0.12, 0.0)),
    "thigh_c3": ("femur", (0.050, -0.20, 0.045)),
    "thigh_c4": ("femur", (0.060, -0.20, 0.0)),
    "shank_c1": ("tibia", (0.035, -0.12, 0.040)),
    "shank_c2": ("tibia", (0.045, -0.12, 0.0)),
    "shank_c3": ("tibia", (0.030, -0.185, 0.040)),
    "shank_c4": ("tibia", (0.040, -0.185, 0.0)),
    "hip": ("femur", (0.0, 0.02, 0.075)),
    "FIB": ("tibia", (-0.02, -0.045, 0.052)),
    "TTB": ("tibia", (0.045, -0.07, 0.005)),
    "HEL": ("calcn", (-0.01, 0.02, 0.035)),
    "HEM": ("calcn", (-0.01, 0.02, -0.030)),
    "HLX": ("toes", (0.055, 0.015, -0.02)),
    "CREST": ("pelvis", (-0.045, 0.10, 0.14)),
    "FHD": ("torso", (0.11, 0.60, 0.07)),
    "BHD": ("torso", (-0.07, 0.61, 0.07)),
    "FIN": ("hand", (0.012, -0.095, 0.0)),
    "MC5": ("hand", (-0.03, -0.085, 0.0)),
}
"""Markers of the right side: body, place in it [m]; the left side is their mirror image."""

_MIDLINE: dict[str, tuple[str, tuple[float, float, float]]] = {
    "STRN": ("torso", (0.075, 0.22, 0.0)),
    "T10": ("torso", (-0.105, 0.22, 0.0)),
    "RBAK": ("torso", (-0.10, 0.32, 0.07)),
    "SACR": ("pelvis", (-0.17, 0.03, 0.0)),
}


@dataclass(frozen=True)
class MarkerSet:
    """Markers fixed to the bodies of the model.

    Attributes:
        names: Marker names.
        bodies: Body of each.
        places: Place of each in its body [m].
    """

    names: tuple[str, ...]
    bodies: tuple[str, ...]
    places: Float[Array, "marker 3"]

    def positions(self, pose: Pose) -> Float[Array, "frame marker 3"]:
        """Where the markers are in a pose [m]."""
        paths = [
            pose[body].origin + pose[body].rotation @ place
            for body, place in zip(self.bodies, self.places, strict=True)
        ]
        return np.stack(paths, axis=1)


def synthetic_markers(skeleton: Skeleton) -> MarkerSet:
    """The marker set on a model."""
    found: dict[str, tuple[str, Array]] = {
        name: (skeleton.marker_body[name], skeleton.marker_location[name])
        for name in skeleton.marker_body
        if not name.endswith("JC") and name not in _TIBIAL_PLATEAU
    }
    for side, sign in (("R", 1.0), ("L", -1.0)):
        for name, (body, place) in _ONE_SIDE.items():
            label = f"{side}_{name}" if name.islower() or "_" in name else f"{side}{name}"
            owner = body if body in ("pelvis", "torso") else f"{body}_{side.lower()}"
            found[label] = (owner, np.array(place) * (1.0, 1.0, sign))
    found.update({name: (body, np.array(place)) for name, (body, place) in _MIDLINE.items()})
    places = np.array([place for _, place in found.values()])
    return MarkerSet(tuple(found), tuple(body for body, _ in found.values()), places)
