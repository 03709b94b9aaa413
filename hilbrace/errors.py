"""Errors a user can act on: what went wrong, where, and what mends it."""

from __future__ import annotations


class HilbraceError(Exception):
    """A named failure that prints as two lines: what and where, then what to do.

    Args:
        what: What is wrong, in one sentence without a full stop.
        where: File, frame, key or stage that shows it.
        hint: What the reader can do about it.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str, hint: str) -> None:
        super().__init__(f"{what} ({where})")
        self.what = what
        self.where = where
        self.hint = hint

    def two_lines(self) -> str:
        """The message as the command line prints it."""
        name = type(self).__name__
        return f"{name}: {self.what} [{self.where}]\n  mend: {self.hint}"


class InputError(HilbraceError):
    """A file or recording cannot be used as it is."""

    exit_code = 2


class ConfigError(HilbraceError):
    """A key or value of the configuration is wrong."""

    exit_code = 3


class GeometryError(HilbraceError):
    """A surface, region or solid cannot be made from what was given."""

    exit_code = 4


class SolverError(HilbraceError):
    """A computation did not reach a valid answer."""

    exit_code = 5


class BusyError(HilbraceError):
    """Another process is working in the same run folder."""

    exit_code = 6
