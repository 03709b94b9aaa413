"""``hilbrace fabricate RUN | brace.stl --limb limb.stl``: the mold of a brace, proved and ready to print."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hilbrace.errors import ConfigError, InputError

if TYPE_CHECKING:
    from rich.console import Console

    from fabrication.build import Step
    from fabrication.mold import Casting
    from hilbrace.config.mold import MoldSettings

OUT = "mold"
"""Folder in the run folder; beside a foreign brace it is called after the brace's file."""


def add_commands(parser: argparse.ArgumentParser) -> None:
    """Give ``hilbrace fabricate`` its arguments; loads nothing heavy.

    Args:
        parser: Parser of ``fabricate``.
    """
    parser.description = (
        "Make the casting mold of a brace: grooved core, shells, base and fixtures, each proved to close, to "
        "fill and to come apart, as STL, 3MF, GLB and STEP, with a work sheet for the casting. Research "
        "software, not a medical device."
    )
    parser.epilog = (
        "example: hilbrace fabricate hilbrace-demo; "
        "hilbrace fabricate brace.stl --limb limb.stl --set mold.printer=ender3"
    )
    parser.add_argument(
        "source", type=Path, metavar="RUN|brace.stl", help="run folder with a finished solid, or a brace"
    )
    parser.add_argument(
        "--limb", type=Path, metavar="limb.stl", help="the limb under a brace.stl (none under a flat coupon)"
    )
    parser.add_argument(
        "--units", choices=("mm", "cm", "m", "in"), help="unit of a brace.stl (default: told from its size)"
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the mold (default: RUN/mold, or brace-mold)"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="mold.KEY=VALUE", help="change one value of the mold"
    )
    parser.add_argument(
        "--slice", action="store_true", help="let PrusaSlicer tell time and filament of each piece (minutes)"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.set_defaults(command=_fabricate)


def _fabricate(options: argparse.Namespace) -> int:
    from rich.console import Console

    from fabrication.build import build_mold
    from fabrication.files import record_metrics, write_mold
    from fabrication.printers import profile
    from hilbrace.run.folder import locked

    settings = _settings(options)
    printer = profile(settings)
    run = options.source.is_dir()
    out = options.out or (options.source / OUT if run else _beside(options.source))
    step = _steps(Console(stderr=True, quiet=options.json))
    with locked(options.source) if run else nullcontext():
        with step("casting"):
            casting = _casting(options, settings)
        mold = build_mold(casting, settings, step)
        result = write_mold(out, mold, printer, settings, slice_pieces=options.slice, step=step)
        if run:
            record_metrics(options.source, result)
    failed = result.failure(out)
    if options.json:
        _print_json(result.content(out))
    else:
        from fabrication.summary import print_mold

        print_mold(result, out)
    if failed is not None:
        sys.stderr.write(failed.two_lines() + "\n")
        return failed.exit_code
    return 0


def _settings(options: argparse.Namespace) -> MoldSettings:
    from hilbrace.config import read_config
    from hilbrace.config.run_file import apply_overrides, parse_config

    overrides = {}
    for text in options.set:
        key, equals, value = text.partition("=")
        if not equals:
            raise ConfigError(f"'{text}' sets nothing", where="--set", hint="write --set mold.key=value")
        overrides[key.strip()] = value.strip()
    if options.source.is_dir():
        return read_config(options.source / "run.toml", overrides).mold
    content: dict[str, Any] = {}
    apply_overrides(content, overrides)
    return parse_config(content, "--set").mold


def _casting(options: argparse.Namespace, settings: MoldSettings) -> Casting:
    source: Path = options.source
    if source.is_dir():
        if options.limb or options.units:
            given = "--limb" if options.limb else "--units"
            raise InputError(
                f"{given} goes with a brace's file, not with a run folder",
                where=str(source),
                hint=f"leave {given} out: the run knows its limb, in millimetres",
            )
        from fabrication.casting import casting_of_run

        return casting_of_run(source, settings)
    if not source.exists():
        raise InputError(
            "no such file or folder", where=str(source), hint="name a run folder or a brace's STL file"
        )
    from fabrication.casting import casting_of_stl

    return casting_of_stl(source, options.limb, settings, units=options.units)


def _beside(brace: Path) -> Path:
    return brace.parent / f"{brace.stem}-mold"


def _steps(console: Console) -> Step:
    """Steps that show on a console: what goes on while it does, and how long it took."""

    @contextmanager
    def step(name: str) -> Iterator[None]:
        start = time.perf_counter()
        waiting: AbstractContextManager[object] = (
            console.status(name) if console.is_terminal else nullcontext()
        )
        with waiting:
            yield
        console.print(f"{name:<9} {time.perf_counter() - start:7.1f} s")

    return step


def _print_json(content: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
