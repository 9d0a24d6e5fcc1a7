"""How far a batch is: a bar and failures where a person looks, else a line for each recording."""

from __future__ import annotations

import sys
import time
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any

from posetrack_cli.text import one_line

if TYPE_CHECKING:
    from posetrack_cli.batch.engine import Told
    from posetrack_cli.batch.jobs import Outcome


class BatchProgress:
    """Shows recordings that are over, frames, frames per second, what is left, and failures.

    Args:
        total: how many recordings there are.
    """

    def __init__(self, total: int) -> None:
        from tqdm import tqdm

        self._total, self._over, self._failed = total, 0, 0
        self._frames: dict[str, int] = {}  # that are being tracked, by job
        self._done, self._began_s = 0, time.monotonic()
        self._lock = Lock()
        self._bar: Any = tqdm(
            total=total, unit="recording", desc="batch", file=sys.stderr, disable=None, dynamic_ncols=True
        )

    def __enter__(self) -> BatchProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

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
            if self._bar.disable or is_failed:
                self._write(f"[{self._over}/{self._total}] {line_of(outcome)}")
            self._bar.update(1)
            self._show()

    def note(self, line: str) -> None:
        """Say what a user should know meanwhile."""
        with self._lock:
            self._write(line)

    def _show(self) -> None:
        frames = self._done + sum(self._frames.values())
        rate = frames / max(1e-9, time.monotonic() - self._began_s)
        failed = f", {self._failed} failed" if self._failed else ""
        self._bar.set_postfix_str(f"{frames} frames, {rate:.1f}/s{failed}")

    def _write(self, line: str) -> None:
        self._bar.write(one_line(line), file=sys.stderr)


def line_of(outcome: Outcome) -> str:
    """What came of a recording, in one line."""
    if outcome.state == "failed":
        return f"{outcome.name}: failed: {outcome.reason}"
    if outcome.state == "kept":
        return f"{outcome.name}: kept"
    rate = f" ({outcome.frames / outcome.seconds:.1f} frames/s)" if outcome.seconds and outcome.frames else ""
    done = f"{outcome.frames} frames in {outcome.seconds:.1f} s{rate}"
    return f"{outcome.name}: {outcome.state.value}, {done}"
