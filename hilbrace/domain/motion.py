"""The brace's surface in motion at any rate: posed vertices and how each triangle is stretched."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.body.body import Body
from hilbrace.domain.deformation import deformation_gradients
from hilbrace.domain.frames import pose_in_distal
from hilbrace.domain.rest import RestDomain
from hilbrace.errors import InputError

Array = np.ndarray


class MovingSurface(NamedTuple):
    """A surface in N frames.

    Attributes:
        time: Instants [s].
        posed: Vertices in each frame [mm], in the frame of the neutral bone below the joint.
        deformation: Deformation gradient of each triangle [-], see `hilbrace.domain.deformation`.
    """

    time: Float[Array, " frame"]
    posed: Float[Array, "frame vertex 3"]
    deformation: Float[Array, "frame triangle 2 2"]


def resampled(
    time: Float[Array, " frame"], values: Float[Array, "frame coordinate"], rate_hz: float
) -> tuple[Float[Array, " sample"], Float[Array, "sample coordinate"]]:
    """Coordinates at an even rate, linear between the recording's frames.

    Args:
        time: Instants of the recording [s], ascending.
        values: Coordinates there.
        rate_hz: Wanted rate [1/s], for example 15 or 60.

    Returns:
        Instants from the first of the recording on, and the coordinates there.

    Raises:
        InputError: The rate is not positive, or coordinates are missing (NaN).
    """
    if not rate_hz > 0.0:
        raise InputError(f"a rate of {rate_hz} per second", where="frames", hint="give a positive rate")
    if not np.isfinite(values).all():
        raise InputError(
            "coordinates are missing", where="frames", hint="choose a part of the recording without gaps"
        )
    count = int((time[-1] - time[0]) * rate_hz + 1e-9) + 1
    even = time[0] + np.arange(count) / rate_hz
    return even, np.stack([np.interp(even, time, column) for column in values.T], axis=1)


def moving_domain(rest: RestDomain, body: Body, loads: JointLoads, rate_hz: float) -> MovingSurface:
    """The sleeve over the whole recording at a rate of one's own, by direct skinning.

    Args:
        rest: The sleeve at rest, see `hilbrace.domain.rest.rest_domain`; it moves as it is worn.
        body: The body that moves it.
        loads: The recording's coordinates.
        rate_hz: Frames per second.

    Raises:
        InputError: The rate is not positive, or coordinates are missing.
        GeometryError: The body's skin hangs on no bone below the joint.
    """
    time, coordinates = resampled(loads.time, loads.coordinates, rate_hz)
    posed = pose_in_distal(rest.worn, rest.joint, body, loads.coordinate_names, coordinates)
    return MovingSurface(
        time, posed, deformation_gradients(rest.surface.vertices, posed, rest.surface.triangles)
    )
