"""A file of equal records, written forward and read backward: memory stays flat, however many there are.

The file begins with a line of JSON that names the arrays of a record, their types and shapes; the records
follow, one after the other.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli.errors import ResultError
from posetrack_cli.results.checkpoint import RESTART_HINT

BLOCK_BYTES = 1 << 22
"""Read at once, at least one record: few system calls, and little memory."""

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

    Raises:
        ResultError: here and in every method, when the file cannot be written or read, holds fewer records
            than are to be kept, or a record is unlike the first.
    """

    def __init__(self, path: Path, keep: int = 0) -> None:
        self._path, self._count = path, keep
        self._dtype: np.dtype[Any] | None = None
        self._start = 0
        with self._guarded():
            self._file = path.open("r+b" if keep else "w+b")
        if keep:
            try:
                self._restore(keep)
            except BaseException:
                self._file.close()
                raise

    def __len__(self) -> int:
        return self._count

    def append(self, record: Record) -> None:
        """Write one record behind the others."""
        with self._guarded():
            self._file.write(self._packed(record, self._dtype or self._begin(record)).tobytes())
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
        stop = self._count
        while stop > 0:
            block = self._block(stop)
            for values in block[::-1]:
                yield {name: np.array(values[name]) for name in values.dtype.names}
            stop -= len(block)

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
        fields = {name: (_kind(values), list(np.shape(values))) for name, values in record.items()}
        line = json.dumps(fields).encode() + b"\n"
        self._file.write(line)
        return self._lay_out(fields, len(line))

    def _restore(self, keep: int) -> None:
        with self._guarded():
            line, size = self._file.readline(), self._path.stat().st_size
        try:
            self._lay_out(json.loads(line), len(line))
        except (ValueError, TypeError, AttributeError) as error:
            raise ResultError("spool cannot be read", where=self._path, hint=RESTART_HINT) from error
        end = self._end_of(keep)
        if size < end:
            found, expected = f"{size} bytes", f"{end}, for {keep} frames"
            raise ResultError(
                "spool ends early", where=self._path, found=found, expected=expected, hint=RESTART_HINT
            )
        with self._guarded():
            self._file.truncate(end)
            self._file.seek(end)

    def _lay_out(self, fields: Mapping[str, Any], start: int) -> np.dtype[Any]:
        layout: list[Any] = [(name, kind, tuple(shape)) for name, (kind, shape) in fields.items()]
        self._dtype, self._start = np.dtype(layout), start
        return self._dtype

    def _end_of(self, count: int) -> int:
        """Return where in the file so many records end."""
        return self._start + (0 if self._dtype is None else count * self._dtype.itemsize)

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
        """Return the records before number ``stop``, as many as fit a block."""
        if self._dtype is None:
            return np.empty(0)
        count = min(stop, max(1, BLOCK_BYTES // self._dtype.itemsize))
        size = count * self._dtype.itemsize
        with self._guarded():
            self._file.seek(self._end_of(stop - count))
            data = self._file.read(size)
            self._file.seek(0, os.SEEK_END)  # where the next record goes
        if len(data) < size:
            raise ResultError("spool ends early", where=self._path, hint=RESTART_HINT)
        return np.frombuffer(data, dtype=self._dtype)

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
