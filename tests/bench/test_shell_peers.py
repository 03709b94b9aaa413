"""This shell beside other programs on one knee brace, and the README beside the benchmark's figures."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
import torch

from hilbrace.shell import LoadPattern, build_shell, joint_line_shares, shell_response
from hilbrace.shell.solver import available_backends
from tests.bench import show_shell, torch_fem_table
from tests.bench.bench_shell import ROOT
from tests.bench.contestants import own, splu_once, spsolve_each, torch_fem_each
from tests.bench.knee_brace import FRAMES, LOAD_WINDOW_MM, POISSON, THICKNESS_MM, knee_brace


@pytest.fixture(scope="module")
def brace():
    return knee_brace(torch_fem_table.TRIANGLES)


@pytest.fixture(scope="module")
def ours(brace):
    """Compliance under 1 N along each axis, by design."""
    loops = brace.upper_loop, brace.lower_loop
    shell = build_shell(brace.vertices, brace.triangles, *loops, THICKNESS_MM, POISSON)
    shares = joint_line_shares(brace.vertices, brace.triangles, LOAD_WINDOW_MM)
    load = LoadPattern(shares, torch.eye(3, dtype=torch.float64))

    def compliance(design):
        modulus = torch.from_numpy(torch_fem_table.modulus_of(brace, design))
        return shell_response(modulus, shell, load).compliance.numpy()

    return {design: compliance(design) for design in ("uniform", "patches")}


@pytest.fixture(scope="module")
def table(brace):
    read = json.loads(torch_fem_table.TABLE.read_text())
    assert torch_fem_table.fingerprint(brace) == pytest.approx(read["fingerprint"], rel=1e-12)
    return read["compliance"]


@pytest.fixture
def torch_fem():
    """torch-fem, which counts in torch's default precision."""
    before = torch.get_default_dtype()
    pytest.importorskip("torchfem", reason="torch-fem is not installed (extra: bench)")
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(before)


@pytest.mark.parametrize(
    ("design", "settings"), [("uniform", "default"), ("uniform", "matched"), ("patches", "matched")]
)
def test_compliance_within_half_a_percent_of_torch_fem(ours, table, design, settings):
    np.testing.assert_allclose(ours[design], table[design][settings], rtol=5e-3)


def test_the_rest_of_the_difference_is_torch_fem_s_drilling_spring(ours, table):
    """Left at its default the spring lets rough designs give way; ten times stiffer, the gap closes."""
    loose = np.array(table["patches"]["default"]) / ours["patches"] - 1
    tied = np.array(table["patches"]["matched"]) / ours["patches"] - 1
    assert 5e-3 < loose.max() < 8e-3
    assert np.abs(tied).max() < 3e-3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.usefixtures("torch_fem")
def test_the_table_is_what_torch_fem_gives(brace, table):
    given = torch_fem_table.compliances(brace, "patches", torch_fem_table.MATCHED)
    np.testing.assert_allclose(given, table["patches"]["matched"], rtol=1e-6)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.usefixtures("torch_fem")
def test_torch_fem_s_gradient_points_the_same_way():
    few = first_frames(knee_brace(2000), 2)
    theirs = torch_fem_each(few, 2, "scipy")()
    mine = own("loads", "scipy").start(few)()
    np.testing.assert_allclose(theirs.compliance, mine.compliance, rtol=5e-3)
    cosine = theirs.gradient @ mine.gradient / np.linalg.norm(theirs.gradient) / np.linalg.norm(mine.gradient)
    assert cosine > 0.998


def first_frames(brace, count):
    fields = vars(brace) | {"forces": brace.forces[:count]}
    return type(brace)(**fields)


def assert_same(one, other):
    np.testing.assert_allclose(one.compliance, other.compliance, rtol=1e-8)
    np.testing.assert_allclose(one.gradient, other.gradient, rtol=1e-6, atol=1e-9 * abs(one.gradient).max())


@pytest.mark.parametrize("backend", available_backends())
@pytest.mark.parametrize("task", ["pattern", "loads"])
def test_every_way_to_the_rest_shape_gives_one_answer(task, backend):
    small = knee_brace(500)
    mine, theirs = own(task, backend).start(small)(), splu_once(small)()
    np.testing.assert_allclose(mine.compliance, theirs.compliance, rtol=1e-8)
    np.testing.assert_allclose(
        mine.gradient, theirs.gradient, rtol=1e-6, atol=1e-9 * abs(mine.gradient).max()
    )


def test_frame_by_frame_gives_the_same_answer():
    few = first_frames(knee_brace(500), 3)
    assert_same(spsolve_each(few, 3)(), splu_once(few)())


@pytest.mark.parametrize("task", ["clusters:9", "frame"])
def test_bent_shapes_answer_for_every_frame(task):
    small = knee_brace(500)
    bent, straight = own(task, "scipy").start(small)(), own("pattern", "scipy").start(small)()
    assert bent.compliance.shape == (FRAMES,)
    assert (
        0.3
        < (bent.compliance / straight.compliance).min()
        < 1.0
        < (bent.compliance / straight.compliance).max()
        < 3.0
    )


def test_a_measurement_stands_alone():
    command = [sys.executable, "-m", "tests.bench.measure", "growth", "scipy", "300"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    row = json.loads(done.stdout)
    assert row["triangles"] == len(knee_brace(300).triangles)
    assert 0 < row["solve_s"] < row["iteration_s"]
    assert 50 < row["peak_memory_mib"] < 2000


def test_the_readme_shows_the_committed_run():
    made = show_shell.section(json.loads(show_shell.JSON.read_text()))
    assert made in show_shell.README.read_text(), "make bench, or python -m tests.bench.show_shell"


def test_a_run_beside_other_programs_says_so():
    run = json.loads(show_shell.JSON.read_text())
    for row in run["own"] + run["peers"]:
        row["cpu_per_wall"] = 0.97
    assert not show_shell.waited(run)
    assert "Other programs" not in show_shell.section(run)
    run["peers"][1]["cpu_per_wall"] = 0.4
    assert show_shell.waited(run) == [run["peers"][1]["name"]]
    assert "Other programs ran at the same time" in " ".join(show_shell.section(run).split())
    assert run["peers"][1]["name"] in show_shell.verdict(run).splitlines()[-1]


def test_the_readme_s_other_words_stay():
    before = f"head\n{show_shell.BEGIN}\nold\n{show_shell.END}\ntail\n"
    after = show_shell.replaced(before, "new\n")
    assert after == before.replace("old", "new")


def test_the_plot_is_a_function_of_the_run(tmp_path):
    run = json.loads(show_shell.JSON.read_text())
    show_shell.draw(run, tmp_path / "a.svg")
    show_shell.draw(run, tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
