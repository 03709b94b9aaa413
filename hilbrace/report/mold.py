"""The mold's part of the report: what ``mold/checks.json`` of a run says, and its pictures."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hilbrace.errors import InputError


@dataclass(frozen=True)
class MoldSection:
    """What the report shows of a mold.

    Attributes:
        passed: Whether all checks passed.
        checks: Name, value, rule and verdict of each check.
        pictures: Captions and PNG files as base64.
    """

    passed: bool
    checks: tuple[tuple[str, str, str, str], ...]
    pictures: tuple[tuple[str, str], ...]


def mold_section(run: Path) -> MoldSection | None:
    """Read the mold of a run folder; ``None`` where none was made.

    Args:
        run: The run folder.

    Raises:
        InputError: ``mold/checks.json`` is damaged.
    """
    file = run / "mold" / "checks.json"
    if not file.is_file():
        return None
    try:
        content = json.loads(file.read_text("utf-8"))
        return MoldSection(
            bool(content["passed"]),
            tuple(_check(name, each) for name, each in content["checks"].items()),
            tuple(
                (name, base64.b64encode((file.parent / path).read_bytes()).decode())
                for name, path in content["pictures"].items()
                if path.endswith(".png") and (file.parent / path).is_file()
            ),
        )
    except (ValueError, KeyError, TypeError, AttributeError) as fault:
        raise InputError(
            f"damaged: {fault}", where=str(file), hint="make the mold again with hilbrace fabricate"
        ) from fault


def _check(name: str, found: dict[str, Any]) -> tuple[str, str, str, str]:
    verdict = "passed" if found["passed"] else f"FAILED; {found['mend']}"
    return name, f"{found['value']:g}", str(found["rule"]), f"{verdict} ({found['means']})"
