"""States of head trackers that no tracker made: refused before they are put together, without a warning."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError
from posetrack_cli.head.config import RunSettings
from posetrack_cli.results.columns import LayoutError
from support.damage import Arrays, damaged_arrays, wild_numbers
from support.mono_scene import Scene as MonoScene
from support.mono_scene import map_skin_soon
from support.stereo_scene import FEW, Told
from support.stereo_scene import Scene as StereoScene

Put = Callable[[Arrays], object]
Saved = tuple[Put, Callable[[Any], object], Arrays]
"""What puts a state together, a step from it, and a real state's arrays."""


@pytest.fixture(scope="module", autouse=True)
def _soon() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patched:
        map_skin_soon(patched)
        yield


def stereo(frames: int = 5, passes: int = 1) -> Saved:
    scene = StereoScene(config=FEW.model_copy(update={"run": RunSettings(passes=passes)}))
    for index in range(frames):
        scene.step(index)
    arrays = scene.tracker.codec.to_arrays(scene.state)
    frame = scene.frame(frames)
    return (
        scene.tracker.codec.from_arrays,
        lambda state: scene.tracker.step(state, frame, np.random.default_rng(0)),
        arrays,
    )


def searching() -> Saved:
    scene = StereoScene(told=Told(there=False))
    scene.step(0, blank=True)
    frame = scene.frame(1)
    arrays = scene.tracker.codec.to_arrays(scene.state)
    put = scene.tracker.codec.from_arrays
    return put, lambda state: scene.tracker.step(state, frame, np.random.default_rng(0)), arrays


def mono(frames: int, known: Arrays | None = None) -> Saved:
    """In the middle of collecting faces, or following one."""
    scene = MonoScene(known=known)
    for index in range(frames):
        scene.step(index)
    tracker = scene.tracker
    arrays = tracker.codec.to_arrays(scene.state)
    frame = scene.frame(frames)
    scene.told.index = frames
    put = tracker.codec.from_arrays
    return put, lambda state: tracker.step(state, frame, np.random.default_rng(0)), arrays


def on_skin() -> Saved:
    """In a second pass, with a map of the skin."""
    scene = MonoScene()
    for index in range(20):
        scene.step(index)
    known = scene.tracker.learned(scene.state, for_second_pass=True)
    assert "person0.skin_map.images" in known
    return mono(3, known)


STATES: dict[str, Callable[[], Saved]] = {
    "stereo": stereo,
    "stereo, first of two passes": lambda: stereo(5, passes=2),
    "stereo, searching": searching,
    "mono, collecting": lambda: mono(2),
    "mono, following": lambda: mono(14),
    "mono, on its skin": on_skin,
}


@pytest.fixture(scope="module", params=STATES)
def saved(request: pytest.FixtureRequest) -> Saved:
    return STATES[request.param]()


def test_the_state_itself_is_taken(saved: Saved) -> None:
    put, step, arrays = saved
    step(put(arrays))


def test_every_array_is_needed_and_of_its_type_and_shape(saved: Saved) -> None:
    """But for those of one kind in each other's place: they are a state, if another one."""
    put, step, arrays = saved
    for what, damaged in damaged_arrays(arrays):
        try:
            state = put(damaged)
        except LayoutError as error:
            assert "\n" not in str(error)
            continue
        assert " and " in what and {a.dtype for a in damaged.values()} == {a.dtype for a in arrays.values()}
        attempt(step, state)


def test_numbers_that_are_none_are_refused_or_do_no_harm(saved: Saved) -> None:
    """NaN stands for what was not seen, in a few arrays; a tracker goes on with it as it always did."""
    put, step, arrays = saved
    taken = []
    for what, damaged in wild_numbers(arrays):
        try:
            state = put(damaged)
        except LayoutError:
            continue
        taken.append(what)
        attempt(step, state)
    missing = ("pixels", "centres", "tangents", "single")
    usual = {f"{name} with nan" for name in arrays if name.endswith(missing)}
    assert set(taken) <= usual | {f"{name} of -1" for name in arrays if name.endswith(("stamps", "_ns"))}


def attempt(step: Callable[[Any], object], state: object) -> None:
    """Go on from a state: it works, or is one line; warnings are errors."""
    try:
        step(state)
    except PosetrackError as error:
        assert "\n" not in str(error)


def test_nothing_is_no_state(saved: Saved) -> None:
    with pytest.raises(LayoutError, match="is missing"):
        saved[0]({})
