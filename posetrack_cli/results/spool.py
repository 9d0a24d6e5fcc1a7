"""A file of equal records, written forward and read backward: memory stays flat, however many there are.

The file begins with a line of JSON that names the arrays of a record, their types and shapes; the records
follow, one after the other, each with a digest of itself and of its place. Nothing is made of what the line
says: a run that is resumed knows what its records are, and refuses a file with another line.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.files import open_existing, open_output
from posetrack_cli.results.checkpoint import RESTART_HINT

BLOCK_BYTES = 1 << 22
"""Read at once, at least one record: few system calls, and little memory."""

DIGEST_BYTES = 16
"""Behind each record."""

Array: TypeAlias = np.ndarray[Any, Any]
Record: TypeAlias = Mapping[str, Array]
"""Arrays, or numbers, by name: each is kept in its own type, little-endian."""


class RecordSpool:
    """A temporary file of records, each the same arrays by name.

        with RecordSpool(path) as spool:
            spool.append({"pose": pose, "covariance": covariance})
            for record in reversed(spool):
                ...
            spool.delete()

    Args:
        path: of the file; what was there is replaced.
        keep: of an interrupted run's file, this many records stay, and what came after them goes.
        like: a record of the same names, types and shapes as those that are kept; none where none is.

    Raises:
        ResultError: here and in every method, when the file cannot be written or read, holds fewer records
            than are to be kept or other ones than were written, or a record is unlike the first.
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
        """Write one record behind the others."""
        with self._guarded():
            data = self._packed(record, self._dtype or self._begin(record)).tobytes()
            self._file.write(data + self._digest(self._count, data))
        self._count += 1

    def flush(self) -> None:
        """Wait until all records are on the disk: a checkpoint that counts on them comes after."""
        with self._guarded():
            self._file.flush()
            os.fsync(self._file.fileno())

    def __reversed__(self) -> Iterator[dict[str, Array]]:
        """Yield copies of the records, the last first."""
        with self._guarded():
            self._file.flush()
        for stop in self._stops():
            for values in self._block(stop)["record"][::-1]:
                yield {name: np.array(values[name]) for name in values.dtype.names}

    def close(self) -> None:
        """Close the file and let it lie, for a run that is resumed; closing twice does nothing."""
        with self._guarded():
            self._file.close()

    def delete(self) -> None:
        """Close the file and remove it."""
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
            raise ResultError(what, where=self._path, found="records of another kind", hint=RESTART_HINT)
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
        """Note what a record is, and the line that says so."""
        fields = {name: (_kind(values), list(np.shape(values))) for name, values in record.items()}
        self._head = json.dumps(fields).encode() + b"\n"
        layout: list[Any] = [(name, kind, tuple(shape)) for name, (kind, shape) in fields.items()]
        self._dtype = np.dtype(layout)
        return self._dtype

    def _digest(self, number: int, data: bytes) -> bytes:
        """Return the digest of the record of a number, with what all of them are."""
        parts = self._head, number.to_bytes(8, "little"), data
        return hashlib.blake2b(b"".join(parts), digest_size=DIGEST_BYTES).digest()

    def _check_digests(self, stop: int) -> None:
        """Refuse the block before a record number if one of its records is not as it was written."""
        block = self._block(stop)
        for number, stored in enumerate(block, stop - len(block)):
            if self._digest(number, stored["record"].tobytes()) != stored["digest"].tobytes():
                what = "spool cannot be used"
                found = f"record {number}, which does not fit its digest"
                raise ResultError(what, where=self._path, found=found, hint=RESTART_HINT)

    def _stops(self) -> Iterator[int]:
        """Yield the record numbers that blocks end before, the last first."""
        stop = self._count
        while stop > 0:
            yield stop
            stop -= self._per_block(stop)

    def _per_block(self, stop: int) -> int:
        """How many records the block before a record number has."""
        return min(stop, max(1, BLOCK_BYTES // self._stored_bytes))

    @property
    def _stored_bytes(self) -> int:
        return DIGEST_BYTES + (0 if self._dtype is None else self._dtype.itemsize)

    def _end_of(self, count: int) -> int:
        """Return where in the file so many records end."""
        return len(self._head) + count * self._stored_bytes

    def _packed(self, record: Record, dtype: np.dtype[Any]) -> Array:
        packed: Array = np.empty((), dtype=dtype)
        expected = {name: packed[name].shape for name in dtype.names or ()}
        found = {name: np.shape(values) for name, values in record.items()}
        if found != expected:
            raise ResultError(
                "a record is unlike the first", where=self._path, found=found, expected=expected
            )
        for name, values in record.items():
            packed[name] = values
        return packed

    def _block(self, stop: int) -> Array:
        """Return the records before number ``stop`` with their digests, as many as fit a block."""
        count = self._per_block(stop)
        size = count * self._stored_bytes
        with self._guarded():
            self._file.seek(self._end_of(stop - count))
            data = self._file.read(size)
            self._file.seek(0, os.SEEK_END)  # where the next record goes
        if len(data) < size:
            raise ResultError("spool ends early", where=self._path, hint=RESTART_HINT)
        return np.frombuffer(data, [("record", self._dtype), ("digest", np.uint8, DIGEST_BYTES)])

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Tell of the file what goes wrong with it."""
        try:
            yield
        except FileNotFoundError as error:
            raise ResultError("no spool to resume from", where=self._path, hint=RESTART_HINT) from error
        except OSError as error:
            found = error.strerror or error
            raise ResultError("cannot be written or read", where=self._path, found=found) from error


def _kind(values: Any) -> str:
    """Return how values are kept: in their own type, little-endian."""
    return np.asarray(values).dtype.newbyteorder("<").str
