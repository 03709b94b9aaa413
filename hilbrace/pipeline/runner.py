"""Run the stages of a run folder."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import tomli_w
import torch
from rich.console import Console

from hilbrace import __version__
from hilbrace.config import Config, read_config
from hilbrace.errors import InputError
from hilbrace.material.curves import cell_digest, load_table
from hilbrace.motion.trial_reader import recorded_files
from hilbrace.pipeline.stage import Inputs, Stage
from hilbrace.pipeline.stages import STAGES
from hilbrace.run import folder as runs
from hilbrace.run.progress import display
from hilbrace.run.records import load, save, write_atomic


def run_stages(config: Config, folder: Path, until: str = "report", quiet: bool = False) -> dict[str, Any]:
    """Run the pipeline in a folder; stages that are current are left alone.

    Args:
        config: The configuration; an effective copy is kept in the folder as ``run.toml``.
        folder: Run folder, made if absent.
        until: Last stage to run.
        quiet: Show no progress.

    Returns:
        The metrics by group.

    Raises:
        BusyError: Another process works in the folder.
        HilbraceError: What a stage raises; the stages before it keep their results.
    """
    torch.set_num_threads(1)  # the sums of several threads end in changing bits
    for name in own_cells(config):
        load_table(name)
    console = Console(stderr=True, quiet=quiet)
    with runs.locked(folder):
        manifest = runs.read_manifest(folder)
        mold = _mold_figures(folder)
        _write_config(config, folder)
        done: dict[str, runs.StageEntry] = {}
        metrics: dict[str, dict[str, Any]] = {}
        for stage in STAGES:
            key = stage_key(stage, config, {name: done[name].key for name in stage.needs})
            if stage.name == "report" and "mold" in metrics:
                key = runs.digest(key, json.dumps(metrics["mold"], sort_keys=True))
            entry = manifest.get(stage.name)
            if entry is not None and runs.is_current(folder, entry, key):
                console.print(f"[dim]{stage.name:<9} unchanged[/dim]")
                if stage.name == "solid" and mold is not None:
                    metrics["mold"] = mold
            else:
                entry = _run_stage(stage, config, folder, key, metrics, console)
            done[stage.name] = entry
            for group, figures in entry.metrics.items():
                metrics.setdefault(group, {}).update(figures)
            runs.write_manifest(folder, manifest | done, _about(config))
            runs.write_json(folder / runs.METRICS, metrics)
            if stage.name == until:
                break
    return metrics


def stage_key(stage: Stage, config: Config, upstream: dict[str, str]) -> str:
    """Digest of all that a stage's result depends on."""
    whole = config.model_dump(mode="json")
    sections = {name: whole[name] for name in stage.sections}
    inputs = _input_digests(config) if "motion" in stage.sections else []
    if "domain" in stage.sections:
        inputs += [runs.file_digest(path) for path in painted_files(config)]
    if "material" in stage.sections:
        inputs += [cell_digest(name) for name in own_cells(config)]
    return runs.digest(
        __version__, stage.name, json.dumps([sections, upstream, inputs], sort_keys=True, default=str)
    )


def read_metrics(folder: Path) -> dict[str, Any]:
    """The metrics of a run folder.

    Raises:
        InputError: There are none.
    """
    path = folder / runs.METRICS
    try:
        return json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise InputError(
            "no run in this folder", where=str(folder), hint="run `hilbrace demo` or `hilbrace run`"
        ) from None
    except ValueError as fault:
        raise InputError(f"damaged: {fault}", where=str(path), hint="run the folder again") from fault


def _run_stage(
    stage: Stage,
    config: Config,
    folder: Path,
    key: str,
    metrics: dict[str, dict[str, Any]],
    console: Console,
) -> runs.StageEntry:
    own = folder / stage.name
    own.mkdir(exist_ok=True)
    by_name = {each.name: each for each in STAGES}
    records = {
        name: load(kind, folder / by_name[name].file)
        for name in stage.needs
        if (kind := by_name[name].kind) is not None
    }
    runs.log_event(folder, "start", stage=stage.name, key=key)
    start = time.perf_counter()
    with display(console, stage.name) as progress:
        outcome = stage.work(Inputs(config, own, records, metrics, key, progress))
    files = list(outcome.files)
    if stage.kind is not None:
        save(outcome.record, folder / stage.file)
        files.insert(0, folder / stage.file)
    seconds = round(time.perf_counter() - start, 3)
    runs.log_event(folder, "end", stage=stage.name, seconds=seconds)
    console.print(f"{stage.name:<9} {seconds:7.1f} s")
    digests = {str(path.relative_to(folder)): runs.file_digest(path) for path in files}
    return runs.StageEntry(key, digests, seconds, outcome.metrics)


def _mold_figures(folder: Path) -> dict[str, Any] | None:
    """Figures of a mold that `hilbrace fabricate` made of the folder's solid; ``None`` if there is none.

    They belong to the solid that is there: one that is made anew has no mold yet.
    """
    return read_metrics(folder).get("mold") if (folder / runs.METRICS).exists() else None


def _input_digests(config: Config) -> list[str]:
    """Digests of the files that people may change between two runs."""
    paths = [*recorded_files(config.motion)]
    if config.biomech.model is not None:
        paths.append(config.biomech.model)
    if config.body.model_file is not None:
        paths.append(config.body.model_file)
    if config.motion.marker_map.endswith(".toml"):
        paths.append(Path(config.motion.marker_map))
    return [runs.file_digest(path) for path in paths]


def painted_files(config: Config) -> list[Path]:
    """Files of painted skin that the domain is cut by."""
    domain = config.domain
    return [path for path in (domain.painted, *(relief.painted for relief in domain.reliefs)) if path]


def own_cells(config: Config) -> list[str]:
    """Skeleton files of cells that are not built in."""
    return [name for name in (config.material.firm, config.material.soft) if name.endswith(".toml")]


def _write_config(config: Config, folder: Path) -> None:
    """Keep the effective configuration in the folder; a file that says the same is left as it is.

    A file that says something else (a person's, run with ``--set``) is kept beside it.
    """
    path = folder / "run.toml"
    if path.exists():
        if read_config(path) == config:
            return
        write_atomic(folder / "run.toml.before", path.read_bytes())
    content = config.model_dump(mode="json", exclude_none=True)
    write_atomic(path, tomli_w.dumps(content).encode())


def _about(config: Config) -> dict[str, Any]:
    return {
        "hilbrace": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "torch": torch.__version__,
        "motion": "synthetic" if config.motion.synthetic else "recorded",
        "note": "research software, not a medical device",
    }
