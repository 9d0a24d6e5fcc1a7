"""Smoothed tracks, and two passes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Generic, NamedTuple, Protocol, Self, TypeAlias, TypeVar

import numpy as np

from posetrack_cli.errors import EXIT_DATA_LOST, RecordingError, ResultError
from posetrack_cli.filtering.smoothing import NOTHING, Memory, Smoothed, Smoother, Step
from posetrack_cli.outputs import part_path, state_path
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.columns import (
    COUNTS,
    STAMPS_NS,
    Layout,
    LayoutError,
    check_arrays,
    check_numbers,
    counts,
    floats,
)
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.spool import RESTART_HINT, Array, Checkpoint, RecordSpool
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.loop import RunState, Tracker
from posetrack_cli.tracking.options import RunOptions, RunOutcome
from posetrack_cli.tracking.run import Report, Run, Stopped

# A smoothed track: what a smoother keeps of each frame, spooled, and smoothed backwards


Described = TypeVar("Described")
STATUSES = tuple(Status)
KEPT, BESIDES = "filter.", "frame."
"""What names of a record begin with that are the smoother's, and that are kept for ``describe`` besides."""
_NO_FRAME = {"frame_index": 0, "stamp_ns": 0, "status": 0, "cut": 0, "dt": 0.0, "confidence": 0.0}


class FrameFacts(NamedTuple):
    """What an estimate says of its frame, smoothed or not: fields of ``Estimate``."""

    frame_index: int
    stamp_ns: int
    status: Status
    confidence: float

    @classmethod
    def of(cls, estimate: Estimate) -> FrameFacts:
        """Return those of an estimate."""
        return cls(*(getattr(estimate, name) for name in cls._fields))


Describe: TypeAlias = Callable[[Smoothed, FrameFacts, Memory], Described]
"""Makes what is written of a smoothed state, of its frame, and of what was kept of it."""


class Kept(NamedTuple):
    """What a file of an interrupted run is to hold.

    Attributes:
        frames: how many of them stay; 1 or more.
        state: any that the smoother remembers, and
        frame: what is kept of any frame: those that stay have to be of the same arrays.
    """

    frames: int
    state: Any
    frame: Memory = NOTHING


class SmoothedTrack(Generic[Described]):
    """Remembers every frame of a run and then smooths them, from the last to the first.

        with SmoothedTrack(path, smoother, describe, kept) as track:
            track.remember(state.particles, FrameFacts.of(estimate), dt, cut, frame)  # each frame
            track.flush()                                           # before a checkpoint
            for estimate in track.backward(): ...                   # at the end
            track.delete()

    A chain of frames is smoothed as one; a re-initialised track begins another. The memory is a file,
    and what is held of it does not grow with the recording.

    Args:
        path: of the file, beside the result.
        smoother: the backward pass.
        describe: makes the estimates.
        kept: of an interrupted run; None for nothing.

    Raises:
        ResultError: here and in every method, when the file cannot be written or read, or holds what no run
            wrote.
    """

    def __init__(
        self, path: Path, smoother: Smoother, describe: Describe[Described], kept: Kept | None = None
    ) -> None:
        self._path, self._smoother, self._describe = path, smoother, describe
        if kept is None:
            self._spool = RecordSpool(path)
            return
        like = _record(_NO_FRAME, smoother.remember(kept.state, Step(0.0, True, kept.frame)), kept.frame)
        self._spool = RecordSpool(path, kept.frames, like)
        try:
            smoother.resume(self._memory_of(next(reversed(self._spool))))
        except BaseException:
            self._spool.close()
            raise

    def __len__(self) -> int:
        return len(self._spool)

    def remember(self, state: Any, facts: FrameFacts, dt: float, cut: bool, frame: Memory = NOTHING) -> None:
        """Keep what is known after a frame.

        Args:
            state: as the smoother remembers it, such as a filter's.
            facts: what was written of the frame.
            dt: seconds that the state advanced by to this frame; 0 if it stood still.
            cut: whether the state does not follow from the frame before: at the first, or re-initialised.
            frame: what is kept of it besides, for the smoother's fits and for ``describe``.
        """
        numbers = facts._asdict() | {"status": STATUSES.index(facts.status), "cut": int(cut), "dt": dt}
        numbers["confidence"] = float(facts.confidence)
        about = {name: numbers[name] for name in _NO_FRAME}
        self._spool.append(_record(about, self._smoother.remember(state, Step(dt, cut, frame)), frame))

    def flush(self) -> None:
        """Wait until everything is on the disk."""
        self._spool.flush()

    def backward(self) -> Iterator[Described]:
        """Yield what is made of the smoothed states, the last frame first.

        Status and confidence are those of the filter, which say whether the frame itself was understood.
        """
        later, ends, dt = None, True, 0.0
        for record in reversed(self._spool):
            memory = self._memory_of(record)
            if later is None or ends:
                later = self._smoother.begin(memory)
            else:
                later = self._smoother.back(memory, dt) if dt > 0.0 else self._smoother.stay(memory, later)
            ends, dt = bool(record["cut"]), float(record["dt"])
            yield self._describe(later, _facts(record), memory | _named(record, BESIDES))

    def delete(self) -> None:
        """Remove the file."""
        self._spool.delete()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Let the file lie, for a run that is resumed."""
        self._spool.close()

    def _memory_of(self, record: dict[str, Array]) -> dict[str, Array]:
        """What of a record is the smoother's, once all of the record is known to be what a run wrote."""
        try:
            check_arrays(record, _layouts(record))
        except LayoutError as error:
            what = "spool cannot be used"
            raise ResultError(what, where=self._path, found=error, hint=RESTART_HINT) from error
        return _named(record, KEPT)


def smoothing_path(output: Path) -> Path:
    """The file beside a result in which a run remembers what it will smooth."""
    return output.with_name(f"{output.name}.part.frames")


def _facts(record: Mapping[str, Array]) -> FrameFacts:
    return FrameFacts(
        int(record["frame_index"]),
        int(record["stamp_ns"]),
        STATUSES[int(record["status"])],
        float(record["confidence"]),
    )


def _record(about: Mapping[str, float], memory: Memory, frame: Memory) -> dict[str, Array]:
    """The record of a frame; what a smoother has kept of it itself is not kept twice."""
    kept = {f"{KEPT}{name}": values for name, values in memory.items()}
    besides = {f"{BESIDES}{name}": values for name, values in frame.items() if name not in memory}
    return {name: np.asarray(value) for name, value in (dict(about) | kept | besides).items()}


def _named(record: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    """What of a record has names that begin with this, which is taken off."""
    named = ((name, values) for name, values in record.items() if name.startswith(prefix))
    return {name.removeprefix(prefix): values for name, values in named}


def _layouts(record: Mapping[str, Array]) -> dict[str, Layout]:
    """What the values of a record must be; its types and shapes are those of all others."""
    most = float(STAMPS_NS[1])
    layouts = {
        name: Layout(values.dtype.name, values.shape, -np.inf if values.ndim else 0.0, most)
        for name, values in record.items()
    }
    layouts["status"] = counts(most=len(STATUSES) - 1)
    layouts["cut"] = counts(most=1)
    layouts["dt"] = floats(least=0.0)
    return layouts


# Runs in two passes: what the first one learns, the second begins with, and only the second is written


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
