"""Process set-up of the command line: standard streams, library output, memory limits and signals.

An error is one line on standard error, but C libraries (libpng, libtiff, FFmpeg, OpenCV, GL drivers) print
warnings to file descriptor 2. Python's standard error is therefore moved to another descriptor, and
descriptor 2 is redirected to /dev/null. POSETRACK_DEBUG=1 shows everything.

Ctrl-C stops a command after the current frame, and at once while a kernel is being compiled.
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
# Threshold of the garbage collector, 700 by default. Most objects are created by imports and compilation
# and stay alive; looking for garbage took a tenth of a short run.
_NEW_OBJECTS = 20_000


def is_debugging() -> bool:
    """Return whether POSETRACK_DEBUG asks for tracebacks and library output."""
    return os.environ.get(_DEBUG, "") not in ("", "0")


def prepare_process() -> None:
    """Make standard streams safe to use, and silence libraries unless debugging.

    BLAS is limited to one thread: its partition of a product determines the rounding, so results would
    depend on the number of cores. The matrices are too small to gain from threads.
    """
    os.environ.update(dict.fromkeys(_BLAS_THREADS, "1"))  # must precede the import of numpy and scipy
    gc.set_threshold(_NEW_OBJECTS)
    _fill_closed_descriptors()
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115 open until exit
    elif not is_debugging():
        _divert_libraries()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # None if closed
            stream.reconfigure(errors="backslashreplace")  # file names may not be encodable
    faulthandler.enable(sys.stderr)
    if not is_debugging():
        _silence_python_libraries()


def leave_process(code: int) -> NoReturn:
    """Exit; after an interruption without waiting for threads, which may be compiling."""
    if code == EXIT_INTERRUPTED:
        for stream in (sys.stdout, sys.stderr):
            with suppress(AttributeError, OSError):  # the stream may be closed or full
                stream.flush()
        os._exit(code)
    sys.exit(code)


def _fill_closed_descriptors() -> None:
    """Open closed standard descriptors, else the next opened file would receive standard error."""
    for descriptor in _STANDARD:
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one


def _divert_libraries() -> None:
    """Move Python's standard error to another descriptor, and redirect descriptor 2 to /dev/null."""
    own = os.dup(_ERROR)
    sys.stderr.flush()
    encoding = sys.stderr.encoding
    sys.stderr = open(own, "w", buffering=1, encoding=encoding)  # noqa: PTH123, SIM115 open until exit
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, _ERROR)
    os.close(nowhere)


def _silence_python_libraries() -> None:
    """Hide log messages, and warnings unless -W or PYTHONWARNINGS is set."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    logging.getLogger().addHandler(logging.NullHandler())  # without a handler, logging prints warnings


LEAST_DATA_BYTES = 1 << 29
# Minimum limits of address space and data, bytes; below them libraries abort or hang while loading
_LEAST = {
    "ulimit -v": (resource.RLIMIT_AS, 5 << 28),
    "ulimit -d": (resource.RLIMIT_DATA, LEAST_DATA_BYTES),
}


def check_memory() -> None:
    """Check that the memory limits suffice for loading the libraries.

    Raises:
        UsageError: ``ulimit -v`` or ``ulimit -d`` is too low.
    """
    for name, (which, least) in _LEAST.items():
        limit, _ = resource.getrlimit(which)
        if limit != resource.RLIM_INFINITY and limit < least:
            found, expected = f"{limit >> 10} KiB", f"{least >> 10} KiB or more"
            raise UsageError(
                f"memory limit is too low ({name})",
                found=found,
                expected=expected,
                hint=f"run: {name} unlimited",
            )


def fork_under_memory_limit() -> None:
    """Continue in a child process if memory is limited, and report it in one line if a library aborts.

    Native libraries call ``abort`` when out of memory, which Python cannot catch.
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal also sends it to the child
    signal.signal(signal.SIGTERM, lambda number, frame: os.kill(child, number))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code in (-signal.SIGABRT, -signal.SIGSEGV, -signal.SIGBUS):
        print_note(
            f"posetrack: a library aborted, probably out of memory ({', '.join(limited)}); raise the limit"
        )
        code = EXIT_FAILED
    # A negative code is a signal; shells report 128 plus its number.
    os._exit(code if code >= 0 else 128 - code)


# ``PR_SET_PDEATHSIG`` of Linux
_SET_SIGNAL_AT_PARENTS_END = 1

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Time a stop may take while kernels compile; a single step of the compiler takes up to 10 s
GRACE_S = 1.0


def terminate_as_interrupted() -> None:
    """Handle SIGTERM like Ctrl-C, so that no partial files are left."""
    if signal.getsignal(signal.SIGTERM) != signal.SIG_IGN:  # the parent wants it to be ignored
        signal.signal(signal.SIGTERM, signal.default_int_handler)


@contextmanager
def stop_signals(at_once: Callable[[], bool] = lambda: False) -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether Ctrl-C or SIGTERM was received.

    A second Ctrl-C, or any signal while ``at_once`` returns True, raises KeyboardInterrupt.
    """
    requested = threading.Event()

    def stop(number: int, frame: object) -> None:
        requested.set()
        # The next Ctrl-C raises KeyboardInterrupt.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        if at_once():
            raise KeyboardInterrupt

    before = {number: signal.signal(number, stop) for number in SIGNALS}
    try:
        yield requested.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def watch_signals(is_stuck: Callable[[], bool], give_up: Callable[[], None]) -> Iterator[threading.Event]:
    """Yield an event that is set by a stop signal, even while the main thread is in native code.

    Args:
        is_stuck: called ``GRACE_S`` after a signal, unless the context has been left.
        give_up: called in another thread if ``is_stuck`` returns True.
    """
    # Python runs signal handlers between bytecodes only; the wakeup descriptor is written immediately.
    requested, left = threading.Event(), threading.Event()
    reading, writing = os.pipe()
    os.set_blocking(writing, False)  # required by set_wakeup_fd

    def watch() -> None:
        while number := os.read(reading, 1):
            if number[0] in SIGNALS:
                requested.set()
                if not left.wait(GRACE_S) and is_stuck():
                    give_up()

    thread = threading.Thread(target=watch, name="signals", daemon=True)
    thread.start()
    before = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    try:
        yield requested
    finally:
        signal.set_wakeup_fd(before)
        left.set()
        # Closing the writing end ends the thread's read.
        os.close(writing)
        thread.join()
        os.close(reading)
