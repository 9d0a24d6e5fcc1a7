"""Reading of skinned meshes from glTF files."""

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
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_input
from posetrack_cli.geometry import rotations

# Binary glTF 2.0 (GLB): container and accessors.
#
# Khronos Group, glTF 2.0 specification, sections 3.6 (accessors) and 4 (GLB). Supported are one JSON and one
# BIN chunk, but not sparse accessors, compression or external buffers.

_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_HARMLESS = {"KHR_mesh_quantization", "KHR_texture_transform", "KHR_materials_unlit", "EXT_texture_webp"}
_KINDS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


@dataclass(frozen=True)
class Gltf:
    """GLB file.

    Attributes:
        path: path of the file.
        content: JSON chunk.
        binary: BIN chunk.
    """

    path: Path
    content: dict[str, Any]
    binary: bytes

    def items(self, name: str) -> list[dict[str, Any]]:
        """Return the list ``nodes``, ``meshes``, ``skins`` ...; empty if missing."""
        found: list[dict[str, Any]] = self.content.get(name, [])
        if not isinstance(found, list):
            raise TypeError(f"'{name}' is not a list")
        return found

    def item(self, name: str, index: Any) -> dict[str, Any]:
        """Return one of ``items``; an invalid index is reported as damage."""
        items = self.items(name)
        return items[whole(index, name, len(items) - 1)]

    def count(self, index: Any) -> int:
        """Return the number of elements of an accessor, after checking that the file contains them."""
        return self._placed(self.item("accessors", index)).elements

    def integers(self, index: Any) -> NDArray[np.int64]:
        """Return the integers of an accessor, (count,) or (count, width)."""
        return self._values(index).astype(np.int64)

    def numbers(self, index: Any) -> FloatArray:
        """Return the numbers of an accessor; normalised integers are scaled to their maximum."""
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
        """Return the location of an accessor's elements, checked against its view of the BIN chunk."""
        if "sparse" in accessor:
            raise UsageError(
                "sparse accessors are not supported", where=self.path, hint="export the file without them"
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
            raise ValueError(f"byteStride {stride} for elements of {size} bytes")
        if count and offset + (count - 1) * stride + size > length:
            raise ValueError(f"{count} elements in a view of {length} bytes")
        return _Placed(kind, width, first + offset, stride, count)


class _Placed(NamedTuple):
    """Location of an accessor's elements in the BIN chunk, bytes."""

    kind: np.dtype[Any]
    width: int
    start: int
    stride: int
    elements: int


def whole(value: Any, name: str, most: int) -> int:
    """Return an integer from 0 to ``most``.

    Raises:
        ValueError: the value is anything else.
    """
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"invalid {name} {value if type(value) is int else type(value).__name__}")
    return value


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Convert errors from inconsistent parts of a glTF file into a one-line error.

    Raises:
        UsageError: in place of errors by invalid indices, types and sizes, and of floating point warnings.
    """
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        what = "glTF file is damaged: its parts are inconsistent"
        raise UsageError(what, where=path, found=f"{type(error).__name__} {error}") from error


def read_glb(path: Path) -> Gltf:
    """Read a GLB file.

    Raises:
        UsageError: the file is missing, truncated, of another format, or requires an extension.
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
    """Bytes of a GLB file."""

    path: Path
    data: bytes

    def check_header(self) -> None:
        path, data, expected = self.path, self.data, "a binary glTF 2.0 file (.glb)"
        if len(data) < 12 or data[:4] != _MAGIC:
            hint = "export it as one binary file" if data.lstrip()[:1] == b"{" else ""
            raise UsageError("not a GLB file", where=path, expected=expected, hint=hint)
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise UsageError("unsupported glTF version", where=path, found=version, expected=expected)
        if length > len(data):
            found = f"{len(data)} of {length} bytes"
            raise UsageError("GLB file is truncated", where=path, found=found, hint="copy it again")

    def chunks(self) -> Iterator[tuple[bytes, bytes]]:
        """Yield kinds and bytes of the chunks, last first, so that the first of each kind wins in a dict."""
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
            raise UsageError("GLB file has no valid JSON", where=self.path, found=error) from error
        if not isinstance(content, dict):
            found = type(content).__name__
            raise UsageError("GLB file has no JSON object", where=self.path, found=found)
        return content


def _check_needs(gltf: Gltf) -> None:
    needed = [name for name in gltf.content.get("extensionsRequired", []) if name not in _HARMLESS]
    if needed:
        raise UsageError(
            "glTF file requires an unsupported extension",
            where=gltf.path,
            found=", ".join(needed),
            hint="export the file without compression",
        )
    if any("uri" in buffer for buffer in gltf.items("buffers")):
        what = "GLB file with external buffers"
        raise UsageError(what, where=gltf.path, hint="export it as one binary file")


# Skinned mesh of a glTF file in its rest pose

