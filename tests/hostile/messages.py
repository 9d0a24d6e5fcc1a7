"""ROS 1, ROS 2 and protobuf messages whose text, fields and bytes are as told, right or not."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Any

from hypothesis import strategies as st

from hostile.mcap_bytes import CHANNEL, MESSAGE, SCHEMA, Record
from hostile.values import changed_bytes, changed_text, composite, integers, numbers, one_of, texts, utf8

RULE = "=" * 80
TIME_1, TIME_2 = "time", "builtin_interfaces/Time"


@dataclass(frozen=True)
class Field:
    """A field of a message: type as ROS writes it, name, and value; of a nested message its fields."""

    kind: str
    name: str
    value: Any


Layout = tuple[Field, ...]

_STRUCTS = {
    "bool": "?",
    "uint8": "B",
    "int8": "b",
    "byte": "B",
    "char": "B",
    "uint16": "H",
    "int16": "h",
    "uint32": "I",
    "int32": "i",
    "uint64": "Q",
    "int64": "q",
    "float32": "f",
    "float64": "d",
}


def header(ros: int, stamp_ns: int, frame_id: str) -> Field:
    sec, nanosec = divmod(stamp_ns, 10**9)
    if ros == 1:
        fields = (
            Field("uint32", "seq", 0),
            Field("time", "stamp", (sec, nanosec)),
            Field("string", "frame_id", frame_id),
        )
    else:
        time = (Field("int32", "sec", sec), Field("uint32", "nanosec", nanosec))
        fields = (Field(TIME_2, "stamp", time), Field("string", "frame_id", frame_id))
    return Field("std_msgs/Header", "header", fields)


def image(ros: int, stamp_ns: int, pixels: Any, encoding: str) -> Layout:
    height, width = pixels.shape[:2]
    data = pixels.tobytes()
    return (
        header(ros, stamp_ns, "cam"),
        Field("uint32", "height", height),
        Field("uint32", "width", width),
        Field("string", "encoding", encoding),
        Field("uint8", "is_bigendian", 0),
        Field("uint32", "step", len(data) // height),
        Field("uint8[]", "data", data),
    )


def disparity_image(ros: int, stamp_ns: int, pixels: Any) -> Layout:
    return (
        header(ros, stamp_ns, "cam"),
        Field("sensor_msgs/Image", "image", image(ros, stamp_ns, pixels, "32FC1")),
        Field("float32", "f", 45.0),
        Field("float32", "T" if ros == 1 else "t", 0.075),
        Field("float32", "min_disparity", 0.0),
    )


def compressed_image(ros: int, stamp_ns: int, data: bytes, kind: str) -> Layout:
    return header(ros, stamp_ns, "cam"), Field("string", "format", kind), Field("uint8[]", "data", data)


def camera_info(ros: int, stamp_ns: int, width: int, height: int) -> Layout:
    names = "DKRP" if ros == 1 else "dkrp"
    k = [45.0, 0.0, (width - 1) / 2, 0.0, 45.0, (height - 1) / 2, 0.0, 0.0, 1.0]
    return (
        header(ros, stamp_ns, "cam"),
        Field("uint32", "height", height),
        Field("uint32", "width", width),
        Field("string", "distortion_model", "plumb_bob"),
        Field("float64[]", names[0], [0.0] * 5),
        Field("float64[9]", names[1], k),
        Field("float64[9]", names[2], [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        Field("float64[12]", names[3], [45.0, 0.0, 0.0, 0.0] * 3),
        Field("uint32", "binning_x", 0),
        Field("uint32", "binning_y", 0),
    )


def transforms(ros: int, stamp_ns: int) -> Layout:
    vector = tuple(Field("float64", axis, 0.1) for axis in "xyz")
    turn = (*(Field("float64", axis, 0.0) for axis in "xyz"), Field("float64", "w", 1.0))
    transform = (
        Field("geometry_msgs/Vector3", "translation", vector),
        Field("geometry_msgs/Quaternion", "rotation", turn),
    )
    stamped = (
        header(ros, stamp_ns, "cam"),
        Field("string", "child_frame_id", "other"),
        Field("geometry_msgs/Transform", "transform", transform),
    )
    return (Field("geometry_msgs/TransformStamped[]", "transforms", [stamped]),)


def definition(layout: Layout) -> str:
    """Return the text that describes a layout, and the nested types below rules."""
    parts, nested = [_lines(layout)], {}
    _collect(layout, nested)
    parts += [f"MSG: {name}\n{_lines(fields)}" for name, fields in nested.items()]
    return f"{RULE}\n".join(parts)


def _lines(layout: Layout) -> str:
    return "".join(f"{field.kind} {field.name}\n" for field in layout)


def _collect(layout: Layout, found: dict[str, Layout]) -> None:
    for field in layout:
        inner = _nested(field)
        if inner is not None:
            found.setdefault(field.kind.removesuffix("[]"), inner)
            _collect(inner, found)


def _nested(field: Field) -> Layout | None:
    value = field.value
    if isinstance(value, list) and value and isinstance(value[0], tuple):
        value = value[0]
    return value if isinstance(value, tuple) and value and isinstance(value[0], Field) else None


def ros1_bytes(layout: Layout) -> bytes:
    return _Writer(align=False).layout(layout)


def cdr_bytes(layout: Layout) -> bytes:
    return b"\0\1\0\0" + _Writer(align=True).layout(layout)


class _Writer:
    """Little endian; with CDR's alignment, and its terminated texts, where asked for."""

    def __init__(self, *, align: bool) -> None:
        self._align, self._out = align, bytearray()

    def layout(self, layout: Layout) -> bytes:
        self._fields(layout)
        return bytes(self._out)

    def _fields(self, layout: Layout) -> None:
        for field in layout:
            base, bracket, count = field.kind.partition("[")
            if not bracket:
                self._one(base, field.value)
                continue
            values = field.value
            if count == "]":
                self._number("I", len(values))
            if isinstance(values, bytes):
                self._out += values
            else:
                for value in values:
                    self._one(base, value)

    def _one(self, kind: str, value: Any) -> None:
        if isinstance(value, tuple) and value and isinstance(value[0], Field):
            self._fields(value)
        elif kind in ("time", "duration"):
            for number in value if isinstance(value, tuple) else (value, 0):
                self._number("I", number)
        elif kind == "string" or isinstance(value, (str, bytes)):
            data = value if isinstance(value, bytes) else utf8(str(value))
            data += b"\0" * self._align
            self._number("I", len(data))
            self._out += data
        elif isinstance(value, (int, float)):
            self._number(_STRUCTS.get(kind, "I"), value)

    def _number(self, code: str, value: float) -> None:
        size = struct.calcsize(code)
        if self._align:
            self._out += bytes(-len(self._out) % min(size, 8))
        if code in "fd":
            try:
                self._out += struct.pack("<" + code, float(value))
            except OverflowError:
                self._out += struct.pack("<" + code, float("inf"))
        else:
            number = int(value) if value == value and abs(value) != float("inf") else 0
            self._out += (number % (1 << 8 * size)).to_bytes(size, "little")


