"""Errors for people: one line with what, where, found, expected, hint."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from posetrack_cli.text import printable

# Errors that a user can mend, each shown as one line, and the exit codes of the command line


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


# The rule for readers of containers: an adapter handles the errors it declares; any other is damage


T = TypeVar("T")

DAMAGED_HERE = "is damaged here"
_LONGEST_MESSAGE = 300


@contextmanager
def damage_reported(where: Callable[[], object]) -> Iterator[None]:
    """Report an error that no adapter declares as damage of the file that is read.

    Args:
        where: returns the file, and the place in it that is read.

    Raises:
        RecordingError: anything else was raised than an error of posetrack, of the disk or of memory.
    """
    try:
        yield
    except (PosetrackError, OSError, MemoryError):
        raise
    except Exception as error:
        raise RecordingError(
            DAMAGED_HERE,
            where=where(),
            found=error_words(error),
            hint="if other programs read it, please report it with what POSETRACK_DEBUG=1 shows",
        ) from error


def read_from(path: Path, items: Iterable[T], word: str) -> Iterator[T]:
    """Yield the items of a file; what its reader raises and no adapter declares is damage behind the last.

    Args:
        path: the file.
        items: what is read of it.
        word: for one of them.
    """
    count = 0
    with damage_reported(lambda: f"{path}, after {word} {count}" if count else path):
        for item in items:
            yield item
            count += 1


def error_words(error: Exception) -> str:
    """Return an error's type and message, and the line of posetrack that it comes from."""
    kind = type(error)
    name = kind.__name__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__name__}"
    words = " ".join(str(error).split())
    message = f"{name}: {words[:_LONGEST_MESSAGE]}" if words else name
    return f"{message} at {_place(error)}"


def _place(error: Exception) -> str:
    """File and line of posetrack that is innermost among those that led to an error."""
    package, place = Path(__file__).parent, "no line of posetrack"
    for frame, line in traceback.walk_tb(error.__traceback__):
        path = Path(frame.f_code.co_filename)
        if path.is_relative_to(package):
            place = f"{path.relative_to(package.parent)}:{line}"
    return place
