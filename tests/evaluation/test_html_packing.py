"""What is embedded in a page comes out as it went in, and does no harm there."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.evaluation.html.packing import (
    FINEST_STEP_MM,
    MISSING,
    Packed,
    json_text,
    packed,
    quantisation,
    quantised,
)


def unpacked(one: Packed) -> np.ndarray:
    return np.frombuffer(base64.b64decode(one["data"]), dtype="<" + one["type"])


@pytest.mark.parametrize(
    ("kind", "values"),
    [("u1", [0, 255]), ("i2", [-32768, 32767]), ("i4", [-(2**31), 2**31 - 1]), ("u4", [0, 2**32 - 1])],
)
def test_whole_numbers_are_kept(kind: str, values: list[int]) -> None:
    np.testing.assert_array_equal(unpacked(packed(np.array(values), kind)), values)  # type: ignore[arg-type]


def test_floats_are_kept_to_single_precision_nan_and_infinity_too() -> None:
    values = np.array([1 / 3, np.nan, -np.inf, 1e300])
    expected = [np.float32(1 / 3), np.nan, -np.inf, np.inf]
    np.testing.assert_array_equal(unpacked(packed(values, "f4")), expected)


@given(
    st.lists(st.tuples(*[st.floats(-2000.0, 2000.0)] * 3), min_size=1, max_size=20),
    st.floats(0.0, 5000.0),
)
def test_points_are_kept_to_half_a_step(points: list[tuple[float, float, float]], away: float) -> None:
    array = np.add(points, [0.0, 0.0, away])
    origin, step = quantisation(array)
    back = origin + step * unpacked(quantised(array, origin, step)).reshape(-1, 3)
    assert step >= FINEST_STEP_MM
    assert np.abs(back - array).max() <= 0.5 * step * (1 + 1e-9)


def test_unknown_points_are_marked_and_stretch_nothing() -> None:
    points = np.array([[1.0, 2.0, 3.0], [np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]])
    origin, step = quantisation(points)
    assert step == FINEST_STEP_MM
    steps = unpacked(quantised(points, origin, step)).reshape(-1, 3)
    assert (steps[1:] == MISSING).all()
    np.testing.assert_allclose(origin + step * steps[0], points[0])


def test_points_that_are_all_unknown() -> None:
    points = np.full((2, 3), np.nan)
    assert (unpacked(quantised(points, *quantisation(points))) == MISSING).all()


@given(st.text())
def test_json_of_any_text_can_stand_in_a_script_element(text: str) -> None:
    written = json_text({text: [text]})
    assert not set("<>&\u2028\u2029") & set(written)
    assert json.loads(written) == {text: [text]}


def test_json_says_null_where_there_is_no_number() -> None:
    data = {"a": [float("nan"), (np.float64("inf"), 1.5)], "b": np.int64(3), "c": {"d": -np.inf}}
    assert json.loads(json_text(data)) == {"a": [None, [None, 1.5]], "b": 3, "c": {"d": None}}
