"""What a result says of itself and of its frames is data: anything but what we write is one line."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.camera_record import cameras_from_record, cameras_to_record
from posetrack_cli.results.columns import column_blocks
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.estimate_json import estimate_from_json, estimate_to_json
from posetrack_cli.results.records import check_run_record, subject_from_record, subject_to_record
from support.results import make_estimate

DEEP = "[" * 1000 + "]" * 1000
SUBJECT = Subject("hand", "camera", ("a", "b"), ("p", "q"), (-1, 0), np.array([[0, 1, 2]]))
ANYTHING = [DEEP, "", "nope", "null!", "1", "{}", "[[]]", '[["a"]]', "[true]", "[1e400]", "[NaN]", "9" * 5000]


@pytest.mark.parametrize("key", subject_to_record(SUBJECT))
@pytest.mark.parametrize("value", ANYTHING, ids=range(len(ANYTHING)))
def test_a_subject_record_of_anything_else(key: str, value: str) -> None:
    with pytest.raises(ResultError, match=r"posetrack\.subject") as error:
        subject_from_record(subject_to_record(SUBJECT) | {key: value})
    assert len(str(error.value)) < 400


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("shape_names", ["a", "a"]),
        ("number_names", ["n", "n"]),
        ("point_parents", [0, 0]),
        ("triangles", [[0, 1, -1]]),
        ("triangles", [[0, 1, 10**9]]),
        ("lines", [[0, 2]]),
        ("name", "a" * 300),
        ("shape_names", ["a"] * 20_000),
    ],
)
def test_a_subject_that_cannot_be(key: str, value: Any) -> None:
    with pytest.raises(ResultError):
        subject_from_record(subject_to_record(SUBJECT) | {key: json.dumps(value)})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("width", -1),
        ("width", 10**30),
        ("width", True),
        ("height", 10**6),
        ("fx", 1e300),
        ("fx", "300"),
        ("distortion", [[1.0]]),
        ("distortion_model", "none of ours"),
        ("name", ["a"]),
        ("camera_T_reference", [[1e308] * 4] * 3),
    ],
)
def test_a_camera_that_cannot_be(key: str, value: Any) -> None:
    record = cameras_to_record([Camera(640, 480, 300.0, 300.0, 320.0, 240.0, (0.1, 0.0, 0.0, 0.0))])
    assert cameras_from_record(record)[0].width == 640
    (camera,) = json.loads(record["cameras"])
    with pytest.raises(ResultError, match=r"posetrack\.cameras"):
        cameras_from_record({"cameras": json.dumps([camera | {key: value}])})
    with pytest.raises(ResultError):
        cameras_from_record({"cameras": DEEP})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("configuration", DEEP),
        ("configuration", "[]"),
        ("camera", '"a"'),
        ("end", "x"),
        ("start", "-1"),
        ("stride", "9" * 5000),
        ("input.fps", "nan"),
        ("input.tolerance_ms", "1e999"),
    ],
)
def test_a_run_record_of_anything_else(key: str, value: str) -> None:
    check_run_record({"end": "", "start": "0", "configuration": "{}"})
    with pytest.raises(ResultError, match=f"invalid '{key}'"):
        check_run_record({key: value})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("frame_index", -1),
        ("frame_index", True),
        ("stamp_ns", 2**63),
        ("confidence", True),
        ("confidence", 1e308),
        ("position", [0.0, 0.0, 1e10]),
        ("quaternion", [0.0, 0.0, 0.0, 0.0]),
        ("quaternion", [1e200, 0.0, 0.0, 0.0]),
        ("shape", [10**30] * 5),
        ("shape", {"a": 1}),
        ("resampled", 1),
        ("evaluations", 0.5),
    ],
)
def test_an_estimate_that_cannot_be(key: str, value: Any) -> None:
    data = json.dumps(json.loads(estimate_to_json(make_estimate(0))) | {key: value}).encode()
    with pytest.raises(ResultError, match=rf"found '{key}"):
        estimate_from_json(data)
    with pytest.raises(ResultError, match=rf"found '{key}"):
        list(column_blocks([data]))


def test_a_message_larger_than_any_is_not_parsed() -> None:
    """A message of a small file may be 128 MiB of brackets; as lists they take gigabytes."""
    data = b'{"position": [' + b"[]," * (limits.MESSAGE_BYTES // 3)
    with pytest.raises(ResultError, match="exceed the limit of 1048576"):
        estimate_from_json(data)
