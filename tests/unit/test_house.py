"""The house rules that no linter knows, held over every module: docstrings, shapes, lengths, names."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from hilbrace.shell.directors import triangle_normals

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("hilbrace", "fabrication", "evaluation")
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts): ast.parse(path.read_text("utf-8"), str(path))
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
}

LOAD_OPENSIM = {f"hilbrace.biomech.opensim_{name}" for name in ("worker", "model", "state", "muscles")}
"""Modules of the OpenSim process, which no other process may import."""

LONGEST_FILE, LONGEST_FUNCTION = 400, 80

SHAPED = {"Float", "Int", "Integer", "Bool", "Shaped", "Num", "Complex", "UInt8", "Float32"}
"""Names of jaxtyping that give an array its shape."""

BARE = {"Array", "ndarray", "Tensor", "NDArray", "ArrayLike"}
"""Arrays of no stated shape."""

MACHINE_PATH = re.compile(r"(?<![\w.$}])/(?:work|home|root|tmp|Users|opt|mnt)/\w")

Function = ast.FunctionDef | ast.AsyncFunctionDef


def source(module: str) -> str:
    """Text of a module."""
    return (ROOT / Path(*module.split("."))).with_suffix(".py").read_text("utf-8")


def definitions(body: list[ast.stmt], prefix: str) -> Iterator[tuple[str, Function | ast.ClassDef]]:
    """Functions, classes and methods with their dotted names, those inside functions left out."""
    for node in body:
        if isinstance(node, Function | ast.ClassDef):
            yield f"{prefix}.{node.name}", node
        if isinstance(node, ast.ClassDef):
            yield from definitions(node.body, f"{prefix}.{node.name}")


def public(name: str) -> bool:
    """No part of the dotted name is private; special methods such as ``__call__`` are public."""
    return not any(part.startswith("_") and not part.endswith("__") for part in name.split("."))


PUBLIC = [
    (name, node)
    for module, tree in MODULES.items()
    for name, node in definitions(tree.body, module)
    if public(name)
]


def annotations(node: Function) -> Iterator[ast.expr]:
    """Annotations of a function's arguments and of what it returns."""
    every = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
    yield from (argument.annotation for argument in every if argument.annotation)
    if node.returns:
        yield node.returns


def last_name(node: ast.expr) -> str:
    """``ndarray`` of ``np.ndarray`` and of ``ndarray``."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def without_shape(annotation: ast.expr) -> bool:
    """An array stands in the annotation bare, or with a shape that is no text."""
    if isinstance(annotation, ast.Subscript) and last_name(annotation.value) in SHAPED:
        parts = annotation.slice.elts if isinstance(annotation.slice, ast.Tuple) else []
        return not (
            len(parts) == 2 and isinstance(parts[1], ast.Constant) and isinstance(parts[1].value, str)
        )
    if last_name(annotation) in BARE:
        return True
    return any(without_shape(part) for part in ast.iter_child_nodes(annotation) if isinstance(part, ast.expr))


def test_there_is_a_house():
    assert len(MODULES) > 80
    assert len(PUBLIC) > 300
    assert set(MODULES) >= LOAD_OPENSIM


def test_public_names_have_docstrings():
    exempt = {"__init__", "__enter__", "__exit__", "__post_init__"}
    missing = [
        name
        for name, node in PUBLIC
        if node.name not in exempt and not (ast.get_docstring(node) or "").strip()
    ]
    assert missing == []


def test_arrays_of_public_functions_have_shapes():
    bare = [
        f"{name}: {ast.unparse(annotation)}"
        for name, node in PUBLIC
        if isinstance(node, Function)
        for annotation in annotations(node)
        if without_shape(annotation)
    ]
    assert bare == []


def test_arrays_of_records_have_shapes():
    bare = [
        f"{name}.{ast.unparse(item.target)}: {ast.unparse(item.annotation)}"
        for name, node in PUBLIC
        if isinstance(node, ast.ClassDef)
        for item in node.body
        if isinstance(item, ast.AnnAssign) and without_shape(item.annotation)
    ]
    assert bare == []


@pytest.mark.parametrize(
    ("annotation", "bare"),
    [
        ("Float[Array, 'frame 3']", False),
        ("dict[str, Float[np.ndarray, ' frame']] | None", False),
        ("Float[Array, 3]", True),
        ("tuple[int, np.ndarray]", True),
        ("Array | None", True),
        ("list[float]", False),
    ],
)
def test_the_rule_of_shapes_itself(annotation, bare):
    assert without_shape(ast.parse(annotation, mode="eval").body) == bare


def test_shapes_are_checked_while_tests_run():
    with pytest.raises(TypeCheckError, match="vertices"):
        triangle_normals(np.zeros((3, 2)), np.zeros((1, 3), int))


@pytest.mark.malformed
def test_tests_of_malformed_input_reach_the_library_itself():
    with pytest.raises(IndexError):
        triangle_normals(np.zeros((3, 2)), np.full((1, 3), 7))


def test_files_and_functions_stay_short():
    long_files = [
        f"{module}: {count} lines"
        for module in MODULES
        if (count := len(source(module).splitlines())) > LONGEST_FILE
    ]
    long_functions = [
        f"{module}.{node.name}: {length} lines"
        for module, tree in MODULES.items()
        for node in ast.walk(tree)
        if isinstance(node, Function)
        and (length := (node.end_lineno or 0) - node.lineno + 1) > LONGEST_FUNCTION
    ]
    assert long_files + long_functions == []


def test_the_library_neither_prints_nor_asserts_nor_keeps_globals():
    found = [
        f"{module}:{node.lineno}"
        for module, tree in MODULES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Assert | ast.Global)
        or (
            isinstance(node, ast.Call) and last_name(node.func) == "print" and isinstance(node.func, ast.Name)
        )
    ]
    assert found == []


def test_annotations_are_never_evaluated_on_import():
    late = "from __future__ import annotations"
    defining = [m for m, tree in MODULES.items() if any(definitions(tree.body, m))]
    assert [module for module in defining if late not in source(module)] == []


def test_no_path_of_a_machine_is_written_down():
    files = [
        path
        for folder in (*PACKAGES, "mocks", "tests", ".ci", ".")
        for path in sorted((ROOT / folder).glob("*" if folder == "." else "**/*"))
        if path.suffix in {".py", ".md", ".toml", ".txt", ".cff", ".json", ".html"}
        or path.name in {"run", "Makefile"}
    ]
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in files
        if path.is_file()
        for number, line in enumerate(path.read_text("utf-8").splitlines(), 1)
        if MACHINE_PATH.search(line)
    ]
    assert len(files) > 150
    assert found == []


def test_every_module_imports_and_keeps_what_it_promises():
    for name in MODULES:
        if name in LOAD_OPENSIM or name.endswith("__main__"):
            continue
        module = importlib.import_module(name.removesuffix(".__init__"))
        promised = getattr(module, "__all__", [])
        assert [word for word in promised if not hasattr(module, word)] == [], name
        assert len(set(promised)) == len(promised), name
    assert "opensim" not in sys.modules
