"""The one-camera tracker's state: as arrays and back again, and what its steps change."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.config import AdjustmentSettings
from posetrack_cli.head.dense.face import KnownFace, NeutralFace
from posetrack_cli.head.dense.lengths import UNKNOWN_PERSON
from posetrack_cli.head.dense.points import DENSE_COUNT
from posetrack_cli.head.initialisation.search import Search
from posetrack_cli.head.subject import SIGNS
from posetrack_cli.head.tracker.codecs import (
    SCENE_HEIGHT,
    SCENE_WIDTH,
    MonoState,
    ReportedPose,
    is_cut,
    mono_codec,
    people_codec,
    thumbnail,
)
from posetrack_cli.head.tracker.frame_tracker import TrackRecord
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import LayoutError
from posetrack_cli.tracking.confidence import RunningSigns
from support.bundles import random_model
from support.codecs import assert_lawful
from support.mono_cases import assert_same, random_detected, random_known, random_templates, random_track

MODEL = random_model(0)
CODEC = mono_codec(people_codec(MODEL, AdjustmentSettings(average=6)))
STAMP = 1_700_000_000_123_456_789
"""ns, since 1970: more digits than a float64 has."""
SEARCHED = Search(7, 0.31, Counter({"no face": 5, "no image": 2}))
ONE, TWO = random_known(1, MODEL), random_known(2, MODEL, views=0, sets=1)
CANDIDATES = tuple(random_detected(index, STAMP + index) for index in range(3))
TRACK = replace(random_track(3, MODEL), stamp_ns=STAMP)
KNOWN = MonoState(people=(ONE, TWO), scale=1.0)
STATES = {
    "empty": MonoState(),
    "searching": MonoState(lost=7, search=SEARCHED, first_ns=STAMP),
    "collecting": MonoState(candidates=CANDIDATES, reference=random_templates(4), search=SEARCHED, scale=0.4),
    "known, not yet found": KNOWN,
    "tracked": MonoState(people=(ONE,), track=TRACK, checked_ns=STAMP - 5, trust=0.8, scale=1.0),
    "stated": replace(
        KNOWN, track=TRACK, stated=ReportedPose(TRACK.pose.moved(np.full(6, 0.1)), np.arange(5.0))
    ),
    "put there": MonoState(people=(ONE,), track=random_track(6, MODEL, seen=False), scale=0.5),
    "with a past": replace(
        KNOWN,
        track=TRACK,
        evidence=RunningSigns(np.random.default_rng(5).normal(size=len(SIGNS)), 7),
        record=TrackRecord(frames=9, doubtful=2, gap_ns=10**9, gap_frame=4, last_frame=8),
    ),
    "another person": replace(
        KNOWN,
        people=(ONE, TWO, random_known(7, MODEL)),
        current=2,
        track=TRACK,
        changes=((7, 1), (16, 2)),
        begun_frame=3,
    ),
    "after a cut": replace(
        KNOWN,
        dense=(
            KnownFace(
                replace(UNKNOWN_PERSON, histogram=UNKNOWN_PERSON.histogram + 3),
                NeutralFace(np.full((DENSE_COUNT, 3), 0.1), np.full(DENSE_COUNT, 2.5)),
                is_closed=True,
            ),
        ),
        track=TRACK,
        scene=np.random.default_rng(11).random(SCENE_WIDTH * SCENE_HEIGHT),
        cut=True,
        elsewhere=True,
    ),
    "lost, a stranger comes": replace(
        KNOWN,
        current=1,
        track=TRACK,
        lost=6,
        strange=4,
        candidates=CANDIDATES[:1],
        reference=random_templates(8),
    ),
}


@pytest.mark.parametrize("state", STATES.values(), ids=STATES.keys())
def test_a_state_comes_back(state: MonoState) -> None:
    assert_same(assert_lawful(CODEC, state), state)


def test_every_field_is_told_by_some_state() -> None:
    """A field that a checkpoint forgets would come back as it is by default."""
    default = MonoState()
    for one in fields(MonoState):
        usual = getattr(default, one.name)
        assert any(getattr(state, one.name) is not usual for state in STATES.values()), one.name


@pytest.mark.parametrize("state", STATES.values(), ids=STATES.keys())
def test_arrays_are_plain(state: MonoState) -> None:
    """No objects: so a checkpoint holds them."""
    assert all(array.dtype.kind in "iufbU" for array in CODEC.to_arrays(state).values())


def test_nothing_is_no_state() -> None:
    with pytest.raises(LayoutError, match="is missing"):
        CODEC.from_arrays({})


@pytest.mark.parametrize("name", ["known, not yet found", "collecting"])
def test_faces_were_seen_at_some_scale(name: str) -> None:
    arrays = CODEC.to_arrays(STATES[name])
    del arrays["scale"]
    with pytest.raises(LayoutError, match="array 'scale' is missing"):
        CODEC.from_arrays(arrays)


def test_what_was_stated_deforms_as_what_is_tracked() -> None:
    """The one is taken from the other, for a rate."""
    arrays = CODEC.to_arrays(STATES["stated"])
    with pytest.raises(LayoutError, match=r"'stated\.coefficients' is float64"):
        CODEC.from_arrays(arrays | {"stated.coefficients": np.zeros(3)})


def test_a_thumbnail_has_its_size() -> None:
    arrays = CODEC.to_arrays(STATES["after a cut"])
    with pytest.raises(LayoutError, match="'scene' has 10 pixels, expected 768"):
        CODEC.from_arrays(arrays | {"scene": np.zeros(10)})


def test_switching_to_another_person_is_remembered() -> None:
    state = replace(KNOWN, track=TRACK)
    assert state.switch_person(0, STAMP) is state
    switched = state.switch_person(1, STAMP)
    assert switched.person is TWO and switched.changes == ((STAMP, 1),)
    assert switched.switch_person(0, STAMP + 1).changes == ((STAMP, 1), (STAMP + 1, 0))


def test_a_new_person_is_tracked_from_a_clean_beginning() -> None:
    first = STATES["collecting"].with_new_person(ONE, TRACK, STAMP)
    assert first.people == (ONE,) and first.changes == () and first.search is SEARCHED
    assert first.candidates == () and first.reference is None and first.scale == 0.4
    worn = replace(first, lost=5, strange=9, checked_ns=STAMP, cut=True)
    second = worn.with_new_person(TWO, TRACK, STAMP + 1)
    assert second.people == (ONE, TWO) and second.person is TWO and second.changes == ((STAMP + 1, 1),)
    assert second.lost == second.strange == 0 and not second.cut
    assert second.checked_ns == MonoState().checked_ns


def test_only_the_person_tracked_is_updated() -> None:
    more = random_known(9, MODEL)
    assert replace(KNOWN, current=1).update_person(more).people == (ONE, more)


def test_the_first_frames_templates_stay_the_reference() -> None:
    first, second = random_templates(1), random_templates(2)
    state = MonoState().with_candidate(CANDIDATES[0], first).with_candidate(CANDIDATES[1], second)
    assert state.candidates == CANDIDATES[:2] and state.first_templates is first


def test_candidates_too_long_ago_are_dropped_with_their_templates() -> None:
    state = STATES["collecting"]
    assert state.drop_before(STAMP) is state
    dropped = state.drop_before(STAMP + 1)
    assert dropped.candidates == () and dropped.reference is None and dropped.search is SEARCHED
    assert_same(dropped, state.clear_candidates())


def test_a_face_in_one_frame_is_one_that_was_found() -> None:
    assert not MonoState().is_found and not KNOWN.is_found
    assert STATES["collecting"].is_found and STATES["tracked"].is_found


def test_before_it_was_tracked_a_head_was_last_seen_a_frame_ago() -> None:
    frame = Frame(3, STAMP, (None,))
    assert KNOWN.last_seen_ns(frame) == STAMP - 33_333_333
    assert replace(KNOWN, track=TRACK).last_seen_ns(frame) == TRACK.stamp_ns


# Cuts are told by how the whole image changes, not by its brightness


ROUNDING = 0.02
"""Of a correlation: grey levels in 8 bits, of contrasts down to some 20."""


def scene(seed: int) -> np.ndarray:
    """A picture with something large in it."""
    noise = np.random.default_rng(seed).normal(size=(60, 80))
    smooth = cv2.resize(cv2.GaussianBlur(noise, (0, 0), 7.5), (640, 480), interpolation=cv2.INTER_CUBIC)
    return (128.0 + 40.0 * smooth / smooth.std()).clip(0, 255).astype(np.uint8)


@given(st.integers(0, 1000), st.floats(0.4, 1.0), st.floats(0.0, 60.0))
def test_a_light_that_changes_is_no_cut(seed: int, gain: float, offset: float) -> None:
    image = scene(seed)
    lit = np.clip(gain * image + offset, 0, 255).astype(np.uint8)
    now, then = thumbnail(lit), thumbnail(image)
    clipped = float(np.mean(lit == 255))
    assert now @ then > 1.0 - ROUNDING - 2.0 * clipped
    assert clipped > 0.01 or not is_cut(then, now)


@pytest.mark.parametrize("seed", range(20))
def test_another_scene_is_a_cut(seed: int) -> None:
    assert is_cut(thumbnail(scene(seed)), thumbnail(scene(seed + 1000)))


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_small_movement_are_none(seed: int) -> None:
    image, rng = scene(seed), np.random.default_rng(seed)
    moved = np.roll(image, (5, 8), axis=(0, 1)) + rng.normal(0.0, 4.0, image.shape)
    assert not is_cut(thumbnail(image), thumbnail(moved.clip(0, 255).astype(np.uint8)))


def test_an_image_that_becomes_even_is_a_cut() -> None:
    """And nothing is divided by its contrast."""
    even = thumbnail(np.full((480, 640), 90, np.uint8))
    np.testing.assert_array_equal(even, 0.0)
    assert is_cut(thumbnail(scene(0)), even)


def test_a_thumbnail_has_zero_mean_and_unit_norm() -> None:
    small = thumbnail(scene(3))
    assert abs(small.mean()) < 1e-12 and np.linalg.norm(small) == pytest.approx(1.0)
