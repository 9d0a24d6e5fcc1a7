"""Jobs of a batch, their outcomes, and splitting long recordings into overlapping pieces."""

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

# Bounds of the values in a job record; records are untrusted input.
Finite = Annotated[float, Field(ge=0.0, le=limits.NUMBER, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, le=limits.INTEGER)]

RECORDS_FOLDER = ".batch"
"""Folder for records, logs and unjoined pieces, inside the results folder."""


def record_path(results: Path, name: str) -> Path:
    """Return the path of a job's record. Its log and its unjoined pieces are stored next to it.

    Args:
        results: results folder.
        name: path of the job's result relative to ``results``, without extension.
    """
    *folders, last = Path(name).parts
    # The suffix ".dir" keeps the folder of "a/b" apart from the record and pieces of a recording "a".
    return Path(results, RECORDS_FOLDER, "records", *(f"{one}.dir" for one in folders), f"{last}.json")


def input_path(results: Path, name: str, file: Path) -> Path:
    """Return the path of the local copy of a remote recording; copies of running jobs do not collide.

    Args:
        results: results folder.
        name: path of the job's result relative to ``results``, without extension.
        file: name of the remote file, whose extension states its kind.
    """
    return record_path(results, name).with_suffix(".input") / file


PIECE = "//"
"""Separates recording and number in the name of a piece's job; normalised paths never contain it."""


def recording_of(name: str) -> str:
    """Return the job name of the recording that a job, or the job of a piece, belongs to."""
    return name.partition(PIECE)[0]


class Kind(StrEnum):
    """Task of a job's child process."""

    TRACK = "track"
    SPLIT = "split"
    JOIN = "join"


class State(StrEnum):
    """Final state of a job."""

    DONE = "done"
    KEPT = "kept"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Piece:
    """A range of frames that is tracked as a job of its own.

    Attributes:
        start, end: tracked frames, half-open; they overlap with neighbouring pieces.
        first, last: frames that the piece contributes to the joined result, half-open.
    """

    start: Count
    end: Count
    first: Count
    last: Count


@dataclass(frozen=True)
class Job:
    """Tracking of one recording, or of a piece of one.

    Attributes:
        name: unique in the batch; path of the result relative to ``results``, without extension, printable.
        command: tracking command, such as ``("hand", "run")``.
        recording: file or folder.
        arguments: options of the command, except recording, output, ``--resume`` and ``--overwrite``.
        output: path of the result.
        record: path of the job's record (``records.JobRecord``); the log is next to it.
        results: results folder, which contains output and record; symbolic links in it are not followed.
        truth: ground-truth file; None uses the ground truth in the result.
        gates: gates that the result must pass.
        page: path of the HTML page to write about the result; None writes none.
        kind: task of the child process.
        chunk_s, overlap_s: length and overlap of the pieces of a recording that is split, s.
        pieces: results and pieces to join.
        digests: digests of the recording's files that an earlier process computed (``identity.Digests``).
        sources: digest of the posetrack sources that must run the job (``build.source_digest``).
        url: of a remote recording, whose local copy is ``recording``; empty for a local one.
        person: whom the recording shows; empty if unknown.
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
    url: str = ""
    person: str = ""

    @property
    def shown_recording(self) -> str:
        """The recording as the user named it."""
        return self.url or str(self.recording)

    @property
    def log(self) -> Path:
        """Path of the log with the output of the child process."""
        return self.record.with_suffix(".log")

    @property
    def pieces_folder(self) -> Path:
        """Folder of the pieces until they are joined."""
        return self.record.with_suffix(".pieces")

    def as_kind(self, kind: Kind, **changes: Any) -> Job:
        """Return a job of another kind for the same recording."""
        return replace(self, kind=kind, **changes)


@dataclass(frozen=True)
class Limits:
    """Resource limits of a job's child process.

    Attributes:
        memory_bytes: limit of its data segment; None for no limit.
        timeout_s: wall-clock limit, s; None for no limit.
        threads: number of threads; 0 divides the cores of the machine among its jobs.
        redo: replace finished and partial results.
    """

    memory_bytes: int | None = None
    timeout_s: float | None = None
    threads: int = 0
    redo: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of running a job.

    Attributes:
        name: name of the job.
        state: final state.
        reason: why it failed or was repeated; one line.
        last_lines: last lines of the log of a failed job.
        exit_code: exit code of the child process, negative for a signal; None if none was started.
        seconds, cpu_s: wall-clock and CPU time of the child process, s.
        peak_bytes: peak resident memory, bytes.
        frames: number of tracked frames.
        lost_data: whether part of the recording was unusable (exit code 3).
        pieces: pieces of a recording that was split.
        remarks: notes for the user from the tracking command.
        digests: file digests that the child process computed.
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
    def has_result(self) -> bool:
        """Whether the job has a finished result."""
        return self.state in (State.DONE, State.KEPT)


# Splitting and joining of long recordings


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
    """Split a recording into pieces of equal duration; a short one is returned as a single piece.

    Args:
        recording: read once, without decoding images.
        chunk_s: duration of a piece, s; a remainder of at most half a piece is added to the last.
        overlap_s: duration tracked before the frames that a piece contributes, s.
        start, end, stride: selection of frames to track.
        looks_ahead: whether results depend on later frames (``--smooth``), so that pieces must overlap on
            both sides.
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
        return [Piece(start, start + 1, start, start + 1)]  # tracking this piece reports the missing frames
    return pieces_of(numbers, stamps, chunk_s, overlap_s, overlap_s if looks_ahead else 0.0)


