"""The folder of a mold whose checks fail: written, and named in the error."""

import json
from dataclasses import replace

import pytest
from manifold3d import Manifold

from fabrication import files
from fabrication.build import build_mold
from fabrication.printers import profile
from hilbrace.config.mold import MoldSettings
from tests.unit.mold_cases import flat_coupon

SETTINGS = MoldSettings(printer="250x210x210")
NAMES = ("exploded", "section", "undercut", "step_core", "step_close", "step_fill", "step_open")


@pytest.fixture
def broken():
    """A coupon's mold whose core has a loose crumb."""
    mold = build_mold(flat_coupon(), SETTINGS)
    crumb = Manifold.cube((3, 3, 3)).translate((200, 0, 0))
    core = replace(mold.pieces[0], solid=mold.pieces[0].solid + crumb)
    return replace(mold, pieces=(core, *mold.pieces[1:]))


def test_files_are_written_though_a_check_fails(broken, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "write_pictures", lambda folder, mold: dict.fromkeys(NAMES, b"png"))
    result = files.write_mold(tmp_path / "mold", broken, profile(SETTINGS), SETTINGS)
    assert [check.name for check in result.failed] == ["pieces_not_in_one_part"]
    written = {path.name for path in (tmp_path / "mold").iterdir()}
    assert {"checks.json", "worksheet.html", "mold.3mf", "mold.glb", "fixtures.step", "stl"} <= written
    content = json.loads((tmp_path / "mold" / "checks.json").read_text())
    assert content["passed"] is False
    assert content["checks"]["pieces_not_in_one_part"]["passed"] is False
    assert content["checks"]["pieces_not_in_one_part"]["where"] == "core"
    assert "Do not print this mold" in (tmp_path / "mold" / "worksheet.html").read_text("utf-8")
    fault = result.failure(tmp_path / "mold")
    assert fault is not None
    assert fault.exit_code == 4
    files.record_metrics(tmp_path, result)
    assert json.loads((tmp_path / "metrics.json").read_text())["mold"]["passed"] is False
    lines = fault.two_lines().splitlines()
    assert len(lines) == 2
    assert "pieces_not_in_one_part" in lines[0]
    assert "mend" in lines[1]
