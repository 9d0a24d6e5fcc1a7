"""The images of a recording that belong to the estimates of a result, in one pass."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any, cast

from posetrack_cli.arrays import IntArray
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording


def matched_images(
    recording: Recording, stamp_ns: IntArray, frame_index: IntArray | None, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield (position in ``stamp_ns``, frame) in the recording's order.

    A frame belongs to the estimate of its number, where estimates have one, else of its stamp.

    Args:
        recording: read once, from the first frame asked for to the last.
        stamp_ns: (N,) of the estimates, unique.
        frame_index: (N,) their frames' positions in the recording, None if unknown.
        losses: gets what the recording lost, and the estimates without a frame.
    """
    keys = stamp_ns if frame_index is None else frame_index
    positions = {int(key): position for position, key in enumerate(keys)}
    if not positions:
        return
    with closing(_frames(recording, frame_index)) as frames:
        for frame in frames:
            position = positions.pop(frame.stamp_ns if frame_index is None else frame.index, None)
            if position is not None:
                yield position, frame
            if not positions:
                return
    for _ in positions:
        losses.add("estimates whose frame the recording does not give", str(recording.path))


def _frames(recording: Recording, frame_index: IntArray | None) -> Any:
    """The frames from the first number on to the last; all where numbers are not known."""
    if frame_index is None:
        return recording.frames()
    first, last = int(frame_index.min()), int(frame_index.max())
    return cast(Any, recording.frames(start=first, end=last + 1))
