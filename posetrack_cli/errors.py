"""User-facing errors: one line with what, where, found, expected, hint."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from posetrack_cli.text import printable

# Exit codes and error types

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_DATA_LOST = 3
EXIT_INTERRUPTED = 130


class PosetrackError(Exception):
    """Base class of all errors that posetrack raises deliberately.

    Args:
        what: description of the problem, in a few words.
        where: file, topic, frame or time of the problem.
        found: offending value.
        expected: valid values.
        hint: suggestion for the user.

    ``str(error)`` is one line of the given parts, without control characters.
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
    """Invalid command, option or configuration."""

    exit_code = EXIT_USAGE


class RecordingError(PosetrackError):
    """Unreadable recording."""


class ResultError(PosetrackError):
    """Result that cannot be written or read."""


class TruthError(PosetrackError):
    """Reference data that is unreadable or does not belong to the result."""


class RenderingError(PosetrackError):
    """No working GL, or an unsupported rendering request."""


def nearest_name(name: str, known: Iterable[str]) -> str:
    """Return a hint ``did you mean 'x'?`` for a misspelt name, or the known names if none is near."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"known: {', '.join(names)}"


# Container readers: an adapter handles the errors it declares; any other exception means a damaged file

T = TypeVar("T")

DAMAGED_HERE = "is damaged here"
_LONGEST_MESSAGE = 300


@contextmanager
def damage_reported(where: Callable[[], object]) -> Iterator[None]:
    """Convert undeclared exceptions into an error about a damaged file.

    Args:
        where: returns the file and position being read.

    Raises:
        RecordingError: anything other than a posetrack, OS or memory error was raised.
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
            hint="if other programs can read the file, please report it with the output of POSETRACK_DEBUG=1",
        ) from error


def read_from(path: Path, items: Iterable[T], word: str) -> Iterator[T]:
    """Yield the items of a file; report undeclared exceptions as damage after the last item.

    Args:
        path: the file.
        items: items read from it.
        word: name of one item.
    """
    count = 0
    with damage_reported(lambda: f"{path}, after {word} {count}" if count else path):
        for item in items:
            yield item
            count += 1


def error_words(error: Exception) -> str:
    """Return an error's type, message and innermost posetrack source line."""
    kind = type(error)
    name = kind.__name__ if kind.__module__ == "builtins" else f"{kind.__module__}.{kind.__name__}"
    words = " ".join(str(error).split())
    message = f"{name}: {words[:_LONGEST_MESSAGE]}" if words else name
    return f"{message} at {_place(error)}"


def _place(error: Exception) -> str:
    package, place = Path(__file__).parent, "unknown posetrack line"
    for frame, line in traceback.walk_tb(error.__traceback__):
        path = Path(frame.f_code.co_filename)
        if path.is_relative_to(package):
            place = f"{path.relative_to(package.parent)}:{line}"
    return place
