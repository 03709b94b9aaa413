"""The one place where units change.

Outside geometry everything is SI (m, N, s, rad). The design domain, the shell and every part that is
printed are in mm, N and MPa, so that moments are N*mm and stiffnesses N*mm/rad.
"""

from __future__ import annotations

import math

MM_PER_M = 1000.0
GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""

LENGTH_TO_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Length units that motion files name, in metres."""
MESH_TO_M = {**LENGTH_TO_M, "inch": 0.0254}
"""Length units that mesh files come in, in metres."""

DEG = math.pi / 180.0
"""One degree [rad]."""
