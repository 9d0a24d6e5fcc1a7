"""The loop over frames: what it asks of any tracker, its steps, and its state as a checkpoint."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import FLAGS, LayoutError, Stamp, check_numbers, floats
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.spool import Checkpoint
from posetrack_cli.tracking.state_codec import Codec, Maybe, codec_of, joined, part_of

State = TypeVar("State")


class Tracker(Protocol[State]):
    """A tracker: pure steps from one state to the next, and states that can be saved.

    How a state begins differs between hands and heads; their own protocols add it.
    """

    def step(self, state: State, frame: Frame, rng: np.random.Generator) -> tuple[State, Estimate]:
        """Advance by one frame; the state given is left as it is."""

    @property
    def codec(self) -> Codec[State]:
        """How states become arrays, for a checkpoint, and back."""


StartState = Callable[[Frame, np.random.Generator], Any]
"""Makes a tracker's state before a first frame."""


_MOST = 1e30
"""Of what a belief holds: poses that leap give velocities without a meaning, but with a number."""


class VelocityBelief(NamedTuple):
    """What is believed of a body's motion after a frame (``tracking.velocity``).

    Attributes:
        stamp_ns: of the frame.
        pose: (1 + D,) position, quaternion and shape entries.
        velocity: (D,) in the tangent space.
        covariance: (3, D) variance of the pose, covariance of pose and velocity, variance of the velocity.
        surprise: (D,) square of the last innovation over its variance; 1 where there was none.
    """

    stamp_ns: Stamp
    pose: Annotated[FloatArray, replace(floats("pose entries"), unit=(3, 7))]
    velocity: Annotated[FloatArray, floats("velocities", least=-_MOST, most=_MOST)]
    covariance: Annotated[FloatArray, floats(3, "velocities", least=-_MOST, most=_MOST)]
    surprise: Annotated[FloatArray, floats("velocities", least=0.0, most=_MOST)]


class RunState(NamedTuple):
    """Where a pass is.

    Attributes:
        state: the tracker's, None before its first frame.
        rng: the random generator.
        frame_index: of the last frame tracked, -1 before the first.
        velocity: what is believed of the motion; None where nothing is.
    """

    state: Any
    rng: np.random.Generator
    frame_index: int = -1
    velocity: VelocityBelief | None = None


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
    state, rng, last = run_state.state, run_state.rng, run_state.frame_index
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


_VELOCITY = "run_velocity"
"""What the arrays of a velocity's belief are called in a checkpoint, beside those of the tracker."""
_VELOCITY_CODEC = Maybe(codec_of(VelocityBelief))
_BITS_32, _BITS_128 = (0, (1 << 32) - 1), (0, (1 << 128) - 1)


def checkpoint_of(tracker: Tracker[Any], run_state: RunState, frames: int) -> Checkpoint:
    """Return the checkpoint after a frame, of which ``frames`` are written."""
    record: dict[str, Any] = {"rng": run_state.rng.bit_generator.state}
    if run_state.state is None:
        return Checkpoint(run_state.frame_index, frames, {}, record)
    motion = _VELOCITY_CODEC.to_arrays(run_state.velocity)
    arrays = tracker.codec.to_arrays(run_state.state) | {
        joined(_VELOCITY, name): v for name, v in motion.items()
    }
    return Checkpoint(run_state.frame_index, frames, arrays, record)


def run_state_at(tracker: Tracker[Any], checkpoint: Checkpoint, rng: np.random.Generator) -> RunState:
    """Return where a checkpoint was saved; the generator given is set to where it was.

    Raises:
        LayoutError: it is of no state of this tracker, or of no such generator.
    """
    record, index = checkpoint.state, checkpoint.frame_index
    _set_state(rng, record.get("rng"))
    if index < 0:
        return RunState(None, rng, index)
    motion = part_of(checkpoint.arrays, _VELOCITY)
    own = {name: v for name, v in checkpoint.arrays.items() if not name.startswith(f"{_VELOCITY}.")}
    return RunState(tracker.codec.from_arrays(own), rng, index, _VELOCITY_CODEC.from_arrays(motion))


def _set_state(rng: np.random.Generator, state: Any) -> None:
    """Set a generator (PCG64, as ``numpy.random.default_rng`` makes it) to where another was."""
    kind = rng.bit_generator.state["bit_generator"]
    if not isinstance(state, dict) or state.get("bit_generator") != kind:
        raise LayoutError(f"no state of the random generator {kind}")
    check_numbers(state, {"has_uint32": FLAGS, "uinteger": _BITS_32})
    check_numbers(state.get("state"), {"state": _BITS_128, "inc": _BITS_128})
    rng.bit_generator.state = state
