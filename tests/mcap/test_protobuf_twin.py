"""Protobuf twins of JSON messages: the same values for any reader, and nothing but plain schemas."""

from __future__ import annotations

import json
from typing import Any

import pytest
from google.protobuf.json_format import MessageToDict
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Channel, Message, Schema
from mcap_protobuf.decoder import DecoderFactory

from posetrack_cli.mcap.protobuf_twin import NoTwinError, ProtobufTwin, json_of, twin_of, twin_of_channel

NUMBER = {"type": "number"}
SCHEMA: dict[str, Any] = {
    "type": "object",
    "required": ["count", "listed", "points"],
    "properties": {
        "count": {"type": "integer"},
        "text": {"type": "string"},
        "flag": {"type": "boolean"},
        "value": NUMBER,
        "listed": {"type": "array", "items": NUMBER},
        "points": {
            "type": "array",
            "items": {"type": "object", "properties": {"x": NUMBER, "name": {"type": "string"}}},
        },
        "numbers": {"type": "object", "properties": {"sign_cost": NUMBER, "fits": NUMBER}},
    },
}
TWIN = ProtobufTwin("posetrack.Test", SCHEMA)

numbers = st.floats(allow_nan=False, allow_infinity=False)
optional = {
    "text": st.text(st.characters(exclude_categories=["Cs"])),
    "flag": st.booleans(),
    "value": numbers,
    "numbers": st.fixed_dictionaries({}, optional={"sign_cost": numbers, "fits": numbers}),
}
values = st.fixed_dictionaries(
    {
        "count": st.integers(-(2**63), 2**63 - 1),
        "listed": st.lists(numbers),
        "points": st.lists(st.fixed_dictionaries({"x": numbers}, optional={"name": st.just("thumb")})),
    },
    optional=optional,
)


def in_order(value: dict[str, Any]) -> bytes:
    """A message as it is written: fields in the order of the schema."""
    ordered = {name: value[name] for name in SCHEMA["properties"] if name in value}
    return json.dumps(ordered, separators=(",", ":")).encode()


@given(values)
def test_there_and_back_is_the_same_json(value: dict[str, Any]) -> None:
    assert json.loads(TWIN.decode(TWIN.encode(in_order(value)))) == value


@given(values)
def test_a_reader_that_knows_only_the_schema_reads_the_same_values(value: dict[str, Any]) -> None:
    schema = Schema(id=1, data=TWIN.definition, encoding="protobuf", name="posetrack.Test")
    decode = DecoderFactory().decoder_for("protobuf", schema)
    assert decode is not None
    message = decode(TWIN.encode(in_order(value)))
    found = MessageToDict(
        message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )
    assert found | {"count": int(found["count"])} == value  # JSON of protobuf has text for 64 bits


def test_missing_is_not_zero() -> None:
    empty = TWIN.decode(TWIN.encode(b'{"count":0,"value":0.0,"listed":[],"points":[]}'))
    assert empty == b'{"count":0,"value":0.0,"listed":[],"points":[]}'


@pytest.mark.parametrize(
    "schema",
    [
        {"properties": {"a b": NUMBER}},
        {"properties": {"1a": NUMBER}},
        {"properties": {"a": {"type": ["number", "null"]}}},
        {"properties": {"a": {"type": "array", "items": {"type": "array", "items": NUMBER}}}},
        {"properties": {"a": {}}},
        {"properties": {f"a{k}": NUMBER for k in range(10_001)}},
        {
            "properties": {
                "a_b": {"type": "object", "properties": {}},
                "aB": NUMBER,
                "a_B": {"type": "object", "properties": {}},
            }
        },
        {},
        [],
    ],
    ids=range(9),
)
def test_other_schemas_have_none(schema: Any) -> None:
    with pytest.raises(NoTwinError):
        twin_of("posetrack.Other", json.dumps(schema).encode())


def test_deep_schemas_and_names_have_none() -> None:
    deep: Any = NUMBER
    for _ in range(1000):
        deep = {"type": "object", "properties": {"a": deep}}
    with pytest.raises(NoTwinError):
        ProtobufTwin("a.B", deep)
    for name in ("", ".", "a b.C", "a..B", "a/../b.C", "a.é"):
        with pytest.raises(NoTwinError):
            ProtobufTwin(name, SCHEMA)
    for text in (b"", b"[" * 5000, b"nope", b"9" * 5000):
        with pytest.raises(NoTwinError):
            twin_of("a.B", text)


@pytest.mark.parametrize(
    "data",
    [
        *(b"", b"[]", b"nope", b"[" * 5000, b" " * (2 << 20)),
        *(b'{"count":"x"}', b'{"count":"1"}', b'{"count":1e300}', b'{"count":%d}' % 2**63, b'{"no":1}'),
        *(b'{"listed":[[1]]}', b'{"listed":[null]}', b'{"points":[1]}', b'{"value":"NaN"}', b'{"value":NaN}'),
    ],
    ids=range(15),
)
def test_messages_that_do_not_fit_have_none(data: bytes) -> None:
    with pytest.raises(NoTwinError):
        TWIN.encode(data)


def item(data: bytes, encoding: str = "protobuf", definition: bytes = TWIN.definition) -> Any:
    schema = Schema(id=1, data=definition, encoding=encoding, name="posetrack.Test")
    channel = Channel(id=1, topic="/t", message_encoding=encoding, metadata={}, schema_id=1)
    return schema, channel, Message(channel_id=1, log_time=0, data=data, publish_time=0, sequence=0)


def test_only_the_known_layout_is_read() -> None:
    data = TWIN.encode(b'{"count":1,"listed":[],"points":[]}')
    assert json_of(item(data), lambda: [TWIN]) == b'{"count":1,"listed":[],"points":[]}'
    assert json_of(item(b"as it is", "json"), lambda: pytest.fail()) == b"as it is"
    with pytest.raises(NoTwinError, match="another version"):
        json_of(item(data, definition=TWIN.definition + b"\0"), lambda: [TWIN])
    with pytest.raises(NoTwinError, match=r"not a posetrack\.Test"):
        json_of(item(b"\xff\xff"), lambda: [TWIN])
    with pytest.raises(NoTwinError, match="not JSON with a schema"):
        twin_of_channel(*item(data)[:2])
