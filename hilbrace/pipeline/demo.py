"""The built-in subject's configuration."""

from __future__ import annotations

from typing import Any

from hilbrace.config import Config, PresetName, apply_overrides, parse_config

QUICK: dict[str, Any] = {
    "domain": {"triangles": 1500, "frames_per_second": 10.0},
    "optimize": {"iterations": 25},
}
"""A coarser run, for a first look and for tests."""

LANDING: dict[str, tuple[float, float]] = {"serve": (1.2, 2.6), "gait": (0.4, 1.6), "squat": (0.0, 2.0)}
"""The part of each synthetic motion that a quick run uses [s]."""


PAPER_GAIT_RATE_HZ = 60.0
"""The paper samples walking at this rate and everything else at 15 Hz (Sec. 3.3.1)."""


def demo_config(
    motion: str,
    quick: bool = False,
    overrides: dict[str, str] | None = None,
    preset: PresetName = "default",
) -> Config:
    """Configuration of the demo.

    Args:
        motion: ``serve``, ``gait`` or ``squat``; all are synthetic.
        quick: Coarser mesh, fewer iterations, only the key part of the motion.
        overrides: Values by dotted key.
        preset: Values for what is not said otherwise, see `hilbrace.config.presets`.

    Raises:
        ConfigError: An override is wrong.
    """
    content: dict[str, Any] = {
        "preset": preset,
        "subject": {"name": "synthetic subject"},
        "motion": {"synthetic": motion, "cutoff_hz": 20.0},
        "biomech": {"knee_regularisation": 0.0},  # no skin moves under synthetic markers
    }
    if preset == "paper" and motion == "gait":
        content["domain"] = {"frames_per_second": PAPER_GAIT_RATE_HZ}
    if quick:
        content = {**content, **{name: dict(values) for name, values in QUICK.items()}}
        content["motion"] = content["motion"] | {"window": list(LANDING[motion])}
    apply_overrides(content, overrides or {})
    return parse_config(content, "demo")
