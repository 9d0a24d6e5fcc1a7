"""How far a batch is: a bar and failures where a person looks, else a line for each recording."""

from __future__ import annotations

import time
from contextlib import ExitStack
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING

from posetrack_cli.cli.progress import bar
from posetrack_cli.cli.standard_output import is_quiet, print_note

if TYPE_CHECKING:
    from posetrack_cli.batch.engine import Told
    from posetrack_cli.batch.jobs import Outcome


class BatchProgress:
    """Shows recordings that are over, frames, frames per second, what is left, and failures.

    Args:
        total: how many recordings there are.
    """

    def __init__(self, total: int) -> None:
        self._total, self._over, self._failed = total, 0, 0
        self._frames: dict[str, int] = {}  # that are being tracked, by job
        self._done, self._began_s = 0, time.monotonic()
        self._lock = Lock()
        self._stack = ExitStack()
        self._bar = self._stack.enter_context(bar("batch", "recording", total))

    def __enter__(self) -> BatchProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def on_progress(self, told: Told) -> None:
        """A job is so far."""
        with self._lock:
            self._frames[told.job] = told.frames
            self._show()

    def on_outcome(self, outcome: Outcome) -> None:
        """A recording is over."""
        from posetrack_cli.batch.jobs import recording_of

        with self._lock:
            others = {name: n for name, n in self._frames.items() if recording_of(name) != outcome.name}
            self._frames = others
            self._over += 1
            self._done += outcome.frames
            is_failed = outcome.state == "failed"
            self._failed += is_failed
            if is_failed or outcome.reason or not (self._bar.is_drawn or is_quiet()):
                print_note(f"[{self._over}/{self._total}] {line_of(outcome)}")
            self._show(1)

    def note(self, line: str) -> None:
        """Say what a user should know meanwhile."""
        with self._lock:
            print_note(line)

    def _show(self, over: int = 0) -> None:
        frames = self._done + sum(self._frames.values())
        rate = frames / max(1e-9, time.monotonic() - self._began_s)
        failed = f"{self._failed} failed, " if self._failed else ""
        self._bar.advance(over, f"{failed}{frames} frames, {rate:.1f}/s")


def line_of(outcome: Outcome) -> str:
    """What came of a recording, in one line."""
    if outcome.state == "failed":
        return f"{outcome.name}: failed: {outcome.reason}"
    if outcome.state == "kept":
        return f"{outcome.name}: kept"
    rate = f" ({outcome.frames / outcome.seconds:.1f} frames/s)" if outcome.seconds and outcome.frames else ""
    done = f"{outcome.frames} frames in {outcome.seconds:.1f} s{rate}"
    reason = f"; {outcome.reason}" if outcome.reason else ""
    return f"{outcome.name}: {outcome.state.value}, {done}{reason}"
