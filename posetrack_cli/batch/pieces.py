"""A long recording in pieces that overlap: where they begin and end, and their results as one."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from posetrack_cli.batch.jobs import Piece
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.joining import Share
from posetrack_cli.results.joining import join_results as join
from posetrack_cli.results.reader import load_arrays, read_result
from posetrack_cli.tracking.options import is_hardly_tracked

_NS = 1_000_000_000


def split_frames(
    recording: Recording,
    chunk_s: float,
    overlap_s: float,
    *,
    start: int = 0,
    end: int | None = None,
    stride: int = 1,
    looks_ahead: bool = False,
) -> list[Piece]:
    """Return the pieces of a recording, of equal length by its stamps; one where it is short.

    Args:
        recording: is read once, without decoding its images.
        chunk_s: length of a piece, s; the last takes what is left of half a piece or less.
        overlap_s: what a piece is tracked for before its own frames, s.
        start, end, stride: which frames are tracked of all.
        looks_ahead: whether later frames matter, too (a smoothed track): pieces then overlap on both sides.
    """
    stamps: list[int] = []
    numbers: list[int] = []
    for number, frame in recording.stored_frames(LossLog()):
        is_in = number >= start and (number - start) % stride == 0
        if end is not None and number >= end:
            break
        if is_in:
            numbers.append(number)
            stamps.append(frame.stamp_ns)
    if not numbers:
        return [Piece(start, start + 1, start, start + 1)]  # tracking it tells that there is nothing
    return pieces_of(numbers, stamps, chunk_s, overlap_s, overlap_s if looks_ahead else 0.0)


def pieces_of(
    numbers: Sequence[int], stamps: Sequence[int], chunk_s: float, before_s: float, after_s: float
) -> list[Piece]:
    """Return the pieces of frames with these numbers and stamps (ns), both increasing.

    Every frame is one piece's own: ``first`` of a piece is ``last`` of the one before.

    Args:
        numbers, stamps: at least one.
        chunk_s: length of a piece, s.
        before_s, after_s: what it is tracked for before and after its own frames, s.
    """
    length, ahead, later = (round(seconds * _NS) for seconds in (chunk_s, before_s, after_s))
    count = max(1, round((stamps[-1] - stamps[0]) / length))
    begins = [stamps[0] + k * length for k in range(count)]
    cuts = [*(bisect_left(stamps, begin) for begin in begins), len(stamps)]
    pieces = []
    for own, after in pairwise(cuts):
        if own == after:
            continue  # a gap in the recording
        before = bisect_left(stamps, stamps[own] - ahead)
        behind = bisect_left(stamps, stamps[after - 1] + later + 1)
        pieces.append(Piece(numbers[before], numbers[behind - 1] + 1, numbers[own], _last(numbers, after)))
    return pieces


def _last(numbers: Sequence[int], after: int) -> int:
    """The number of the frame behind a piece's own."""
    return numbers[after] if after < len(numbers) else numbers[-1] + 1


def meeting_frame(one: tuple[Path, Piece], other: tuple[Path, Piece]) -> int:
    """Return the frame from which on the joined result is that of the next piece: where both agree best.

    Of the frames that both have tracked the later half is looked at: the next piece has found what it tracks
    by then, and has forgotten that it had to look for it. Where fingers are hidden two tracks may differ by a
    centimetre for a while; they meet as soon as the fingers show.

    Args:
        one, other: results and pieces, one behind the other.
    """
    (before, after), first = (load_arrays(path) for path, _ in (one, other)), other[1].first
    both, rows, columns = np.intersect1d(before["frame_index"], after["frame_index"], return_indices=True)
    if not len(both):
        return first
    later = both >= both[len(both) // 2]
    apart = before["points"][rows[later]] - after["points"][columns[later]]
    distances = np.linalg.norm(apart, axis=2).mean(axis=1)
    nearest = np.flatnonzero(distances == distances.min())[-1]
    return int(both[later][nearest])


def join_results(
    pieces: Sequence[tuple[Path, Piece]], output: Path, chunk_s: float, overlap_s: float
) -> bool:
    """Write one result of those of the pieces, whose record says how it was made; an older one is replaced.

    One piece goes over to the next where they agree best (``meeting_frame``).

    Returns:
        Whether some of the recording could not be used, or hardly any of it was tracked.
    """
    first, last = pieces[0][1], pieces[-1][1]
    changes = {
        "start": str(first.first),
        "end": str(last.last),
        "chunk_s": f"{chunk_s:g}",
        "overlap_s": f"{overlap_s:g}",
        "pieces": str(len(pieces)),
    }
    cuts = [first.first, *(meeting_frame(*pair) for pair in pairwise(pieces)), last.last]
    shares = [Share(path, *own) for (path, _), own in zip(pieces, pairwise(cuts), strict=True)]
    join(shares, output, changes, overwrite=True)
    summary = read_result(output).summary
    return "losses" in summary or is_hardly_tracked(int(summary["frames"]), int(summary["lost"]))
