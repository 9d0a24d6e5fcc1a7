"""How OpenCV shares work among threads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2


@contextmanager
def in_one_thread() -> Iterator[None]:
    """Let OpenCV work in one thread: sums come in one order, and small work is not handed around."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
