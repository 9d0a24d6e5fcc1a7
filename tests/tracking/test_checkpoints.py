"""A checkpoint gives back how far a run has come, random numbers included."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posetrack_cli.results import spool
from posetrack_cli.results.spool import Progress
from posetrack_cli.tracking.loop import RunState, checkpoint_of, run_state_at
from support.codecs import TRACKER


def test_state_frame_and_random_numbers_come_back_from_a_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    rng.standard_normal(5)
    saved = checkpoint_of(TRACKER, RunState((np.arange(3.0), 7), rng, 11), 6)
    spool.save(tmp_path / "state", saved, Progress(0, 2, 0, {}))
    loaded, _ = spool.load(tmp_path / "state")
    assert (loaded.frame_index, loaded.frames_written) == (11, 6)
    (total, count), again, index, motion = run_state_at(TRACKER, loaded, np.random.default_rng(0))
    assert (total.tolist(), count, index, motion) == ([0.0, 1.0, 2.0], 7, 11, ())
    assert again.standard_normal(9).tolist() == rng.standard_normal(9).tolist()


def test_before_the_first_frame_there_is_no_state() -> None:
    saved = checkpoint_of(TRACKER, RunState(None, np.random.default_rng(4)), 0)
    state, rng, index, _ = run_state_at(TRACKER, saved, np.random.default_rng(0))
    assert state is None and index == -1
    assert rng.integers(1 << 40) == np.random.default_rng(4).integers(1 << 40)
