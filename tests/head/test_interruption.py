"""A run that is stopped in the middle of a frame, as Ctrl-C does while kernels are compiled."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

from posetrack_cli.head.config import HeadStereoConfig, RunSettings
from posetrack_cli.head.run import HeadRun, HeadRunOptions
from posetrack_cli.head.subject import head_subject
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import Frame
from posetrack_cli.results import Estimate, read_result
from posetrack_cli.tracking.options import RunOutcome
from support.head_run import CAMERAS, COMPONENTS, FakeState, FakeTracker, Memory


class InterruptedTracker(FakeTracker):
    """Compiles something in the given frame, and is interrupted there."""

    def __init__(self, known: Any, frame: int | None, asked: Event) -> None:
        super().__init__(known)
        self._frame, self._asked = frame, asked

    def step(self, state: FakeState, frame: Frame, rng: np.random.Generator) -> tuple[FakeState, Estimate]:
        if frame.index == self._frame:
            self._asked.set()
            raise KeyboardInterrupt
        return super().step(state, frame, rng)


def track(
    path: Path, interrupted: int | None = None, stopped: bool = True, passes: int = 1, **options: Any
) -> RunOutcome:
    asked = Event()
    run = HeadRun(
        Memory(),
        HeadStereoConfig(run=RunSettings(passes=passes)),
        HeadRunOptions(path, **options),
        name="fake",
        subject=head_subject(CAMERAS[0].name, COMPONENTS),
        flush_frames=3,
        make_tracker=lambda known: InterruptedTracker(known, interrupted, asked),
    )
    return run.track(lambda estimate: None, asked.is_set if stopped else lambda: False)


@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("frame", [0, 5, 6])
def test_a_run_that_is_stopped_within_a_frame_resumes_to_the_same_bytes(
    tmp_path: Path, passes: int, frame: int
) -> None:
    whole, path = tmp_path / "whole.mcap", tmp_path / "r.mcap"
    track(whole, passes=passes)
    outcome = track(path, interrupted=frame, passes=passes)
    assert outcome.stopped and not path.exists()
    assert len(list(read_result(part_path(path)).estimates())) == outcome.frames
    assert not track(path, passes=passes, resume=True).stopped
    assert path.read_bytes() == whole.read_bytes()


def test_an_interruption_that_nobody_waits_for_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        track(tmp_path / "r.mcap", interrupted=5, stopped=False)
    assert part_path(tmp_path / "r.mcap").exists()
