"""The loop over frames: one generator of steps, for every tracker and every pass."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.protocol import Tracker

StartState = Callable[[Frame, np.random.Generator], Any]
"""Makes a tracker's state before a first frame."""


class RunState(NamedTuple):
    """Where a pass is.

    Attributes:
        state: the tracker's, None before its first frame.
        rng: the random generator.
        frame_index: of the last frame tracked, -1 before the first.
    """

    state: Any
    rng: np.random.Generator
    frame_index: int = -1


class Step(NamedTuple):
    """One frame that was tracked.

    Attributes:
        frame: as recorded.
        estimate: of it.
        after: where the pass is then.
    """

    frame: Frame
    estimate: Estimate
    after: RunState


def track_frames(
    tracker: Tracker[Any],
    frames: Iterable[Frame],
    run_state: RunState,
    start_state: StartState,
    *,
    timings: bool = False,
) -> Iterator[Step]:
    """Yield a step for each frame after those that were tracked before.

    Args:
        tracker: makes the steps.
        frames: of the recording, from its first one on.
        run_state: where the pass is.
        start_state: makes the state before the first frame.
        timings: give every estimate the milliseconds that its step took.
    """
    state, rng, last = run_state
    for frame in frames:
        if frame.index <= last:
            continue
        if state is None:
            state = start_state(frame, rng)
        began = time.perf_counter()
        state, estimate = tracker.step(state, frame, rng)
        if timings:
            estimate = replace(estimate, milliseconds=1e3 * (time.perf_counter() - began))
        yield Step(frame, estimate, RunState(state, rng, frame.index))
