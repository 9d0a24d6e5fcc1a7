"""A run's state as a checkpoint, and back."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from posetrack_cli.results.checkpoint import Checkpoint
from posetrack_cli.tracking.protocol import Tracker


class Reached(NamedTuple):
    """How far a run has come.

    Attributes:
        state: the tracker's, None before its first frame.
        rng: the random generator.
        frame_index: of the last frame tracked, -1 before the first.
    """

    state: Any
    rng: np.random.Generator
    frame_index: int = -1


def checkpoint_of(tracker: Tracker[Any], reached: Reached, frames: int) -> Checkpoint:
    """Return the checkpoint after a frame, of which ``frames`` are written."""
    record: dict[str, Any] = {"rng": reached.rng.bit_generator.state}
    if reached.state is None:
        return Checkpoint(reached.frame_index, frames, {}, record)
    arrays, numbers = tracker.state_parts(reached.state)
    return Checkpoint(reached.frame_index, frames, arrays, record | {"numbers": numbers})


def reached_at(tracker: Tracker[Any], checkpoint: Checkpoint, rng: np.random.Generator) -> Reached:
    """Return where a checkpoint was saved; the generator given is set to where it was."""
    record = checkpoint.state
    rng.bit_generator.state = record["rng"]
    if not checkpoint.arrays:
        return Reached(None, rng, checkpoint.frame_index)
    state = tracker.state_from_parts(checkpoint.arrays, record["numbers"])
    return Reached(state, rng, checkpoint.frame_index)
