"""The command line: ``hilbrace demo | run | show | doctor``, and the commands of other packages.

Only the chosen command's own modules are imported, so that ``--help`` answers at once. A package adds a
command by an entry point of the group `COMMANDS`: its name is the command's, and it leads to a function that
gives an argument parser its arguments and its default ``command``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from hilbrace import __version__
from hilbrace.errors import ConfigError, HilbraceError

STAGES = ("motion", "body", "biomech", "domain", "optimize", "pattern", "solid", "report")

COMMANDS = "hilbrace.commands"
"""Entry-point group of the commands that other packages bring."""

OWN_PACKAGES = {
    "fabricate": "mold pieces for any brace solid, with proof that they come apart",
    "evaluate": "joint angles, recorded or live, and the comparison of brace conditions",
}
"""Commands of the packages that are installed along with this one."""

DISCLAIMER = "Research software, not a medical device."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; errors print as two lines on standard error.

    Args:
        arguments: The words after ``hilbrace``; those of the process if left out.

    Returns:
        0, or the exit code of the named error; 130 when interrupted.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    options = argparse.Namespace(json="--json" in words)
    _repeatable_arithmetic()
    try:
        options = _parser(words).parse_args(words)
        return int(options.command(options))
    except HilbraceError as fault:
        if getattr(options, "json", False):
            _print_json(
                {"error": type(fault).__name__, "what": fault.what, "where": fault.where, "mend": fault.hint}
            )
        sys.stderr.write(fault.two_lines() + "\n")
        return fault.exit_code
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command goes on from the last checkpoint\n")
        return 130


def _parser(words: list[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hilbrace",
        description=f"Design soft prophylactic braces from human motion. {DISCLAIMER}",
        epilog="example: hilbrace demo --quick --out my-first-brace",
    )
    parser.add_argument("--version", action="version", version=f"hilbrace {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    demo = _command(
        commands, "demo", _demo, "the whole chain on the built-in synthetic subject",
        "hilbrace demo --quick --out my-first-brace",
    )  # fmt: skip
    demo.add_argument(
        "--quick", action="store_true", help="coarser mesh and fewer iterations, about a minute"
    )
    demo.add_argument(
        "--motion",
        choices=("serve", "gait", "squat"),
        default="serve",
        help="synthetic motion (default: serve)",
    )
    demo.add_argument(
        "--preset",
        choices=("default", "smooth", "paper"),
        default="default",
        help="values for all that is not said otherwise (default: default)",
    )
    _run_options(demo, default_out="hilbrace-demo")

    run = _command(
        commands, "run", _run, "run the stages of a run.toml, only what changed",
        "hilbrace run my-study/run.toml --out my-study/left-knee --set domain.side=right",
    )  # fmt: skip
    run.add_argument(
        "source", type=Path, metavar="FOLDER|run.toml", help="run folder, or a configuration file"
    )
    _run_options(run, default_out=None)

    ablate = _command(
        commands, "ablate", _ablate, "what each loss and the volume do to a design: one table, one picture",
        "hilbrace ablate hilbrace-demo --out ablation --preset paper",
    )  # fmt: skip
    _ablate_options(ablate)

    show = _command(commands, "show", _show, "what came out of a run folder", "hilbrace show hilbrace-demo")
    show.add_argument("folder", type=Path, metavar="FOLDER", help="run folder")
    show.add_argument("--json", action="store_true", help="print metrics.json instead of the table")

    doctor = _command(
        commands, "doctor", _doctor, "versions, backends, threads and memory", "hilbrace doctor"
    )
    doctor.add_argument("--json", action="store_true", help="one JSON object on standard output")
    cells = _command(
        commands, "cells", _cells, "the microstructures: stiffness, pictures, cells of your own, test pieces",
        "hilbrace cells --out cells; hilbrace cells add my_cell.toml; hilbrace cells coupon star --d 0.5;"
        " hilbrace cells calibrate curve.csv",
    )  # fmt: skip
    _cells_options(cells, "".join(words[1:2]) if words[:1] == ["cells"] else "")

    scan = _command(
        commands, "scan", _scan, "from structured-light pictures or a scanner's mesh to a limb",
        "hilbrace scan patterns --out patterns --projector 1280x720",
    )  # fmt: skip
    if words[:1] == ["scan"]:
        from hilbrace.scan.scan_command import add_options

        add_options(scan, "".join(words[1:2]))
    _add_packages(commands, words[0] if words else "")
    return parser


def _add_packages(commands: Any, chosen: str) -> None:
    """Add the commands of other packages; only the chosen one's package is imported.

    Raises:
        ConfigError: The chosen command's package is not installed, or does not load.
    """
    found: dict[str, EntryPoint] = {point.name: point for point in entry_points(group=COMMANDS)}
    if chosen in OWN_PACKAGES and chosen not in found:
        raise ConfigError(
            f"no installed package brings the command '{chosen}'",
            where=f"entry points '{COMMANDS}'",
            hint="install it again; in a checkout: pip install --no-deps --editable .",
        )
    for name, point in sorted(found.items()):
        text = OWN_PACKAGES.get(
            name, f"command of the package {point.dist.name if point.dist else point.value}"
        )
        command = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name == chosen:
            try:
                add_arguments = point.load()
            except (ImportError, AttributeError) as fault:
                raise ConfigError(
                    f"the command '{name}' does not load: {fault}",
                    where=f"entry point {point.value}",
                    hint="install the package that brings it again",
                ) from None
            add_arguments(command)


def _command(commands: Any, name: str, action: Any, text: str, example: str) -> argparse.ArgumentParser:
    command = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", epilog=f"example: {example}"
    )
    command.set_defaults(command=action)
    return command


def _run_options(command: argparse.ArgumentParser, default_out: str | None) -> None:
    where = (
        f"default: {default_out}"
        if default_out
        else "default: the folder, or runs/<name of the file's folder>"
    )
    command.add_argument("--out", type=Path, metavar="DIR", default=default_out, help=f"run folder ({where})")
    command.add_argument(
        "--until", choices=STAGES, default=STAGES[-1], help="last stage to run (default: all)"
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="A.B=VALUE",
        help="change one value of the configuration",
    )
    command.add_argument("--json", action="store_true", help="print metrics.json when done, and nothing else")


def _demo(options: argparse.Namespace) -> int:
    from hilbrace.pipeline import demo_config, run_stages

    config = demo_config(
        options.motion, quick=options.quick, overrides=_overrides(options.set), preset=options.preset
    )
    metrics = run_stages(config, Path(options.out), until=options.until, quiet=options.json)
    return _finish(options, Path(options.out), metrics)


def _run(options: argparse.Namespace) -> int:
    from hilbrace.config import read_config
    from hilbrace.pipeline import run_stages

    source: Path = options.source
    file = source / "run.toml" if source.is_dir() else source
    config = read_config(file, _overrides(options.set))
    out = options.out or (source if source.is_dir() else Path("runs") / file.resolve().parent.name)
    metrics = run_stages(config, out, until=options.until, quiet=options.json)
    return _finish(options, out, metrics)


def _ablate_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "source", type=Path, metavar="RUN|run.toml", help="run folder, or a configuration file"
    )
    command.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of table, picture and variants (default: RUN/ablation, or runs/<name of the file's "
        "folder>/ablation)",
    )
    command.add_argument(
        "--preset",
        choices=("default", "smooth", "paper"),
        help="take a preset's values, whatever the source says (default: the source's own)",
    )
    command.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="A.B=VALUE",
        help="change one value of the configuration",
    )
    command.add_argument(
        "--json", action="store_true", help="print ablation.json when done, and nothing else"
    )


def _ablate(options: argparse.Namespace) -> int:
    from hilbrace.config import preset_overrides, read_config
    from hilbrace.pipeline.ablation import run_ablation
    from hilbrace.report.ablation import ablation_figures, ablation_text

    file: Path = options.source / "run.toml" if options.source.is_dir() else options.source
    chosen = preset_overrides(options.preset) if options.preset else {}
    config = read_config(file, chosen | _overrides(options.set))
    finished = file.parent if (file.parent / "manifest.json").is_file() else None
    out = options.out or (finished or Path("runs") / file.resolve().parent.name) / "ablation"
    ablation = run_ablation(config, finished, out, quiet=options.json)
    if options.json:
        _print_json(ablation_figures(ablation))
        return 0
    sys.stdout.write(ablation_text(ablation))
    sys.stdout.write(
        f"\npage    {out / 'ablation.html'}\npicture {out / 'ablation.png'}\ntable   {out / 'ablation.csv'}\n"
    )
    return 0


def _finish(options: argparse.Namespace, out: Path, metrics: dict[str, Any]) -> int:
    if options.json:
        _print_json(metrics)
        return 0
    from hilbrace.pipeline import print_summary

    print_summary(out, metrics)
    return 0


def _show(options: argparse.Namespace) -> int:
    from hilbrace.pipeline import print_summary, read_metrics

    metrics = read_metrics(options.folder)
    if options.json:
        _print_json(metrics)
    else:
        print_summary(options.folder, metrics)
    return 0


def _doctor(options: argparse.Namespace) -> int:
    from hilbrace.doctor import examine, print_findings

    findings = examine()
    if options.json:
        _print_json(findings)
    else:
        print_findings(findings)
    return 0 if findings["healthy"] else 1


def _cells_options(command: argparse.ArgumentParser, action: str) -> None:
    if action in ("coupon", "calibrate"):
        from hilbrace.pattern.coupon.command import add_options

        command.set_defaults(command=_coupon)
        add_options(command, action)
        return
    command.add_argument(
        "cells",
        nargs="*",
        metavar="CELL",
        help="built-in names or skeleton files (default: all built-in); 'add FILE.toml' homogenizes a"
        " skeleton file of your own, once, and writes its table beside it",
    )
    command.add_argument(
        "--pixels", type=int, default=128, metavar="N", help="pixels a side for 'add' (default: 128)"
    )
    command.add_argument(
        "--volume",
        type=float,
        default=0.35,
        metavar="V",
        help="compare at this volume fraction (default: 0.35)",
    )
    command.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        default=Path("hilbrace-cells"),
        help="folder of pictures and samples (default: hilbrace-cells)",
    )
    command.add_argument("--json", action="store_true", help="one JSON object on standard output")


def _cells(options: argparse.Namespace) -> int:
    from rich.console import Console

    from hilbrace.material.cell_atlas import add_cell, atlas, atlas_text, chosen_cells
    from hilbrace.run.progress import display

    added, shown = chosen_cells(options.cells)
    for path in added:
        with display(Console(stderr=True, quiet=options.json), Path(path).stem) as progress:
            add_cell(path, options.pixels, progress)
    figures = atlas(shown, options.volume, options.out)
    if options.json:
        _print_json(figures)
    else:
        sys.stdout.write(atlas_text(figures))
    return 0


def _coupon(options: argparse.Namespace) -> int:
    from hilbrace.pattern.coupon.command import calibrated, coupon

    figures, text = (coupon if options.action == "coupon" else calibrated)(options)
    if options.json:
        _print_json(figures)
    else:
        sys.stdout.write(text)
    return 0


def _scan(options: argparse.Namespace) -> int:
    from hilbrace.scan.scan_command import act

    figures, text = act(options)
    if options.json:
        _print_json(figures)
    else:
        sys.stdout.write(text)
    return 0


def _overrides(pairs: list[str]) -> dict[str, str]:
    overrides: dict[str, str] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise ConfigError(f"'{pair}' has no '='", where="--set", hint="write --set section.key=value")
        overrides[key.strip()] = value.strip()
    return overrides


def _print_json(content: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(content) + "\n")


def _repeatable_arithmetic() -> None:
    """Ask the linear algebra libraries for the same bits on every run; must come before they are loaded."""
    os.environ.setdefault("MKL_CBWR", "COMPATIBLE")
    os.environ.setdefault("OMP_DYNAMIC", "FALSE")


if __name__ == "__main__":
    sys.exit(main())
