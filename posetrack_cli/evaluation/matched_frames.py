"""The frames of a recording that belong to the estimates of a result, in one pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing

from posetrack_cli.arrays import IntArray
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.readahead import read_ahead
from posetrack_cli.recording.recording import Recording
from posetrack_cli.recording.stored import StoredFrame, decode_frames

Numbered = tuple[int, StoredFrame]
Key = Callable[[int, StoredFrame], int]


def matched_frames(
    recording: Recording, stamp_ns: IntArray, frame_index: IntArray | None, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield (position in ``stamp_ns``, frame) in the recording's order; only these frames are decoded.

    A frame belongs to the estimate of its stamp. Where no stamp at all agrees, as after reading a folder
    at another rate, frames are matched by their number.

    Args:
        recording: of depth; read once, twice if no stamp agrees.
        stamp_ns: (N,) of the estimates, unique.
        frame_index: (N,) their frames' positions in the recording, None if unknown.
        losses: gets what cannot be decoded, and the estimates without a frame.
    """
    found, lost_before = 0, _count(losses)
    for pair in _frames_at(recording, stamp_ns, _stamp, losses):
        found += 1
        yield pair
    if not found and frame_index is not None:
        for pair in _frames_at(recording, frame_index, _index, losses):
            found += 1
            yield pair
    undecoded = _count(losses) - lost_before
    for _ in range(len(stamp_ns) - found - undecoded):
        losses.add("estimates whose frame the recording does not give", str(recording.path))


def _count(losses: LossLog) -> int:
    return sum(loss.count for loss in losses.losses)


def _stamp(index: int, frame: StoredFrame) -> int:
    return frame.stamp_ns


def _index(index: int, frame: StoredFrame) -> int:
    return index


def _frames_at(
    recording: Recording, keys: IntArray, key: Key, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield the frames whose key is among those asked for, with its position there."""
    positions = {int(value): position for position, value in enumerate(keys)}
    if not positions:
        return
    by_index: dict[int, int] = {}
    last = max(positions)

    def chosen() -> Iterator[Numbered]:
        # what is wrong with frames that nobody asked for is no loss here
        for index, frame in recording.stored_frames(LossLog()):
            if key(index, frame) > last:
                return  # both keys increase
            if key(index, frame) in positions:
                by_index[index] = positions[key(index, frame)]
                yield index, frame

    with closing(read_ahead(decode_frames(chosen(), losses))) as frames:
        for frame in frames:
            yield by_index.pop(frame.index), frame
