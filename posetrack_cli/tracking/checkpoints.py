"""A run's state as a checkpoint, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from posetrack_cli.results.checkpoint import Checkpoint
from posetrack_cli.results.layouts import FLAGS, LayoutError, check_numbers
from posetrack_cli.tracking.loop import RunState
from posetrack_cli.tracking.protocol import Tracker

_BITS_32, _BITS_128 = (0, (1 << 32) - 1), (0, (1 << 128) - 1)


def checkpoint_of(tracker: Tracker[Any], run_state: RunState, frames: int) -> Checkpoint:
    """Return the checkpoint after a frame, of which ``frames`` are written."""
    record: dict[str, Any] = {"rng": run_state.rng.bit_generator.state}
    if run_state.state is None:
        return Checkpoint(run_state.frame_index, frames, {}, record)
    return Checkpoint(run_state.frame_index, frames, tracker.codec.to_arrays(run_state.state), record)


def run_state_at(tracker: Tracker[Any], checkpoint: Checkpoint, rng: np.random.Generator) -> RunState:
    """Return where a checkpoint was saved; the generator given is set to where it was.

    Raises:
        LayoutError: it is of no state of this tracker, or of no such generator.
    """
    record, index = checkpoint.state, checkpoint.frame_index
    _set_state(rng, record.get("rng"))
    if index < 0:
        return RunState(None, rng, index)
    return RunState(tracker.codec.from_arrays(checkpoint.arrays), rng, index)


def _set_state(rng: np.random.Generator, state: Any) -> None:
    """Set a generator (PCG64, as ``numpy.random.default_rng`` makes it) to where another was."""
    kind = rng.bit_generator.state["bit_generator"]
    if not isinstance(state, dict) or state.get("bit_generator") != kind:
        raise LayoutError(f"no state of the random generator {kind}")
    check_numbers(state, {"has_uint32": FLAGS, "uinteger": _BITS_32})
    check_numbers(state.get("state"), {"state": _BITS_128, "inc": _BITS_128})
    rng.bit_generator.state = state
