"""Number the frames of a recording, keep stamps strictly increasing, and select a range."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

from posetrack_cli.errors import UsageError
from posetrack_cli.losses import LossLog

NOT_LATER = "frame dropped, stamp not later than the frame before"
OUT_OF_RANGE = "frame dropped, stamp before 1970 or after 2262"
LATEST_NS = 2**63 - 1
"""What 64-bit integers, and so arrays of stamps, can hold."""


class Stamped(Protocol):
    """A frame as far as its order is concerned: when it was taken, and how errors call it."""

    @property
    def stamp_ns(self) -> int:
        """Integer nanoseconds."""

    @property
    def where(self) -> str:
        """File name, or topic and time."""


S = TypeVar("S", bound=Stamped)


def select_frames(
    stored: Iterable[S | None],
    losses: LossLog,
    *,
    start: int = 0,
    end: int | None = None,
    stride: int = 1,
) -> Iterator[tuple[int, S]]:
    """Yield (index, frame) for the indices start, start + stride, ... below end.

    Which frames count as out of order does not depend on the range: every frame is compared with the
    latest stamp before it, selected or not. Stamps that 64 bits cannot hold are dropped too, and are no
    reason to drop what follows. Reading stops at ``end``.

    Args:
        stored: all frames of the recording; None for one that could not be read, which keeps its index.
        losses: gets the dropped frames of the range.
        start: first index.
        end: index to stop before, None for all.
        stride: distance between indices.

    Raises:
        UsageError: for a negative start or end or a stride below 1.
    """
    check_range(start, end, stride)
    latest = -1
    for index, frame in enumerate(stored):
        if end is not None and index >= end:
            return
        wanted = index >= start and (index - start) % stride == 0
        if frame is None:
            continue
        fault = _fault(frame.stamp_ns, latest)
        if fault is not None:
            if wanted:
                losses.add(fault, f"frame {index} at {frame.stamp_ns} ns, {frame.where}")
            continue
        latest = frame.stamp_ns
        if wanted:
            yield index, frame


def _fault(stamp_ns: int, latest: int) -> str | None:
    """Why a frame with this stamp is dropped after one with the latest; None if it is not."""
    if not 0 <= stamp_ns <= LATEST_NS:
        return OUT_OF_RANGE
    return NOT_LATER if stamp_ns <= latest else None


def check_range(start: int, end: int | None, stride: int) -> None:
    """Raise UsageError unless 0 <= start, 0 <= end and 1 <= stride."""
    if start < 0 or (end is not None and end < 0) or stride < 1:
        raise UsageError(
            "frame range cannot be used",
            found=f"start {start}, end {end}, stride {stride}",
            expected="start and end from 0, stride from 1",
        )
