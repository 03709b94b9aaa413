"""``hilbrace evaluate angles | table | verify-pig``, and the commands of the live laboratory."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from evaluation.live_cli import add_live_commands
from hilbrace.errors import InputError

OUT = "evaluation"
"""Folder beside the study file, unless --out names another."""


def add_commands(parser: argparse.ArgumentParser) -> None:
    """Give ``hilbrace evaluate`` its own commands; loads nothing heavy.

    Args:
        parser: Parser of ``evaluate``.
    """
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    angles = _command(
        commands, "angles", _angles, "knee and ankle angles of every trial of a study, as CSV files",
        "hilbrace evaluate angles study.toml --convention plug_in_gait",
    )  # fmt: skip
    _study_options(angles)
    angles.add_argument(
        "--convention",
        choices=("paper", "visual3d", "plug_in_gait"),
        help="signs of the knee angles (default: the study file's)",
    )
    table = _command(
        commands, "table", _table, "the paper's table of brace conditions, with intervals, and a report",
        "hilbrace evaluate table study.toml --out results",
    )  # fmt: skip
    _study_options(table)
    table.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the bootstrap (default: 0)")
    verify = _command(
        commands, "verify-pig", _verify, "hold our angles against those that Plug-in Gait stored",
        "hilbrace evaluate verify-pig walk.c3d stairs.c3d",
    )  # fmt: skip
    verify.add_argument(
        "files", type=Path, nargs="+", metavar="FILE.c3d", help="files with Plug-in Gait outputs"
    )
    verify.add_argument("--json", action="store_true", help="one JSON object on standard output")
    add_live_commands(commands, _command)


def _command(commands: Any, name: str, action: Any, text: str, example: str) -> argparse.ArgumentParser:
    command = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", epilog=f"example: {example}"
    )
    command.set_defaults(command=action)
    return command


def _study_options(command: argparse.ArgumentParser) -> None:
    command.add_argument("study", type=Path, metavar="study.toml", help="conditions, trials and protocol")
    command.add_argument(
        "--out", type=Path, metavar="DIR", help=f"folder of results (default: {OUT}, beside the study file)"
    )
    command.add_argument("--json", action="store_true", help="one JSON object on standard output")


def _angles(options: argparse.Namespace) -> int:
    from evaluation.conventions import KNEE_MEANING, PLANES
    from evaluation.tables import trials_json, write_angles_csv

    measured = _measure(options)
    settings = measured.study.settings
    convention = options.convention or settings.convention
    folder = _folder(options, "angles")
    files = []
    for trial in measured.trials:
        files.append(folder / f"{trial.name}.csv")
        write_angles_csv(files[-1], trial, settings.protocol.side, convention)
    if options.json:
        signs = dict(zip(PLANES, KNEE_MEANING[convention], strict=True))
        trials = [
            row | {"file": str(file)} for row, file in zip(trials_json(measured, None), files, strict=True)
        ]
        _print_json({"convention": convention, "signs": signs, "trials": trials,
                     "warnings": list(measured.notes)})  # fmt: skip
    else:
        from evaluation.terminal import print_trials

        print_trials(measured, folder)
    return 0


def _table(options: argparse.Namespace) -> int:
    from evaluation.report import write_report
    from evaluation.results import evaluate
    from evaluation.tables import table_json, write_events_toml, write_table_csv
    from hilbrace.run.records import write_atomic

    result = evaluate(_measure(options), options.seed)
    folder = _folder(options)
    content = table_json(result)
    write_table_csv(folder / "table.csv", result)
    write_atomic(folder / "table.json", (json.dumps(content, indent=1) + "\n").encode())
    write_events_toml(folder / "events.toml", result)
    page = write_report(folder, result)
    if options.json:
        _print_json(content | {"files": {"report": str(page), "table": str(folder / "table.csv")}})
    else:
        from evaluation.terminal import print_table

        print_table(result, folder)
    return 0


def _verify(options: argparse.Namespace) -> int:
    from evaluation.verification import TOLERANCE_DEG, verify_plug_in_gait
    from hilbrace.motion.c3d import C3DReader

    checks, refused, notes = [], [], []
    with C3DReader() as reader:
        for path in options.files:
            try:
                found, remarks = verify_plug_in_gait(reader.read(path), str(path))
            except InputError as fault:
                if len(options.files) == 1:
                    raise
                refused.append((path, fault))
            else:
                checks += [(path, check) for check in found]
                notes += [f"{path.name}: {remark}" for remark in remarks]
    agree = all(check.agrees for _, check in checks) and not refused
    if options.json:
        rows = [
            {
                "file": str(path),
                "angles": check.name,
                "from": check.source,
                "frames": check.frames,
                "rms_deg": [float(value) for value in check.rms_deg],
                "largest_deg": [float(value) for value in check.largest_deg],
                "agrees": check.agrees,
            }
            for path, check in checks
        ]
        refusals = [{"file": str(path), "what": fault.what, "mend": fault.hint} for path, fault in refused]
        _print_json(
            {
                "tolerance_deg": TOLERANCE_DEG,
                "agrees": agree,
                "checks": rows,
                "refused": refusals,
                "notes": notes,
            }
        )
    else:
        from evaluation.terminal import print_checks

        print_checks(checks, refused, notes)
    return 0 if agree else 1


def _measure(options: argparse.Namespace) -> Any:
    from rich.console import Console

    from evaluation.measure import measure_study
    from evaluation.study import read_study
    from hilbrace.run.progress import display

    study = read_study(options.study)
    with display(Console(stderr=True, quiet=options.json), "trials") as progress:
        return measure_study(study, progress)


def _folder(options: argparse.Namespace, inside: str = "") -> Path:
    folder = (options.out or options.study.resolve().parent / OUT) / inside
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(
            f"cannot make the folder: {fault.strerror}", where=str(folder), hint="give another --out"
        ) from None
    return folder


def _print_json(content: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
