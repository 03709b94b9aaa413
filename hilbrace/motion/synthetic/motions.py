"""The synthetic motions by name."""

from __future__ import annotations

from collections.abc import Callable

from hilbrace.errors import ConfigError
from hilbrace.motion.synthetic.gait import gait
from hilbrace.motion.synthetic.jump import serve, squat
from hilbrace.motion.synthetic.plan import Motion

MOTIONS: dict[str, Callable[[], Motion]] = {"serve": serve, "gait": gait, "squat": squat}


def motion(name: str) -> Motion:
    """The motion of that name.

    Raises:
        ConfigError: There is no such motion.
    """
    if name not in MOTIONS:
        raise ConfigError(
            f"no synthetic motion is called '{name}'",
            where="motion.synthetic",
            hint=f"choose one of {', '.join(MOTIONS)}",
        )
    return MOTIONS[name]()
