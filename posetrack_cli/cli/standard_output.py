"""Standard output that cannot be written any more."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def discard_output() -> None:
    """What is buffered for an output that cannot be written goes nowhere: exit must not try again."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def reader_may_leave() -> Iterator[None]:
    """Print what a reader such as ``head`` need not read to its end: nothing else depends on that."""
    try:
        yield
        if sys.stdout is not None:
            sys.stdout.flush()  # a log that takes both shows this before what follows on standard error
    except BrokenPipeError:
        discard_output()
