"""PrusaSlicer's opinion and figures."""

import numpy as np
import pytest
import trimesh

from fabrication.printers import PRINTERS
from fabrication.slicer import ask_slicer, read_comments, slice_piece, slicer_program
from hilbrace.errors import ConfigError, InputError

needed = pytest.mark.skipif(slicer_program() is None, reason="PrusaSlicer is not installed")


def test_comments_of_the_gcode_give_time_and_filament():
    text = "; filament used [mm] = 2.0\n; filament used [g] = 191.40\nG1 X0\n"
    text += "; estimated printing time (normal mode) = "
    assert read_comments(text + "9h 28m 30s\n").minutes == pytest.approx(568.5)
    assert read_comments(text + "1d 2h 3m 0s\n").minutes == pytest.approx(1563.0)
    assert read_comments(text + "45s\n").filament_g == pytest.approx(191.4)
    with pytest.raises(InputError, match="time"):
        read_comments("; filament used [g] = 2\n")


def test_without_the_program_the_error_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError, match="PrusaSlicer") as caught:
        ask_slicer(tmp_path / "any.stl")
    assert "apt install" in caught.value.hint


@needed
@pytest.mark.slicer
def test_the_slicer_tells_closed_from_open_meshes(tmp_path):
    box = trimesh.creation.box((10, 20, 30))
    box.export(tmp_path / "box.stl")
    opinion = ask_slicer(tmp_path / "box.stl")
    assert opinion.manifold
    assert (opinion.open_edges, opinion.parts) == (0, 1)
    assert opinion.volume_mm3 == pytest.approx(6000.0)
    trimesh.Trimesh(box.vertices, box.faces[1:]).export(tmp_path / "open.stl")
    assert not ask_slicer(tmp_path / "open.stl").manifold
    (tmp_path / "text.stl").write_text("nothing")
    with pytest.raises(InputError):
        ask_slicer(tmp_path / "text.stl")


@needed
@pytest.mark.slicer
def test_a_box_is_sliced(tmp_path):
    trimesh.creation.box((10, 20, 30)).apply_translation((0, 0, 15)).export(tmp_path / "box.stl")
    slicing = slice_piece(tmp_path / "box.stl", PRINTERS["prusa_mk4"], tmp_path / "box.gcode")
    assert 1 < slicing.minutes < 60
    assert 1.24 * 6.0 * 0.15 < slicing.filament_g < 1.24 * 6.0
    assert (tmp_path / "box.gcode").stat().st_size > 10_000
    assert np.isfinite(slicing.filament_g)
