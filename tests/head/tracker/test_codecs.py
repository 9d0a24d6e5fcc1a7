"""People as arrays: all that is known comes back, and what no tracker learned is refused."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.head.adjustment.views import PER_CELL
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.tracker.codecs import PEOPLE, known_people, people_codec
from posetrack_cli.head.tracker.person import KnownPerson
from support.bundles import random_model
from support.mono_cases import assert_same, random_known

MODEL = random_model(0)
SETTINGS = AdjustmentSettings(average=6)
CODEC = people_codec(MODEL, SETTINGS)


def people(count: int, **how: int) -> tuple[KnownPerson, ...]:
    return tuple(random_known(10 * index, MODEL, **how) for index in range(count))


def learned() -> dict[str, np.ndarray]:
    return CODEC.to_arrays(people(2))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_people_come_back(count: int) -> None:
    known = people(count)
    assert_same(CODEC.from_arrays(CODEC.to_arrays(known)), known)


def test_more_than_nine_people_are_told_apart() -> None:
    """The arrays of person 1 and of person 10 begin alike."""
    known = people(12, views=1, sets=1)
    assert_same(CODEC.from_arrays(CODEC.to_arrays(known)), known)


def test_a_person_who_was_only_found_comes_back() -> None:
    known = people(1, views=0, sets=1)
    assert_same(CODEC.from_arrays(CODEC.to_arrays(known)), known)


def test_an_album_comes_back_page_by_page() -> None:
    """Many frames, so that some cells are full."""
    known = people(1, views=60)
    assert max(len(page) for page in known[0].album.pages.values()) == PER_CELL
    assert_same(CODEC.from_arrays(CODEC.to_arrays(known)), known)


def test_arrays_are_plain() -> None:
    """No objects: an npz without pickle holds them."""
    assert all(array.dtype.kind in "iufb" for array in learned().values())


def test_what_was_learned_is_taken() -> None:
    known_people(learned(), people_codec(MODEL, SETTINGS))


@pytest.mark.parametrize("name", [PEOPLE, "person0.identity", "person1.offsets"])
def test_a_missing_array_is_named(name: str) -> None:
    arrays = learned()
    del arrays[name]
    assert_refused(arrays, f"no array '{name}'")


def test_missing_templates_are_named() -> None:
    arrays = {name: array for name, array in learned().items() if not name.startswith("person1.sets.")}
    assert_refused(arrays, "no array 'person1.sets.windows'")


@pytest.mark.parametrize(
    "name, shape", [("person0.identity", (11,)), ("person1.identity", ()), ("person0.offsets", (3, 10))]
)
def test_an_array_of_another_shape_is_named(name: str, shape: tuple[int, ...]) -> None:
    assert_refused(learned() | {name: np.zeros(shape)}, f"'{name}' as float64 {shape}, not float64 (")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_named(bad: float) -> None:
    arrays = learned()
    arrays["person1.offsets"][3, 1] = bad
    assert_refused(arrays, "'person1.offsets'")


def test_of_another_face_model_is_refused() -> None:
    with pytest.raises(ResultError, match=r"'person0.identity' as float64 \(10,\), not float64 \(7\)"):
        known_people(learned(), people_codec(random_model(0, identities=7), SETTINGS))


def assert_refused(arrays: dict[str, np.ndarray], found: str) -> None:
    with pytest.raises(ResultError) as caught:
        known_people(arrays, people_codec(MODEL, SETTINGS))
    said = str(caught.value)
    assert found in said and "model is incomplete or damaged" in said and "\n" not in said
