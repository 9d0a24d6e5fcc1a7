"""What the process of a command line does once, before it runs: streams, and what libraries print.

A failure is one line on standard error, and C libraries do not know that: libpng, libtiff, FFmpeg, OpenCV and
GL drivers write to file descriptor 2 whatever they think of a file. So Python's standard error moves to
another descriptor, and the second one leads nowhere. With POSETRACK_DEBUG=1 everything is shown.
"""

from __future__ import annotations

import faulthandler
import logging
import os
import sys
import warnings
from contextlib import suppress
from io import TextIOWrapper
from typing import NoReturn

from posetrack_cli.errors import EXIT_INTERRUPTED

_DEBUG = "POSETRACK_DEBUG"
_STANDARD = (0, 1, 2)
_ERROR = 2


def is_debugging() -> bool:
    """Whether the user asked for what libraries print, and for tracebacks: POSETRACK_DEBUG=1."""
    return os.environ.get(_DEBUG, "") not in ("", "0")


def prepare_process() -> None:
    """Make standard streams safe to use, and silence what is not ours to say unless it was asked for."""
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
