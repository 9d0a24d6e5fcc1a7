"""What a command says and shows: lines, notes, bars."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from threading import RLock, Thread
from time import sleep
from typing import IO, Any

from posetrack_cli.phases import Advance
from posetrack_cli.text import one_line, printable

# What commands print: every line of every command goes through here.
#
# Topic names, metadata and messages come from files, and files from strangers: what a terminal would obey is
# escaped. Only data that programs read goes out as it is, and not to a terminal.


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


# How far a command is: bars on standard error, drawn only where a person looks and wants to be told


_USUAL_COLUMNS = 80
_ECHO_COLUMNS = 3
"""Kept free behind a bar: a terminal shows ^C there, and a longer line would break."""

_REDRAWN_EVERY_S = 1.0
"""Of a bar whose count stands still for long: its time goes on."""

_LOCK = RLock()


class Bar:
    """How much of something is done.

    Args:
        options: of tqdm's bar; None where nobody looks.
    """

    def __init__(self, options: Mapping[str, Any] | None) -> None:
        self._options, self._done, self._note = options, 0, ""
        self._drawn: Any = None
        if not drawn_bars:
            self._draw()

    @property
    def done(self) -> int:
        """How much is done."""
        return self._done

    @property
    def is_drawn(self) -> bool:
        """Whether anybody sees it."""
        return self._options is not None

    def begin_at(self, done: int) -> None:
        """So much was done before, and took no time of this run."""
        self._done = done
        self._draw()
        if self._drawn is not None:
            self._drawn.reset()
            self._drawn.initial = self._drawn.n = self._drawn.last_print_n = done

    def advance(self, count: int = 1, note: str | None = None, total: int | None = None) -> None:
        """So much more is done.

        Args:
            count: how much.
            note: shown beside the bar from now on; None leaves what is shown.
            total: how much there is, where that was not known.
        """
        self._done += count
        self._draw()
        if self._drawn is None:
            return
        self._drawn.ncols = _columns()
        if total is not None:
            self._drawn.total = total
        if note is not None:
            self._note = one_line(note)
        self._drawn.set_postfix_str(self._note, refresh=False)  # also in place of what was said meanwhile
        self._drawn.update(count)

    def _draw(self) -> None:
        """Draw it from now on, below the one before, which is over."""
        if self._options is None or self._drawn is not None:
            return
        from tqdm import tqdm

        close_bars()
        tqdm.monitor_interval = 0  # its thread looks every ten seconds only
        tqdm.set_lock(_LOCK)  # by default it is one of all processes
        sizes = {"ncols": _columns(), "nrows": 2}
        self._drawn = tqdm(**self._options, **sizes, file=sys.stderr, miniters=0)
        drawn_bars.append(self._drawn)
        Thread(target=_redraw, args=(self._drawn,), daemon=True).start()


def _redraw(drawn: Any) -> None:
    """Draw a bar of tqdm's again and again, as long as it is the one that is drawn."""
    while True:
        sleep(_REDRAWN_EVERY_S)
        with _LOCK:
            if not _is_drawn(drawn):
                return
            drawn.refresh()


def _is_drawn(bar_of_tqdm: Any) -> bool:
    return any(one is bar_of_tqdm for one in drawn_bars)


def say_meanwhile(text: str) -> None:
    """Show a text on the bar that is drawn, if there is one, until it advances."""
    with _LOCK:
        for drawn in drawn_bars:
            drawn.set_postfix_str(one_line(text))


@contextmanager
def phase_shown(name: str, unit: str, total: int | None) -> Iterator[Advance]:
    """Show a phase (``posetrack_cli.phases``): a bar where a person looks, else a line when it begins."""
    with bar(name, unit, total) as shown:
        if not shown.is_drawn:
            print_aside(f"{name} ...")
        yield shown.advance


@contextmanager
def bar(name: str, unit: str, total: int | None = None, *, stays: bool = True) -> Iterator[Bar]:
    """Yield a bar; one that another context surrounds is drawn once something is done, and ends the other's.

    Args:
        name: what is done.
        unit: of what is counted.
        total: None where it is not known.
        stays: whether its last state is left to be read.
    """
    is_seen = sys.stderr.isatty() and not is_quiet()
    try:
        yield Bar({"desc": name, "unit": unit, "total": total, "leave": stays} if is_seen else None)
    finally:
        close_bars()


def _columns() -> int:
    """Return how wide a bar may be."""
    try:
        columns = os.get_terminal_size(sys.stderr.fileno()).columns
    except OSError:
        columns = 0  # as some terminals say themselves
    return (columns or _USUAL_COLUMNS) - _ECHO_COLUMNS


def close_bars() -> None:
    """Leave the terminal as it was: also for a process that ends at once, from whichever thread."""
    with _LOCK:
        while drawn_bars:
            drawn_bars.pop().close()
