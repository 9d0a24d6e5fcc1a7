"""What commands print: every line of every command goes through here.

Topic names, metadata and messages come from files, and files from strangers: what a terminal would obey is
escaped. Only data that programs read goes out as it is, and not to a terminal.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import IO, Any

from posetrack_cli.text import one_line, printable

STANDARD_OUTPUT = Path("-")
"""What stands for it as the name of a file."""


QUIET, USUAL, VERBOSE = -1, 0, 1
_volume = [USUAL]
"""What is said of the command that runs."""


drawn_bars: list[Any] = []
"""The bar of tqdm's that is drawn now, if there is one; lines go above it."""


@contextmanager
def volume(asked: int) -> Iterator[None]:
    """Say less or more than usual of what is done inside."""
    _volume.append(asked)
    try:
        yield
    finally:
        _volume.pop()


def is_quiet() -> bool:
    """Whether only what went wrong is to be said."""
    return _volume[-1] <= QUIET


def _print(text: str, file: IO[str]) -> None:
    drawn = next(iter(drawn_bars), None)
    with nullcontext() if drawn is None else drawn.external_write_mode(file):
        print(one_line(text), file=file, flush=True)


def print_line(text: str = "") -> None:
    """Print one line of a command's answer on standard output, without control characters.

    --quiet leaves it out.
    """
    if not is_quiet():
        _print(text, sys.stdout)


def print_note(text: str) -> None:
    """Print one line on standard error, without control characters: what the user should know."""
    _print(text, sys.stderr)


def print_aside(text: str) -> None:
    """Print what is good to know, and nothing has gone wrong; not for --quiet."""
    if not is_quiet():
        print_note(text)


def print_detail(text: str) -> None:
    """Print what only --verbose asks for."""
    if _volume[-1] >= VERBOSE:
        print_note(text)


def print_data(text: str) -> None:
    """Print text for programs on standard output, exactly and as UTF-8; a terminal gets it escaped, too."""
    if sys.stdout is None:
        return
    sys.stdout.flush()  # lines before it come before it
    shown = printable(text) if sys.stdout.isatty() else text
    sys.stdout.buffer.write(shown.encode("utf-8", "backslashreplace"))


def discard_output() -> None:
    """What is buffered for an output that cannot be written goes nowhere: exit must not try again."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Print what a reader such as ``head`` need not read to its end: nothing else depends on that."""
    try:
        yield
        if sys.stdout is not None:
            sys.stdout.flush()  # a log that takes both shows this before what follows on standard error
    except BrokenPipeError:
        discard_output()
