"""Two-pass runs: the second pass starts with what the first has learned; only the second is written."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Generator
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
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.spool import Checkpoint
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.loop import RunState, Tracker
from posetrack_cli.tracking.options import RunOptions, RunOutcome
from posetrack_cli.tracking.run import Report, Run, Stopped

State = TypeVar("State")
Learned: TypeAlias = dict[str, np.ndarray[Any, Any]]
"""Learned arrays of a tracker, by name."""

FIRST_PASS_FRAME = "first_pass_frame"
_LEARNED = "learned:"


class NothingFoundError(RecordingError):
    """The subject was not detected in any frame."""


class NothingTrackedError(NothingFoundError):
    """The subject was not detected although all frames were searched."""

    exit_code = EXIT_DATA_LOST


class LearningTracker(Tracker[State], Protocol[State]):
    """Tracker that detects its subject by itself and learns its model while tracking.

    Estimates before the first detection are finite and have status lost.
    """

    def start(self, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before the first frame, without a detected subject."""

    def learned(self, state: State, *, for_second_pass: bool = False) -> Learned:
        """Return what was learned; empty before the first detection.

        It can initialise another tracker for other recordings of the subject or, with ``for_second_pass``,
        for a second pass. The latter also includes what is specific to this recording.
        """

    def not_found(self, state: State) -> str:
        """Describe the unsuccessful search; empty after a detection.

        The text, such as ``600 frames searched, best score 0.31``, completes "no face found".
        """

    def remarks(self, state: State) -> tuple[str, ...]:
        """Return notes for the user about a finished run, one line each."""


MakeTracker: TypeAlias = Callable[[Learned | None], LearningTracker[Any]]
"""Creates a tracker, optionally from what another one has learned."""


class TwoPassRun(Run):
    """Run with one or two passes; see ``Run``.

    Args:
        recording: recording to track.
        options: frame selection and output.
        flush_frames: estimates between two checkpoints.
        passes: 1 or 2.
        make_tracker: creates the tracker of each pass.
        first_pass: called with every estimate of a first pass, which are not written.
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
        self._learned: Learned = {}  # set when the second pass begins

    @abstractmethod
    def learned_by(self, state: Any, *, for_second_pass: bool = False) -> Learned:
        """Return what the tracker has learned; see ``LearningTracker.learned``.

        Raises:
            NothingFoundError: nothing was detected.
        """

    def after_first_pass(self, state: Any) -> Any:
        """Return the state from which a second pass starts, by default that after the last frame."""
        return state

    def estimates(self, stopped: Stopped = lambda: False) -> Generator[Estimate, None, RunOutcome]:
        """Track every frame; see ``Run.estimates``. Only the last pass yields estimates.

        Raises:
            NothingFoundError: nothing was detected in any frame; no file is left except that of an earlier,
                interrupted run.
        """
        try:
            return (yield from super().estimates(stopped))
        except NothingFoundError:
            if not self._options.resume:  # the unfinished result of an earlier run is kept
                for path in (part_path(self._options.output), state_path(self._options.output)):
                    path.unlink(missing_ok=True)
            raise

    def run_state_at(self, checkpoint: Checkpoint) -> RunState:
        """Return the state at an interruption of either pass."""
        learned = learned_before(checkpoint)
        if learned:
            self._begin_second_pass(learned)
        return super().run_state_at(as_of_one_pass(checkpoint))

    def checkpoint(self, run_state: RunState, frames: int) -> Checkpoint:
        """Return the checkpoint after a written frame."""
        return within_second_pass(super().checkpoint(run_state, frames), self._learned)

    def before_writing(self, writer: ResultWriter, run_state: RunState, stopped: Stopped) -> RunState | None:
        """Do the first of two passes unless it is complete; it may determine the subjects."""
        if self._passes == 1 or self._learned:
            return run_state
        learned = self._first_pass(writer, run_state, stopped)
        if learned is None:
            return None
        before = self.subjects
        self._begin_second_pass(learned)
        if self.subjects is not before:
            writer.restart(self.subjects)
        beginning = RunState(None, self.new_rng())
        writer.save_checkpoint(self.checkpoint(beginning, 0))
        return beginning

    def _first_pass(self, writer: ResultWriter, run_state: RunState, stopped: Stopped) -> Learned | None:
        """Track without writing; return what was learned, or None if stopped."""
        with closing(self._frames()) as frames:
            for step in self.steps(frames, run_state):
                run_state = step.after
                self._tracked += 1
                self._first_pass_report(step.estimate)
                if self._tracked % self._flush_frames == 0:
                    writer.save_checkpoint(within_first_pass(super().checkpoint(run_state, 0)))
                if stopped():
                    return None
        return self.learned_by(self.after_first_pass(run_state.state), for_second_pass=True)

    def _begin_second_pass(self, learned: Learned) -> None:
        self._learned = learned
        self.tracker = self._make_tracker(learned)


def within_first_pass(checkpoint: Checkpoint) -> Checkpoint:
    """Return a checkpoint of the first pass, during which the result is empty."""
    state = {**checkpoint.state, FIRST_PASS_FRAME: checkpoint.frame_index}
    return replace(checkpoint, frame_index=-1, state=state)


def within_second_pass(checkpoint: Checkpoint, learned: Learned) -> Checkpoint:
    """Return a checkpoint of the second pass, including what it started from."""
    kept = {f"{_LEARNED}{name}": values for name, values in learned.items()}
    return replace(checkpoint, arrays={**checkpoint.arrays, **kept})


def learned_before(checkpoint: Checkpoint) -> Learned:
    """Return what the first pass learned; empty during the first pass."""
    arrays = checkpoint.arrays.items()
    return {name.removeprefix(_LEARNED): values for name, values in arrays if name.startswith(_LEARNED)}


def as_of_one_pass(checkpoint: Checkpoint) -> Checkpoint:
    """Return a checkpoint of either pass in the form of a single-pass run.

    Raises:
        LayoutError: its frame number is invalid.
    """
    arrays = {name: v for name, v in checkpoint.arrays.items() if not name.startswith(_LEARNED)}
    index = checkpoint.frame_index
    if FIRST_PASS_FRAME in checkpoint.state:
        check_numbers(checkpoint.state, {FIRST_PASS_FRAME: COUNTS})
        index = checkpoint.state[FIRST_PASS_FRAME]
    return replace(checkpoint, arrays=arrays, frame_index=index)
