"""Terminal output of the commands: lines, notes and progress bars."""

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

# All output goes through this module. Topic names, metadata and messages come from untrusted files, so
# control characters are escaped; only data for other programs is written unchanged, and not to a terminal.


# Value of a path option that stands for standard output
STANDARD_OUTPUT = Path("-")


QUIET, USUAL, VERBOSE = -1, 0, 1
# Stack of verbosity levels
_volume = [USUAL]


# The tqdm bar on the screen, if any; lines are printed above it
drawn_bars: list[Any] = []


@contextmanager
def volume(level: int) -> Iterator[None]:
    """Set the verbosity inside the context."""
    _volume.append(level)
    try:
        yield
    finally:
        _volume.pop()


def is_quiet() -> bool:
    """Return whether only errors and warnings are printed."""
    return _volume[-1] <= QUIET


def _print(text: str, file: IO[str]) -> None:
    # tqdm clears its bar, lets the line through and redraws the bar below.
    drawn = next(iter(drawn_bars), None)
    with nullcontext() if drawn is None else drawn.external_write_mode(file):
        print(one_line(text), file=file, flush=True)


def print_line(text: str = "") -> None:
    """Print one line on standard output, without control characters; nothing with --quiet."""
    if not is_quiet():
        _print(text, sys.stdout)


def print_note(text: str) -> None:
    """Print a warning or error, one line on standard error without control characters."""
    _print(text, sys.stderr)


def print_info(text: str) -> None:
    """Print information on standard error; nothing with --quiet."""
    if not is_quiet():
        print_note(text)


def print_detail(text: str) -> None:
    """Print a detail on standard error, with --verbose only."""
    if _volume[-1] >= VERBOSE:
        print_note(text)


def print_data(text: str) -> None:
    """Print text on standard output unchanged, as UTF-8; escape it if that is a terminal."""
    if sys.stdout is None:
        return
    sys.stdout.flush()  # the text bypasses the buffer of sys.stdout
    shown = printable(text) if sys.stdout.isatty() else text
    sys.stdout.buffer.write(shown.encode("utf-8", "backslashreplace"))


def discard_output() -> None:
    """Redirect standard output to /dev/null, so that Python does not retry a failed flush at exit."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def ignore_closed_pipe() -> Iterator[None]:
    """Ignore a closed pipe inside the context, for output piped to programs such as ``head``."""
    try:
        yield
        if sys.stdout is not None:
            sys.stdout.flush()  # keeps the order with later lines on standard error in a shared log
    except BrokenPipeError:
        discard_output()


# Progress bars on standard error, only on a terminal and without --quiet


_USUAL_COLUMNS = 80
# Left free after a bar: terminals echo ^C there, which would wrap a full line
_ECHO_COLUMNS = 3

# Redraw interval that keeps the elapsed time running while the count stands still
_REDRAWN_EVERY_S = 1.0

_LOCK = RLock()


class Bar:
    """A progress bar.

    Args:
        options: arguments of ``tqdm.tqdm``; None shows nothing.
    """

    def __init__(self, options: Mapping[str, Any] | None) -> None:
        self._options, self._done, self._note = options, 0, ""
        self._drawn: Any = None
        if not drawn_bars:
            self._draw()

    @property
    def done(self) -> int:
        """Current count."""
        return self._done

    @property
    def is_drawn(self) -> bool:
        """Whether the bar is shown."""
        return self._options is not None

    def begin_at(self, done: int) -> None:
        """Set the initial count, which does not enter the rate."""
        self._done = done
        self._draw()
        if self._drawn is not None:
            self._drawn.reset()
            self._drawn.initial = self._drawn.n = self._drawn.last_print_n = done

    def advance(self, count: int = 1, note: str | None = None, total: int | None = None) -> None:
        """Add to the count.

        Args:
            count: increment.
            note: new text after the bar; None keeps the current one.
            total: total count, if it was unknown.
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
        self._drawn.set_postfix_str(self._note, refresh=False)  # also replaces a temporary text
        self._drawn.update(count)

    def _draw(self) -> None:
        """Show the bar below the previous one, which is closed."""
        if self._options is None or self._drawn is not None:
            return
        from tqdm import tqdm

        close_bars()
        tqdm.monitor_interval = 0  # tqdm's monitor thread only redraws every ten seconds
        tqdm.set_lock(_LOCK)  # the default lock is shared by all processes
        sizes = {"ncols": _columns(), "nrows": 2}
        self._drawn = tqdm(**self._options, **sizes, file=sys.stderr, miniters=0)
        drawn_bars.append(self._drawn)
        Thread(target=_redraw, args=(self._drawn,), daemon=True).start()


def _redraw(drawn: Any) -> None:
    """Redraw a tqdm bar periodically while it is on the screen."""
    while True:
        sleep(_REDRAWN_EVERY_S)
        with _LOCK:
            if not _is_drawn(drawn):
                return
            drawn.refresh()


def _is_drawn(bar_of_tqdm: Any) -> bool:
    return any(one is bar_of_tqdm for one in drawn_bars)


def show_on_bar(text: str) -> None:
    """Show a temporary text on the current bar, until the bar advances."""
    with _LOCK:
        for drawn in drawn_bars:
            drawn.set_postfix_str(one_line(text))


@contextmanager
def show_phase(name: str, unit: str, total: int | None) -> Iterator[Advance]:
    """Show a phase (``posetrack_cli.phases``) as a bar on a terminal, else as one line."""
    with bar(name, unit, total) as shown:
        if not shown.is_drawn:
            print_info(f"{name} ...")
        yield shown.advance


@contextmanager
def bar(name: str, unit: str, total: int | None = None, *, stays: bool = True) -> Iterator[Bar]:
    """Yield a progress bar. A nested bar appears at its first count, and closes the outer one.

    Args:
        name: label.
        unit: unit of the count.
        total: total count; None if unknown.
        stays: whether the bar stays on the screen at the end.
    """
    # Log files get lines instead of bars.
    is_seen = sys.stderr.isatty() and not is_quiet()
    try:
        yield Bar({"desc": name, "unit": unit, "total": total, "leave": stays} if is_seen else None)
    finally:
        close_bars()


def _columns() -> int:
    try:
        columns = os.get_terminal_size(sys.stderr.fileno()).columns
    except OSError:
        columns = 0  # some terminals report 0 as well
    return (columns or _USUAL_COLUMNS) - _ECHO_COLUMNS


def close_bars() -> None:
    """Close all bars and restore the terminal; callable from any thread."""
    with _LOCK:
        while drawn_bars:
            drawn_bars.pop().close()