# Changed ones


KINDS = (
    "uint8",
    "uint32",
    "string",
    "float64",
    "uint8[]",
    "float64[9]",
    "float64[]",
    "time",
    "Header",
    "std_msgs/Header",
)
CODE = (
    'string __import__("os").system("id>pwned");X=1',
    'uint8 a\nstring __import__("os").system("id>pwned");X=1',
    "uint8 A=__import__('os').system('id>pwned')",
    'string S="""+__import__("os").system("id>pwned")+"""',
    "string a\\nimport os",
    "uint8[99999999999] a",
    "uint8[-1] a",
    "uint32[<=4294967295] a",
    "x/y a",
    "sensor_msgs/Image self",
    "string<=5 a",
    "uint8 __class__",
    "uint8 \x1b[2J",
    "\n" * 2000,
    RULE + "\nMSG: a/b\na/b c\n",
    RULE,
    "MSG: x",
)


@composite
def changed_layout(draw: st.DrawFn, layout: Layout) -> Layout:
    """A layout with a field changed, gone, doubled, renamed or of another type; text and bytes go along."""
    fields = list(layout)
    for _ in range(draw(st.integers(1, 2))):
        if not fields:
            break
        k = draw(st.integers(0, len(fields) - 1))
        field = fields[k]
        how = draw(
            st.sampled_from(("value", "value", "value", "value", "drop", "double", "rename", "kind", "into"))
        )
        if how == "drop":
            del fields[k]
        elif how == "double":
            fields.insert(k, field)
        elif how == "rename":
            fields[k] = replace(
                field, name=draw(st.sampled_from(("a", "data", "__class__", "height", "header")))
            )
        elif how == "kind":
            kind = draw(st.sampled_from(KINDS))
            fields[k] = replace(field, kind=kind, value=draw(field_value(kind)))
        else:
            fields[k] = _changed_field(draw, field)
    return tuple(fields)


