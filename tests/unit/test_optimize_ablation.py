"""The verdict on the paper's findings follows from the rows, and says why where one did not come out."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hilbrace.config import OptimizeSettings
from hilbrace.optimize.ablation import (
    DESIGN,
    UNIFORM,
    WITHOUT_L2,
    WITHOUT_L3,
    AblationRow,
    BraceFigures,
    findings,
)
from hilbrace.pipeline.ablation import variants

FIGURES = BraceFigures((0.0,) * 5, 2.0, 1.0, 2.0, 60.0, 1.5, 0.8, 2.0, 0.01, 0.1, 0.4)


def rows(**changes: dict[str, float]) -> tuple[AblationRow, ...]:
    names = (DESIGN, WITHOUT_L2, WITHOUT_L3, UNIFORM)
    return tuple(AblationRow(name, name, replace(FIGURES, **changes.get(name, {}))) for name in names)


def test_findings_that_came_out_say_by_how_much():
    found = findings(
        rows(
            without_elastic_energy={"sagittal_nm_per_deg": 1.5, "bent_sagittal_nm_per_deg": 1.2},
            without_compliance={"frontal_nm_per_deg": 1.0},
            uniform={"sagittal_nm_per_deg": 30.0},
        ),
        OptimizeSettings(coupling="paper"),
    )
    assert [finding.came_out for finding in found] == [True, True, True]
    assert "+50 % with the joint straight, +50 % at 60 degrees" in found[0].sentence
    assert "-50 % with the joint straight" in found[1].sentence
    assert "30 times" in found[2].sentence
    assert not any(finding.why for finding in found)


@pytest.mark.parametrize("coupling", ["stiffness", "paper"])
def test_findings_that_did_not_come_out_say_why(coupling: str):
    found = findings(rows(), OptimizeSettings.model_validate({"coupling": coupling}))
    assert [finding.came_out for finding in found] == [False, False, False]
    assert all(finding.why for finding in found)
    assert ("L1 itself" in found[1].why) == (coupling == "stiffness")


def test_a_loss_that_the_design_lacks_cannot_be_taken_away():
    settings = OptimizeSettings.model_validate({"weights": {"compliance": 0.0}})
    assert findings(rows(), settings)[1].why == "The design itself has no such loss."


def test_a_variant_that_cannot_be_cast_leaves_the_finding_open():
    made = rows()
    lost = (made[0], replace(made[1], figures=None, reason="no design has the volume 0.7"), *made[2:])
    first = findings(lost, OptimizeSettings())[0]
    assert first.came_out is None
    assert "0.7" in first.sentence


def test_variants_change_one_thing_each_and_repeat_no_volume():
    settings = OptimizeSettings(volume_fraction=0.5)
    made = variants(settings)
    assert [variant.name for variant in made] == [
        "design",
        "without_elastic_energy",
        "without_compliance",
        "volume_30_percent",
        "volume_70_percent",
    ]
    assert made[0].settings == settings
    assert made[1].settings.weights.elastic_energy == 0.0
    assert made[1].settings.weights.compliance == settings.weights.compliance
    assert made[2].settings.weights.compliance == 0.0
    assert made[4].settings.volume_fraction == 0.7
    assert len({variant.name for variant in variants(OptimizeSettings())}) == 6
