"""What a batch does: jobs, the limits they run under, and what comes of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.build import source_digest

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