def _changed_field(draw: st.DrawFn, field: Field) -> Field:
    value = field.value
    if isinstance(value, tuple) and value and isinstance(value[0], Field):
        return replace(field, value=draw(changed_layout(value)))
    if isinstance(value, list) and value and isinstance(value[0], tuple):
        many = draw(st.sampled_from((0, 1, 1, 1, 2, 500)))
        return replace(field, value=[draw(changed_layout(value[0]))] * many)
    if isinstance(value, list) and value and draw(st.booleans()):
        k = draw(st.integers(0, len(value) - 1))
        return replace(field, value=[*value[:k], draw(numbers()), *value[k + 1 :]])
    if isinstance(value, bytes) and draw(st.booleans()):
        return replace(field, value=draw(changed_bytes(value)))
    return replace(field, value=draw(field_value(field.kind)))


ENCODINGS = (
    "mono8",
    "mono16",
    "16UC1",
    "32FC1",
    "8UC1",
    "rgb8",
    "bgra8",
    "bayer_rggb8",
    "64FC1",
    "16UC1; compressedDepth png",
    "32FC1; compressedDepth rvl",
    "jpeg",
    "png",
    "mono8; png compressed ",
)


def field_value(kind: str) -> st.SearchStrategy[Any]:
    if kind == "string":
        return st.one_of(texts(), st.sampled_from(ENCODINGS))
    if kind == "uint8[]":
        return st.one_of(st.binary(max_size=40), st.sampled_from((b"", bytes(10_000))))
    if "[" in kind:
        return st.lists(numbers(), max_size=14)
    if kind in ("time", "duration"):
        return st.tuples(integers(), integers())
    if kind.endswith("Header"):
        return st.just(header(1, 1, "x").value)
    return numbers() if kind.startswith("float") else integers()


@composite
def ros_records(draw: st.DrawFn, ros: int, topics: dict[str, tuple[str, list[Layout]]]) -> list[Record]:
    """Schemas, channels and messages of ROS layouts by topic and type, some of them changed."""
    records: list[Record] = []
    hit = draw(st.sampled_from(sorted(topics)))
    for number, (topic, (kind, layouts)) in enumerate(topics.items(), 1):
        own = list(layouts)
        how = (
            draw(st.sampled_from(("fields", "fields", "values", "values", "text", "code", "bytes")))
            if topic == hit
            else ""
        )
        text = utf8(definition(own[0]))
        if how == "fields":
            own = [draw(changed_layout(own[0]))] * len(own)
            text = utf8(definition(own[0]))
        elif how == "values":
            k = draw(st.integers(0, len(own) - 1))
            own[k] = draw(changed_layout(own[k]))
        elif how == "text":
            text = draw(changed_text(definition(own[0]), CODE))
        elif how == "code":
            text = draw(one_of((utf8(draw(st.sampled_from(CODE)) + "\n"), text)))
            text = utf8(draw(st.sampled_from(CODE)) + "\n") + text
        data = [ros1_bytes(layout) if ros == 1 else cdr_bytes(layout) for layout in own]
        if how == "bytes":
            k = draw(st.integers(0, len(data) - 1))
            data[k] = draw(changed_bytes(data[k]))
        names = {1: (f"{kind}", "ros1msg", "ros1"), 2: (kind.replace("/", "/msg/"), "ros2msg", "cdr")}[ros]
        name, schema, encoding = names
        if how == "text" and draw(st.integers(0, 3)) == 0:
            schema = draw(st.sampled_from(("ros1msg", "ros2msg", "ros2idl", "", "protobuf", "jsonschema")))
        records.append({"op": SCHEMA, "id": number, "name": name, "encoding": schema, "data": text})
        channel = {
            "op": CHANNEL,
            "id": number,
            "schema_id": number,
            "topic": topic,
            "message_encoding": encoding,
        }
        records.append({**channel, "metadata": {}})
        records += [
            {
                "op": MESSAGE,
                "channel_id": number,
                "sequence": k,
                "log_time": 10 + k,
                "publish_time": 10 + k,
                "data": d,
            }
            for k, d in enumerate(data)
        ]
    return records


# Protobuf


@composite
def changed_protobuf(draw: st.DrawFn, message: Any) -> bytes:
    """A protobuf message with fields at the edges, or its bytes changed."""
    copy = type(message)()
    copy.CopyFrom(message)
    for _ in range(draw(st.integers(1, 2))):
        if draw(st.integers(0, 4)) == 0:
            return draw(changed_bytes(copy.SerializeToString()))
        _change_message(draw, copy)
    return bytes(copy.SerializeToString())


