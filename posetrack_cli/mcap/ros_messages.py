"""Read ROS 1 and ROS 2 messages, decoded by the layouts that ROS publishes.

Definitions in a file are untrusted, so they are only compared with the published ones. Layouts end with the
last field that is read; further fields are ignored.

Both serialise fields in order: ROS 1 little-endian and packed (ROS wiki, "msg", section 2.1), ROS 2 as
plain CDR (OMG Common Data Representation, XCDR version 1), with numbers aligned to their size, counted from
the end of a four-byte header.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal

from posetrack_cli import limits

Dialect = Literal["ros1", "cdr"]  # MCAP's message encodings of ROS 1 and ROS 2

_GEOMETRY = {
    "TransformStamped": "Header header\nstring child_frame_id\nTransform transform",
    "Transform": "Vector3 translation\nQuaternion rotation",
    "Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "TFMessage": "TransformStamped[] transforms",
    "tfMessage": "TransformStamped[] transforms",
}
_IMAGES = {
    "Image": "Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data",
    "CompressedImage": "Header header\nstring format\nuint8[] data",
}
_VALUES = {"Float32": "float32 data", "String": "string data"}
_CAMERA_INFO = "Header header\nuint32 height\nuint32 width\nstring distortion_model\n"
_PART_OF_SENSOR = "\nuint32 binning_x\nuint32 binning_y\nRegionOfInterest roi"
_REGION = "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify"
# In ROS notation, without packages: no two types that are read have the same name.
DEFINITIONS: Mapping[Dialect, Mapping[str, str]] = {
    "ros1": {
        "Header": "uint32 seq\ntime stamp\nstring frame_id",
        "DisparityImage": "Header header\nImage image\nfloat32 f\nfloat32 T",
        "CameraInfo": _CAMERA_INFO
        + "float64[] D\nfloat64[9] K\nfloat64[9] R\nfloat64[12] P"
        + _PART_OF_SENSOR,
        "RegionOfInterest": _REGION,
        **_IMAGES,
        **_GEOMETRY,
        **_VALUES,
    },
    "cdr": {
        "Header": "Time stamp\nstring frame_id",
        "Time": "int32 sec\nuint32 nanosec",
        "DisparityImage": "Header header\nImage image\nfloat32 f\nfloat32 t",
        "CameraInfo": _CAMERA_INFO
        + "float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p"
        + _PART_OF_SENSOR,
        "RegionOfInterest": _REGION,
        "CompressedVideo": "Time timestamp\nstring frame_id\nuint8[] data\nstring format",
        **_IMAGES,
        **_GEOMETRY,
        **_VALUES,
    },
}

# Layouts that may have further fields; others are nested and must end where they end here.
_OPEN = ("Image", "CompressedImage", "CameraInfo", "DisparityImage")
# Number of trailing fields that may be missing: some writers end a CameraInfo with P.
_TAIL = {"CameraInfo": 3}
_NUMBERS = {"uint8": "B", "bool": "B", "uint32": "I", "int32": "i", "float32": "f", "float64": "d"}
_FIELD = re.compile(r"([A-Za-z][\w/]*)(\[(?:<=)?\d*\])?\s+([A-Za-z]\w*)\s*(=?)")
_RULE = re.compile(r"^=+$", re.MULTILINE)
_PART = re.compile(r"\s*MSG:\s*(\S+)[^\n]*\n?")


class OtherLayoutError(ValueError):
    """A file's definition of a message differs from the one that ROS publishes."""


@dataclass(frozen=True)
class Field:
    """One field of a message.

    Attributes:
        name: its name.
        kind: its type, without package.
        array: "" for a single value, "[]" for any number of them, "[9]" for a fixed number.
    """

    name: str
    kind: str
    array: str = ""


def parse_fields(text: str) -> tuple[Field, ...]:
    """Return the fields in a definition in ROS notation, without constants and comments.

    Raises:
        OtherLayoutError: a line is not a field.
    """
    fields = []
    for line in text.splitlines():
        line = line.partition("#")[0].strip()
        if not line:
            continue
        found = _FIELD.match(line)
        if found is None:
            raise OtherLayoutError("invalid line in its definition")
        kind, array, name, equals = found.groups()
        if not equals:
            bounded = array is None or "<" not in array
            fields.append(Field(name, kind.rpartition("/")[2], (array or "") if bounded else "[]"))
    return tuple(fields)


LAYOUTS = {
    dialect: {name: parse_fields(text) for name, text in definitions.items()}
    for dialect, definitions in DEFINITIONS.items()
}


