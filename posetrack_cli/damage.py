"""The rule for readers of containers: an adapter handles the errors it declares; any other is damage."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from posetrack_cli.errors import PosetrackError, RecordingError

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