def _change_message(draw: st.DrawFn, message: Any) -> None:
    field = draw(st.sampled_from(list(message.DESCRIPTOR.fields)))
    if field.message_type is not None:
        if _is_repeated(field):
            entries = getattr(message, field.name)
            if len(entries) and draw(st.booleans()):
                _change_message(draw, entries[draw(st.integers(0, len(entries) - 1))])
            else:
                for _ in range(draw(st.sampled_from((1, 3, 400)))):
                    entries.add()
        elif draw(st.integers(0, 4)) == 0:
            message.ClearField(field.name)
        else:
            getattr(message, field.name).SetInParent()
            _change_message(draw, getattr(message, field.name))
        return
    value = _protobuf_value(draw, field, getattr(message, field.name))
    try:
        if _is_repeated(field):
            del getattr(message, field.name)[:]
            getattr(message, field.name).extend(value)
        else:
            setattr(message, field.name, value)
    except (ValueError, TypeError, OverflowError):
        message.ClearField(field.name)


def _is_repeated(field: Any) -> bool:
    return bool(getattr(field, "is_repeated", False) if hasattr(field, "is_repeated") else field.label == 3)


def _protobuf_value(draw: st.DrawFn, field: Any, before: Any) -> Any:
    if _is_repeated(field):
        values = list(before)
        if values and draw(st.booleans()):
            values[draw(st.integers(0, len(values) - 1))] = draw(_scalar(field))
            return values
        return [draw(_scalar(field)) for _ in range(draw(st.sampled_from((0, 1, 2, 9, 13))))]
    if field.type == field.TYPE_BYTES and draw(st.booleans()):
        return draw(changed_bytes(before))
    return draw(_scalar(field))


def _scalar(field: Any) -> st.SearchStrategy[Any]:
    if field.type == field.TYPE_STRING:
        return st.one_of(texts(), st.sampled_from(ENCODINGS))
    if field.type == field.TYPE_BYTES:
        return st.one_of(st.binary(max_size=40), st.just(bytes(10_000)))
    if field.type in (field.TYPE_DOUBLE, field.TYPE_FLOAT):
        return numbers().map(_finite_float)
    bits = (
        64
        if field.type in (field.TYPE_INT64, field.TYPE_UINT64, field.TYPE_FIXED64, field.TYPE_SFIXED64)
        else 32
    )
    signed = field.type in (field.TYPE_INT32, field.TYPE_INT64, field.TYPE_SFIXED32, field.TYPE_SFIXED64)
    if field.type in (field.TYPE_BOOL, field.TYPE_ENUM):
        return st.integers(0, 1)
    return integers().map(
        lambda n: (n + (1 << bits - 1)) % (1 << bits) - (1 << bits - 1) if signed else n % (1 << bits)
    )


def _finite_float(number: Any) -> float:
    try:
        return float(number)
    except OverflowError:
        return 1e300


@composite
def changed_descriptor(draw: st.DrawFn, data: bytes) -> bytes:
    """A protobuf schema with fields of other names, numbers, types, or types that hold themselves."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files = FileDescriptorSet.FromString(data)
    for _ in range(draw(st.integers(1, 3))):
        found = [message for file in files.file for message in file.message_type if message.field]
        if found:
            change = draw(st.sampled_from((_change_field, _change_field, _change_type, _change_file)))
            change(draw, files, draw(st.sampled_from(found)))
    return bytes(files.SerializeToString())


def _change_field(draw: st.DrawFn, files: Any, message: Any) -> None:
    field = draw(st.sampled_from(list(message.field)))
    how = draw(st.sampled_from(("name", "number", "label", "drop")))
    if how == "name":
        field.name = draw(st.sampled_from(("data", "x", "__class__", "width", "")))
    elif how == "number":
        field.number = draw(st.sampled_from((0, 1, 2, 5, -1, 2**29, 2**31 - 1)))
    elif how == "label":
        field.label = draw(st.integers(1, 3))
    else:
        message.field.remove(field)


def _change_type(draw: st.DrawFn, files: Any, message: Any) -> None:
    field = draw(st.sampled_from(list(message.field)))
    if draw(st.booleans()):
        field.type = draw(st.integers(1, 18))
        field.ClearField("type_name")
    else:
        field.type = field.TYPE_MESSAGE
        own = f".{files.file[0].package}.{message.name}"
        field.type_name = draw(st.sampled_from((own, ".foxglove.RawImage", ".x.Y", "")))


def _change_file(draw: st.DrawFn, files: Any, message: Any) -> None:
    how = draw(st.sampled_from(("name", "message", "depends")))
    if how == "name":
        names = ("", "../../pwned", "google/protobuf/timestamp.proto", "\x1b[2J")
        files.file[0].name = draw(st.sampled_from(names))
    elif how == "message":
        message.name = draw(st.sampled_from(("", "X", "RawImage")))
    else:
        files.file[-1].dependency.append(draw(st.sampled_from(("nowhere.proto", files.file[-1].name))))