def check_definition(dialect: Dialect, name: str, text: str) -> None:
    """Compare a file's definition of a message and its nested types with the published one.

    Raises:
        OtherLayoutError: they differ, or the definition is too long.
    """
    if len(text) > limits.DEFINITION_CHARACTERS:
        raise OtherLayoutError(f"its definition exceeds {limits.DEFINITION_CHARACTERS} characters")
    layouts = LAYOUTS[dialect]
    own, *parts = _RULE.split(text)
    _check_fields(name, parse_fields(own), layouts[name])
    for part in parts:
        head = _PART.match(part)
        kind = head.group(1).rpartition("/")[2] if head is not None else ""
        if head is not None and kind in layouts:
            _check_fields(kind, parse_fields(part[head.end() :]), layouts[kind])


def ros_decoder(dialect: Dialect, name: str) -> Callable[[bytes], Any]:
    """Return the decoder of a type, named without package, to objects with its fields.

    A stamp has ``sec`` and ``nanosec`` in both dialects.

    Raises:
        KeyError: the type is not supported.
    """
    LAYOUTS[dialect][name]  # fail early for an unknown type
    reader = _Ros1Reader if dialect == "ros1" else _CdrReader

    def decode(data: bytes) -> Any:
        return reader(data).message(name)

    return decode


def _check_fields(name: str, found: tuple[Field, ...], published: tuple[Field, ...]) -> None:
    if name in _OPEN:
        found = found[: len(published)]
        lacking = len(published) - len(found)
        published = published[: len(found)] if lacking == _TAIL.get(name) else published
    if found != published:
        raise OtherLayoutError(f"its definition of {name} differs from the one published by ROS")


class _Ros1Reader:
    """Reads values in sequence.

    Raises:
        ValueError, struct.error: in every method, if the message ends early.
    """

    dialect: Dialect = "ros1"

    def __init__(self, data: bytes) -> None:
        self._data, self._position, self._order = data, 0, "<"

    def message(self, name: str) -> Any:
        fields = LAYOUTS[self.dialect][name]
        first_of_tail = len(fields) - _TAIL.get(name, 0)
        values = {}
        for number, field in enumerate(fields):
            if number == first_of_tail and self._position >= len(self._data):
                break
            values[field.name] = self._field(field)
        return SimpleNamespace(**values)

    def _field(self, field: Field) -> Any:
        if not field.array:
            return self._value(field.kind)
        count = int(field.array[1:-1]) if field.array != "[]" else self._number("I")
        if field.kind == "uint8":
            return self._bytes(count)
        if field.kind in _NUMBERS:
            return self._numbers(_NUMBERS[field.kind], count)
        if count > limits.TRANSFORMS:
            raise ValueError(f"{count} {field.kind}")
        return [self._value(field.kind) for _ in range(count)]

    def _value(self, kind: str) -> Any:
        if kind in _NUMBERS:
            return self._number(_NUMBERS[kind])
        if kind == "string":
            return self._string()
        if kind == "time":
            return SimpleNamespace(sec=self._number("I"), nanosec=self._number("I"))
        return self.message(kind)

    def _number(self, code: str) -> Any:
        return self._numbers(code, 1)[0]

    def _numbers(self, code: str, count: int) -> tuple[Any, ...]:
        if not count:
            return ()
        size = struct.calcsize(code)
        self._align(size)
        self._check(size * count)
        values = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._position)
        self._position += size * count
        return values

    def _string(self) -> str:
        return self._bytes(self._number("I")).decode(errors="replace")

    def _bytes(self, count: int) -> bytes:
        self._check(count)
        begin = self._position
        self._position += count
        return self._data[begin : self._position]

    def _check(self, size: int) -> None:
        """Raise ValueError unless ``size`` bytes are left, before allocating for a stated count."""
        if self._position + size > len(self._data):
            raise ValueError(f"message of {len(self._data)} bytes ends early")

    def _align(self, size: int) -> None:
        """Do nothing: ROS 1 messages are packed."""


class _CdrReader(_Ros1Reader):
    """Reads aligned values and zero-terminated strings."""

    dialect: Dialect = "cdr"
    _HEAD = 4

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        if len(data) < self._HEAD or data[0] or data[1] > 1:
            raise ValueError("no plain CDR header")
        self._position, self._order = self._HEAD, "<" if data[1] else ">"

    def _string(self) -> str:
        return super()._string().rstrip("\0")

    def _align(self, size: int) -> None:
        self._position += -(self._position - self._HEAD) % size
