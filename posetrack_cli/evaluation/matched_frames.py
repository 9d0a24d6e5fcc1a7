"""The frames of a recording that belong to the estimates of a result, in one pass."""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator
from contextlib import closing
from typing import cast

from posetrack_cli.arrays import IntArray
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame, Recording
from posetrack_cli.recording.readahead import read_ahead
from posetrack_cli.recording.stored import StoredFrame, StoredRecording, decode_frames


def matched_frames(
    recording: Recording, stamp_ns: IntArray, frame_index: IntArray | None, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield (position in ``stamp_ns``, frame) in the recording's order.

    A frame belongs to the estimate of its stamp. Where no stamp at all agrees, as after reading a folder
    at another rate, frames are matched by their number. Of a recording that gives undecoded frames only these
    are decoded.

    Args:
        recording: read once; twice if no stamp agrees.
        stamp_ns: (N,) of the estimates, unique.
        frame_index: (N,) their frames' positions in the recording, None if unknown.
        losses: gets what cannot be decoded, and the estimates without a frame.
    """
    found, lost_before = 0, _count(losses)
    for keys in (stamp_ns, frame_index):
        if keys is None or found:
            continue
        positions = {int(key): position for position, key in enumerate(keys)}
        by_number = keys is frame_index
        for frame in _frames_at(recording, positions, losses, by_number=by_number):
            found += 1
            yield positions[frame.index if by_number else frame.stamp_ns], frame
    undecoded = _count(losses) - lost_before
    for _ in range(len(stamp_ns) - found - undecoded):
        losses.add("estimates whose frame the recording does not give", str(recording.path))


def _count(losses: LossLog) -> int:
    return sum(loss.count for loss in losses.losses)


def _frames_at(
    recording: Recording, keys: Collection[int], losses: LossLog, *, by_number: bool
) -> Iterator[Frame]:
    """Yield the frames whose stamps, or numbers, are among the keys."""
    if not keys:
        return
    last = max(keys)
    if not hasattr(recording, "stored_frames"):
        with closing(cast(Generator[Frame], recording.frames())) as frames:
            for frame in frames:
                key = frame.index if by_number else frame.stamp_ns
                if key in keys:
                    yield frame
                if key >= last:
                    return
        return

    def chosen() -> Iterator[tuple[int, StoredFrame]]:
        # what is wrong with frames that nobody asked for is no loss here
        for index, stored in cast(StoredRecording, recording).stored_frames(LossLog()):
            key = index if by_number else stored.stamp_ns
            if key > last:
                return  # both keys increase
            if key in keys:
                yield index, stored

    with closing(read_ahead(decode_frames(chosen(), losses))) as frames:
        yield from frames
