"""Reading of untrusted npz files: no code execution, no allocation beyond the file's contents.

A zip entry of a few kilobytes can claim gigabytes, and an npy header can request any array. All sizes are
therefore read first, from the zip index and the array headers, and must agree with each other and with
``limits``. Headers must have numpy's format and are never evaluated.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
import zlib
from io import BytesIO
from typing import IO, Any, TypeAlias

import numpy as np

from posetrack_cli import limits

Arrays: TypeAlias = dict[str, np.ndarray[Any, Any]]

_SUFFIX = ".npy"
_ENCRYPTED = 0x1
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # zipfile does not bound memory for the others
_MAGIC = b"\x93NUMPY"
_HEADER = re.compile(
    rb"\{'descr': '([<|][biufcU]\d{1,9})', 'fortran_order': (False|True), "
    rb"'shape': \(((?:\d{1,18}, ?)*(?:\d{1,18})?)\), \} *\n"
)
_HEADER_BYTES = 1 << 12
_MOST_AXES = 8
_LAST_CHARACTER = 0x10FFFF
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    OSError,
    RuntimeError,
    ValueError,
    OverflowError,
)
"""Exceptions that zipfile and numpy raise on damaged bytes."""


class NpzError(ValueError):
    """Invalid, damaged or oversized npz file."""


def read_npz(source: bytes | IO[bytes]) -> Arrays:
    """Return the arrays of an npz file by name.

    Supported are little-endian numbers, booleans and text, but not objects or records.

    Args:
        source: the file's bytes, or the open file.

    Raises:
        NpzError: it is not an npz file, is damaged, or exceeds ``limits``.
    """
    stream = BytesIO(source) if isinstance(source, bytes) else source
    if not zipfile.is_zipfile(stream):
        raise NpzError("not a complete npz file")
    try:
        with zipfile.ZipFile(stream) as archive:
            return {name: _array(archive, entry, name) for name, entry in _entries(archive, stream).items()}
    except NpzError:
        raise
    except _DAMAGE as error:
        raise NpzError(f"not a complete npz file: {error}") from error


def _entries(archive: zipfile.ZipFile, stream: IO[bytes]) -> dict[str, zipfile.ZipInfo]:
    """Return the zip entries by array name after checking count, size and encoding."""
    entries = archive.infolist()
    if len(entries) > limits.NPZ_ARRAYS:
        raise NpzError(f"{len(entries)} arrays exceed the limit of {limits.NPZ_ARRAYS}")
    total, most = sum(entry.file_size for entry in entries), _most_bytes(stream)
    if total > most:
        raise NpzError(f"arrays of {total} bytes in total exceed the limit of {most}")
    named: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        name = entry.filename.removesuffix(_SUFFIX)
        if name == entry.filename:
            raise NpzError(f"'{name}' is not an array")
        if name in named:
            raise NpzError(f"array '{name}' occurs twice")
        if entry.flag_bits & _ENCRYPTED or entry.compress_type not in _COMPRESSIONS:
            raise NpzError(f"array '{name}' is encrypted or uses an unsupported compression")
        named[name] = entry
    return named


def _most_bytes(stream: IO[bytes]) -> int:
    """Return the maximum total size of the arrays."""
    stream.seek(0, 2)
    return max(limits.NPZ_FLOOR_BYTES, limits.NPZ_EXPANSION * stream.tell())


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> np.ndarray[Any, Any]:
    """Return one array; its data is read only if its size matches the header."""
    with archive.open(entry) as stream:
        start = stream.read(8)
        longer = start[6:7] != b"\x01"  # npy version 1 has a 2-byte header length, later versions 4 bytes
        counted = stream.read(4 if longer else 2)
        if start[:6] != _MAGIC or len(counted) != (4 if longer else 2):
            raise NpzError(f"'{name}' is not an array")
        length = int.from_bytes(counted, "little")
        header = _HEADER.fullmatch(stream.read(min(length, _HEADER_BYTES + 1)))
        if header is None:
            raise NpzError(f"array '{name}' has an unsupported type, expected numbers, booleans or text")
        dtype, order, shape = _laid_out(name, *header.groups())
        size = entry.file_size - len(start) - len(counted) - length
        if math.prod(shape) * dtype.itemsize != size:
            raise NpzError(f"array '{name}' has {size} bytes, which do not fit {dtype} {shape}")
        data = stream.read(size)
    if len(data) != size:
        raise NpzError(f"array '{name}' ends early")
    values = np.frombuffer(data, dtype, math.prod(shape)) if size else np.empty(math.prod(shape), dtype)
    _check_values(name, values)
    return values.reshape(shape, order=order).copy(order="K")  # writable; frombuffer is read-only


def _laid_out(
    name: str, descr: bytes, fortran: bytes, lengths: bytes
) -> tuple[np.dtype[Any], Any, tuple[int, ...]]:
    """Return dtype, memory order and shape from the header fields."""
    shape = tuple(int(length) for length in lengths.split(b",") if length.strip())
    try:
        dtype = np.dtype(descr.decode())
    except (TypeError, ValueError, OverflowError) as error:
        raise NpzError(f"array '{name}' has an unsupported type {descr.decode()}") from error
    if len(shape) > _MOST_AXES or not dtype.isnative or dtype.name in ("float128", "complex256"):
        raise NpzError(f"array '{name}' has an unsupported type or shape, {dtype} {shape}")
    return dtype, "F" if fortran == b"True" else "C", shape


def _check_values(name: str, values: np.ndarray[Any, Any]) -> None:
    """Refuse bytes that are not valid for the type; numpy's behaviour on them is undefined."""
    if values.dtype.kind == "b" and np.any(values.view(np.uint8) > 1):
        raise NpzError(f"array '{name}' has invalid booleans")
    if values.dtype.kind == "U" and values.nbytes and np.any(values.view(np.uint32) > _LAST_CHARACTER):
        raise NpzError(f"array '{name}' has invalid text")