def pieces_of(
    numbers: Sequence[int], stamps: Sequence[int], chunk_s: float, before_s: float, after_s: float
) -> list[Piece]:
    """Split frames into pieces.

    Each frame is contributed by exactly one piece: ``first`` of a piece is ``last`` of the previous one.

    Args:
        numbers, stamps: frame numbers and stamps (ns), both increasing; at least one.
        chunk_s: duration of a piece, s.
        before_s, after_s: duration tracked before and after the frames that a piece contributes, s.
    """
    length, ahead, later = (round(seconds * _NS) for seconds in (chunk_s, before_s, after_s))
    count = max(1, round((stamps[-1] - stamps[0]) / length))
    # Cuts by stamp rather than by frame number: pieces have equal duration even if frames were dropped.
    begins = [stamps[0] + k * length for k in range(count)]
    cuts = [*(bisect_left(stamps, begin) for begin in begins), len(stamps)]
    pieces = []
    for own, after in pairwise(cuts):
        if own == after:
            continue  # a gap in the recording spans the whole piece
        before = bisect_left(stamps, stamps[own] - ahead)
        behind = bisect_left(stamps, stamps[after - 1] + later + 1)
        pieces.append(Piece(numbers[before], numbers[behind - 1] + 1, numbers[own], _last(numbers, after)))
    return pieces


def _last(numbers: Sequence[int], after: int) -> int:
    """Return the end (exclusive) of the frames that a piece contributes."""
    return numbers[after] if after < len(numbers) else numbers[-1] + 1


def handover_frame(one: tuple[Path, Piece], other: tuple[Path, Piece]) -> int:
    """Return the frame at which the joined result switches to the next piece: where both agree best.

    Only the later half of the common frames is considered, so that the track of the next piece has settled
    after its initialisation. Tracks of hidden fingers can differ by 1 cm and converge once the fingers are
    visible.

    Args:
        one, other: results and pieces, in temporal order.
    """
    (before, after), first = (load_arrays(path) for path, _ in (one, other)), other[1].first
    both, rows, columns = np.intersect1d(before["frame_index"], after["frame_index"], return_indices=True)
    if not len(both):
        return first
    later = both >= both[len(both) // 2]
    apart = before["points"][rows[later]] - after["points"][columns[later]]
    distances = np.linalg.norm(apart, axis=2).mean(axis=1)
    nearest = np.flatnonzero(distances == distances.min())[-1]  # the last one, furthest from initialisation
    return int(both[later][nearest])


def join_results(
    pieces: Sequence[tuple[Path, Piece]], output: Path, chunk_s: float, overlap_s: float
) -> bool:
    """Join the results of the pieces, switching at ``handover_frame``; overwrite an existing output.

    The run record of the joined result states how it was split.

    Returns:
        Whether data was lost: part of the recording was unusable, or hardly any frame was tracked.
    """
    first, last = pieces[0][1], pieces[-1][1]
    changes = {
        "start": str(first.first),
        "end": str(last.last),
        "chunk_s": f"{chunk_s:g}",
        "overlap_s": f"{overlap_s:g}",
        "pieces": str(len(pieces)),
    }
    cuts = [first.first, *(handover_frame(*pair) for pair in pairwise(pieces)), last.last]
    shares = [Share(path, *own) for (path, _), own in zip(pieces, pairwise(cuts), strict=True)]
    join(shares, output, changes, overwrite=True)
    summary = read_result(output).summary
    return "losses" in summary or is_hardly_tracked(int(summary["frames"]), int(summary["lost"]))
