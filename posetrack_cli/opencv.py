"""OpenCV thread settings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def in_one_thread() -> Iterator[None]:
    """Run OpenCV single-threaded: fixed summation order, no thread overhead on small images."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
