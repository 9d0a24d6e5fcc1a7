"""The frames of a recording that belong to the estimates of a result, in one pass."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import closing

from posetrack_cli.arrays import IntArray
from posetrack_cli.damage import read_from
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame, StoredFrame, decode_frames
from posetrack_cli.recording.readahead import read_ahead
from posetrack_cli.recording.recording import Recording


def matched_frames(
    recording: Recording, stamp_ns: IntArray, frame_index: IntArray | None, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield (position in ``stamp_ns``, frame) in the recording's order; only these frames are decoded.

    A frame belongs to the estimate of its stamp. Where no stamp at all agrees, as after reading a folder
    at another rate, frames are matched by their number.

    Args:
        recording: read once; twice if no stamp agrees.
        stamp_ns: (N,) of the estimates, unique.
        frame_index: (N,) their frames' positions in the recording, None if unknown.
        losses: gets what cannot be decoded, and the estimates without a frame.
    """
    met: list[int] = []  # numbers of the frames that belong to an estimate, those that do not decode, too
    for keys in (stamp_ns, frame_index):
        if keys is None or met:
            continue
        positions = {int(key): position for position, key in enumerate(keys)}
        by_number = keys is frame_index
        for frame in _frames_at(recording, positions, met, losses, by_number=by_number):
            yield positions[frame.index if by_number else frame.stamp_ns], frame
    for _ in range(len(stamp_ns) - len(met)):
        losses.add("estimates whose frame the recording does not give", str(recording.path))


def _frames_at(
    recording: Recording, keys: Collection[int], met: list[int], losses: LossLog, *, by_number: bool
) -> Iterator[Frame]:
    """Yield the frames whose stamps, or numbers, are among the keys."""
    if not keys:
        return
    last = max(keys)

    def chosen() -> Iterator[tuple[int, StoredFrame]]:
        # what is wrong with frames that nobody asked for is no loss here
        for index, stored in recording.stored_frames(LossLog()):
            key = index if by_number else stored.stamp_ns
            if key > last:
                return  # both keys increase
            if key in keys:
                met.append(index)
                yield index, stored

    decoded = read_from(recording.path, decode_frames(chosen(), losses), "frame")
    with closing(read_ahead(decoded)) as frames:
        yield from frames
