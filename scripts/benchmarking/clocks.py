"""How long parts of a tracker take, told by their classes' methods."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

Part = tuple[type, tuple[str, ...]]
"""A class and those of its methods whose time counts."""


class Clocks:
    """Adds up the seconds of parts by name; the outermost call alone counts.

    Args:
        names: of the parts.
    """

    def __init__(self, names: Iterable[str], now: Callable[[], float] = time.perf_counter) -> None:
        self.seconds = dict.fromkeys(names, 0.0)
        self._now, self._busy = now, False

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, whose time is added to a part's."""

        def call(*arguments: Any, **named: Any) -> Any:
            if self._busy:
                return function(*arguments, **named)
            self._busy, began = True, self._now()
            try:
                return function(*arguments, **named)
            finally:
                self._busy = False
                self.seconds[name] += self._now() - began

        return call


class FrameClock:
    """CPU time of a run's frames, of all threads, from one of its first estimates to its last.

    Args:
        settling: so many estimates are the start; no more than half of those that come.
    """

    def __init__(self, settling: int, now: Callable[[], float] = time.process_time) -> None:
        self._settling, self._now = settling, now
        self._times: list[float] = []

    def note(self, estimate: object) -> None:
        """See an estimate that was written."""
        self._times.append(self._now())

    @property
    def seconds_a_frame(self) -> float:
        """Seconds; NaN of fewer than two estimates."""
        times = self._times[min(self._settling, len(self._times) // 2) :]
        return (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else float("nan")


@contextmanager
def clocked(parts: Mapping[str, Iterable[Part]]) -> Iterator[Clocks]:
    """Put clocks on methods as long as the context lasts."""
    clocks = Clocks(parts)
    with ExitStack() as stack:
        for name, classes in parts.items():
            for owner, methods in classes:
                for method in methods:
                    function = clocks.timed(name, getattr(owner, method))
                    stack.enter_context(patch.object(owner, method, function))
        yield clocks
