"""How long commands are stopped: Ctrl-C ends them after the frame at hand, and waits for no compiler."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)
GRACE_S = 1.0
"""How long a stop may take while kernels are compiled: a compiler's single steps take up to 10 s."""


def terminate_as_interrupted() -> None:
    """Let SIGTERM end a command as Ctrl-C does, so that nothing half-written stays behind."""
    if signal.getsignal(signal.SIGTERM) != signal.SIG_IGN:  # whoever started this wants it to be ignored
        signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def stop_signals(at_once: Callable[[], bool] = lambda: False) -> Iterator[Callable[[], bool]]:
    """Yield a function that tells whether Ctrl-C or SIGTERM came.

    A second Ctrl-C stops at once, by KeyboardInterrupt, and so does what comes while ``at_once`` says so.
    """
    asked = threading.Event()

    def stop(number: int, frame: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if at_once():
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def signals_watched(is_stuck: Callable[[], bool], give_up: Callable[[], None]) -> Iterator[threading.Event]:
    """Yield an event that a signal to stop sets, also while the main thread is in a library and handles none.

    Args:
        is_stuck: asked ``GRACE_S`` after a signal, unless the context is left by then.
        give_up: called where it is, in a thread of its own.
    """
    asked, left = threading.Event(), threading.Event()
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def watch() -> None:
        while number := os.read(reading, 1):
            if number[0] in SIGNALS:
                asked.set()
                if not left.wait(GRACE_S) and is_stuck():
                    give_up()

    thread = threading.Thread(target=watch, name="signals", daemon=True)
    thread.start()
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    try:
        yield asked
    finally:
        signal.set_wakeup_fd(before)
        left.set()
        os.close(writing)
        thread.join()
        os.close(reading)
