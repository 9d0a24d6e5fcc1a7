"""Errors that a user can mend, each shown as one line, and the exit codes of the command line."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from posetrack_cli.text import printable

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_DATA_LOST = 3
EXIT_INTERRUPTED = 130


class PosetrackError(Exception):
    """Root of every error that posetrack raises on purpose.

    Args:
        what: what went wrong, in a few words.
        where: file, topic, frame or time it went wrong at.
        found: what was there.
        expected: what should have been there.
        hint: what the user can do about it.

    ``str(error)`` is one line of the parts that are given, without control characters.
    """

    exit_code = EXIT_FAILED

    def __init__(
        self,
        what: str,
        *,
        where: object = "",
        found: object = "",
        expected: object = "",
        hint: str = "",
    ) -> None:
        parts = [f"{where}: {what}" if str(where) else what]
        if str(found):
            parts.append(f"found {found}")
        if str(expected):
            parts.append(f"expected {expected}")
        line = ", ".join(parts)
        if hint:
            line += f"; {hint}"
        super().__init__(printable(" ".join(line.split())))


class UsageError(PosetrackError):
    """A command, option or configuration that cannot be meant."""

    exit_code = EXIT_USAGE


class RecordingError(PosetrackError):
    """A recording that cannot be read."""


class ResultError(PosetrackError):
    """A result that cannot be written or read."""


class TruthError(PosetrackError):
    """A truth that cannot be read, or is of something else than the result."""


class RenderingError(PosetrackError):
    """No working GL, or a renderer asked for something it cannot do."""


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Return a hint ``did you mean 'x'?`` for a misspelt name, or the known names if none is near."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"known: {', '.join(names)}"
