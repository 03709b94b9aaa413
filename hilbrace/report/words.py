"""What a run found, in sentences that need no other page."""

from __future__ import annotations

from typing import Any

from hilbrace.config import ANGLES, Config, departures, passive_stiffness
from hilbrace.optimize.design import Design


def summary(
    config: Config, design: Design, metrics: dict[str, dict[str, Any]], why: list[str]
) -> list[tuple[str, str]]:
    """Headings and sentences: for whom, what the brace gives and costs, beside what, and where it is firm.

    Args:
        config: The run's configuration.
        design: The finished design.
        metrics: Figures of the stages.
        why: Sentences on where it is firm and why.
    """
    return [
        ("For whom, from what", _whom(config, metrics)),
        ("What it gives", what_it_gives(config, metrics["brace"])),
        ("What it costs", _costs(design, metrics["brace"], config.domain.joint)),
        ("Beside the joint itself", _beside(config, metrics["brace"])),
        ("Where it is firm, and why", why[0]),
    ]


def preset_sentence(config: Config) -> str:
    """The preset's name, and where the run departs from it."""
    left = departures(config.preset, config)
    if not left:
        return f"Preset '{config.preset}', in everything that it sets."
    return f"Preset '{config.preset}', but for {', '.join(left)}."


def what_it_gives(config: Config, brace: dict[str, Any]) -> str:
    """Frontal stiffness, straight and bent, beside the uniform brace's, and how far that was asked for.

    Args:
        config: The run's configuration.
        brace: The group ``brace`` of the metrics.
    """
    own, plain = brace["stiffness_frontal_nm_per_deg"], brace["stiffness_frontal_uniform_nm_per_deg"]
    text = (
        f"With the joint straight it resists bending sideways with {own:.4f} N*m per degree, "
        f"{times(own / plain)} what a uniform brace of the same volume of rubber does"
    )
    bent = [posture for posture in brace["postures"] if posture["flexion_deg"] > 20.0]
    if not bent:
        return text + "."
    shares = [each["frontal_nm_per_deg"] / each["frontal_uniform_nm_per_deg"] for each in bent]
    parts = [f"{times(share)} at {each['flexion_deg']:.0f}" for share, each in zip(shares, bent, strict=True)]
    text = f"{text}; {listed(parts)} degrees of {ANGLES[config.domain.joint][0]}."
    until, share = config.optimize.support_until_deg, config.optimize.support_beyond
    if bent[-1]["flexion_deg"] <= until or config.optimize.coupling != "stiffness":
        return text
    return f"{text} Past {until:g} degrees only {share:g} times was asked for, which leaves it freer to bend."


def times(factor: float) -> str:
    """``1.3 times``, ``0.97 times``."""
    return f"{factor:.1f} times" if factor >= 1.05 else f"{factor:.2f} times"


def listed(words: list[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _whom(config: Config, metrics: dict[str, dict[str, Any]]) -> str:
    motion, biomech, body = metrics["motion"], metrics["biomech"], metrics["body"]
    joint = config.domain.joint
    bend = max(biomech["joint_sagittal_range_deg"], key=abs)
    bent = ANGLES[joint][0] if joint == "knee" or bend > 0 else "plantarflexion"
    made = "a synthetic motion, no person was measured" if motion["origin"] == "synthetic" else "a recording"
    return (
        f"A {config.domain.side} {joint} brace for {config.subject.name} "
        f"({motion['subject_mass_kg']:.0f} kg, {body['height_m']:.2f} m), "
        f"from '{motion['name']}' ({made}): {motion['frames']} frames at "
        f"{motion['rate_hz']:g} Hz, in which the {joint} reaches {abs(bend):.0f} degrees of {bent} and a net "
        f"force of up to {biomech['acting_force_peak_bw']:.2f} body weights acts across it."
    )


def _costs(design: Design, brace: dict[str, Any], joint: str) -> str:
    own, plain = brace["stiffness_sagittal_nm_per_deg"], brace["stiffness_sagittal_uniform_nm_per_deg"]
    text = (
        f"It resists {ANGLES[joint][0]} with {own:.4f} N*m per degree, {times(own / plain)} what the uniform "
        "brace does."
    )
    if not len(design.moment_flexions):
        return text
    free, held = (abs(curve).max(axis=1) for curve in (design.moment_free, design.moment_held))
    return (
        f"{text} Over the motion that is a moment of up to {free[0]:.3f} N*m if it slides on the skin "
        f"(uniform {free[1]:.3f}) and {held[0]:.2f} N*m if it sticks to it (uniform {held[1]:.2f})."
    )


def _beside(config: Config, brace: dict[str, Any]) -> str:
    joint = config.domain.joint
    frontal = passive_stiffness(config.optimize, joint)[1]
    share = 100.0 * brace["stiffness_frontal_nm_per_deg"] / frontal
    own = brace["coupling"]
    rows = brace["passive_sensitivity"]
    levels = " to ".join(f"{row['passive_frontal_nm_per_deg']:g}" for row in (rows[0], rows[-1]))
    changes = " to ".join(f"{row[own]['frontal_change_max_deg']:.2g}" for row in (rows[0], rows[-1]))
    return (
        f"A relaxed {joint} is assumed to have {frontal:g} N*m per degree in the frontal plane, which nobody "
        f"measured on this subject; the brace adds {share:.2g} % to it. The model predicts that the frontal "
        f"angle changes by at most {brace['predicted_frontal_change_max_deg']:.2g} degrees; with {levels} "
        f"N*m per degree it would be {changes}. A soft sleeve guides, it does not hold by force."
    )
