"""A run: every frame of a recording through a tracker into a result."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import replace
from itertools import chain
from typing import Any, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, loss_line
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.recording.timeline import StampCheck
from posetrack_cli.results.checkpoint import Checkpoint
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.checkpoints import Reached, checkpoint_of, reached_at
from posetrack_cli.tracking.options import RunOptions, RunOutcome, frames_ahead, nothing_to_track
from posetrack_cli.tracking.protocol import Tracker
from posetrack_cli.tracking.truth import truth_carrier

Report = Callable[[Estimate], None]
Stopped = Callable[[], bool]


class FrameMemory(Protocol):
    """What a run keeps of every frame, to write more once the last one is tracked: the smoothed track."""

    def remember(self, state: Any, estimate: Estimate) -> None:
        """Keep what is needed of a frame."""

    def flush(self) -> None:
        """Wait until everything is on the disk, before a checkpoint says so."""

    def finish(self, writer: ResultWriter) -> None:
        """Write what rests on all frames, and forget them."""


class Run(ABC):
    """One run of a tracker over a recording; what is a hand's or a head's own is added by a subclass.

    Args:
        recording: frames.
        options: which frames, and where to.
        flush_frames: estimates between two checkpoints.

    Raises:
        UsageError: no frame to track; no file is made that would have to be overwritten.
    """

    tracker: Tracker[Any]
    _record: Mapping[str, str]
    """The run record; set by the subclass."""

    def __init__(self, recording: Recording, options: RunOptions, flush_frames: int) -> None:
        self._recording, self._options, self._flush_frames = recording, options, flush_frames
        self._tracked = 0  # frames, by this run alone
        self._stamps = StampCheck()
        if frames_ahead(recording, options) == 0:
            raise nothing_to_track(recording)

    def track(self, report: Report, stopped: Stopped = lambda: False) -> RunOutcome:
        """Track every frame.

        Args:
            report: called with every estimate once it is written.
            stopped: asked after every frame whether to stop; the result then stays unfinished.

        Raises:
            UsageError, RecordingError: there is no frame to track; no file is made.
            PosetrackError: the recording or the result fails; what was flushed stays as NAME.part.
        """
        began = time.perf_counter()
        with closing(self._frames()) as frames:
            first = next(frames, None)
            if first is None:
                raise nothing_to_track(self._recording)
            return self._track(chain((first,), frames), began, report, stopped)

    # What a subclass says of its subject

    @abstractmethod
    def _subject(self) -> Subject:
        """What is tracked."""

    @abstractmethod
    def _started(self, frame: Frame, rng: np.random.Generator) -> Any:
        """The tracker's state before the first frame."""

    def _cameras(self) -> tuple[Camera, ...]:
        """The cameras that the result states, the one that estimates are relative to first."""
        return self._recording.cameras[:1]

    @abstractmethod
    def _noted(self, frame: Frame) -> None:
        """Look at every frame that is read, also at those that were tracked before an interruption."""

    def _vertices(self, estimate: Estimate) -> FloatArray | None:
        """The mesh (V, 3) to draw of an estimate, mm, camera axes; None for none."""
        return None

    def _memory(self, writer: ResultWriter) -> AbstractContextManager[FrameMemory | None]:
        """What is kept of every frame; None where nothing is."""
        return nullcontext()

    def _reached(self, checkpoint: Checkpoint) -> Reached:
        """Where a run was interrupted; LayoutError or ResultError if its tracker says nothing of it."""
        return reached_at(self.tracker, checkpoint, self._rng())

    def _begun(self, writer: ResultWriter, reached: Reached, stopped: Stopped) -> Reached | None:
        """Where to write from, given where the run starts or was interrupted; None if stopped on the way."""
        return reached

    def _saved(self, reached: Reached, frames: int) -> Checkpoint:
        """The checkpoint after a frame."""
        return checkpoint_of(self.tracker, reached, frames)

    def _ended(self, writer: ResultWriter, state: Any) -> dict[str, str]:
        """Write what comes last in the result; return what its summary says of it."""
        return {}

    def _losses(self) -> tuple[Loss, ...]:
        """Data that could not be used."""
        return self._recording.losses

    def _remarks(self, state: Any) -> tuple[str, ...]:
        """What else a user should know once all frames are tracked, one line each."""
        return ()

    # The loop

    def _track(self, frames: Iterable[Frame], began: float, report: Report, stopped: Stopped) -> RunOutcome:
        writer, reached = self._open()
        with writer, _stopped_at_once(stopped):
            begun = self._begun(writer, reached, stopped)
            if begun is None:
                return self._outcome(writer, began, stopped=True)
            state, rng, last = begun
            with closing(self._truth(writer)) as truth, self._memory(writer) as memory:
                for frame in frames:
                    self._noted(frame)
                    self._stamps.add(frame.index, frame.stamp_ns)
                    if frame.index <= last:
                        continue  # tracked before the interruption
                    if state is None:
                        state = self._started(frame, rng)
                    state, estimate = self._timed_step(state, frame, rng)
                    truth.send(frame.stamp_ns)
                    self._write(writer, memory, Reached(state, rng, frame.index), estimate)
                    report(estimate)
                    self._tracked += 1
                    if stopped():
                        return self._outcome(writer, began, stopped=True)
                if memory is not None:
                    memory.finish(writer)
                remarks = self._stamps.remarks + self._remarks(state)
                self._finish(writer, state, remarks)
            return replace(self._outcome(writer, began, stopped=False), remarks=remarks)
        return self._outcome(writer, began, stopped=True)

    def _write(
        self, writer: ResultWriter, memory: FrameMemory | None, reached: Reached, estimate: Estimate
    ) -> None:
        """Write an estimate, and a checkpoint where the result is flushed."""
        if memory is not None:
            memory.remember(reached.state, estimate)
        if writer.write(estimate, self._vertices(estimate)):
            if memory is not None:
                memory.flush()
            writer.save_checkpoint(self._saved(reached, writer.frames_written))

    def _open(self) -> tuple[ResultWriter, Reached]:
        """The writer, and where to begin; what was interrupted is put together before any file is touched."""
        options, flush = self._options, self._flush_frames
        camera, *others = self._cameras()
        about = self._subject(), camera, self._record
        if options.resume:
            writer, checkpoint = ResultWriter.resume(
                options.output, *about, others=others, flush_frames=flush, check=self._reached
            )
            return writer, self._reached(checkpoint)
        overwrite = options.overwrite
        writer = ResultWriter(options.output, *about, others=others, flush_frames=flush, overwrite=overwrite)
        start = Reached(None, self._rng())
        writer.save_checkpoint(checkpoint_of(self.tracker, start, 0))
        return writer, start

    def _rng(self) -> np.random.Generator:
        """The random generator at the start of a pass."""
        return np.random.default_rng(self._options.seed)

    def _frames(self) -> Any:
        options = self._options
        return self._recording.frames(start=options.start, end=options.end, stride=options.stride)

    def _truth(self, writer: ResultWriter) -> Generator[None, int]:
        return truth_carrier(iter(self._recording.truth()), writer)

    def _timed_step(self, state: Any, frame: Frame, rng: np.random.Generator) -> tuple[Any, Estimate]:
        began = time.perf_counter()
        state, estimate = self.tracker.step(state, frame, rng)
        if self._options.timings:
            estimate = replace(estimate, milliseconds=1e3 * (time.perf_counter() - began))
        return state, estimate

    def _finish(self, writer: ResultWriter, state: Any, remarks: tuple[str, ...]) -> None:
        said, losses = self._ended(writer, state), self._losses()
        more = {"losses": loss_line(losses), "remarks": "; ".join(remarks)}
        writer.finish(said | {name: line for name, line in more.items() if line})

    def _outcome(self, writer: ResultWriter, began: float, *, stopped: bool) -> RunOutcome:
        seconds = time.perf_counter() - began
        lost = writer.count(Status.LOST)
        return RunOutcome(writer.frames_written, self._tracked, lost, seconds, self._losses(), stopped)


@contextmanager
def _stopped_at_once(stopped: Stopped) -> Iterator[None]:
    """Let KeyboardInterrupt end a run as ``stopped`` does: a second Ctrl-C, or one while kernels compile."""
    try:
        yield
    except KeyboardInterrupt:
        if not stopped():
            raise
