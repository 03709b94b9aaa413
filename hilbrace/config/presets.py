"""Named sets of values: the paper's own choices, and a smoother field than the default's.

A preset fills in what a ``run.toml`` leaves out; what the file or ``--set`` says wins. `departures` tells
where a configuration says something else than its preset, so that a report can say so too.

What the paper preset cannot take over literally, or what the paper does not say, is listed in `OPEN`.
"""

from __future__ import annotations

import json
from typing import Any, Literal

from pydantic import BaseModel

PresetName = Literal["default", "smooth", "paper"]

PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "smooth": {"optimize": {"sigma": 10.0}},
    "paper": {
        "biomech": {"convention": "paper_literal"},  # Eq. 1, signs as printed
        "domain": {"flatten": "lscm", "frames_per_second": 15.0},  # Sec. 3.1.4, Sec. 3.3.1
        "material": {
            "firm": "voronoi_open",  # Sec. 4.2: the stiffest and the softest of its five cells
            "soft": "sinusoidal",
            "segmentation": "spectral",  # Sec. 3.3.2
            "lame": "plane_strain",  # Eq. 5: lambda = nu E / ((1 + nu) (1 - 2 nu))
        },
        "optimize": {
            "coupling": "paper",  # Eq. 3 and Sec. 3.3.1
            "field": "gaussian",  # Sec. 6: one layer of 10,000 neurons
            "sigma": 4.0,
            "iterations": 200,
            "volume": "penalised",  # L4 of the loss table
            "volume_fraction": 0.5,  # Sec. 7.1
            "p_norm": 20.0,
            "geometry": "frame",  # k_0(t_i) in the compliance of Sec. 3.3.1
            "segmentation_every": 50,  # Sec. 3.3.2: by W_e, which depends on the present f_E(d)
            "weights": {
                "joint_stability": 0.5,  # Sec. 5
                "elastic_energy": 0.8,
                "compliance": 0.6,
                "volume": 0.3,
                "seam": 0.02,
            },
        },
        "pattern": {"scale": 0.08},  # Sec. 4.1
    },
}
"""Values by section and key. Each of the paper's carries the place where it says so."""

OPEN = (
    "The paper lets the design variable run through [0, 1]; here it runs through the widths that can be cast "
    "(pattern.min_strut_mm, pattern.min_slit_mm), since narrower struts tear when the mold opens.",
    "The paper names no iterations, learning rate, schedule of the segmentation, thickness, width of the "
    "load's window, share of the load, passive stiffness of the joint, nor width of the blended band: these "
    "are this program's.",
    "L4 and L5 start at zero, so that they cannot be divided by their first values; they are measured by an "
    "error of 5 % (hilbrace.optimize.objective).",
    "The paper names two of its five cells; the skeletons of both are drawn anew and homogenized here.",
    "The body is this program's own model, not SKEL; the joint responds by a linear model about the recorded "
    "motion in place of OpenSim inside the loop.",
    "Both edges of the brace keep solid rims (pattern.rim_mm).",
)
"""What the paper preset cannot take over literally, and what the paper leaves open."""


def with_preset(content: dict[str, Any]) -> dict[str, Any]:
    """A parsed TOML document with the values of the preset that it names filled in.

    An unknown preset is left for the check of the document. Of `pattern.scale` and `pattern.period_mm`, which
    exclude each other, the document's own wins.

    Args:
        content: The document; not changed.
    """
    name = content.get("preset", "default")
    values = PRESETS.get(name, {}) if isinstance(name, str) else {}
    merged = _filled(values, content)
    own = content.get("pattern")
    if isinstance(own, dict) and "period_mm" in own and "scale" not in own:
        merged["pattern"].pop("scale", None)
    return merged


def preset_overrides(name: str) -> dict[str, str]:
    """A preset as overrides by dotted key, for a document that says every value itself.

    Args:
        name: Name of the preset.
    """
    return {"preset": json.dumps(name)} | _dotted(PRESETS[name], "")


def departures(preset: str, config: BaseModel) -> tuple[str, ...]:
    """Where a configuration says something else than its preset, as ``key = value (preset: value)``.

    Args:
        preset: Name of the preset.
        config: The whole configuration.
    """
    return tuple(_differences(PRESETS[preset], config.model_dump(mode="json"), ""))


def _dotted(values: dict[str, Any], prefix: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for key, value in values.items():
        if isinstance(value, dict):
            found |= _dotted(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = json.dumps(value)
    return found


def _filled(defaults: dict[str, Any], content: dict[str, Any]) -> dict[str, Any]:
    """Nested values of both; where both have one, that of the content."""
    merged: dict[str, Any] = {}
    for key in (*content, *(key for key in defaults if key not in content)):
        own, default = content.get(key), defaults.get(key)
        if isinstance(default, dict) and (isinstance(own, dict) or key not in content):
            merged[key] = _filled(default, own or {})
        else:
            merged[key] = own if key in content else default
    return merged


def _differences(defaults: dict[str, Any], values: dict[str, Any], prefix: str) -> list[str]:
    found: list[str] = []
    for key, default in defaults.items():
        own = values[key]
        if isinstance(default, dict):
            found += _differences(default, own, f"{prefix}{key}.")
        elif own != default:
            found.append(f"{prefix}{key} = {own} (preset: {default})")
    return found
