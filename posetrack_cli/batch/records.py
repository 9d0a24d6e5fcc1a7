"""Job records: JSON files with the inputs and the outcome of each job."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from posetrack_cli import limits
from posetrack_cli.batch import remote
from posetrack_cli.batch.jobs import Count, Job, Outcome
from posetrack_cli.build import libraries
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.files import open_input, read_text, write_output
from posetrack_cli.outputs import whole_or_nothing
from posetrack_cli.recording.identity import file_digest, files_digest, files_state

FORMAT = "posetrack.batch.job/2"
_STAMPED_BYTES = 1 << 16
RUNNING = "running"
"""State of a job whose end has not been recorded."""


@dataclass(frozen=True)
class JobRecord:
    """Record of a job's last run.

    Attributes:
        key: key of the job (``job_key``).
        page: key of the page about its result (``page_key``); empty without a page.
        input: state and digest of the recording's files at that time (``input_digest``).
        output: stamp of the finished result (``output_stamp``), or of the result that the running job is
            about to replace; empty if there is none.
        state: ``RUNNING`` or the final state (``jobs.State``).
        outcome: outcome of the job; None while it runs.
        format: format of the record file.
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
    """The record is unreadable, invalid or of another format; its job is repeated."""


def read_record(path: Path) -> JobRecord | None:
    """Return the record of a job, or None if there is none.

    Raises:
        DamagedRecordError: the record is unreadable, invalid or of another format.
    """
    try:
        record = _READER.validate_json(read_text(path, limits.TEXT_BYTES), strict=True)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise DamagedRecordError("job record is damaged", where=path) from error
    if record.format != FORMAT:
        raise DamagedRecordError(
            "job record has an unsupported format", where=path, found=record.format, expected=FORMAT
        )
    return record


def write_record(path: Path, record: JobRecord) -> None:
    """Write the record of a job atomically.

    Raises:
        ResultError: the record cannot be written.
    """
    with whole_or_nothing(path) as part:
        write_output(part, _READER.dump_json(record, indent=1))


def job_key(job: Job, digest: str) -> str:
    """Return a hash of everything that determines the result of a job.

    Covers input, command, options and the files they name, and the posetrack sources and libraries. The
    processor type is left out: it only changes the last digits (``Summary.processors``).

    Args:
        job: job of a recording or a piece.
        digest: digest of the recording (``input_digest``).
    """
    # Split points and the options of the pieces are functions of these values and need no keys.
    chunks = [job.chunk_s, job.overlap_s]
    files = sorted(_digests_of_options(job.arguments).items())
    return _digest_of([job.sources, libraries(), job.command, job.arguments, digest, chunks, files])


def page_key(job: Job) -> str:
    """Return a hash of everything that determines the page about a result; empty without a page."""
    if job.page is None:
        return ""
    return _digest_of([job.sources, "" if job.truth is None else input_digest(job.truth, {})["sha256"]])


def input_digest(path: Path, known: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state (names, sizes, modification times) and the SHA-256 digest of a recording's files.

    Args:
        path: file or folder of the recording.
        known: return value of an earlier call; files whose state is unchanged are not read again.

    Raises:
        RecordingError: a file cannot be read, or the folder has too many files.
    """
    try:
        files = list(islice(_files_of(path), limits.SEARCH_ENTRIES + 1))
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    if len(files) > limits.SEARCH_ENTRIES:
        raise RecordingError(
            "folder has too many files", where=path, expected=f"at most {limits.SEARCH_ENTRIES}"
        )
    # Hashing a recording takes as long as reading it, so an unchanged state reuses the known digest.
    state = files_state(files)
    if known.get("state") == state and "sha256" in known:
        return dict(known)
    alone = len(files) == 1 and files[0][1] == path
    return {"state": state, "sha256": (file_digest(path) if alone else files_digest(files))[1]}


def remote_digest(url: str, path: Path, known: Mapping[str, Any], copy: Callable[[], None]) -> dict[str, Any]:
    """Return the state and digest of a remote recording like ``input_digest``.

    Args:
        url: of the recording.
        path: its local copy.
        known: return value of an earlier call; an unchanged file is not copied again.
        copy: copies the file.

    Raises:
        RecordingError: the file cannot be read.
    """
    state = remote.stamp(url)
    if known.get("state") == state and "sha256" in known:
        return dict(known)
    copy()
    return {"state": state, "sha256": file_digest(path)[1]}


def output_stamp(path: Path) -> tuple[int, str] | tuple[()]:
    """Return the size of a result and a digest of its last 64 KiB; empty if it does not exist.

    The end of an MCAP file holds its index and checksums, so results with different content differ there.

    Raises:
        OSError: the file cannot be read, or is not a regular file.
    """
    if not path.exists():
        return ()
    with open_input(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        stream.seek(max(0, size - _STAMPED_BYTES))
        return size, hashlib.sha256(stream.read(_STAMPED_BYTES)).hexdigest()


def _files_of(path: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files of a recording with their relative names, sorted."""
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
    """Return the digests of all option values that name an existing file, by option."""
    found: dict[str, str] = {}
    for argument in arguments:
        _, _, value = argument.partition("=")
        try:
            path = Path(value)
            if value and path.is_file():
                found[argument] = file_digest(path)[1]
        except (OSError, ValueError):  # not a file name: too long, or contains a null character
            continue
    return found


def _digest_of(values: Any) -> str:
    # sort_keys and default=str: equal values give equal text, whatever their order or path type.
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()
