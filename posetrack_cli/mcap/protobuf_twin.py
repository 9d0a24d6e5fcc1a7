"""Protobuf counterparts of JSON messages: the same fields and values, described by a FileDescriptorSet."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any

from mcap.records import Channel, Schema

from posetrack_cli import limits
from posetrack_cli.mcap.stream import McapItem

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,127}")


class NoTwinError(ValueError):
    """A JSON schema or message that has no protobuf counterpart."""


class ProtobufTwin:
    """Protobuf messages with the fields of a JSON schema.

    Fields are numbered in the order of the schema's properties. Numbers are doubles, integers int64, all
    optional, so that missing values stay missing.

    Args:
        name: name of the schema, ``PACKAGE.NAME``.
        schema: JSON schema of objects, arrays, numbers, integers, booleans and text.

    Attributes:
        name: name of the message type, as of the schema.
        definition: serialised FileDescriptorSet, for the schema of a channel.

    Raises:
        NoTwinError: the schema has other types, or names that are not identifiers.
    """

    def __init__(self, name: str, schema: Mapping[str, Any]) -> None:
        # Not at the top: reading a result needs no protobuf, which is slow to load.
        from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
        from google.protobuf.descriptor_pool import DescriptorPool
        from google.protobuf.message_factory import GetMessageClass

        package, _, own = name.rpartition(".")
        if not all(NAME.fullmatch(part) for part in name.split(".")):
            raise NoTwinError(f"schema {name!r} is not named like a message")
        file = FileDescriptorProto(name=f"{name.replace('.', '/')}.proto", package=package, syntax="proto3")
        _describe(file.message_type.add(name=own), schema, f".{name}", [limits.COLUMNS])
        try:
            pool = DescriptorPool()
            pool.Add(file)
            self._class = GetMessageClass(pool.FindMessageTypeByName(name))
        except (TypeError, ValueError, KeyError) as error:
            raise NoTwinError(f"schema {name} has clashing names") from error
        self._json_schema = schema
        self.name = name
        self.definition = bytes(FileDescriptorSet(file=[file]).SerializeToString(deterministic=True))

    def encode(self, data: bytes) -> bytes:
        """Return a JSON message as protobuf.

        Raises:
            NoTwinError: it does not fit the schema.
        """
        from google.protobuf.json_format import ParseDict, ParseError

        try:
            if len(data) > limits.MESSAGE_BYTES:
                raise ValueError(f"{len(data)} bytes")
            values = json.loads(data)
            encoded = bytes(ParseDict(values, self._class()).SerializeToString(deterministic=True))
            stated = {name: value for name, value in values.items() if value is not None}
            if json.loads(self.decode(encoded)) != stated:  # such as text that reads like a number
                raise ValueError("values of other types")
        except (ValueError, TypeError, AttributeError, RecursionError, ParseError) as error:
            raise NoTwinError(f"message is not a {self.name}") from error
        return encoded

    def decode(self, data: bytes) -> bytes:
        """Return a protobuf message as JSON, fields in the order of the schema.

        Raises:
            NoTwinError: it is damaged.
        """
        from google.protobuf.message import DecodeError

        try:
            message = self._class.FromString(data)
        except DecodeError as error:
            raise NoTwinError(f"message is not a {self.name}") from error
        return json.dumps(_plain(message, self._json_schema), separators=(",", ":")).encode()


@lru_cache(maxsize=16)
def twin_of(name: str, schema: bytes) -> ProtobufTwin:
    """Return the twin of a schema, given as JSON text.

    Raises:
        NoTwinError: see ``ProtobufTwin``.
    """
    try:
        if len(schema) > limits.DEFINITION_CHARACTERS:
            raise ValueError(f"{len(schema)} bytes")
        return ProtobufTwin(name, json.loads(schema))
    except NoTwinError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise NoTwinError(f"schema {name} is not supported") from error


def twin_of_channel(schema: Schema | None, channel: Channel) -> ProtobufTwin:
    """Return the twin of a channel of JSON messages.

    Raises:
        NoTwinError: it has other messages or no schema, or see ``ProtobufTwin``.
    """
    if schema is None or (channel.message_encoding, schema.encoding) != ("json", "jsonschema"):
        raise NoTwinError("it is not JSON with a schema")
    return twin_of(schema.name, schema.data)


def json_of(item: McapItem, twins: Callable[[], Iterable[ProtobufTwin]]) -> bytes:
    """Return a message as JSON if it is a twin; any other message unchanged.

    No class is built from the schema of the file, which only selects one of the twins.

    Args:
        item: the message.
        twins: returns the possible twins; called for protobuf messages only.

    Raises:
        NoTwinError: the file has another layout, or the message is damaged.
    """
    schema, channel, message = item
    if schema is None or channel.message_encoding != "protobuf":
        return message.data
    for twin in twins():
        if twin.definition == schema.data:
            return twin.decode(message.data)
    raise NoTwinError("protobuf layout of another version: export the result again")


def _describe(message: Any, schema: Mapping[str, Any], path: str, left: list[int], depth: int = 1) -> None:
    """Add the fields of an object to a DescriptorProto; ``left`` is the number of fields allowed."""
    from google.protobuf.descriptor_pb2 import FieldDescriptorProto

    scalars = {
        "integer": FieldDescriptorProto.TYPE_INT64,
        "number": FieldDescriptorProto.TYPE_DOUBLE,
        "string": FieldDescriptorProto.TYPE_STRING,
        "boolean": FieldDescriptorProto.TYPE_BOOL,
    }
    left[0] -= len(schema["properties"])
    if depth > limits.KEY_PARTS or left[0] < 0:
        raise NoTwinError("schema is too large")
    for number, (name, stated) in enumerate(schema["properties"].items(), 1):
        is_list = stated["type"] == "array"
        kind = stated["items"] if is_list else stated
        if not NAME.fullmatch(name) or kind["type"] not in {"object", *scalars}:
            raise NoTwinError(f"field {name!r} has no counterpart")
        field = message.field.add(name=name, number=number, json_name=name)
        field.label = FieldDescriptorProto.LABEL_REPEATED if is_list else FieldDescriptorProto.LABEL_OPTIONAL
        if kind["type"] == "object":
            nested = "".join(part.capitalize() for part in name.split("_"))
            field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f"{path}.{nested}"
            _describe(message.nested_type.add(name=nested), kind, f"{path}.{nested}", left, depth + 1)
            continue
        field.type = scalars[kind["type"]]
        if not is_list:
            field.proto3_optional, field.oneof_index = True, len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{name}")


def _plain(message: Any, schema: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name, stated in schema["properties"].items():
        value = getattr(message, name)
        if stated["type"] == "array":
            items = stated["items"]
            listed = [_plain(one, items) for one in value] if items["type"] == "object" else list(value)
            if listed or name in schema.get("required", ()):
                values[name] = listed
        elif message.HasField(name):
            values[name] = _plain(value, stated) if stated["type"] == "object" else value
    return values
