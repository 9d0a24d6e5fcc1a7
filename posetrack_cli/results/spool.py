"""Auxiliary files of a run: checkpoints, and record spools that are read backwards."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.files import open_existing, open_input, open_output
from posetrack_cli.npz import read_npz
from posetrack_cli.recording.base import PATH_KEY
from posetrack_cli.results.columns import COUNTS, check_numbers

# Checkpoints: npz files without pickle next to the unfinished result, with the tracker's arrays, one JSON
# text for everything else, and a digest of both, so that a damaged checkpoint is never resumed.

_ARRAY_PREFIX = "array."
_JSON_KEY, _DIGEST_KEY = "json", "digest"
FORMAT_VERSION = 6
RESTART_HINT = "start again with --overwrite"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """State needed to continue a run after its last flushed frame.

    Attributes:
        frame_index: last frame whose estimate is flushed.
        frames_written: number of flushed estimates.
        arrays: the tracker's arrays by name; no Python objects.
        state: other tracker state, JSON-serialisable (e.g. the random generator's).
        fingerprint: fingerprint of the run, set by ``ResultWriter.save_checkpoint``.
    """

    frame_index: int
    frames_written: int
    arrays: Mapping[str, np.ndarray[Any, Any]] = field(default_factory=dict)
    state: Mapping[str, Any] = field(default_factory=dict)
    fingerprint: str = ""


@dataclass(frozen=True)
class Progress:
    """State of a result file at its last flush.

    Attributes:
        file_bytes: file size.
        flush_frames: estimates per flush, which determines chunk boundaries.
        truth_messages: number of truth messages copied.
        statuses: number of estimates per status, and with several subjects per subject.
    """

    file_bytes: int
    flush_frames: int
    truth_messages: int
    statuses: Mapping[str, int]


def fingerprint(run: Mapping[str, str]) -> str:
    """Return the SHA-256 of a run record, independent of key order.

    The recording's path is excluded, as the recording may be moved before a resume.
    """
    kept = {key: value for key, value in run.items() if key != PATH_KEY}
    text = json.dumps(kept, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def save(path: Path, checkpoint: Checkpoint, progress: Progress) -> None:
    """Write both to one file atomically.

    Raises:
        ResultError: the file cannot be written, or the state has unsupported types.
    """
    temporary = path.with_name(path.name + ".tmp")
    contents = _contents(path, checkpoint, progress)
    try:
        with open_output(temporary) as stream:
            np.savez(stream, **contents)  # type: ignore[arg-type]
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(path)
    except OSError as error:
        raise ResultError("cannot be written", where=temporary, found=error.strerror or error) from error


def load(path: Path) -> tuple[Checkpoint, Progress]:
    """Read a file written by ``save``.

    Raises:
        ResultError: the file is missing, damaged, or has another version or format.
    """
    try:
        with open_input(path) as stream:
            return _parsed(read_npz(stream))
    except FileNotFoundError as error:
        raise ResultError("no checkpoint to resume from", where=path, hint=RESTART_HINT) from error
    except OSError as error:
        what = "checkpoint cannot be read"
        raise ResultError(what, where=path, found=error.strerror or error, hint=RESTART_HINT) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        found = f"{error} is missing" if isinstance(error, KeyError) else error
        raise ResultError("checkpoint cannot be read", where=path, found=found, hint=RESTART_HINT) from error


def _parsed(contents: Mapping[str, np.ndarray[Any, Any]]) -> tuple[Checkpoint, Progress]:
    """Return the contents of a checkpoint file.

    Raises:
        ValueError, KeyError, TypeError, RecursionError: the arrays do not have the format of ``save``.
    """
    fields = json.loads(contents[_JSON_KEY].tobytes())
    check_numbers(fields, {"version": (FORMAT_VERSION, FORMAT_VERSION)})
    if contents[_DIGEST_KEY].tobytes() != _digest(contents):
        raise ValueError("contents that do not match their digest")
    kept, progress = fields["checkpoint"], fields["progress"]
    check_numbers(kept, {"frame_index": (-1, COUNTS[1]), "frames_written": COUNTS})
    check_numbers(progress, {"file_bytes": COUNTS, "flush_frames": (1, COUNTS[1]), "truth_messages": COUNTS})
    if not (isinstance(kept["state"], dict) and isinstance(kept["fingerprint"], str)):
        raise ValueError("invalid state or fingerprint")
    names = [name for name in contents if name.startswith(_ARRAY_PREFIX)]
    arrays = {name.removeprefix(_ARRAY_PREFIX): contents[name] for name in names}
    return Checkpoint(arrays=arrays, **kept), Progress(**progress)


def _digest(contents: Mapping[str, np.ndarray[Any, Any]]) -> bytes:
    """Return the SHA-256 of names, types, shapes and bytes of all arrays except the digest."""
    digest = hashlib.sha256()
    for name in sorted(contents.keys() - {_DIGEST_KEY}):
        array = contents[name]
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(array.tobytes())
    return digest.digest()


def _contents(path: Path, checkpoint: Checkpoint, progress: Progress) -> dict[str, np.ndarray[Any, Any]]:
    for name, array in checkpoint.arrays.items():
        if np.asarray(array).dtype.hasobject:
            raise ResultError(f"state '{name}' cannot be saved", where=path, found="Python objects")
    kept = {
        name: getattr(checkpoint, name) for name in ("frame_index", "frames_written", "state", "fingerprint")
    }
    kept["state"] = dict(kept["state"])
    fields = {"version": FORMAT_VERSION, "checkpoint": kept, "progress": asdict(progress)}
    try:
        text = json.dumps(fields).encode()
    except TypeError as error:
        raise ResultError("state cannot be saved", where=path, found=error) from error
    arrays = {f"{_ARRAY_PREFIX}{name}": np.asarray(array) for name, array in checkpoint.arrays.items()}
    contents = {_JSON_KEY: np.frombuffer(text, dtype=np.uint8), **arrays}
    return {**contents, _DIGEST_KEY: np.frombuffer(_digest(contents), dtype=np.uint8)}


# Record spools: files of fixed-size records, written forwards and read backwards in constant memory.
#
# The first line is JSON with names, types and shapes of a record's arrays. The records follow, each with a
# digest of its contents and number. The line is only compared with the expected one, never interpreted.

BLOCK_BYTES = 1 << 22
"""Bytes read at once (at least one record): few system calls, little memory."""

DIGEST_BYTES = 16
"""Appended to each record."""

Array: TypeAlias = np.ndarray[Any, Any]
Record: TypeAlias = Mapping[str, Array]
"""Arrays or numbers by name; each keeps its own type, little-endian."""


class RecordSpool:
    """Temporary file of records, each with the same arrays by name.

        with RecordSpool(path) as spool:
            spool.append({"pose": pose, "covariance": covariance})
            for record in reversed(spool):
                ...
            spool.delete()

    Args:
        path: file; an existing one is replaced unless ``keep`` is given.
        keep: number of records to keep from an interrupted run's file; later ones are dropped.
        like: record with the same names, types and shapes as the kept ones; not needed if none are kept.

    Raises:
        ResultError: here and in every method: the file cannot be written or read, has fewer than ``keep``
            or different records, or a record differs in layout from the first.
    """

    def __init__(self, path: Path, keep: int = 0, like: Record = MappingProxyType({})) -> None:
        self._path, self._count = path, keep
        self._dtype: np.dtype[Any] | None = None
        self._head = b""
        with self._guarded():
            if not keep:
                open_output(path).close()
            self._file = open_existing(path)
        if keep:
            try:
                self._restore(keep, like)
            except BaseException:
                self._file.close()
                raise

    def __len__(self) -> int:
        return self._count

    def append(self, record: Record) -> None:
        """Append a record."""
        with self._guarded():
            data = self._packed(record, self._dtype or self._begin(record)).tobytes()
            self._file.write(data + self._digest(self._count, data))
        self._count += 1

    def flush(self) -> None:
        """Sync all records to disk; call before saving a checkpoint that relies on them."""
        with self._guarded():
            self._file.flush()
            os.fsync(self._file.fileno())

    def __reversed__(self) -> Iterator[dict[str, Array]]:
        """Yield copies of the records, last first."""
        with self._guarded():
            self._file.flush()
        for stop in self._stops():
            for values in self._block(stop)["record"][::-1]:
                yield {name: np.array(values[name]) for name in values.dtype.names}

    def close(self) -> None:
        """Close the file but keep it for resuming; idempotent."""
        with self._guarded():
            self._file.close()

    def delete(self) -> None:
        """Close and delete the file."""
        self.close()
        with self._guarded():
            self._path.unlink(missing_ok=True)

    def __enter__(self) -> RecordSpool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, record: Record) -> np.dtype[Any]:
        dtype = self._lay_out(record)
        self._file.write(self._head)
        return dtype

    def _restore(self, keep: int, like: Record) -> None:
        self._lay_out(like)
        with self._guarded():
            head, size = self._file.read(len(self._head)), os.fstat(self._file.fileno()).st_size
        if head != self._head:
            what = "spool cannot be used"
            raise ResultError(what, where=self._path, found="records of another type", hint=RESTART_HINT)
        end = self._end_of(keep)
        if size < end:
            found, expected = f"{size} bytes", f"{end}, for {keep} frames"
            raise ResultError(
                "spool ends early", where=self._path, found=found, expected=expected, hint=RESTART_HINT
            )
        for stop in self._stops():
            self._check_digests(stop)
        with self._guarded():
            self._file.truncate(end)
            self._file.seek(end)

    def _lay_out(self, record: Record) -> np.dtype[Any]:
        """Set the record dtype and the header line."""
        fields = {name: (_kind(values), list(np.shape(values))) for name, values in record.items()}
        self._head = json.dumps(fields).encode() + b"\n"
        layout: list[Any] = [(name, kind, tuple(shape)) for name, (kind, shape) in fields.items()]
        self._dtype = np.dtype(layout)
        return self._dtype

    def _digest(self, number: int, data: bytes) -> bytes:
        """Return the digest of a record, its number and the header line."""
        parts = self._head, number.to_bytes(8, "little"), data
        return hashlib.blake2b(b"".join(parts), digest_size=DIGEST_BYTES).digest()

    def _check_digests(self, stop: int) -> None:
        """Check the digests of the block that ends before record ``stop``."""
        block = self._block(stop)
        for number, stored in enumerate(block, stop - len(block)):
            if self._digest(number, stored["record"].tobytes()) != stored["digest"].tobytes():
                what = "spool cannot be used"
                found = f"record {number}, which does not match its digest"
                raise ResultError(what, where=self._path, found=found, hint=RESTART_HINT)

    def _stops(self) -> Iterator[int]:
        """Yield the record numbers at which blocks end, last first."""
        stop = self._count
        while stop > 0:
            yield stop
            stop -= self._per_block(stop)

    def _per_block(self, stop: int) -> int:
        """Return the number of records in the block ending before ``stop``."""
        return min(stop, max(1, BLOCK_BYTES // self._stored_bytes))

    @property
    def _stored_bytes(self) -> int:
        return DIGEST_BYTES + (0 if self._dtype is None else self._dtype.itemsize)

    def _end_of(self, count: int) -> int:
        """Return the file offset at which ``count`` records end."""
        return len(self._head) + count * self._stored_bytes

    def _packed(self, record: Record, dtype: np.dtype[Any]) -> Array:
        packed: Array = np.empty((), dtype=dtype)
        expected = {name: packed[name].shape for name in dtype.names or ()}
        found = {name: np.shape(values) for name, values in record.items()}
        if found != expected:
            raise ResultError(
                "record layout differs from the first", where=self._path, found=found, expected=expected
            )
        for name, values in record.items():
            packed[name] = values
        return packed

    def _block(self, stop: int) -> Array:
        """Return the block of records with their digests that ends before ``stop``."""
        count = self._per_block(stop)
        size = count * self._stored_bytes
        with self._guarded():
            self._file.seek(self._end_of(stop - count))
            data = self._file.read(size)
            self._file.seek(0, os.SEEK_END)  # append() writes at the current position
        if len(data) < size:
            raise ResultError("spool ends early", where=self._path, hint=RESTART_HINT)
        return np.frombuffer(data, [("record", self._dtype), ("digest", np.uint8, DIGEST_BYTES)])

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Convert OS errors into ResultErrors that name the file."""
        try:
            yield
        except FileNotFoundError as error:
            raise ResultError("no spool to resume from", where=self._path, hint=RESTART_HINT) from error
        except OSError as error:
            found = error.strerror or error
            raise ResultError("cannot be written or read", where=self._path, found=found) from error


def _kind(values: Any) -> str:
    """Return the storage type: the array's own type, little-endian."""
    return np.asarray(values).dtype.newbyteorder("<").str
