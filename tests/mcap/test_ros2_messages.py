"""What is written as ROS 2, read by a library that knows nothing of it but the definitions beside it."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from mcap_ros2._dynamic import generate_dynamic

from posetrack_cli.mcap.ros2_messages import _LAYOUTS, DEFINITIONS, ros2_encoder, ros2_schema
from posetrack_cli.mcap.ros_messages import LAYOUTS, check_definition, parse_fields, ros_decoder

WIDTHS = {"bool": 1, "uint8": 8, "int32": 31, "uint32": 32}


def made_up(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """Values of all fields of a type."""
    return {field.name: value_of(field.kind, field.array, rng) for field in _LAYOUTS[kind.rpartition("/")[2]]}


def value_of(kind: str, array: str, rng: np.random.Generator) -> Any:
    if array:
        count = int(rng.integers(4)) if array == "[]" else int(array[1:-1])
        return [value_of(kind, "", rng) for _ in range(count)]
    if kind == "string":
        return "ü" * int(rng.integers(5))
    if kind in WIDTHS:
        return int(rng.integers(1 << WIDTHS[kind]))
    if kind.startswith("float"):
        return float(np.float32(rng.normal()))
    return made_up(kind, rng)


def as_values(message: Any) -> Any:
    """A message of the library as plain values."""
    if hasattr(message, "__slots__"):
        return {name: as_values(getattr(message, name)) for name in message.__slots__}
    if isinstance(message, bytes | list | tuple):
        return [as_values(each) for each in message]
    return message


def same(found: Any, expected: Any) -> bool:
    if isinstance(expected, Mapping):
        return all(same(found[name], value) for name, value in expected.items())
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    return bool(found == expected)


@pytest.mark.parametrize("kind", DEFINITIONS)
def test_another_reader_finds_every_value(kind: str) -> None:
    """Strings and lists of any length before numbers of every size: each alignment occurs."""
    schema = ros2_schema(kind)
    decode = generate_dynamic(schema.name, schema.data.decode())[schema.name]
    for seed in range(20):
        values = made_up(kind, np.random.default_rng(seed))
        assert same(as_values(decode(ros2_encoder(kind)(values))), values)


def test_what_is_left_out_is_zero_and_what_is_wrong_is_refused() -> None:
    encode = ros2_encoder("nav_msgs/Odometry")
    assert encode({}) == encode({"child_frame_id": "", "pose": {"covariance": [0.0] * 36}})
    with pytest.raises(KeyError, match="Odometry has no twisted"):
        encode({"twisted": {}})
    with pytest.raises(ValueError, match="covariance of 35 entries, not 36"):
        encode({"pose": {"covariance": [0.0] * 35}})
    with pytest.raises(struct.error):
        encode({"header": {"stamp": {"sec": 1 << 31}}})


def test_definitions_are_those_that_are_read() -> None:
    """The layouts of both directions are the same, as far as they are read, and so is what comes of them."""
    both = {
        kind: kind.rpartition("/")[2] for kind in DEFINITIONS if kind.rpartition("/")[2] in LAYOUTS["cdr"]
    }
    assert len(both) > 5
    for kind, name in both.items():
        check_definition("cdr", name, ros2_schema(kind).data.decode())
        assert parse_fields(DEFINITIONS[kind])[: len(LAYOUTS["cdr"][name])] == LAYOUTS["cdr"][name]
    info = {
        "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "kinect"},
        "d": [0.1, 0.2],
        "k": range(9),
    }
    found = ros_decoder("cdr", "CameraInfo")(ros2_encoder("sensor_msgs/CameraInfo")(info))
    assert (found.header.stamp.nanosec, found.d, found.k) == (6, (0.1, 0.2), tuple(range(9)))
