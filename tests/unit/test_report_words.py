"""The report's words on where a brace is firm and why, and what it shows of a mold."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hilbrace.config import PatternSettings, parse_config
from hilbrace.errors import InputError
from hilbrace.report.mold import mold_section
from hilbrace.report.reasons import Zones, pull_picture, reasons
from hilbrace.report.words import listed, preset_sentence, times, what_it_gives
from tests.unit.knee_tube import knee_domain, knee_loads
from tests.unit.sleeve import sleeve_design

DOMAIN = knee_domain(knee_loads(), around=16, along=12)
DESIGN = sleeve_design(DOMAIN, PatternSettings(scale=0.08))


def painted(firm_side: int, thirds: tuple[int, ...], pulls: np.ndarray):
    """A design that is dense on one side, open elsewhere, and its zones."""
    count = len(DOMAIN.triangles)
    side, third = np.arange(count) % 4.0, np.arange(count) // 4 % 3.0
    dense = (side == firm_side) & np.isin(third, thirds)
    made = replace(DESIGN, d_triangle=np.where(dense, 0.9, 0.4), pulls=pulls)
    return made, Zones(side, third, np.ones(count))


def test_the_firm_side_its_height_and_who_wants_it():
    pulls = np.zeros((5, len(DOMAIN.triangles)))
    pulls[0], pulls[2], pulls[1] = 3.0, 1.0, -5.0
    first = reasons(*painted(3, (0, 1, 2), pulls))[0]
    assert first.startswith("The medial side is firm from edge to edge (mean design variable 0.90")
    assert "L1 joint stability (75 % of the pull) and L3 compliance (25 % of the pull)" in first
    assert "L2" not in first


def test_an_open_side_is_wanted_by_what_pulls_it_open():
    pulls = np.zeros((5, len(DOMAIN.triangles)))
    pulls[1] = -1.0
    design, zones = painted(1, (2,), pulls)
    design = replace(design, d_triangle=1.0 - design.d_triangle)
    told = reasons(design, zones)
    assert told[-1].startswith("The lateral side is open in its upper third")
    assert "L2 elastic energy (100 % of the pull)" in told[-1]


def test_an_even_brace_is_called_even():
    design, zones = painted(0, (), np.zeros((5, len(DOMAIN.triangles))))
    assert reasons(design, zones) == [
        "The brace is about equally firm all around (mean design variable 0.40)."
    ]


def test_the_picture_has_a_row_for_each_loss_that_pulls():
    pulls = np.zeros((5, len(DOMAIN.triangles)))
    pulls[0], pulls[1], pulls[3] = 1.0, -1.0, -1.0
    assert len(pull_picture(DOMAIN, replace(DESIGN, pulls=pulls)).axes) == 2 * 4 + 1


def test_presets_are_named_with_what_departs_from_them():
    assert preset_sentence(parse_config({}, "test")) == "Preset 'default', in everything that it sets."
    changed = parse_config({"preset": "paper", "optimize": {"sigma": 6.0}}, "test")
    assert "'paper', but for optimize.sigma = 6.0 (preset: 4.0)" in preset_sentence(changed)


def test_less_support_past_the_flexion_it_is_asked_for_up_to_is_said():
    brace = {"stiffness_frontal_nm_per_deg": 0.006, "stiffness_frontal_uniform_nm_per_deg": 0.0064}
    postures = [
        {"flexion_deg": flexion, "frontal_nm_per_deg": own, "frontal_uniform_nm_per_deg": 0.004}
        for flexion, own in ((0.0, 0.004), (60.0, 0.004), (90.0, 0.003))
    ]
    told = what_it_gives(parse_config({}, "test"), brace | {"postures": postures})
    assert "1.00 times at 60 and 0.75 times at 90 degrees of flexion." in told
    assert told.endswith("Past 75 degrees only 0.7 times was asked for, which leaves it freer to bend.")
    shallow = what_it_gives(parse_config({}, "test"), brace | {"postures": postures[:2]})
    assert "Past" not in shallow


def test_small_words():
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert (times(7.06), times(0.974)) == ("7.1 times", "0.97 times")


def test_a_mold_is_shown_with_its_checks_and_pictures(tmp_path: Path):
    assert mold_section(tmp_path) is None
    folder = tmp_path / "mold" / "pictures"
    folder.mkdir(parents=True)
    (folder / "section.png").write_bytes(b"picture")
    check = {
        "value": 0.25, "rule": "at most 2", "limit": 2.0, "passed": True,
        "means": "overlap of the pieces", "mend": "widen mold.gap_mm", "where": "",
    }  # fmt: skip
    content = {
        "passed": False,
        "checks": {"overlap_mm3": check, "walls_mm": check | {"passed": False}},
        "pictures": {"section": "pictures/section.png", "gone": "pictures/gone.png"},
    }
    (tmp_path / "mold" / "checks.json").write_text(json.dumps(content))
    found = mold_section(tmp_path)
    assert found is not None
    assert not found.passed
    assert found.checks[0] == ("overlap_mm3", "0.25", "at most 2", "passed (overlap of the pieces)")
    assert found.checks[1][3].startswith("FAILED; widen mold.gap_mm")
    assert [name for name, _ in found.pictures] == ["section"]


@pytest.mark.parametrize("content", ["{", "[]", '{"passed": true}', '{"passed": true, "checks": []}'])
def test_a_damaged_mold_is_named(tmp_path: Path, content: str):
    (tmp_path / "mold").mkdir()
    (tmp_path / "mold" / "checks.json").write_text(content)
    with pytest.raises(InputError, match="damaged"):
        mold_section(tmp_path)
