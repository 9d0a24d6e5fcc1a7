"""The frame loop: tracker interface, steps, and checkpoints of its state."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import FLAGS, LayoutError, Stamp, check_numbers, floats
from posetrack_cli.results.estimate import MOST_SUBJECTS, Estimate
from posetrack_cli.results.spool import Checkpoint
from posetrack_cli.tracking.state_codec import Codec, Maybe, codec_of, joined, part_of

State = TypeVar("State")


class Tracker(Protocol[State]):
    """Tracker: pure steps from one state to the next, with serialisable states.

    A tracker of several subjects returns one estimate per subject. Initial states differ between hands and
    heads; their own protocols add them.
    """

    def step(
        self, state: State, frame: Frame, rng: np.random.Generator
    ) -> tuple[State, Estimate | tuple[Estimate, ...]]:
        """Advance by one frame; the given state is not modified."""

    @property
    def codec(self) -> Codec[State]:
        """Codec of the states, for checkpoints."""


StartState = Callable[[Frame, np.random.Generator], Any]
"""Creates a tracker's state before the first frame."""


_MOST = 1e30
"""Bound on velocity beliefs: jumping poses give meaningless but finite velocities."""


class VelocityBelief(NamedTuple):
    """Belief about a body's motion after a frame (``tracking.velocity``).

    Attributes:
        stamp_ns: time of the frame.
        pose: (1 + D,) position, quaternion and shape parameters.
        velocity: (D,) in the tangent space.
        covariance: (3, D) variance of the pose, covariance of pose and velocity, variance of the velocity.
        surprise: (D,) squared last innovation divided by its variance; 1 if there was none.
    """

    stamp_ns: Stamp
    pose: Annotated[FloatArray, replace(floats("pose entries"), unit=(3, 7))]
    velocity: Annotated[FloatArray, floats("velocities", least=-_MOST, most=_MOST)]
    covariance: Annotated[FloatArray, floats(3, "velocities", least=-_MOST, most=_MOST)]
    surprise: Annotated[FloatArray, floats("velocities", least=0.0, most=_MOST)]


class RunState(NamedTuple):
    """State of a pass.

    Attributes:
        state: tracker state, None before its first frame.
        rng: random generator.
        frame_index: last tracked frame, -1 before the first.
        velocities: belief about the motion of each subject, None if there is none; () before the first frame.
    """

    state: Any
    rng: np.random.Generator
    frame_index: int = -1
    velocities: tuple[VelocityBelief | None, ...] = ()


class Step(NamedTuple):
    """One tracked frame.

    Attributes:
        frame: the frame.
        estimates: its estimates, one per subject.
        after: state of the pass after it.
    """

    frame: Frame
    estimates: tuple[Estimate, ...]
    after: RunState

    @property
    def estimate(self) -> Estimate:
        """The first subject's estimate."""
        return self.estimates[0]


def track_frames(
    tracker: Tracker[Any],
    frames: Iterable[Frame],
    run_state: RunState,
    start_state: StartState,
    *,
    timings: bool = False,
) -> Iterator[Step]:
    """Yield a step for each frame that is not yet tracked.

    Args:
        tracker: performs the steps.
        frames: frames of the recording, from the first one.
        run_state: current state of the pass.
        start_state: creates the state before the first frame.
        timings: set the milliseconds of every estimate, those of all subjects together.
    """
    state, rng, last = run_state.state, run_state.rng, run_state.frame_index
    for frame in frames:
        if frame.index <= last:
            continue
        if state is None:
            state = start_state(frame, rng)
        began = time.perf_counter()
        state, found = tracker.step(state, frame, rng)
        estimates = found if isinstance(found, tuple) else (found,)
        if timings:
            spent = 1e3 * (time.perf_counter() - began)
            estimates = tuple(replace(one, milliseconds=spent) for one in estimates)
        yield Step(frame, estimates, RunState(state, rng, frame.index))


_VELOCITY = "run_velocity"
"""Checkpoint prefix of the velocity belief's arrays."""
_VELOCITY_CODEC = Maybe(codec_of(VelocityBelief))
_SUBJECTS = "subjects"
"""Key of the number of velocity beliefs in a checkpoint."""
_BITS_32, _BITS_128 = (0, (1 << 32) - 1), (0, (1 << 128) - 1)


def checkpoint_of(tracker: Tracker[Any], run_state: RunState, frames: int) -> Checkpoint:
    """Return the checkpoint after a frame, with ``frames`` estimates written."""
    record: dict[str, Any] = {"rng": run_state.rng.bit_generator.state}
    if run_state.state is None:
        return Checkpoint(run_state.frame_index, frames, {}, record)
    arrays = dict(tracker.codec.to_arrays(run_state.state))
    for number, belief in enumerate(run_state.velocities):
        motion = _VELOCITY_CODEC.to_arrays(belief)
        arrays |= {joined(f"{_VELOCITY}.{number}", name): v for name, v in motion.items()}
    record[_SUBJECTS] = len(run_state.velocities)
    return Checkpoint(run_state.frame_index, frames, arrays, record)


def run_state_at(tracker: Tracker[Any], checkpoint: Checkpoint, rng: np.random.Generator) -> RunState:
    """Return the state saved in a checkpoint; also restore the given generator.

    Raises:
        LayoutError: it has no state of this tracker or of this generator type.
    """
    record, index = checkpoint.state, checkpoint.frame_index
    _set_state(rng, record.get("rng"))
    if index < 0:
        return RunState(None, rng, index)
    check_numbers(record, {_SUBJECTS: (0, MOST_SUBJECTS)})
    motions = (part_of(checkpoint.arrays, f"{_VELOCITY}.{number}") for number in range(record[_SUBJECTS]))
    own = {name: v for name, v in checkpoint.arrays.items() if not name.startswith(f"{_VELOCITY}.")}
    beliefs = tuple(_VELOCITY_CODEC.from_arrays(motion) for motion in motions)
    return RunState(tracker.codec.from_arrays(own), rng, index, beliefs)


def _set_state(rng: np.random.Generator, state: Any) -> None:
    """Restore a generator (PCG64, as created by ``numpy.random.default_rng``)."""
    kind = rng.bit_generator.state["bit_generator"]
    if not isinstance(state, dict) or state.get("bit_generator") != kind:
        raise LayoutError(f"state of random generator {kind} is missing")
    check_numbers(state, {"has_uint32": FLAGS, "uinteger": _BITS_32})
    check_numbers(state.get("state"), {"state": _BITS_128, "inc": _BITS_128})
    rng.bit_generator.state = state
