"""One-camera model files whose arrays are incomplete, of another shape or damaged are told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import AdjustmentSettings, HeadMonoConfig
from posetrack_cli.head.tracker.codecs import PEOPLE, known_people, people_codec
from posetrack_cli.head.tracker.mono import MonoPeople
from support.bundles import random_model
from support.mono_cases import random_known

MODEL = random_model(0)
CODEC = people_codec(MODEL, AdjustmentSettings())
CAMERA = Camera(640, 480, 700.0, 700.0, 320.0, 240.0)
MAY_BE_NAN = ("single", "pixels", "centres", "tangents")
Learned = dict[str, np.ndarray[Any, Any]]


def learned() -> Learned:
    return CODEC.to_arrays((random_known(0, MODEL), random_known(10, MODEL)))


NEEDED = [name for name in learned() if name.startswith("person1.")]


def assert_refused(arrays: Learned, found: str) -> None:
    with pytest.raises(ResultError) as caught:
        known_people(arrays, people_codec(MODEL, AdjustmentSettings()))
    assert f"model is incomplete or damaged, found {found}" in str(caught.value)


@pytest.mark.parametrize("name", NEEDED)
def test_every_array_is_needed_and_has_its_shape_and_kind(name: str) -> None:
    known_people(learned(), people_codec(MODEL, AdjustmentSettings()))
    right = learned()[name]
    assert_refused(
        {other: array for other, array in learned().items() if other != name}, f"array '{name}' is missing"
    )
    assert_refused(learned() | {name: right[None]}, f"'{name}' is {right.dtype} (1")
    assert_refused(learned() | {name: np.full(right.shape, "text")}, f"'{name}' is <U4")
    if right.ndim:
        assert_refused(learned() | {name: right[:0]}, f"'{name}' is {right.dtype} (0")


@pytest.mark.parametrize("name", [name for name in NEEDED if learned()[name].dtype.kind == "f"])
def test_only_what_may_be_unknown_may_be_nan(name: str) -> None:
    arrays = learned()
    arrays[name] = np.full_like(arrays[name], np.nan)
    if name.endswith(MAY_BE_NAN):
        known_people(arrays, people_codec(MODEL, AdjustmentSettings()))
    else:
        assert_refused(arrays, f"'{name}' has values that are not finite")


@pytest.mark.parametrize("group", ["sets", "views", "album"])
def test_arrays_that_belong_together_are_equally_long(group: str) -> None:
    name = next(name for name in NEEDED if name.startswith(f"person1.{group}."))
    longer = np.concatenate([learned()[name], learned()[name]])
    with pytest.raises(ResultError, match=rf"found 'person1\.{group}\.[a-z]+' is "):
        known_people(learned() | {name: longer}, people_codec(MODEL, AdjustmentSettings()))


def test_a_person_without_frames_is_as_good() -> None:
    """As learned by a whole recording: its frames are in the person."""
    arrays = CODEC.to_arrays((random_known(0, MODEL, views=0),))
    assert not any(name.startswith("person0.views.") for name in arrays)
    known_people(arrays, people_codec(MODEL, AdjustmentSettings()))
    del arrays["person0.album.scores"]
    known_people(arrays, people_codec(MODEL, AdjustmentSettings()))
    (one,) = known_people(arrays, people_codec(MODEL, AdjustmentSettings()))
    assert one.views == one.album.views == ()


@pytest.mark.parametrize("count", [np.array([2]), np.array(2.0), np.array("2")])
def test_how_many_people_there_are_is_one_whole_number(count: np.ndarray[Any, Any]) -> None:
    assert_refused(learned() | {PEOPLE: count}, f"'{PEOPLE}' is {count.dtype}")


@pytest.mark.parametrize("focal", [np.nan, np.inf, 0.0, -700.0, [700.0], "700"])
def test_the_size_of_a_face_is_a_focal_length(focal: object) -> None:
    with pytest.raises(ResultError, match="found 'focal_px' is"):
        MonoPeople(HeadMonoConfig(), CAMERA, MODEL, known={"focal_px": np.array(focal)})
