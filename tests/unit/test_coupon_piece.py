"""Test pieces: their geometry, their files, and their stiffness with every strut against homogenization."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from hilbrace import cli
from hilbrace.errors import ConfigError, GeometryError, InputError
from hilbrace.pattern.coupon import piece
from hilbrace.pattern.coupon import stiffness as stiffness_of_coupon
from hilbrace.pattern.coupon.files import coupon_picture, read_coupon, write_coupon
from hilbrace.pattern.coupon.piece import CouponPlan, coupon_body, lattice, plate, volume_fraction
from hilbrace.pattern.coupon.stiffness import (
    STRAIN_LIMIT,
    detailed_stiffness,
    force_line,
    predict,
    sheet_stiffness,
)
from hilbrace.pattern.thicken import border_edges

SMALL = CouponPlan("star", 0.6, across=2, length=4, grip_mm=12.0)


@pytest.mark.parametrize("along", ["u", "v"])
@pytest.mark.parametrize(("cell", "d"), [("voronoi_open", 0.0), ("honeycomb", 0.5), ("star", 1.0)])
def test_the_plate_is_one_watertight_body_of_its_size(cell, d, along):
    plan = replace(SMALL, cell=cell, d=d, along=along)
    sheet = lattice(plan)
    body = trimesh.Trimesh(*coupon_body(plan, sheet))
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.body_count == 1
    low, high = body.bounds
    grips = plan.gauge_mm / 2 + plan.grip_mm
    assert high - low == pytest.approx([plan.width_mm, 2 * grips, plan.thickness_mm], abs=0.5)
    holes = 2 * np.pi / 4 * plan.pin_mm**2
    rubber = volume_fraction(sheet, plan) * plan.width_mm * plan.gauge_mm
    length = high[1] - low[1] - plan.gauge_mm
    expected = (rubber + length * plan.width_mm - holes) * plan.thickness_mm
    assert body.volume == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("cell", ["voronoi_open", "honeycomb", "star", "square"])
def test_the_plate_has_the_volume_of_its_cell(cell):
    plan = replace(SMALL, cell=cell, d=0.7, length=2)
    assert volume_fraction(lattice(plan, 30), plan) == pytest.approx(sheet_stiffness(plan, 0.45)[1], abs=0.01)


def test_the_mesh_has_no_needles_and_two_pins():
    plan = replace(SMALL, d=0.3)
    sheet = lattice(plan)
    corner = sheet.vertices[sheet.triangles]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = np.cross(first, second)[:, 2] / 2
    squares = (np.roll(corner, 1, axis=1) - corner) ** 2
    assert area.min() > 0
    assert (area / squares.sum(axis=(1, 2))).min() > 0.01
    for pin, side in ((sheet.upper_pin, 1.0), (sheet.lower_pin, -1.0)):
        centre = [0.0, side * (plan.gauge_mm + plan.grip_mm) / 2]
        radius = np.linalg.norm(sheet.vertices[pin, :2] - centre, axis=1)
        assert radius == pytest.approx(plan.pin_mm / 2, abs=0.05)
        assert np.isin(pin, border_edges(sheet.triangles)).all()


def test_a_solid_plate_pulls_as_a_bar_does():
    """A long plate with the stiffness of the solid: E A / L but for what rigid grips hold together."""
    plan = CouponPlan("square", 0.5, across=2, length=20, cell_mm=8.0)
    solid = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]])
    stiffness = stiffness_of_coupon._stretch(plate(plan, 6), plan, solid, 0.0)
    assert stiffness == pytest.approx(plan.width_mm * plan.thickness_mm / plan.gauge_mm, rel=2e-3)


def ratio(plan, steps):
    found = detailed_stiffness(plan, steps=steps)
    return found.stiffness / predict(plan).stiffness


@pytest.mark.parametrize("cell", ["voronoi_open", "star", "square"])
def test_every_strut_pulls_as_the_homogenized_sheet_within_a_tenth(cell):
    assert ratio(CouponPlan(cell, 0.8, across=4, length=4), 24) == pytest.approx(1.0, abs=0.10)


@pytest.mark.soak
@pytest.mark.parametrize("cell", ["voronoi_open", "sinusoidal", "star", "square", "honeycomb", "octagon"])
def test_the_difference_fades_with_more_cells(cell):
    off = [abs(ratio(CouponPlan(cell, 0.8, across=n, length=2 * n), 24) - 1.0) for n in (4, 8)]
    assert off[1] < max(off[0], 0.03)
    assert off[1] < 0.10


def test_the_line_starts_at_zero_and_has_the_predicted_slope():
    found = predict(SMALL)
    line = force_line(SMALL, found, 2.0)
    assert line[0].tolist() == [0.0, 0.0, 0.0]
    assert line[-1, 1] == pytest.approx(STRAIN_LIMIT)
    assert np.diff(line[:, 2]) / np.diff(line[:, 0]) == pytest.approx(2.0 * found.stiffness)


def test_more_rubber_is_stiffer_and_wider():
    found = [predict(replace(SMALL, d=d)) for d in (0.1, 0.5, 0.9)]
    for name in ("stiffness", "modulus", "volume_fraction", "strut_mm"):
        assert (np.diff([getattr(one, name) for one in found]) > 0).all()


def test_thickness_scales_the_stiffness():
    thin, thick = (predict(replace(SMALL, thickness_mm=t)).stiffness for t in (2.0, 4.0))
    assert thick == pytest.approx(2 * thin, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"d": 1.2}, "d"),
        ({"d": float("nan")}, "d"),
        ({"across": 5}, "across"),
        ({"length": 0}, "length"),
        ({"cell_mm": 0.1}, "cell-mm"),
        ({"thickness_mm": -1.0}, "thickness-mm"),
        ({"grip_mm": 3.0}, "grip-mm"),
    ],
)
def test_plans_that_make_no_coupon_are_named(change, named):
    with pytest.raises(ConfigError, match=f"coupon: {named}"):
        lattice(replace(SMALL, **change))


def test_unknown_cells_are_named():
    with pytest.raises(ConfigError, match="no microstructure named 'chain'"):
        predict(replace(SMALL, cell="chain"))


def test_struts_that_leave_the_grips_alone_are_refused(monkeypatch):
    monkeypatch.setattr(piece, "cell_distance", lambda name, u, v: np.full(len(u), 9.0))
    with pytest.raises(GeometryError, match="hang together"):
        lattice(SMALL)


def test_the_files_say_the_same(tmp_path):
    figures = write_coupon(SMALL, tmp_path, 1.15, 0.45, every_strut=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "coupon.json",
        "coupon.png",
        "coupon.stl",
        "coupon_line.csv",
    ]
    piece = read_coupon(tmp_path / "coupon.json")
    assert piece.plan == SMALL
    assert piece.best == pytest.approx(figures["stiffness_n_per_mm_per_mpa"])
    rows = (tmp_path / "coupon_line.csv").read_text().splitlines()
    assert rows[0] == "lengthening_mm,strain,force_n"
    length, _, force = map(float, rows[-1].split(","))
    assert force == pytest.approx(1.15 * piece.best * length, rel=1e-4)
    first = (tmp_path / "coupon.stl").read_bytes()
    write_coupon(SMALL, tmp_path, 1.15, 0.45, every_strut=False)
    assert first == (tmp_path / "coupon.stl").read_bytes()


def test_broken_figures_of_a_coupon_are_refused(tmp_path):
    with pytest.raises(InputError, match="not there"):
        read_coupon(tmp_path / "coupon.json")
    for content in ("{", "{}", json.dumps({"plan": {"cell": "star"}})):
        (tmp_path / "coupon.json").write_text(content)
        with pytest.raises(InputError, match="no figures of a coupon"):
            read_coupon(tmp_path / "coupon.json")


def test_the_picture_states_the_difference():
    figure = coupon_picture(SMALL, lattice(SMALL), predict(SMALL), detailed_stiffness(SMALL, steps=8), 1.15)
    labels = [
        text.get_text()
        for axes in figure.axes
        for text in (axes.get_legend() or axes).findobj()
        if hasattr(text, "get_text")
    ]
    assert any("every strut meshed" in label and "%" in label for label in labels)


def test_the_command_writes_a_coupon_and_reads_a_curve(tmp_path, capsys):
    out = tmp_path / "piece"
    words = ["cells", "coupon", "star", "--d", "0.6", "--across", "2", "--quick", "--out", str(out)]
    assert cli.main([*words, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    stiffness = figures["stiffness_n_per_mm_per_mpa"]
    length = np.linspace(0, 4.0, 30)
    rows = "\n".join(f"{x:.4f},{1.3 * stiffness * x:.6f}" for x in length)
    (out / "curve.csv").write_text(f"extension [mm],force [N]\n{rows}\n")
    assert cli.main(["cells", "calibrate", str(out / "curve.csv"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["youngs_modulus_mpa"] == pytest.approx(1.3, rel=1e-3)
    assert cli.main(["cells", "calibrate", str(out / "curve.csv"), "--thickness-mm", "2"]) == 0
    assert "youngs_modulus_mpa = 2.6" in capsys.readouterr().out
    assert cli.main(["cells", "calibrate", str(out / "none.csv")]) == 2
    assert "mend:" in capsys.readouterr().err
