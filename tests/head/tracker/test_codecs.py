"""People as arrays: all that is known comes back, and what no tracker learned is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from posetrack_cli.errors import ResultError
from posetrack_cli.head.adjustment.adjuster import PER_CELL
from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.tracker.codecs import PEOPLE, known_people, people_codec
from posetrack_cli.head.tracker.person import KnownPerson
from posetrack_cli.results.columns import LayoutError
from support.bundles import random_model
from support.codecs import assert_lawful
from support.mono_cases import assert_same, random_known, random_map, random_skin

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


@given(st.integers(0, 1000), st.integers(0, 3), st.booleans(), st.booleans())
@examples(max_examples=15)
def test_people_come_back_with_their_skin(seed: int, views: int, mapped: bool, another: bool) -> None:
    """Frames of a first pass, or the map that was made of them; of one person, or of one of two."""
    (one, two) = people(2, views=1, sets=1)
    skin_map = random_map(seed, points=5) if mapped else None
    one = replace(one, skin=random_skin(seed, MODEL, views), skin_map=skin_map)
    known = (two, one) if another else (one,)
    assert_same(assert_lawful(CODEC, known), known)


def mapped() -> dict[str, np.ndarray]:
    """A person with frames and a map, neither of which there is in any run at once."""
    (one,) = people(1, views=1, sets=1)
    return CODEC.to_arrays((replace(one, skin=random_skin(1, MODEL), skin_map=random_map(2)),))


MAP, VIEWS = "person0.skin_map", "person0.skin.views"
OF_A_MAP = ("stamps", "crops", "positions", "quaternions", "images", "places", "points", "share")


@pytest.mark.parametrize("name", OF_A_MAP)
def test_a_map_needs_all_its_arrays(name: str) -> None:
    arrays = mapped()
    del arrays[f"{MAP}.{name}"]
    assert_refused(arrays, f"array '{MAP}.{name}' is missing")


@pytest.mark.parametrize("name", [*OF_A_MAP[:-1], "share"])
def test_a_map_whose_arrays_are_of_other_lengths_is_refused(name: str) -> None:
    """One more row, or none; of the share, any row at all."""
    array = mapped()[f"{MAP}.{name}"]
    longer = np.concatenate([array, array[-1:]]) if array.ndim else array[None]
    for changed in (longer, longer[:0], longer[None]):
        assert_refused(mapped() | {f"{MAP}.{name}": changed}, MAP)


@pytest.mark.parametrize("name", ["positions", "quaternions", "places", "points", "share"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_a_map_with_numbers_that_are_none_is_refused(name: str, bad: float) -> None:
    array = mapped()[f"{MAP}.{name}"].copy()
    array.flat[-1] = bad
    assert_refused(mapped() | {f"{MAP}.{name}": array}, f"'{MAP}.{name}' has ")


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_map_is_believed_by_a_share(share: float) -> None:
    assert_refused(
        mapped() | {f"{MAP}.share": np.array(share)}, f"'{MAP}.share' has an out-of-range value {share}"
    )


@pytest.mark.parametrize(
    "images",
    [[0, 0, 1, 1, 2, 2, 3], [0, 1, 2, 1, 2, 2, 2], [2, 1, 1, 1, 1, 0, 0], [0, 0, 0, 0, 0, 0, 2**53]],
    ids=["beyond the last", "one back", "falling", "far beyond the last"],
)
def test_points_of_a_map_belong_to_its_views_in_order(images: list[int]) -> None:
    assert_refused(mapped() | {f"{MAP}.images": np.array(images)}, "'images' is not in ascending order")


def test_points_of_no_view_at_all_are_refused() -> None:
    assert_refused(mapped() | {f"{MAP}.images": np.array([-1, 0, 0, 1, 1, 2, 2])}, f"'{MAP}.images' has")


@pytest.mark.parametrize(
    "turn",
    [[[0.0, 0.0], [0.0, 0.0]], [[1.0, 1.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 0.1]], [[1.0, 0.0], [0.0, -1.0]]],
    ids=["a point", "a line", "sheared", "mirrored"],
)
def test_crops_are_only_turned_scaled_and_moved(turn: list[list[float]]) -> None:
    """Of others there is no way back from the image."""
    arrays = mapped()
    placement = arrays[f"{VIEWS}.placements"].copy()
    placement[1, 0, :, :2] = turn
    assert_refused(arrays | {f"{VIEWS}.placements": placement}, "'placements' are not similarity transforms")


@pytest.mark.parametrize("name", ["view.stamps", "view.pixels", "crops", "placements"])
def test_frames_of_skin_need_all_their_arrays(name: str) -> None:
    arrays = mapped()
    del arrays[f"{VIEWS}.{name}"]
    assert_refused(arrays, f"array '{VIEWS}.{name}' is missing")
    with pytest.raises(LayoutError):
        CODEC.from_arrays(arrays)


def test_crops_of_another_size_are_refused() -> None:
    for name in (f"{VIEWS}.crops", f"{MAP}.crops"):
        assert_refused(mapped() | {name: mapped()[name][:, :, 1:]}, f"'{name}' is uint8")


def test_arrays_are_plain() -> None:
    """No objects: an npz without pickle holds them."""
    assert all(array.dtype.kind in "iufb" for array in learned().values())


def test_what_was_learned_is_taken() -> None:
    known_people(learned(), people_codec(MODEL, SETTINGS))


@pytest.mark.parametrize("name", [PEOPLE, "person0.identity", "person1.offsets"])
def test_a_missing_array_is_named(name: str) -> None:
    arrays = learned()
    del arrays[name]
    assert_refused(arrays, f"array '{name}' is missing")


def test_missing_templates_are_named() -> None:
    arrays = {name: array for name, array in learned().items() if not name.startswith("person1.sets.")}
    assert_refused(arrays, "array 'person1.sets.windows' is missing")


@pytest.mark.parametrize(
    "name, shape", [("person0.identity", (11,)), ("person1.identity", ()), ("person0.offsets", (3, 10))]
)
def test_an_array_of_another_shape_is_named(name: str, shape: tuple[int, ...]) -> None:
    assert_refused(learned() | {name: np.zeros(shape)}, f"'{name}' is float64 {shape}, expected float64 (")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_named(bad: float) -> None:
    arrays = learned()
    arrays["person1.offsets"][3, 1] = bad
    assert_refused(arrays, "'person1.offsets'")


def test_of_another_face_model_is_refused() -> None:
    with pytest.raises(ResultError, match=r"'person0.identity' is float64 \(10,\), expected float64 \(7\)"):
        known_people(learned(), people_codec(random_model(0, identities=7), SETTINGS))


def assert_refused(arrays: dict[str, np.ndarray], found: str) -> None:
    with pytest.raises(ResultError) as caught:
        known_people(arrays, people_codec(MODEL, SETTINGS))
    said = str(caught.value)
    assert found in said and "model is incomplete or damaged" in said and "\n" not in said
