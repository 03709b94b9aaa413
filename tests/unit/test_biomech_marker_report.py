"""Marker errors are summed up by marker and frame, judged, and written as a table."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from hilbrace.biomech.marker_report import (
    load_bearing,
    marker_report,
    report_notes,
    write_marker_errors_csv,
)

TIME = np.array([0.0, 0.01, 0.02])
NAMES = ("LASI", "L,knee", "LACR")
BODIES = ("pelvis", "femur_l", "torso")
ERRORS = np.array([[0.003, 0.010, 0.060], [0.004, np.nan, 0.010], [0.000, 0.030, 0.020]])


def test_errors_are_summed_up_over_what_is_visible():
    report = marker_report(NAMES, ERRORS)
    assert report.marker_rms[0] == pytest.approx(np.sqrt((0.003**2 + 0.004**2) / 3))
    assert report.marker_rms[1] == pytest.approx(np.sqrt((0.01**2 + 0.03**2) / 2))
    assert report.marker_max.tolist() == [0.004, 0.030, 0.060]
    assert report.marker_worst_frame.tolist() == [1, 2, 0]
    assert report.frame_rms[1] == pytest.approx(np.sqrt((0.004**2 + 0.01**2) / 2))
    assert report.frame_max.tolist() == [0.060, 0.010, 0.030]
    assert report.frame_worst.tolist() == [2, 2, 1]
    assert report.largest == 0.060
    assert report.rms == pytest.approx(np.sqrt(np.nanmean(ERRORS**2)))


def test_a_marker_or_frame_that_is_never_seen_has_no_error():
    errors = ERRORS.copy()
    errors[:, 0] = np.nan
    errors[1] = np.nan
    report = marker_report(NAMES, errors)
    assert np.isnan(report.marker_rms[0])
    assert np.isnan(report.marker_max[0])
    assert np.isnan(report.frame_rms[1])
    assert np.isnan(report.frame_max[1])


def test_pelvis_and_legs_are_judged_apart_from_trunk_and_arms():
    legs = load_bearing(NAMES, BODIES, ERRORS)
    assert legs.names == ("LASI", "L,knee")
    assert legs.largest == 0.030


def test_what_is_beyond_the_checklist_is_named_with_its_frame():
    whole, legs = marker_report(NAMES, ERRORS), load_bearing(NAMES, BODIES, ERRORS)
    first, second = report_notes(whole, legs, TIME)
    assert "all markers: RMS 25.3 mm, largest 60.0 mm (LACR at 0.00 s)" in first
    assert "beyond it in 2 of 3 frames: LACR 60 mm" in first
    assert "pelvis and legs: RMS 14.3 mm, largest 30.0 mm (L,knee at 0.02 s)" in second
    assert "beyond" not in second
    fine = marker_report(NAMES, ERRORS / 10)
    assert all("beyond" not in note for note in report_notes(fine, fine, TIME))


def test_the_table_opens_anywhere(tmp_path):
    path = tmp_path / "marker_errors.csv"
    write_marker_errors_csv(TIME, NAMES, ERRORS, path)
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert [row["time_s"] for row in rows] == ["0", "0.01", "0.02", "rms", "max"]
    assert rows[1]["L,knee_mm"] == ""
    assert float(rows[2]["L,knee_mm"]) == pytest.approx(30.0)
    assert rows[0]["worst_marker"] == "LACR"
    assert float(rows[0]["max_mm"]) == pytest.approx(60.0)
    assert float(rows[4]["LACR_mm"]) == pytest.approx(60.0)
    assert float(rows[3]["LASI_mm"]) == pytest.approx(
        1000 * marker_report(NAMES, ERRORS).marker_rms[0], abs=0.01
    )
