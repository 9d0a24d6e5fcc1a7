"""How long commands are stopped: Ctrl-C ends them after the frame at hand."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether Ctrl-C or SIGTERM came; a second Ctrl-C stops at once."""
    asked = threading.Event()
    with _handled(asked, at_once=lambda: False):
        yield asked.is_set


@contextmanager
def stop_signals_of_a_run() -> Iterator[Callable[[], bool]]:
    """The same for a command that compiles kernels, which takes up to a minute: that is not waited for.

    KeyboardInterrupt is raised then, as it is by a second Ctrl-C.
    """
    from posetrack_cli.compiled import interrupted_by

    asked = threading.Event()
    with interrupted_by(asked.is_set) as is_compiling, _handled(asked, at_once=is_compiling):
        yield asked.is_set


def terminate_as_interrupted() -> None:
    """Let SIGTERM end a command as Ctrl-C does, so that nothing half-written stays behind."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def _handled(asked: threading.Event, at_once: Callable[[], bool]) -> Iterator[None]:
    def stop(number: int, frame: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if at_once():
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
