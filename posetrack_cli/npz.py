"""Arrays from npz files of strangers: nothing is executed, and no array is made that the file does not hold.

A zip entry of a few kilobytes can claim to be gigabytes, and an npy header can ask for any array. So all
sizes are read first, from the zip's index and the arrays' own headers, and have to agree with each other and
with ``limits``; the headers are those that numpy writes, and are never evaluated.
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
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # zipfile reads others without a bound on memory
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
"""What zipfile and numpy raise, depending on the bytes that are wrong."""


class NpzError(ValueError):
    """An npz file that is none, damaged, or too large; the text says how."""


def read_npz(source: bytes | IO[bytes]) -> Arrays:
    """Return the arrays of an npz file by name.

    Numbers and truth values little-endian, and text; no objects, no records.

    Args:
        source: the file's bytes, or the open file.

    Raises:
        NpzError: it is none, damaged, or its arrays take more than ``limits`` allow.
    """
    stream = BytesIO(source) if isinstance(source, bytes) else source
    if not zipfile.is_zipfile(stream):
        raise NpzError("no whole npz file")
    try:
        with zipfile.ZipFile(stream) as archive:
            return {name: _array(archive, entry, name) for name, entry in _entries(archive, stream).items()}
    except NpzError:
        raise
    except _DAMAGE as error:
        raise NpzError(f"no whole npz file: {error}") from error


def _entries(archive: zipfile.ZipFile, stream: IO[bytes]) -> dict[str, zipfile.ZipInfo]:
    """Return what the zip's index lists by the arrays' names, once all of it may be read."""
    entries = archive.infolist()
    if len(entries) > limits.NPZ_ARRAYS:
        raise NpzError(f"{len(entries)} arrays, at most {limits.NPZ_ARRAYS} are read")
    total, most = sum(entry.file_size for entry in entries), _most_bytes(stream)
    if total > most:
        raise NpzError(f"arrays of {total} bytes in all, at most {most} are read")
    named: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        name = entry.filename.removesuffix(_SUFFIX)
        if name == entry.filename:
            raise NpzError(f"'{name}', which is no array")
        if name in named:
            raise NpzError(f"array '{name}' twice")
        if entry.flag_bits & _ENCRYPTED or entry.compress_type not in _COMPRESSIONS:
            raise NpzError(f"array '{name}' encrypted, or compressed in an unusual way")
        named[name] = entry
    return named


def _most_bytes(stream: IO[bytes]) -> int:
    """How many bytes the arrays of a file may take."""
    stream.seek(0, 2)
    return max(limits.NPZ_FLOOR_BYTES, limits.NPZ_EXPANSION * stream.tell())


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> np.ndarray[Any, Any]:
    """Return one array; its header is read first, and the rest only if it is as long as the header says."""
    with archive.open(entry) as stream:
        start = stream.read(8)
        longer = start[6:7] != b"\x01"  # version 1 counts its header with two bytes, later ones with four
        counted = stream.read(4 if longer else 2)
        if start[:6] != _MAGIC or len(counted) != (4 if longer else 2):
            raise NpzError(f"'{name}', which is no array")
        length = int.from_bytes(counted, "little")
        header = _HEADER.fullmatch(stream.read(min(length, _HEADER_BYTES + 1)))
        if header is None:
            raise NpzError(f"array '{name}' of another kind than plain numbers and text")
        dtype, order, shape = _laid_out(name, *header.groups())
        size = entry.file_size - len(start) - len(counted) - length
        if math.prod(shape) * dtype.itemsize != size:
            raise NpzError(f"array '{name}' of {size} bytes as {dtype} {shape}")
        data = stream.read(size)
    if len(data) != size:
        raise NpzError(f"array '{name}' ends early")
    values = np.frombuffer(data, dtype, math.prod(shape)) if size else np.empty(math.prod(shape), dtype)
    _check_values(name, values)
    return values.reshape(shape, order=order).copy(order="K")  # one that can be written to


def _laid_out(
    name: str, descr: bytes, fortran: bytes, lengths: bytes
) -> tuple[np.dtype[Any], Any, tuple[int, ...]]:
    """Return type, order in memory and shape that a header states."""
    shape = tuple(int(length) for length in lengths.split(b",") if length.strip())
    try:
        dtype = np.dtype(descr.decode())
    except (TypeError, ValueError, OverflowError) as error:
        raise NpzError(f"array '{name}' as {descr.decode()}") from error
    if len(shape) > _MOST_AXES or not dtype.isnative or dtype.name in ("float128", "complex256"):
        raise NpzError(f"array '{name}' as {dtype} {shape}")
    return dtype, "F" if fortran == b"True" else "C", shape


def _check_values(name: str, values: np.ndarray[Any, Any]) -> None:
    """Refuse bytes that no value of the type has: what numpy does with them is not defined."""
    if values.dtype.kind == "b" and np.any(values.view(np.uint8) > 1):
        raise NpzError(f"array '{name}' with truth values that are neither")
    if values.dtype.kind == "U" and values.nbytes and np.any(values.view(np.uint32) > _LAST_CHARACTER):
        raise NpzError(f"array '{name}' with text that is none")
