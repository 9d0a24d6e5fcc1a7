"""What the process of a command line does once, before it runs: streams, what libraries print, and signals.

A failure is one line on standard error, and C libraries do not know that: libpng, libtiff, FFmpeg, OpenCV and
GL drivers write to file descriptor 2 whatever they think of a file. So Python's standard error moves to
another descriptor, and the second one leads nowhere. With POSETRACK_DEBUG=1 everything is shown.

Ctrl-C ends a command after the frame at hand, and waits for no compiler.
"""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import logging
import os
import resource
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import NoReturn

from posetrack_cli.cli.terminal import print_note
from posetrack_cli.errors import EXIT_FAILED, EXIT_INTERRUPTED, UsageError

_DEBUG = "POSETRACK_DEBUG"
_STANDARD = (0, 1, 2)
_ERROR = 2
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
_NEW_OBJECTS = 20_000
"""After so many Python looks for what may go, not after 700: most are made as a run starts and as kernels
compile, and they stay. A tenth of a short run went into looking."""


def is_debugging() -> bool:
    """Whether the user asked for what libraries print, and for tracebacks: POSETRACK_DEBUG=1."""
    return os.environ.get(_DEBUG, "") not in ("", "0")


def prepare_process() -> None:
    """Make standard streams safe to use, and silence what is not ours to say unless it was asked for.

    BLAS gets one thread, whatever was asked for: how it shares out a product decides how that is rounded, and
    results would differ from one number of cores to another. Our matrices are too small to share.
    """
    os.environ.update(dict.fromkeys(_BLAS_THREADS, "1"))  # read as numpy and scipy are loaded, which is later
    gc.set_threshold(_NEW_OBJECTS)
    _fill_closed_descriptors()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 as long as the process
    elif not is_debugging():
        _divert_libraries()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # not so where it is closed
            stream.reconfigure(errors="backslashreplace")  # a name that it cannot show is no reason to fail
    faulthandler.enable(sys.stderr)
    if not is_debugging():
        _silence_python_libraries()


def leave_process(code: int) -> NoReturn:
    """Exit; after an interruption at once, as threads may be compiling, which cannot be stopped."""
    if code == EXIT_INTERRUPTED:
        for stream in (sys.stdout, sys.stderr):
            with suppress(AttributeError, OSError):  # closed, or full
                stream.flush()
        os._exit(code)
    sys.exit(code)


def _fill_closed_descriptors() -> None:
    """Open what is closed of the standard descriptors: the next file would take its number, and be written
    to by whoever means standard error.
    """
    for descriptor in _STANDARD:
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one


def _divert_libraries() -> None:
    """Move Python's standard error to a descriptor that C libraries do not know."""
    own = os.dup(_ERROR)
    sys.stderr.flush()
    encoding = sys.stderr.encoding
    sys.stderr = open(own, "w", buffering=1, encoding=encoding)  # noqa: PTH123, SIM115 as long as the process
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, _ERROR)
    os.close(nowhere)


def _silence_python_libraries() -> None:
    """Show no log lines, and warnings only where they were asked for: they are no lines of ours."""
    if not sys.warnoptions:  # of -W and PYTHONWARNINGS
        warnings.simplefilter("ignore")
    logging.getLogger().addHandler(logging.NullHandler())  # without any, warnings go to standard error


LEAST_DATA_BYTES = 1 << 29
_LEAST = {
    "ulimit -v": (resource.RLIMIT_AS, 5 << 28),
    "ulimit -d": (resource.RLIMIT_DATA, LEAST_DATA_BYTES),
}
"""What tracking takes with its libraries, which abort or hang on less: address space, and data alone."""


def check_memory() -> None:
    """Refuse to work under a limit of memory that libraries do not survive.

    Raises:
        UsageError: ``ulimit -v`` or ``ulimit -d`` is too low.
    """
    for name, (which, least) in _LEAST.items():
        limit, _ = resource.getrlimit(which)
        if limit != resource.RLIM_INFINITY and limit < least:
            found, expected = f"{limit >> 10} KiB", f"{least >> 10} KiB or more"
            raise UsageError(
                f"limit of memory is too low ({name})",
                found=found,
                expected=expected,
                hint=f"type: {name} unlimited",
            )


def survive_memory_limit() -> None:
    """Go on in a process of its own where memory is limited: libraries abort for want of it.

    This process waits for that one, and says in one line that it was aborted.
    """
    limited = [
        name for name, (which, _) in _LEAST.items() if resource.getrlimit(which)[0] != resource.RLIM_INFINITY
    ]
    if not limited:
        return
    child = os.fork()
    if child == 0:
        faulthandler.disable()
        ctypes.CDLL(None).prctl(_SET_SIGNAL_AT_PARENTS_END, signal.SIGKILL)
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to both
    signal.signal(signal.SIGTERM, lambda number, frame: os.kill(child, number))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code in (-signal.SIGABRT, -signal.SIGSEGV, -signal.SIGBUS):
        print_note(
            f"posetrack: a library aborted, likely for want of memory ({', '.join(limited)}); raise the limit"
        )
        code = EXIT_FAILED
    os._exit(code if code >= 0 else 128 - code)


_SET_SIGNAL_AT_PARENTS_END = 1
"""``PR_SET_PDEATHSIG`` of Linux."""

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
