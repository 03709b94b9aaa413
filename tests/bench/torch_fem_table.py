"""What torch-fem says about the knee brace, as a table: ``python -m tests.bench.torch_fem_table``.

torch-fem brings half a gigabyte of drawing libraries, too much to install wherever the tests run. This script
makes the table where it is installed; the tests compare this package with the table, and the table with
torch-fem where they find it.
"""

from __future__ import annotations

import importlib.metadata
import json
from typing import Any

import numpy as np
import torch

from hilbrace.shell import joint_line_shares
from tests.bench.bench_shell import RESULTS
from tests.bench.contestants import MATCHED, torch_fem_compliance
from tests.bench.knee_brace import LOAD_WINDOW_MM, KneeBrace, knee_brace

TABLE = RESULTS / "torch_fem_compliance.json"
TRIANGLES = 10_000
SETTINGS: dict[str, dict[str, Any]] = {"default": {}, "matched": MATCHED}


def main() -> None:
    """Make the table."""
    torch.set_default_dtype(torch.float64)
    brace = knee_brace(TRIANGLES)
    table = {
        "made_by": f"torch-fem {importlib.metadata.version('torch-fem')}, its direct solver",
        "unit": "N*mm, half the work of 1 N along x, y, z, spread over the joint line",
        "fingerprint": fingerprint(brace),
        "compliance": {
            design: {name: compliances(brace, design, settings) for name, settings in SETTINGS.items()}
            for design in ("uniform", "patches")
        },
    }
    TABLE.write_text(json.dumps(table, indent=1) + "\n")


def modulus_of(brace: KneeBrace, design: str) -> np.ndarray:
    """1 MPa throughout, or the patches of the brace [MPa]."""
    return np.ones(len(brace.triangles)) if design == "uniform" else brace.modulus


def compliances(brace: KneeBrace, design: str, settings: dict[str, Any]) -> list[float]:
    """Compliance under 1 N along each axis, by torch-fem."""
    shares = joint_line_shares(brace.vertices, brace.triangles, LOAD_WINDOW_MM)
    modulus = torch.from_numpy(modulus_of(brace, design))
    loads = [shares[:, None] * axis for axis in np.eye(3)]
    return [torch_fem_compliance(brace, modulus, load, "direct", settings).item() for load in loads]


def fingerprint(brace: KneeBrace) -> dict[str, float]:
    """Figures that change with the mesh."""
    return {"triangles": len(brace.triangles), "sum_of_positions_mm": float(np.abs(brace.vertices).sum())}


if __name__ == "__main__":
    main()
