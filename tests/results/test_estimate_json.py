from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli import limits
from posetrack_cli.errors import ResultError
from posetrack_cli.results import ESTIMATE_SCHEMA, Status, estimate_from_json, estimate_to_json
from posetrack_cli.results.fields import FIELD_NAMES
from support.results import make_estimate, with_fields

KINDS: dict[str, tuple[type, ...]] = {
    "integer": (int,),
    "number": (float,),
    "string": (str,),
    "boolean": (bool,),
    "array": (list,),
    "object": (dict,),
}


def assert_described(value: Any, schema: dict[str, Any]) -> None:
    """Check the value against the keywords that our schema uses."""
    assert type(value) in KINDS[schema["type"]]
    if schema["type"] == "array":
        for item in value:
            assert_described(item, schema["items"])
    if schema["type"] == "object":
        assert set(schema["required"]) <= set(value) <= set(schema["properties"])
        assert not schema["additionalProperties"]
        for key, item in value.items():
            assert schema["properties"][key]["description"]
            assert_described(item, schema["properties"][key])


NO_VELOCITY: dict[str, object] = {"pose_rate": None, "twist": None, "twist_variance": None}
OPTIMISED: dict[str, object] = {
    **NO_VELOCITY,
    "pose_variance": None,
    "effective_sample_size": None,
    "evaluations": 1600,
}


@pytest.mark.parametrize("index", [0, 1, 3])
@pytest.mark.parametrize("changes", [{}, NO_VELOCITY, OPTIMISED], ids=["velocity", "none", "optimised"])
def test_every_written_field_is_described(index: int, changes: dict[str, object]) -> None:
    written = json.loads(estimate_to_json(with_fields(make_estimate(index), **changes)))
    assert_described(written, dict(ESTIMATE_SCHEMA))


def test_schema_lists_every_field_of_an_estimate_in_order() -> None:
    assert set(ESTIMATE_SCHEMA["properties"]) == set(FIELD_NAMES)
    written = list(
        json.loads(estimate_to_json(with_fields(make_estimate(1), milliseconds=4.5, evaluations=513)))
    )
    assert written == list(ESTIMATE_SCHEMA["properties"])


def test_schema_has_only_what_foxglove_can_parse() -> None:
    for field in ESTIMATE_SCHEMA["properties"].values():
        assert isinstance(field["type"], str)
        if field["type"] == "array":
            assert field["items"]["type"] in {"number", "object"}


@pytest.mark.parametrize("index", [0, 1, 3])
def test_reading_back_gives_the_same_bits(index: int) -> None:
    written = with_fields(make_estimate(index), milliseconds=0.1 + 0.2)
    read = estimate_from_json(estimate_to_json(written))
    for name in FIELD_NAMES:
        assert np.array_equal(getattr(read, name), getattr(written, name)), name
    assert isinstance(read.status, Status)
    assert read.points.dtype == np.float64


def test_what_an_optimiser_knows_comes_back() -> None:
    data = estimate_to_json(with_fields(make_estimate(1), **OPTIMISED))
    assert not {name for name, value in OPTIMISED.items() if value is None} & set(json.loads(data))
    read = estimate_from_json(data)
    assert {name: getattr(read, name) for name in OPTIMISED} == OPTIMISED
    assert type(read.evaluations) is int


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_a_cost_without_value_is_left_out(value: float | None) -> None:
    data = estimate_to_json(with_fields(make_estimate(1), cost=value))
    assert "cost" not in json.loads(data)
    assert estimate_from_json(data).cost is None


def test_a_velocity_that_is_not_known_is_left_out() -> None:
    data = estimate_to_json(with_fields(make_estimate(1), **NO_VELOCITY))
    assert not set(NO_VELOCITY) & set(json.loads(data))
    read = estimate_from_json(data)
    assert (read.pose_rate, read.twist, read.twist_variance) == (None, None, None)
    assert read.pose_variance.shape == (9,)


def test_nan_is_refused() -> None:
    with pytest.raises(ResultError, match="frame 1: estimate is not finite"):
        estimate_to_json(with_fields(make_estimate(1), position=np.array([0.0, np.nan, 0.0])))
    data = estimate_to_json(make_estimate(1)).replace(b'"confidence":0', b'"confidence":NaN,"a":0')
    with pytest.raises(ResultError, match=r"not a posetrack\.Estimate"):
        estimate_from_json(data)


@given(st.lists(st.floats(-limits.LENGTH_MM, limits.LENGTH_MM), min_size=3, max_size=3))
def test_any_number_comes_back_to_the_last_bit(numbers: list[float]) -> None:
    position = np.array(numbers)
    read = estimate_from_json(estimate_to_json(with_fields(make_estimate(1), position=position)))
    assert read.position.tobytes() == position.tobytes()


def test_numpy_scalars_are_written_as_numbers() -> None:
    estimate = with_fields(
        make_estimate(1), frame_index=np.int64(1), confidence=np.float32(0.5), resampled=np.bool_(1)
    )
    assert estimate_from_json(estimate_to_json(estimate)).confidence == 0.5


@pytest.mark.parametrize("data", [b"", b"{}", b"[]", b'{"points":3}', b"\xff"])
def test_other_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(ResultError, match=r"not a posetrack\.Estimate"):
        estimate_from_json(data)
