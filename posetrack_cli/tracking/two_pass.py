"""Runs in two passes: what the first one learns, the second begins with, and only the second is written."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np

from posetrack_cli.errors import EXIT_DATA_LOST, RecordingError
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.columns import (
    COUNTS,
    check_numbers,
)
from posetrack_cli.results.spool import Checkpoint
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.loop import RunState, Tracker
from posetrack_cli.tracking.options import RunOptions, RunOutcome
from posetrack_cli.tracking.run import Report, Run, Stopped

State = TypeVar("State")
Learned: TypeAlias = dict[str, np.ndarray[Any, Any]]
"""What a tracker has learned, as arrays by name."""

FIRST_PASS_FRAME = "first_pass_frame"
_LEARNED = "learned:"


class NothingFoundError(RecordingError):
    """What is to be tracked was found in no frame of a recording."""


class NothingTrackedError(NothingFoundError):
    """All frames were searched: as of a run that tracked hardly any of its frames."""

    exit_code = EXIT_DATA_LOST


class LearningTracker(Tracker[State], Protocol[State]):
    """A tracker that finds what it tracks by itself, and learns it while it tracks.

    What it says of frames before the first find is finite, too; their status is lost.
    """

    def start(self, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame, in which the subject has yet to be found."""

    def learned(self, state: State, *, for_second_pass: bool = False) -> Learned:
        """Return what was learned; empty before anything is found.

        Another tracker can begin with it: of another recording of the same subject, or in a second pass, for
        which it also says what holds in this recording alone.
        """

    def not_found(self, state: State) -> str:
        """Say how it was looked for without being found in any frame yet; empty once it was found.

        Such as ``600 frames searched, best score 0.31``: it completes "no face found".
        """

    def remarks(self, state: State) -> tuple[str, ...]:
        """Say what a user should know about a finished run beside its numbers; each is one line."""


MakeTracker: TypeAlias = Callable[[Learned | None], LearningTracker[Any]]
"""Makes a tracker that begins with what another has learned, or with nothing."""


class TwoPassRun(Run):
    """A run that tracks once or twice; see ``Run``.

    Args:
        recording: frames.
        options: which frames, and where to.
        flush_frames: estimates between two checkpoints.
        passes: 1 or 2.
        make_tracker: of each pass.
        first_pass: called with every estimate of the first of two passes; none of them is written.
    """

    tracker: LearningTracker[Any]

    def __init__(
        self,
        recording: Recording,
        options: RunOptions,
        flush_frames: int,
        passes: int,
        make_tracker: MakeTracker,
        first_pass: Report,
    ) -> None:
        super().__init__(recording, options, flush_frames)
        self._passes, self._make_tracker, self._first_pass_report = passes, make_tracker, first_pass
        self._learned: Learned = {}  # in the first of two passes, once the second has begun

    @abstractmethod
    def learned_by(self, state: Any, *, for_second_pass: bool = False) -> Learned:
        """Return what the tracker has learned, see ``LearningTracker.learned``.

        Raises:
            NothingFoundError: nothing was found that it could learn.
        """

    def track(self, report: Report, stopped: Stopped = lambda: False) -> RunOutcome:
        """Track every frame; see ``Run.track``.

        Raises:
            NothingFoundError: nothing was found in any frame; nothing is left that would have to be
                overwritten, but for what was interrupted before.
        """
        try:
            return super().track(report, stopped)
        except NothingFoundError:
            if not self._options.resume:  # what is resumed is never deleted, whatever is found in it
                for path in (part_path(self._options.output), state_path(self._options.output)):
                    path.unlink(missing_ok=True)
            raise

    def run_state_at(self, checkpoint: Checkpoint) -> RunState:
        """Return where a run was interrupted, in either pass."""
        learned = learned_before(checkpoint)
        if learned:
            self._begin_second_pass(learned)
        return super().run_state_at(as_of_one_pass(checkpoint))

    def checkpoint(self, run_state: RunState, frames: int) -> Checkpoint:
        """Return the checkpoint after a frame that was written."""
        return within_second_pass(super().checkpoint(run_state, frames), self._learned)

    def before_writing(self, writer: ResultWriter, run_state: RunState, stopped: Stopped) -> RunState | None:
        """Do the first of two passes, if it is not done."""
        if self._passes == 1 or self._learned:
            return run_state
        learned = self._first_pass(writer, run_state, stopped)
        if learned is None:
            return None
        self._begin_second_pass(learned)
        beginning = RunState(None, self.new_rng())
        writer.save_checkpoint(self.checkpoint(beginning, 0))
        return beginning

    def _first_pass(self, writer: ResultWriter, run_state: RunState, stopped: Stopped) -> Learned | None:
        """Track without writing; return what was learned, None if stopped."""
        with closing(self._frames()) as frames:
            for step in self.steps(frames, run_state):
                run_state = step.after
                self._tracked += 1
                self._first_pass_report(step.estimate)
                if self._tracked % self._flush_frames == 0:
                    writer.save_checkpoint(within_first_pass(super().checkpoint(run_state, 0)))
                if stopped():
                    return None
        return self.learned_by(run_state.state, for_second_pass=True)

    def _begin_second_pass(self, learned: Learned) -> None:
        self._learned = learned
        self.tracker = self._make_tracker(learned)


def within_first_pass(checkpoint: Checkpoint) -> Checkpoint:
    """Return the checkpoint of a frame of the first pass, before anything is in the result."""
    state = {**checkpoint.state, FIRST_PASS_FRAME: checkpoint.frame_index}
    return replace(checkpoint, frame_index=-1, state=state)


def within_second_pass(checkpoint: Checkpoint, learned: Learned) -> Checkpoint:
    """Return the checkpoint within the second pass, with what it began with."""
    kept = {f"{_LEARNED}{name}": values for name, values in learned.items()}
    return replace(checkpoint, arrays={**checkpoint.arrays, **kept})


def learned_before(checkpoint: Checkpoint) -> Learned:
    """Return what the first pass learned; empty within it."""
    arrays = checkpoint.arrays.items()
    return {name.removeprefix(_LEARNED): values for name, values in arrays if name.startswith(_LEARNED)}


def as_of_one_pass(checkpoint: Checkpoint) -> Checkpoint:
    """Return a checkpoint of either pass as a run of this pass alone would have saved it.

    Raises:
        LayoutError: its frame is no number.
    """
    arrays = {name: v for name, v in checkpoint.arrays.items() if not name.startswith(_LEARNED)}
    index = checkpoint.frame_index
    if FIRST_PASS_FRAME in checkpoint.state:
        check_numbers(checkpoint.state, {FIRST_PASS_FRAME: COUNTS})
        index = checkpoint.state[FIRST_PASS_FRAME]
    return replace(checkpoint, arrays=arrays, frame_index=index)
