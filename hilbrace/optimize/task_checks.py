"""What a motion must offer before a brace can be designed for it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError

Array = np.ndarray

LEAST_ANGLE = np.deg2rad(1.0)
"""An angle that never leaves the neutral pose by as much is not moved [rad]."""

LEAST_FORCE_N = 1e-3
"""Acting force below which a frame carries no load [N]."""


def check_moves(angles: Float[Array, "frame angle"], names: tuple[str, ...], joint: str) -> None:
    """Refuse a motion that leaves all angles that the brace shall preserve where they are.

    Nothing would tell a brace that hinders them from one that does not.

    Args:
        angles: The angles to preserve [rad]; none is no fault.
        names: Their names.
        joint: Name of the braced joint.

    Raises:
        InputError: None of them leaves the neutral pose.
    """
    largest = float(np.abs(angles).max(initial=0.0))
    if names and largest < LEAST_ANGLE:
        raise InputError(
            f"the joint never bends: {' and '.join(names)} stay within {np.rad2deg(largest):.2g} deg of the"
            " neutral pose",
            where=f"{joint} in the motion",
            hint="widen motion.window to where the joint moves, or set optimize.preserve to other angles",
        )


def check_loaded(force: Float[Array, "frame 3"], joint: str) -> None:
    """Refuse a motion that loads the joint in no frame. Single frames without load, as in flight, are none.

    Args:
        force: Acting force in the frames of the design [N].
        joint: Name of the braced joint.

    Raises:
        InputError: No frame carries load.
    """
    if not (np.linalg.norm(force, axis=1) > LEAST_FORCE_N).any():
        raise InputError(
            f"no frame of the motion loads the joint: its acting force is zero in all {len(force)}",
            where=f"{joint} in the frames of the design",
            hint="give a recording with ground forces, or design by stiffness alone: "
            'optimize.coupling = "stiffness" and optimize.weights.compliance = 0',
        )
