"""What is known of a job: what it was made from, and what came of it; a file of JSON for each."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from posetrack_cli import limits
from posetrack_cli.batch.jobs import Count, Job, Outcome
from posetrack_cli.build import libraries
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.files import open_input, read_text, write_output
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.recording.identity import file_digest, files_digest, files_state

FORMAT = "posetrack.batch.job/2"
_STAMPED_BYTES = 1 << 16
RUNNING = "running"
"""State of a job that nobody has noted the end of."""


@dataclass(frozen=True)
class JobRecord:
    """What a batch remembers of a job.

    Attributes:
        key: of the job that began last (``job_key``).
        page: key of the page about its result (``page_key``); empty without one.
        input: state and digest of the recording's files as they were then (``input_digest``).
        output: the finished result (``output_stamp``), also one that is about to be replaced; empty if there
            is none.
        state: ``RUNNING``, or what came of it (``jobs.State``).
        outcome: what came of it; None while it runs.
        format: of the file; one of another format counts as none.
    """

    key: str
    page: str = ""
    input: Mapping[str, str] = field(default_factory=dict)
    output: tuple[Count, str] | tuple[()] = ()
    state: str = RUNNING
    outcome: Outcome | None = None
    format: str = FORMAT


_READER = TypeAdapter(JobRecord)


class DamagedRecordError(PosetrackError):
    """A record that does not say what a record says: nothing of it is believed."""


def read_record(path: Path) -> JobRecord | None:
    """Return what is known of a job; None where there is no record.

    Raises:
        DamagedRecordError: the record cannot be read, or no batch of this version wrote it.
    """
    try:
        record = _READER.validate_json(read_text(path, limits.TEXT_BYTES), strict=True)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise DamagedRecordError("record of a job cannot be read", where=path) from error
    if record.format != FORMAT:
        raise DamagedRecordError("record of a job is of another format", where=path)
    return record


def write_record(path: Path, record: JobRecord) -> None:
    """Keep what is known of a job.

    Raises:
        ResultError: it cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, _READER.dump_json(record, indent=1))


def job_key(job: Job, digest: str) -> str:
    """Return what tells jobs apart whose results differ: input, command, options with the files that they
    name, posetrack's sources and libraries. Not the processor, which changes only last digits (``summary``).

    Where a recording is split, and how the pieces are tracked, follows from these.

    Args:
        job: of a recording or a piece of it.
        digest: of the recording (``input_digest``).
    """
    chunks = [job.chunk_s, job.overlap_s]
    files = sorted(_digests_of_options(job.arguments).items())
    return _digest_of([job.sources, libraries(), job.command, job.arguments, digest, chunks, files])


def page_key(job: Job) -> str:
    """Return what tells pages about one result apart; nothing where none is written."""
    if job.page is None:
        return ""
    return _digest_of([job.sources, "" if job.truth is None else input_digest(job.truth, {})["sha256"]])


def input_digest(path: Path, known: Mapping[str, Any]) -> dict[str, Any]:
    """Return the digest of a recording's files, and the state in which they had it.

    Args:
        path: the file or folder.
        known: of an earlier call; where the files' state is as then nothing is read.

    Raises:
        RecordingError: it cannot be read.
    """
    try:
        files = list(islice(_files_of(path), limits.SEARCH_ENTRIES + 1))
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    if len(files) > limits.SEARCH_ENTRIES:
        raise RecordingError(
            "folder holds too many files", where=path, expected=f"at most {limits.SEARCH_ENTRIES}"
        )
    state = files_state(files)
    if known.get("state") == state and "sha256" in known:
        return dict(known)
    alone = len(files) == 1 and files[0][1] == path
    return {"state": state, "sha256": (file_digest(path) if alone else files_digest(files))[1]}


def output_stamp(path: Path) -> tuple[int, str] | tuple[()]:
    """Return what tells a finished result from another: its size, and a digest of its end, where MCAP has its
    index and checksums; nothing where there is none. Copies are equal.

    Raises:
        OSError: it cannot be read, or is no regular file.
    """
    if not path.exists():
        return ()
    with open_input(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        stream.seek(max(0, size - _STAMPED_BYTES))
        return size, hashlib.sha256(stream.read(_STAMPED_BYTES)).hexdigest()


def _files_of(path: Path) -> Iterator[tuple[str, Path]]:
    """The files that a recording is made of, by their names relative to it, in their order."""
    if not path.is_dir():
        yield path.name, path
        return
    for folder, folders, names in os.walk(path):
        folders.sort()
        for name in sorted(names):
            file = Path(folder, name)
            if file.is_file():
                yield str(file.relative_to(path)), file


def _digests_of_options(arguments: Iterable[str]) -> dict[str, str]:
    """Digests of the files that options name, by the option: whatever is the name of a file is one."""
    found: dict[str, str] = {}
    for argument in arguments:
        _, _, value = argument.partition("=")
        try:
            path = Path(value)
            if value and path.is_file():
                found[argument] = file_digest(path)[1]
        except (OSError, ValueError):  # no name of a file: too long, or with a zero
            continue
    return found


def _digest_of(values: Any) -> str:
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()
