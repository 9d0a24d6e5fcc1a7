"""The laws that every state codec is held to, and a tracker with a small state."""

from __future__ import annotations

from operator import itemgetter
from typing import Any, TypeVar, cast

import numpy as np

from posetrack_cli.results.columns import floats
from posetrack_cli.tracking.loop import Tracker
from posetrack_cli.tracking.state_codec import Codec, Fields, Value, whole

T = TypeVar("T")


def assert_same_arrays(one: dict[str, np.ndarray[Any, Any]], other: dict[str, np.ndarray[Any, Any]]) -> None:
    """Fail unless there are the same arrays, bit by bit."""
    assert list(one) == list(other)
    for name, array in one.items():
        assert (array.dtype, array.shape) == (other[name].dtype, other[name].shape), name
        assert array.tobytes() == other[name].tobytes(), name


def assert_lawful(codec: Codec[T], value: T) -> T:
    """Fail unless a value's arrays give a value with the same arrays; return that value."""
    arrays = codec.to_arrays(value)
    again = codec.from_arrays({name: array.copy() for name, array in arrays.items()})
    assert_same_arrays(codec.to_arrays(again), arrays)
    return again


class Counting:
    """A tracker whose state is an array and a number."""

    codec = Fields(
        lambda sum, count: (sum, count),
        sum=(itemgetter(0), Value(floats("n"))),
        count=(itemgetter(1), whole()),
    )


TRACKER = cast(Tracker[Any], Counting())
