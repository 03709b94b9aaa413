"""``hilbrace scan``: from pictures or a mesh to the surface of a limb.

Each action is a module with ``add_options(command)`` and ``act(options)``, which gives figures for ``--json``
and what to tell a person. Only the chosen action's module is imported.
"""

from __future__ import annotations

import argparse
import importlib
from typing import Any

from hilbrace.errors import ConfigError

ACTIONS = {
    "patterns": ("hilbrace.scan.patterns_command", "pictures for the projector, and a board to print"),
    "calibrate": ("hilbrace.scan.calibrate_command", "camera and projector from pictures of a board"),
    "decode": ("hilbrace.scan.decode_command", "points and mesh of a limb from pictures of it"),
    "fit": ("hilbrace.scan.fit_command", "the body of a person from a scan of the legs"),
}
"""Module of each action, and what it does."""


def add_options(command: argparse.ArgumentParser, action: str) -> None:
    """Give the parser of ``hilbrace scan`` the arguments of an action.

    Args:
        command: The parser.
        action: The word after ``scan``; without one, or with an option, the actions are listed.

    Raises:
        ConfigError: There is no such action.
    """
    if action not in ACTIONS:
        if action and not action.startswith("-"):
            raise ConfigError(
                f"scan cannot '{action}'", where="hilbrace scan", hint=f"choose one of {', '.join(ACTIONS)}"
            )
        _list_actions(command)
        return
    module, text = ACTIONS[action]
    command.prog = f"hilbrace scan {action}"
    command.description = text[0].upper() + text[1:] + "."
    command.add_argument("action", choices=(action,), help=argparse.SUPPRESS)
    importlib.import_module(module).add_options(command)
    command.add_argument("--json", action="store_true", help="one JSON object on standard output")


def act(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Do the chosen action; its figures, and what to tell a person."""
    module, _ = ACTIONS[options.action]
    return importlib.import_module(module).act(options)


def _list_actions(command: argparse.ArgumentParser) -> None:
    actions = command.add_subparsers(title="actions", required=True, metavar="ACTION", dest="action")
    for name, (_, text) in ACTIONS.items():
        actions.add_parser(name, help=text, add_help=False)
    command.epilog = "example: hilbrace scan patterns --out patterns --projector 1280x720"
