"""What came out, on one screen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

ROWS = (
    ("motion", "origin", "motion", ""),
    ("motion", "frames", "frames", ""),
    ("motion", "subject_mass_kg", "subject", "kg"),
    ("biomech", "marker_rms_mm", "marker error, RMS", "mm"),
    ("biomech", "knee_flexion_max_deg", "peak knee flexion", "deg"),
    ("biomech", "acting_force_peak_bw", "peak acting force", "body weights"),
    ("biomech", "contact_force_peak_bw", "peak contact force", "body weights"),
    ("domain", "triangles", "triangles of the domain", ""),
    ("brace", "stiffness_frontal_nm_per_deg", "brace stiffness, frontal", "N*m/deg"),
    ("brace", "stiffness_frontal_uniform_nm_per_deg", "  uniform design, same volume", "N*m/deg"),
    ("brace", "stiffness_sagittal_nm_per_deg", "brace stiffness, sagittal", "N*m/deg"),
    ("brace", "stiffness_sagittal_uniform_nm_per_deg", "  uniform design, same volume", "N*m/deg"),
    ("brace", "stiffness_ratio_vs_uniform", "frontal/sagittal against uniform", "times"),
    ("brace", "volume_fraction", "volume fraction", ""),
    ("solid", "mass_g", "mass of the casting", "g"),
    ("solid", "watertight", "watertight", ""),
    ("solid", "parts", "parts", ""),
    ("solid", "min_strut_mm", "narrowest strut", "mm"),
)


def print_summary(folder: Path, metrics: dict[str, Any]) -> None:
    """Print the figures people ask for first, and where the report and the brace are."""
    console = Console()
    table = Table(show_header=False, box=None, pad_edge=False)
    for group, key, label, unit in ROWS:
        if group in metrics and key in metrics[group]:
            value = metrics[group][key]
            table.add_row(label, f"{value:.4g}" if isinstance(value, float) else str(value), unit)
    console.print(table)
    for label, name in (("report", "report/index.html"), ("brace", "solid/brace.stl")):
        if (folder / name).exists():
            console.print(f"{label:<7} {folder / name}", soft_wrap=True)
