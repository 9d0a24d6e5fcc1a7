"""Checkpoints of a run in two passes: what is learned in the first is kept while the second goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from posetrack_cli.head.model_file import Learned
from posetrack_cli.results.checkpoint import Checkpoint
from posetrack_cli.results.layouts import COUNTS, check_numbers
from posetrack_cli.tracking.checkpoints import Reached, checkpoint_of, reached_at
from posetrack_cli.tracking.protocol import Tracker

_FIRST_PASS_FRAME = "first_pass_frame"
_LEARNED = "learned:"


def first_pass_checkpoint(tracker: Tracker[Any], reached: Reached) -> Checkpoint:
    """Return the checkpoint within the first pass, before anything is in the result."""
    checkpoint = checkpoint_of(tracker, reached, 0)
    state = {**checkpoint.state, _FIRST_PASS_FRAME: reached.frame_index}
    return replace(checkpoint, frame_index=-1, state=state)


def second_pass_checkpoint(
    tracker: Tracker[Any], reached: Reached, frames: int, learned: Mapping[str, np.ndarray[Any, Any]]
) -> Checkpoint:
    """Return the checkpoint within the second pass, with what it began with."""
    checkpoint = checkpoint_of(tracker, reached, frames)
    kept = {f"{_LEARNED}{name}": values for name, values in learned.items()}
    return replace(checkpoint, arrays={**checkpoint.arrays, **kept})


def learned_before(checkpoint: Checkpoint) -> Learned:
    """Return what the first pass learned; empty within it."""
    arrays = checkpoint.arrays.items()
    return {name.removeprefix(_LEARNED): values for name, values in arrays if name.startswith(_LEARNED)}


def reached_in_pass(tracker: Tracker[Any], checkpoint: Checkpoint, rng: np.random.Generator) -> Reached:
    """Return where a checkpoint of either pass was saved, given the tracker of that pass.

    Raises:
        LayoutError: as of ``reached_at``.
    """
    arrays = {name: v for name, v in checkpoint.arrays.items() if not name.startswith(_LEARNED)}
    index = checkpoint.frame_index
    if _FIRST_PASS_FRAME in checkpoint.state:
        check_numbers(checkpoint.state, {_FIRST_PASS_FRAME: COUNTS})
        index = checkpoint.state[_FIRST_PASS_FRAME]
    return reached_at(tracker, replace(checkpoint, arrays=arrays, frame_index=index), rng)
