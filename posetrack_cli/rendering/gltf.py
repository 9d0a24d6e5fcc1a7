"""Binary glTF 2.0 (GLB): the container and its numbers.

Khronos Group, glTF 2.0 specification, sections 3.6 (accessors) and 4 (GLB). Read is what skinned meshes
need: one JSON and one BIN chunk; no sparse accessors, no compression, no buffers in other files.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_input

_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_HARMLESS = {"KHR_mesh_quantization", "KHR_texture_transform", "KHR_materials_unlit", "EXT_texture_webp"}
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@dataclass(frozen=True)
class Gltf:
    """One GLB file.

    Attributes:
        path: where it was read from.
        content: the JSON chunk.
        binary: the BIN chunk.
    """

    path: Path
    content: dict[str, Any]
    binary: bytes

    def items(self, name: str) -> list[dict[str, Any]]:
        """The list ``nodes``, ``meshes``, ``skins`` ...; empty where there is none."""
        found: list[dict[str, Any]] = self.content.get(name, [])
        return found

    def integers(self, index: int) -> NDArray[np.int64]:
        """The whole numbers of an accessor: (count,) or (count, width)."""
        return self._values(index).astype(np.int64)

    def numbers(self, index: int) -> FloatArray:
        """The numbers of an accessor, integers that are marked as normalised as shares of their largest."""
        values = self._values(index)
        if values.dtype.kind == "f" or not self.items("accessors")[index].get("normalized", False):
            return values.astype(np.float64)
        return np.maximum(values / np.iinfo(values.dtype).max, -1.0)

    def _values(self, index: int) -> NDArray[Any]:
        accessor = self.items("accessors")[index]
        if "sparse" in accessor:
            raise UsageError(
                "sparse accessors are not read", where=self.path, hint="export the file without them"
            )
        kind, width = np.dtype(_KINDS[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        view = self.items("bufferViews")[accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", kind.itemsize * width)
        values: NDArray[Any] = np.ndarray(
            (accessor["count"], width), kind, self.binary, start, (stride, kind.itemsize)
        )
        return values[:, 0] if accessor["type"] == "SCALAR" else values


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn what goes wrong when a glTF's parts do not fit each other into one line.

    Raises:
        UsageError: instead of the errors that wrong indices, types and sizes give.
    """
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        what = "glTF file is damaged: its parts do not fit each other"
        raise UsageError(what, where=path, found=f"{type(error).__name__} {error}") from error


def read_glb(path: Path) -> Gltf:
    """Read a GLB file.

    Raises:
        UsageError: no such file, another kind of file, a truncated one, or one that needs an extension.
    """
    try:
        data = read_input(path, limits.MESH_BYTES)
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error) from error
    _check_header(path, data)
    chunks = dict(_chunks(path, data))
    gltf = Gltf(path, _parsed(path, chunks.get(_JSON, b"")), chunks.get(_BIN, b""))
    with damage_named(path):
        _check_needs(gltf)
    return gltf


def _check_header(path: Path, data: bytes) -> None:
    expected = "a binary glTF 2.0 file (.glb)"
    if len(data) < 12 or data[:4] != _MAGIC:
        hint = "export it as one binary file" if data.lstrip()[:1] == b"{" else ""
        raise UsageError("not a GLB file", where=path, expected=expected, hint=hint)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise UsageError("glTF of another version", where=path, found=version, expected=expected)
    if length > len(data):
        found = f"{len(data)} of {length} bytes"
        raise UsageError("GLB file is truncated", where=path, found=found, hint="copy it again")


def _chunks(path: Path, data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """The chunks' kinds and bytes, the last of a kind first: only the first of each counts."""
    found, position = [], 12
    while position + 8 <= len(data):
        length, kind = struct.unpack_from("<I4s", data, position)
        chunk = data[position + 8 : position + 8 + length]
        if len(chunk) < length:
            where = kind.decode("ascii", "replace").rstrip("\0")
            raise UsageError(f"GLB file is truncated in its {where} part", where=path, hint="copy it again")
        found.append((kind, chunk))
        position += 8 + length
    yield from reversed(found)


def _parsed(path: Path, text: bytes) -> dict[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError("GLB file without readable JSON", where=path, found=error) from error
    if not isinstance(content, dict):
        raise UsageError("GLB file without a JSON object", where=path, found=type(content).__name__)
    return content


def _check_needs(gltf: Gltf) -> None:
    needed = [name for name in gltf.content.get("extensionsRequired", []) if name not in _HARMLESS]
    if needed:
        raise UsageError(
            "glTF file needs an extension that is not read",
            where=gltf.path,
            found=", ".join(needed),
            hint="export the file without compression",
        )
    if any("uri" in buffer for buffer in gltf.items("buffers")):
        what = "GLB file with its numbers in another file"
        raise UsageError(what, where=gltf.path, hint="export it as one binary file")
