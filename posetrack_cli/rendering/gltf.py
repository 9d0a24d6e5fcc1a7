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
from typing import Any, NamedTuple

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
        if not isinstance(found, list):
            raise TypeError(f"'{name}' is no list")
        return found

    def item(self, name: str, index: Any) -> dict[str, Any]:
        """One of ``items``; an index that is no whole number from 0 on, or too large, is damage."""
        items = self.items(name)
        return items[whole(index, name, len(items) - 1)]

    def count(self, index: Any) -> int:
        """How many elements an accessor has; it is known that the file holds them."""
        return self._placed(self.item("accessors", index)).elements

    def integers(self, index: Any) -> NDArray[np.int64]:
        """The whole numbers of an accessor: (count,) or (count, width)."""
        return self._values(index).astype(np.int64)

    def numbers(self, index: Any) -> FloatArray:
        """The numbers of an accessor, integers that are marked as normalised as shares of their largest."""
        values = self._values(index)
        if values.dtype.kind == "f" or not self.item("accessors", index).get("normalized", False):
            return values.astype(np.float64)
        return np.maximum(values / np.iinfo(values.dtype).max, -1.0)

    def _values(self, index: Any) -> NDArray[Any]:
        accessor = self.item("accessors", index)
        placed = self._placed(accessor)
        values: NDArray[Any] = np.ndarray(
            (placed.elements, placed.width),
            placed.kind,
            self.binary,
            placed.start,
            (placed.stride, placed.kind.itemsize),
        )
        return values[:, 0] if accessor["type"] == "SCALAR" else values

    def _placed(self, accessor: dict[str, Any]) -> _Placed:
        """Where an accessor's elements lie: one behind the other, within their view of the BIN chunk."""
        if "sparse" in accessor:
            raise UsageError(
                "sparse accessors are not read", where=self.path, hint="export the file without them"
            )
        kind, width = np.dtype(_KINDS[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        size = kind.itemsize * width
        view, most = self.item("bufferViews", accessor["bufferView"]), len(self.binary)
        first = whole(view.get("byteOffset", 0), "byteOffset", most)
        length = whole(view["byteLength"], "byteLength", most - first)
        offset = whole(accessor.get("byteOffset", 0), "byteOffset", length)
        stride = whole(view.get("byteStride", size), "byteStride", most)
        count = whole(accessor["count"], "count", most)
        if stride < size:
            raise ValueError(f"byteStride {stride} of elements of {size} bytes")
        if count and offset + (count - 1) * stride + size > length:
            raise ValueError(f"{count} elements in a view of {length} bytes")
        return _Placed(kind, width, first + offset, stride, count)


class _Placed(NamedTuple):
    """Where an accessor's elements lie in the BIN chunk, bytes."""

    kind: np.dtype[Any]
    width: int
    start: int
    stride: int
    elements: int


def whole(value: Any, name: str, most: int) -> int:
    """Return a whole number from 0 to ``most`` as a file states it.

    Raises:
        ValueError: it is something else.
    """
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"{name} {value if type(value) is int else type(value).__name__}")
    return value


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn what goes wrong when a glTF's parts do not fit each other into one line.

    Raises:
        UsageError: instead of the errors that wrong indices, types and sizes give, and of the warnings about
            numbers that no other number comes of.
    """
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        what = "glTF file is damaged: its parts do not fit each other"
        raise UsageError(what, where=path, found=f"{type(error).__name__} {error}") from error


def read_glb(path: Path) -> Gltf:
    """Read a GLB file.

    Raises:
        UsageError: no such file, another kind of file, a truncated one, or one that needs an extension.
    """
    try:
        container = _Container(path, read_input(path, limits.MESH_BYTES))
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error) from error
    container.check_header()
    chunks = dict(container.chunks())
    gltf = Gltf(path, container.parsed(chunks.get(_JSON, b"")), chunks.get(_BIN, b""))
    with damage_named(path):
        _check_needs(gltf)
    return gltf


class _Container(NamedTuple):
    """The bytes of a GLB file."""

    path: Path
    data: bytes

    def check_header(self) -> None:
        path, data, expected = self.path, self.data, "a binary glTF 2.0 file (.glb)"
        if len(data) < 12 or data[:4] != _MAGIC:
            hint = "export it as one binary file" if data.lstrip()[:1] == b"{" else ""
            raise UsageError("not a GLB file", where=path, expected=expected, hint=hint)
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise UsageError("glTF of another version", where=path, found=version, expected=expected)
        if length > len(data):
            found = f"{len(data)} of {length} bytes"
            raise UsageError("GLB file is truncated", where=path, found=found, hint="copy it again")

    def chunks(self) -> Iterator[tuple[bytes, bytes]]:
        """The chunks' kinds and bytes, the last of a kind first: only the first of each counts."""
        found, position, data = [], 12, self.data
        while position + 8 <= len(data):
            length, kind = struct.unpack_from("<I4s", data, position)
            chunk = data[position + 8 : position + 8 + length]
            if len(chunk) < length:
                what = f"GLB file is truncated in its {kind.decode('ascii', 'replace').rstrip(chr(0))} part"
                raise UsageError(what, where=self.path, hint="copy it again")
            found.append((kind, chunk))
            position += 8 + length
        yield from reversed(found)

    def parsed(self, text: bytes) -> dict[str, Any]:
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise UsageError("GLB file without readable JSON", where=self.path, found=error) from error
        if not isinstance(content, dict):
            found = type(content).__name__
            raise UsageError("GLB file without a JSON object", where=self.path, found=found)
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
