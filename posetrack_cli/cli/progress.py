"""How far a command is: bars on standard error, drawn only where a person looks and wants to be told."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import TYPE_CHECKING

from posetrack_cli.cli.standard_output import is_quiet, print_note
from posetrack_cli.text import one_line

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn, Task, TaskID

_DRAWN_EVERY_S = 0.1


class Bar:
    """How much of something is done.

    Args:
        display: draws it; None for nothing.
        name: what is done.
        unit: of what is counted.
        total: None where it is not known.
    """

    def __init__(self, display: Progress | None, name: str, unit: str, total: int | None) -> None:
        self._display, self._drawn_s, self._done = display, 0.0, 0
        self._task: TaskID | None = None
        if display is not None:
            self._task = display.add_task(name, total=total, unit=unit, note="")

    @property
    def done(self) -> int:
        """How much is done."""
        return self._done

    @property
    def is_drawn(self) -> bool:
        """Whether anybody sees it."""
        return self._display is not None

    def begin_at(self, done: int) -> None:
        """So much was done before, and took no time of this run."""
        self._done = done
        if self._display is not None and self._task is not None:
            self._display.reset(self._task, completed=done)

    def advance(self, count: int = 1, note: str | None = None, total: int | None = None) -> None:
        """So much more is done.

        Args:
            count: how much.
            note: shown beside the bar from now on; None leaves what is shown.
            total: how much there is, where that was not known.
        """
        self._done += count
        if self._display is None or self._task is None:
            return
        self._display.update(self._task, completed=self._done, total=total)
        if note is not None:
            self._display.update(self._task, note=one_line(note))
        if (now := time.monotonic()) - self._drawn_s >= _DRAWN_EVERY_S:
            self._drawn_s = now
            with _LOCK:
                self._display.refresh()


_LOCK = RLock()
_shown: list[Progress] = []
"""What draws the bars that there are now; bars of several passes stand below each other."""


@contextmanager
def bar(name: str, unit: str, total: int | None = None, *, stays: bool = True) -> Iterator[Bar]:
    """Yield a bar, drawn at least at its end.

    Args:
        name: what is done.
        unit: of what is counted.
        total: None where it is not known.
        stays: whether its last state is left to be read.
    """
    if is_quiet() or not sys.stderr.isatty():
        yield Bar(None, name, unit, total)
        return
    with _display(stays) as display:
        yield Bar(display, name, unit, total)


@contextmanager
def _display(stays: bool) -> Iterator[Progress]:
    """What draws: the one that is there, or a new one."""
    if _shown:
        yield _shown[0]
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(file=sys.stderr, markup=False, emoji=False, highlight=False)
    display = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        _counted(),
        TimeRemainingColumn(compact=True, elapsed_when_finished=True),
        TextColumn("{task.fields[note]}", markup=False),
        console=console,
        auto_refresh=False,  # no thread of its own: processes are forked meanwhile
        expand=True,  # the bar gets what is left
        transient=not stays,
        redirect_stdout=False,
        redirect_stderr=False,
    )
    with display:
        _shown.append(display)
        try:
            yield display
        finally:
            _shown.clear()


def _counted() -> ProgressColumn:
    """A column: how many of how many, and how many a second."""
    from rich.progress import ProgressColumn
    from rich.text import Text

    class Counted(ProgressColumn):
        def render(self, task: Task) -> Text:
            total = "" if task.total is None else f"/{task.total:.0f}"
            speed = task.finished_speed or task.speed
            rate = "" if not speed else f" {speed:.1f}/s"
            return Text(f"{task.completed:.0f}{total} {task.fields['unit']}s{rate}")

    return Counted()


def print_above(text: str) -> None:
    """Print a line on standard error, above the bars."""
    if not _shown:
        print_note(text)
        return
    with _LOCK:
        _shown[0].console.print(one_line(text), soft_wrap=True)


def close_bars() -> None:
    """Leave the terminal as it was: for a process that ends at once, from whichever thread."""
    for display in _shown:
        display.stop()