_TRIANGLES = 4
_MOST_WEIGHT = 1e3
"""Maximum weight of one joint; weights sum to about 1."""
_LEAST_LENGTH = 1e-9
"""Minimum norm of a rotation, and minimum sum of a point's weights; both are about 1."""


@dataclass(frozen=True)
class GltfSkin:
    """Skin with all meshes bound to it, in scene axes and units.

    Attributes:
        joint_names: (J) names of the joints' nodes.
        joint_parents: (J) nearest joint above each joint, -1 for none.
        joint_positions: (J, 3).
        vertices: (V, 3) as skinned by the nodes' transforms.
        weights: (V, J), rows sum to 1.
        triangles: (T, 3).
    """

    joint_names: tuple[str, ...]
    joint_parents: tuple[int, ...]
    joint_positions: FloatArray
    vertices: FloatArray
    weights: FloatArray
    triangles: IntArray


def read_skin(gltf: Gltf) -> GltfSkin:
    """Return the first skin with triangles bound to it.

    A vertex is placed at sum_j w_j G_j B_j v with G_j the joint's transform in the scene and B_j its
    inverse bind matrix; the mesh's own node is ignored (glTF 2.0, section 3.7.3.1).

    Raises:
        UsageError: there is no skin, or parts of the file are inconsistent.
    """
    with damage_named(gltf.path):
        nodes, skins = gltf.items("nodes"), gltf.items("skins")
        _check_count(gltf, "nodes", len(nodes), limits.MESH_NODES)
        bound = [node for node in nodes if "mesh" in node and "skin" in node]
        if not skins or not bound:
            raise UsageError(
                "no skinned mesh in the glTF file", where=gltf.path, expected="a mesh bound to joints"
            )
        chosen = bound[0]["skin"]
        meshes = [gltf.item("meshes", node["mesh"]) for node in bound if node["skin"] == chosen]
        primitives = [primitive for mesh in meshes for primitive in mesh["primitives"]]
        return _assembled(gltf, gltf.item("skins", chosen), primitives)


def _assembled(gltf: Gltf, skin: dict[str, Any], primitives: list[dict[str, Any]]) -> GltfSkin:
    joints = _joints(gltf, skin)
    _check_sizes(gltf, primitives, len(joints))
    parents = _parents(gltf)
    scene = _scene_transforms(gltf, parents, joints)
    parts = [_primitive(gltf, primitive, len(joints)) for primitive in primitives]
    starts = np.cumsum([0, *(len(points) for points, _, _ in parts[:-1])])
    bind = np.tile(np.eye(4), (len(joints), 1, 1))
    if "inverseBindMatrices" in skin:  # stored column by column
        bind = gltf.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4)[: len(joints)].swapaxes(1, 2)
    _check_reach(gltf, bind, scene)
    vertices = np.concatenate([points for points, _, _ in parts])
    weights = np.concatenate([shares for _, shares, _ in parts])
    homogeneous = np.hstack([vertices, np.ones((len(vertices), 1))])
    shown = np.einsum("vj,jik,vk->vi", weights, (scene @ bind)[:, :3], homogeneous, optimize=True)
    _check_reach(gltf, shown)
    return GltfSkin(
        tuple(str(gltf.items("nodes")[node].get("name", f"node {node}")) for node in joints),
        _joints_above(joints, parents),
        scene[:, :3, 3],
        shown,
        weights,
        np.concatenate([faces + start for (_, _, faces), start in zip(parts, starts, strict=True)]),
    )


def _joints(gltf: Gltf, skin: dict[str, Any]) -> list[int]:
    """Return the nodes of a skin's joints, which must be distinct."""
    nodes = len(gltf.items("nodes"))
    joints = [whole(joint, "joint", nodes - 1) for joint in skin["joints"]]
    _check_count(gltf, "joints", len(joints), limits.MESH_JOINTS)
    if len(set(joints)) < len(joints):
        raise ValueError("duplicate joint")
    return joints


