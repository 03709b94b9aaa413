"""The skin in motion: rigid motions of the bones from the skeleton's coordinates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from hilbrace.body.body import Body
from hilbrace.body.skinning import SKINNINGS
from hilbrace.errors import InputError
from hilbrace.skeleton.kinematics import Skeleton, skeleton_from_table
from hilbrace.skeleton.scaling import scaled_table
from hilbrace.skeleton.table import load_table

Array = np.ndarray


def body_skeleton(body: Body) -> Skeleton:
    """The skeleton scaled to the subject, as the body stage scaled it."""
    scales = dict(zip(body.scaled_bodies, body.segment_scales, strict=True))
    return skeleton_from_table(scaled_table(load_table(), scales, body.mass_kg))


def bone_transforms(
    body: Body, coordinate_names: Sequence[str], coordinates: Float[Array, "frame coordinate"]
) -> tuple[Float[Array, "frame bone 3 3"], Float[Array, "frame bone 3"]]:
    """Motion of each bone against the neutral pose, x -> R x + t in the ground.

    Args:
        body: The subject's body.
        coordinate_names: Names of the skeleton's coordinates; those left out are zero.
        coordinates: Their values [rad or m].

    Returns:
        Rotations and translations [m], in the order of ``body.bones``.

    Raises:
        InputError: A name is not one of the skeleton's, or names and values differ in number.
    """
    if coordinates.ndim != 2 or coordinates.shape[1] != len(coordinate_names):
        raise InputError(
            f"{len(coordinate_names)} coordinate names for values of shape {coordinates.shape}",
            where="body pose",
            hint="give one column per coordinate",
        )
    skeleton = body_skeleton(body)
    moved = skeleton.forward(dict(zip(coordinate_names, coordinates.T, strict=True)))
    neutral = skeleton.forward({})
    rotations, translations = [], []
    for bone in body.bones:
        turn = moved[bone].rotation @ neutral[bone].rotation[0].T
        rotations.append(turn)
        translations.append(moved[bone].origin - turn @ neutral[bone].origin[0])
    shape = (len(coordinates), len(body.bones))
    return (
        np.broadcast_to(np.stack(rotations, axis=1), (*shape, 3, 3)),
        np.broadcast_to(np.stack(translations, axis=1), (*shape, 3)),
    )


def posed_skin(
    body: Body, coordinate_names: Sequence[str], coordinates: Float[Array, "frame coordinate"]
) -> Float[Array, "frame vertex 3"]:
    """The whole skin in each frame [m], in the ground.

    Args:
        body: The subject's body.
        coordinate_names: Names of the skeleton's coordinates; those left out are zero.
        coordinates: Their values [rad or m].

    Raises:
        InputError: A name is not one of the skeleton's, or names and values differ in number.
    """
    motion = bone_transforms(body, coordinate_names, coordinates)
    return SKINNINGS[body.skinning](body.vertices, body.bone_weights, *motion)
