"""What is to be done: jobs, and their pieces."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.build import source_digest
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.joining import Share
from posetrack_cli.results.joining import join_results as join
from posetrack_cli.results.reader import load_arrays, read_result
from posetrack_cli.tracking.options import is_hardly_tracked

# What a batch does: jobs, the limits they run under, and what comes of each


Finite = Annotated[float, Field(ge=0.0, le=limits.NUMBER, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, le=limits.INTEGER)]
"""What a record of a job, which a stranger may have written, must hold."""

RECORDS_FOLDER = ".batch"
"""Below the folder of results: what a batch needs besides; others than results have no place elsewhere."""


def record_path(results: Path, name: str) -> Path:
    """Return the place of what is known of a job; its log and pieces that are not joined yet lie beside it.

    Folders and files end differently, so that no name of a recording or a folder meets another one's.

    Args:
        results: the folder of results.
        name: of the job's result below it, without ending.
    """
    *folders, last = Path(name).parts
    return Path(results, RECORDS_FOLDER, "records", *(f"{one}.dir" for one in folders), f"{last}.json")


PIECE = "//"
"""Before the number in the name of a piece's job; recordings are named by paths, which never have it."""


def recording_of(name: str) -> str:
    """Return the name of the recording's job that a job is, or is a piece of."""
    return name.partition(PIECE)[0]


class Kind(StrEnum):
    """What the process of a job does."""

    TRACK = "track"
    SPLIT = "split"
    JOIN = "join"


class State(StrEnum):
    """What came of a job."""

    DONE = "done"
    KEPT = "kept"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Piece:
    """A stretch of a recording that is tracked by itself.

    Attributes:
        start, end: frames that are tracked, ``end`` not included; they overlap with other pieces.
        first, last: those of them that the joined result has, ``last`` not included.
    """

    start: Count
    end: Count
    first: Count
    last: Count


@dataclass(frozen=True)
class Job:
    """One recording, or a piece of one, and what becomes of it.

    Attributes:
        name: unique within a batch: the result's below the folder of results, without ending, printable.
        command: that tracks it, such as ``("hand", "run")``.
        recording: file or folder.
        arguments: the command's options, without recording, output and what to do with an earlier output.
        output: the result.
        record: what is known of the job (``records.JobRecord``); its log lies beside it.
        results: folder below which output and record lie; no link in it is followed.
        truth: file that the result is compared with; None takes what the result carries.
        gates: conditions under which the result fails.
        page: about the result, to be written; None writes none.
        kind: what is done.
        chunk_s, overlap_s: of a recording that is split: length of a piece and of what it shares, s.
        pieces: of a recording that is joined.
        digests: of the recording's files, where a process before has computed them (``identity.Digests``).
        sources: digest of the posetrack that does it (``build.source_digest``).
    """

    name: str
    command: tuple[str, ...]
    recording: Path
    arguments: tuple[str, ...]
    output: Path
    record: Path
    results: Path
    truth: Path | None = None
    gates: tuple[str, ...] = ()
    page: Path | None = None
    kind: Kind = Kind.TRACK
    chunk_s: float = 0.0
    overlap_s: float = 0.0
    pieces: tuple[tuple[Path, Piece], ...] = ()
    digests: Mapping[str, tuple[int, str]] = field(default_factory=dict)
    sources: str = field(default_factory=source_digest)

    @property
    def log(self) -> Path:
        """What the process prints."""
        return self.record.with_suffix(".log")

    @property
    def pieces_folder(self) -> Path:
        """Where its pieces lie until they are joined."""
        return self.record.with_suffix(".pieces")

    def as_kind(self, kind: Kind, **changes: Any) -> Job:
        """The job of the same recording that does something else."""
        return replace(self, kind=kind, **changes)


@dataclass(frozen=True)
class Limits:
    """What the process of a job may take.

    Attributes:
        memory_bytes: of its data; None for no limit.
        timeout_s: wall-clock seconds; None for no limit.
        threads: that share its work; 0 for as many as there are cores for each job on the machine.
        redo: whether a finished result, or what there is of one, is replaced.
    """

    memory_bytes: int | None = None
    timeout_s: float | None = None
    threads: int = 0
    redo: bool = False


@dataclass(frozen=True)
class Outcome:
    """What came of a job.

    Attributes:
        name: the job's.
        state: what came of it.
        reason: why it failed, or why it was done again; one line.
        last_lines: what its process printed last, where it failed.
        exit_code: of its process; None where there was none, or it was killed.
        seconds, cpu_s: wall-clock and processor time of this process.
        peak_bytes: the most memory it held.
        frames: that it tracked.
        lost_data: whether some of the recording could not be used (exit code 3).
        pieces: of a recording that was split.
        remarks: what the command said that a user should know.
        digests: that its process has computed.
    """

    name: str
    state: State
    reason: str = ""
    last_lines: tuple[str, ...] = ()
    exit_code: Annotated[int, Field(ge=-limits.INTEGER, le=limits.INTEGER)] | None = None
    seconds: Finite = 0.0
    cpu_s: Finite = 0.0
    peak_bytes: Count = 0
    frames: Count = 0
    lost_data: bool = False
    pieces: tuple[Piece, ...] = ()
    remarks: tuple[str, ...] = ()
    digests: Mapping[str, tuple[Count, str]] = field(default_factory=dict)

    @property
    def is_there(self) -> bool:
        """Whether its output is finished."""
        return self.state in (State.DONE, State.KEPT)


# A long recording in pieces that overlap: where they begin and end, and their results as one


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
