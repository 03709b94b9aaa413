"""The table of symbols tells the truth: its code names exist, and no symbol of the paper is left out."""

from __future__ import annotations

import dataclasses
import importlib
import re
from pathlib import Path

import pytest
from pydantic import BaseModel

ROWS = [
    [cell.strip() for cell in line.strip().strip("|").split("|")]
    for line in (Path(__file__).resolve().parents[2] / "NOTATION.md").read_text("utf-8").splitlines()
    if line.startswith("| $")
]
NAMES = sorted({name for row in ROWS for name in re.findall(r"`([\w.]+)`", row[1])})

NOT_YET: set[str] = set()
"""Symbols whose feature is not built; a symbol leaves this set together with its "not yet"."""


def found(name: str) -> bool:
    """A dotted name leads to a member of a module, or to an attribute or field of one of its classes."""
    parts = name.split(".")
    for split in range(len(parts) - 1, 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            if isinstance(thing, type) and part in fields(thing):
                return part == parts[-1]
            if not hasattr(thing, part):
                return False
            thing = getattr(thing, part)
        return True
    return False


def fields(kind: type) -> set[str]:
    """Names of the fields of a record, named tuple or settings section."""
    if issubclass(kind, BaseModel):
        return set(kind.model_fields)
    if dataclasses.is_dataclass(kind):
        return {field.name for field in dataclasses.fields(kind)}
    return set(getattr(kind, "_fields", ()))


def plain(symbol: str) -> str:
    """A symbol without the commands that only set its type face."""
    return re.sub(r"\\(mathbf|text|mathcal|Tilde|bar)(?![a-z])|[{}$\s\\]", "", symbol)


@pytest.mark.parametrize("name", NAMES)
def test_the_code_name_exists(name):
    assert name.startswith("hilbrace.")
    assert found(name)


@pytest.mark.parametrize(
    "name",
    [
        "hilbrace.nowhere.thing",
        "hilbrace.optimize.design.Design.d_nothing",
        "hilbrace.config.LossWeights.weight",
        "hilbrace.biomech.dynamics.Momenta.mass",
        "hilbrace.optimize.design.Design.d_triangle.shape",
    ],
)
def test_a_name_that_does_not_exist_is_noticed(name):
    assert not found(name)


def test_every_row_is_whole():
    assert len(ROWS) > 50
    for row in ROWS:
        assert len(row) == 4
        assert all(row), row
        assert (row[1] == "not yet") == (plain(row[0]) in NOT_YET), row


def test_no_symbol_of_the_paper_is_left_out(shared_data):
    sources = sorted((shared_data.parent / "paper").glob("*.tex"))
    if not sources:
        pytest.skip("the paper's source is not beside the recorded data")
    table = sources[0].read_text("utf-8").split("\\begin{xtabular}")[1].split("\\end{xtabular}")[0]
    symbols = re.findall(r"^(\$.*?\$)\s*&", table, re.MULTILINE)
    ours = {row[0] for row in ROWS}
    assert len(symbols) > 45
    assert [symbol for symbol in symbols if symbol not in ours] == []
