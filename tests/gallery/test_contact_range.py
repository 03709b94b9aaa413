"""Contact forces of recorded walks and landings lie where implants and other models put them.

Instrumented knees carry 2 to 3.5 body weights in walking (Kutzner et al. 2010, J. Biomech. 43:2164); models
of jumps and landings give 5 to 10 (Cleather, Goodwin & Bull 2013, Proc. Inst. Mech. Eng. H 227:3).

The walk of Rajagopal et al. is run on its published model. Without a standing trial the built-in model holds
the hips some 8 degrees too far extended; its hip flexors give out, and the rectus femoris that helps them
presses the right knee to 5.5 body weights.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hilbrace.cli import main

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

HERE = Path(__file__).parent
PUBLISHED_MODEL = "../../../../shared/data/rajagopal_walk/subject_walk_scaled.osim"


@pytest.mark.parametrize(
    ("name", "options", "low", "high"),
    [
        ("walk", (), 2.0, 4.0),
        ("rajagopal_walk", ("--set", f"biomech.model={PUBLISHED_MODEL}"), 2.0, 4.0),
        ("drop_jump", (), 4.0, 10.0),
    ],
)
def test_peak_contact_forces_of_both_knees(shared_data, tmp_path, name, options, low, high):
    run = HERE / name / "run.toml"
    assert main(["run", str(run), "--out", str(tmp_path / "run"), "--until", "biomech", *options]) == 0
    figures = json.loads((tmp_path / "run" / "metrics.json").read_text())["biomech"]
    for knee in ("knee_r", "knee_l"):
        assert low < figures["contact_force_peaks_bw"][knee] < high, knee
    assert figures["muscle_reserve_rms_nm"] < 5.0
    assert figures["residual_force_rms_n"] > 0.0