def _check_sizes(gltf: Gltf, primitives: list[dict[str, Any]], joints: int) -> None:
    """Check the size of a mesh before reading its data."""
    points = [gltf.count(primitive["attributes"]["POSITION"]) for primitive in primitives]
    corners = [
        gltf.count(primitive["indices"]) if "indices" in primitive else count
        for primitive, count in zip(primitives, points, strict=True)
    ]
    _check_count(gltf, "points", sum(points), limits.MESH_POINTS)
    _check_count(gltf, "triangles", sum(corners) // 3, limits.MESH_TRIANGLES)
    _check_count(gltf, "weights", sum(points) * joints, limits.MESH_WEIGHTS)


def _check_count(gltf: Gltf, what: str, count: int, most: int) -> None:
    if count > most:
        raise UsageError(
            f"glTF file has too many {what}", where=gltf.path, found=count, expected=f"at most {most}"
        )


def _check_reach(gltf: Gltf, *numbers: FloatArray) -> None:
    """Check that coordinates are finite and of plausible size."""
    if not all(np.all(np.abs(values) <= limits.MESH_REACH) for values in numbers):
        what = "glTF mesh has invalid or too large coordinates"
        raise UsageError(what, where=gltf.path, expected=f"at most {limits.MESH_REACH:g}")


def _parents(gltf: Gltf) -> list[int]:
    nodes = gltf.items("nodes")
    parents = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.get("children", []):
            if parents[whole(child, "child", len(nodes) - 1)] >= 0:
                raise ValueError(f"node {child} has two parents")
            parents[child] = index
    return parents


def _joints_above(joints: list[int], parents: list[int]) -> tuple[int, ...]:
    """Return the nearest joint above each joint (J), -1 for none."""
    places = {node: place for place, node in enumerate(joints)}
    above: dict[int, int] = {-1: -1}  # by node: itself if it is a joint, else the nearest above it
    for joint in joints:
        way = [joint]
        while parents[way[-1]] not in above:
            way.append(parents[way[-1]])
        nearest = above[parents[way[-1]]]
        for node in reversed(way):
            nearest = above[node] = places.get(node, nearest)
    return tuple(above[parents[joint]] for joint in joints)


def _scene_transforms(gltf: Gltf, parents: list[int], joints: list[int]) -> FloatArray:
    """Return scene_T_node (J, 4, 4) of the joints' nodes."""
    nodes, found = gltf.items("nodes"), {-1: np.eye(4)}
    for joint in joints:
        way, node = [], joint
        while node not in found:
            way.append(node)
            node = parents[node]
            if len(way) > len(parents):
                raise UsageError("nodes of the glTF file form a cycle", where=gltf.path)
        for below in reversed(way):
            found[below] = found[parents[below]] @ _local_transform(nodes[below])
    return np.array([found[joint] for joint in joints])


def _local_transform(node: dict[str, Any]) -> FloatArray:
    if "matrix" in node:
        return _numbers(node, "matrix", np.eye(4).ravel()).reshape(4, 4).T
    transform = np.eye(4)
    quaternion = _numbers(node, "rotation", np.array([0.0, 0.0, 0.0, 1.0]))
    length = float(np.linalg.norm(quaternion))
    if length < _LEAST_LENGTH:
        raise ValueError("rotation of length 0")
    rotation = rotations.matrices_from_quaternions((quaternion / length)[None])[0]
    transform[:3, :3] = rotation * _numbers(node, "scale", np.ones(3))
    transform[:3, 3] = _numbers(node, "translation", np.zeros(3))
    return transform


def _numbers(node: dict[str, Any], name: str, default: FloatArray) -> FloatArray:
    """Return the numbers of a node's property, with the shape of its default."""
    values = np.array(node.get(name, default), dtype=np.float64)
    if values.shape != default.shape or not np.all(np.abs(values) <= limits.MESH_REACH):
        raise ValueError(f"invalid {name}")
    return values


def _primitive(gltf: Gltf, primitive: dict[str, Any], joints: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return points (V, 3), weights (V, J) and triangles (T, 3) of one part of a mesh."""
    if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
        raise UsageError("glTF mesh is not made of triangles", where=gltf.path, hint="export it as triangles")
    attributes = primitive["attributes"]
    points = gltf.numbers(attributes["POSITION"])
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points of shape {points.shape}")
    _check_reach(gltf, points)
    weights = np.zeros((len(points), joints))
    rows, count = np.arange(len(points))[:, None], 0
    while f"JOINTS_{count}" in attributes:
        bones = gltf.integers(attributes[f"JOINTS_{count}"])
        shares = gltf.numbers(attributes[f"WEIGHTS_{count}"])
        if not bones.shape == shares.shape == (len(points), 4):
            raise ValueError(f"joints of shape {bones.shape} and weights of {shares.shape}")
        if not np.all((np.abs(shares) <= _MOST_WEIGHT) & (bones >= 0)):
            raise ValueError("invalid weights")
        np.add.at(weights, (rows, bones), shares)
        count += 1
    total = weights.sum(axis=1, keepdims=True)
    if not (total > _LEAST_LENGTH).all():
        found = f"{np.count_nonzero(~(total > _LEAST_LENGTH))} of {len(points)} points without a weight"
        raise UsageError("glTF mesh is not completely bound to its joints", where=gltf.path, found=found)
    if "indices" in primitive:
        corners = gltf.integers(primitive["indices"])
        if corners.ndim != 1:
            raise ValueError(f"indices of shape {corners.shape}")
        faces = corners.reshape(-1, 3)
    else:
        faces = np.arange(len(points)).reshape(-1, 3)
    if faces.size and not 0 <= faces.min() <= faces.max() < len(points):
        raise UsageError("glTF mesh has invalid triangle indices", where=gltf.path)
    return points, weights / total, faces
