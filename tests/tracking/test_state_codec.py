"""The laws of state codecs, over an object that has all that states are made of, and over damaged arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.results.columns import Layout, LayoutError, NotNegative, Stamp, counts, floats, units
from posetrack_cli.tracking.state_codec import (
    NOT_KEPT,
    Codec,
    Fields,
    Maybe,
    Numbered,
    Stacked,
    Value,
    codec_of,
    flag,
    real,
    stamp,
    whole,
)
from support.codecs import assert_lawful, assert_same_arrays

AXIS = units(3)


@dataclass(frozen=True, eq=False)
class View:
    stamp_ns: int
    axis: np.ndarray


@dataclass(frozen=True, eq=False)
class Person:
    views: tuple[View, ...]
    score: float
    names: list[str]


@dataclass(frozen=True, eq=False)
class State:
    people: tuple[Person, ...]
    last: View | None
    lost: bool
    frames: int
    weights: np.ndarray


VIEW = Fields(lambda stamps, axis: View(stamps, axis), stamps=("stamp_ns", stamp()), axis=Value(AXIS))
PERSON = Fields(
    Person,
    views=Stacked(VIEW, "views"),
    score=real(floats(missing=True)),
    names=Value(Layout("str", ("names?",)), lambda array: array.tolist()),
)
STATE: Codec[State] = Fields(
    State,
    people=Numbered(PERSON, counted="count", called="person", most=5),
    last=Maybe(VIEW),
    lost=flag(),
    frames=whole(),
    weights=Value(floats("weights?")),
)


class Derived(NamedTuple):
    view: Annotated[View, VIEW]
    found: bool
    scores: Annotated[np.ndarray, floats("cameras", "scores", least=0.0)]
    stamp_ns: Stamp
    size: NotNegative | None
    frames: int = 0
    note: Annotated[str, NOT_KEPT] = "note"
    names: tuple[str, ...] = ()


def test_a_codec_of_annotated_fields_is_that_of_their_parts() -> None:
    names = Value(Layout("str", ("names?",)), lambda array: tuple(array.tolist()))
    derived = codec_of(Derived, {"cameras": 2}, names=names)
    written = Fields(
        Derived,
        view=VIEW,
        found=flag(),
        scores=Value(floats(2, "scores", least=0.0)),
        stamp_ns=stamp(),
        size=Maybe(real(floats(least=0.0))),
        frames=whole(),
        names=names,
    )
    for size in (None, 1.5):
        value = Derived(View(7, np.eye(3)[0]), True, np.ones((2, 3)), 8, size, names=("a",))
        arrays = derived.to_arrays(value)
        assert_same_arrays(arrays, written.to_arrays(value))
        assert list(derived.layouts(arrays).items()) == list(written.layouts(arrays).items())
        again = assert_lawful(derived, value)
        assert (again.found, again.size, again.frames, again.names) == (True, size, 0, ("a",))
    with pytest.raises(TypeError, match="tuple"):  # of how many is not stated
        codec_of(Derived, {"cameras": 2})


stamps_ns = st.integers(-(1 << 62), 1 << 62)
numbers = st.floats(-1e9, 1e9)
views = st.builds(View, stamps_ns, st.sampled_from(list(np.eye(3))))
people = st.builds(
    Person,
    st.lists(views, max_size=3).map(tuple),
    st.one_of(numbers, st.just(float("nan"))),
    st.lists(
        st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), min_size=1), max_size=2
    ),
)
states = st.builds(
    State,
    st.lists(people, max_size=3).map(tuple),
    st.none() | views,
    st.booleans(),
    st.integers(0, 1 << 53),
    st.lists(numbers, max_size=4).map(lambda values: np.array(values, dtype=np.float64)),
)


@given(states)
def test_what_is_put_together_is_what_was_taken_apart(state: State) -> None:
    again = assert_lawful(STATE, state)
    assert len(again.people) == len(state.people) and (again.last is None) == (state.last is None)
    assert again.lost is state.lost and again.frames == state.frames
    for one, other in zip(again.people, state.people, strict=True):
        assert one.names == other.names and [v.stamp_ns for v in one.views] == [
            v.stamp_ns for v in other.views
        ]


def full_state() -> State:
    view = View(7, np.eye(3)[0])
    return State((Person((view, view), 1.5, ["a"]), Person((), np.nan, [])), view, True, 3, np.arange(2.0))


@pytest.mark.parametrize("name", sorted(STATE.to_arrays(full_state())))
def test_no_array_can_be_missing_or_of_another_type(name: str) -> None:
    arrays = STATE.to_arrays(full_state())
    without = {key: array for key, array in arrays.items() if key != name}
    with pytest.raises(LayoutError):
        STATE.from_arrays(without)
    with pytest.raises(LayoutError):
        STATE.from_arrays(arrays | {name: np.zeros((2, 2), dtype=np.complex128)})


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("frames", np.array(-1), "'frames'"),
        ("lost", np.array(2), "'lost'"),
        ("people.count", np.array(6), "'people.count'|'count'"),
        ("people.person0.views.axis", np.zeros((2, 3)), "not of unit length"),
        ("people.person0.views.stamps", np.zeros(3, dtype=np.int64), "views"),
        ("weights", np.array([np.nan, 0.0]), "not finite"),
    ],
)
def test_values_that_cannot_be_are_named(name: str, value: Any, says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        STATE.from_arrays(STATE.to_arrays(full_state()) | {name: value})


def test_objects_of_different_lengths_have_lengths_of_their_own() -> None:
    codec = Numbered(Value(floats("n")), counted="count", called="item", most=3)
    arrays = codec.to_arrays([np.zeros(2), np.zeros(5)])
    assert [len(value) for value in codec.from_arrays(arrays)] == [2, 5]


def test_parts_that_share_a_length_must_have_it() -> None:
    @dataclass(frozen=True, eq=False)
    class Pair:
        a: np.ndarray
        b: np.ndarray

    codec = Fields(Pair, a=Value(floats("n")), b=Value(counts("n")))
    arrays = codec.to_arrays(Pair(np.zeros(2), np.zeros(2, dtype=np.int64)))
    assert codec.from_arrays(arrays).a.shape == (2,)
    with pytest.raises(LayoutError, match="'b'"):
        codec.from_arrays(arrays | {"b": np.zeros(3, dtype=np.int64)})
