"""The one-camera tracker's state: taken apart and put together again, and what its steps change."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.cuts import HEIGHT, WIDTH
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.mono_state import MonoState, known_state, parts_of, state_of
from posetrack_cli.head.person_arrays import people_parts
from posetrack_cli.results.layouts import LayoutError
from support.bundles import random_model
from support.mono_cases import assert_same, random_detected, random_following, random_known, random_templates

MODEL = random_model(0)
SETTINGS = AdjustmentSettings(average=6)
STAMP = 1_700_000_000_123_456_789
"""ns, since 1970: more digits than a float64 has."""
SEARCHED = Search(7, 0.31, Counter({"no face": 5, "no image": 2}))
ONE, TWO = random_known(1, MODEL), random_known(2, MODEL, views=0, sets=1)
DETECTED = tuple(random_detected(index, STAMP + index) for index in range(3))
FOLLOWING = replace(random_following(3, MODEL), stamp_ns=STAMP)
STATES = {
    "empty": MonoState(),
    "searching": MonoState(lost=7, search=SEARCHED),
    "collecting": MonoState(detected=DETECTED, reference=random_templates(4), search=SEARCHED),
    "clicked": MonoState(clicked=random_detected(5, STAMP)),
    "known, not yet found": MonoState(people=(ONE, TWO)),
    "following": MonoState(people=(ONE,), following=FOLLOWING, checked_ns=STAMP - 5),
    "put there": MonoState(people=(ONE,), following=random_following(6, MODEL, seen=False)),
    "another person": MonoState((ONE, TWO, random_known(7, MODEL)), 2, FOLLOWING, changes=((7, 1), (16, 2))),
    "after a cut": MonoState(
        (ONE,), 0, FOLLOWING, scene=np.random.default_rng(11).random(WIDTH * HEIGHT), cut=True
    ),
    "lost, a stranger comes": MonoState(
        (ONE, TWO), 1, FOLLOWING, 6, 4, DETECTED[:1], random_templates(8), search=SEARCHED
    ),
}


@pytest.mark.parametrize("state", STATES.values(), ids=STATES.keys())
def test_a_state_comes_back(state: MonoState) -> None:
    assert_same(state_of(*parts_of(state), MODEL, SETTINGS), state)


def test_every_field_is_told_by_some_state() -> None:
    """A field that a checkpoint forgets would come back as it is by default."""
    default = MonoState()
    for one in fields(MonoState):
        usual = getattr(default, one.name)
        assert any(getattr(state, one.name) is not usual for state in STATES.values()), one.name


@pytest.mark.parametrize("state", STATES.values(), ids=STATES.keys())
def test_parts_are_plain(state: MonoState) -> None:
    """No objects, and numbers that fit an int64: so a checkpoint holds them."""
    arrays, numbers = parts_of(state)
    assert all(array.dtype.kind in "iufbU" for array in arrays.values())
    assert all(type(number) is int and -(2**63) <= number < 2**63 for number in numbers.values())


def test_nothing_is_no_state() -> None:
    with pytest.raises(LayoutError, match="no array 'changes'"):
        state_of({}, {}, MODEL, SETTINGS)


def test_what_is_known_begins_a_state() -> None:
    state = known_state(people_parts((ONE, TWO)), MODEL, SETTINGS)
    assert_same(state, MonoState(people=(ONE, TWO)))
    with pytest.raises(ResultError, match="model is incomplete or damaged"):
        known_state({}, MODEL, SETTINGS)


def test_turning_to_another_person_is_remembered() -> None:
    state = MonoState(people=(ONE, TWO), following=FOLLOWING)
    assert state.turned_to(0, STAMP) is state
    turned = state.turned_to(1, STAMP)
    assert turned.person is TWO and turned.changes == ((STAMP, 1),)
    assert turned.turned_to(0, STAMP + 1).changes == ((STAMP, 1), (STAMP + 1, 0))


def test_a_new_person_is_followed_from_a_clean_beginning() -> None:
    first = STATES["collecting"].choose_views(ONE, FOLLOWING, STAMP)
    assert first.people == (ONE,) and first.changes == () and first.search is SEARCHED
    assert first.detected == () and first.reference is None and first.clicked is None
    second = replace(first, lost=5, strange=9).choose_views(TWO, FOLLOWING, STAMP + 1)
    assert second.people == (ONE, TWO) and second.person is TWO
    assert second.changes == ((STAMP + 1, 1),) and second.lost == second.strange == 0


def test_only_the_person_followed_is_replaced() -> None:
    more = random_known(9, MODEL)
    assert MonoState(people=(ONE, TWO), current=1).with_person(more).people == (ONE, more)


def test_the_first_frames_templates_stay_the_reference() -> None:
    first, second = random_templates(1), random_templates(2)
    state = MonoState().seen(DETECTED[0], first).seen(DETECTED[1], second)
    assert state.detected == DETECTED[:2] and state.first_templates is first


def test_frames_too_long_ago_are_forgotten_with_their_templates() -> None:
    state = STATES["collecting"]
    assert state.not_before(STAMP) is state
    forgotten = state.not_before(STAMP + 1)
    assert forgotten.detected == () and forgotten.reference is None and forgotten.search is SEARCHED
    assert_same(forgotten, state.anew())


def test_eye_distance_is_that_of_the_first_face() -> None:
    assert MonoState().eye_distance is None
    assert STATES["collecting"].eye_distance == DETECTED[0].eye_distance
    assert STATES["clicked"].eye_distance == STATES["clicked"].clicked.eye_distance
