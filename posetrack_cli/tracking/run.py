"""A run: track every frame of a recording, write the result, and copy its ground truth."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import chain, islice
from typing import Any, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import compiling_s
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, loss_line
from posetrack_cli.recording.base import Frame, TruthMessage
from posetrack_cli.recording.recording import Recording
from posetrack_cli.recording.timeline import StampCheck
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.spool import Checkpoint
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking.loop import RunState, Step, Tracker, checkpoint_of, run_state_at, track_frames
from posetrack_cli.tracking.options import (
    RunOptions,
    RunOutcome,
    frames_ahead,
    is_hardly_tracked,
    nothing_to_track,
)
from posetrack_cli.tracking.velocity import VelocityModel, check_belief, with_velocities

FRAMES_SHOWN = 8
"""Approximate number of frames read again to explain why hardly any was tracked."""

Report = Callable[[Estimate], None]
Stopped = Callable[[], bool]


class FrameMemory(Protocol):
    """Per-frame data kept by a run to write the smoothed track after the last frame."""

    def remember(self, state: Any, *estimates: Estimate) -> None:
        """Store the data of a frame, with the estimates of all subjects."""

    def flush(self) -> None:
        """Sync everything to disk, before a checkpoint relies on it."""

    def finish(self, writer: ResultWriter) -> None:
        """Write the track that depends on all frames, and delete the stored data."""


class Run(ABC):
    """One run of a tracker over a recording; subclasses add what is specific to hands or heads.

    Args:
        recording: recording to track.
        options: frame selection and output.
        flush_frames: estimates between two checkpoints.

    Raises:
        UsageError: no frames to track; raised before any file is created.

    Attributes:
        tracker: tracker of the current pass; set by the subclass.
        subjects: tracked subjects; set by the subclass.
        record: run record; set by the subclass.
        cameras: cameras stored in the result, the reference camera first.
        velocity_model: model for estimating velocities one frame late; None keeps the tracker's velocities.
        current: estimates of all subjects in the last frame written.
    """

    tracker: Tracker[Any]
    subjects: tuple[Subject, ...]
    record: Mapping[str, str]
    cameras: tuple[Camera, ...]
    velocity_model: VelocityModel | None = None

    def __init__(self, recording: Recording, options: RunOptions, flush_frames: int) -> None:
        self._recording, self._options, self._flush_frames = recording, options, flush_frames
        self._tracked = 0  # frames tracked by this process
        self._ended_s: float | None = None  # time at which all frames were tracked
        self._stamps = StampCheck()
        self.current: tuple[Estimate, ...] = ()
        if frames_ahead(recording, options) == 0:
            raise nothing_to_track(recording)
        self.cameras = recording.cameras

    @property
    def subject(self) -> Subject:
        """The first of the tracked subjects."""
        return self.subjects[0]

    def track(self, report: Report, stopped: Stopped = lambda: False) -> RunOutcome:
        """Track every frame; see ``estimates``.

        Args:
            report: called with every estimate after it is written.
            stopped: called after every frame; True ends the run and leaves the result unfinished.
        """
        estimates = self.estimates(stopped)
        try:
            estimate = next(estimates)
            while True:
                try:
                    report(estimate)
                except BaseException as error:  # raised inside the generator, so that it cleans up
                    estimate = estimates.throw(error)
                else:
                    estimate = next(estimates)
        except StopIteration as end:
            outcome: RunOutcome = end.value
            return outcome

    def estimates(self, stopped: Stopped = lambda: False) -> Generator[Estimate, None, RunOutcome]:
        """Track every frame, yield each estimate after it is written, and return the outcome.

        Of several subjects, only the first one's estimates are yielded; ``current`` has all of that frame.

        Closing the generator early leaves the result unfinished, as NAME.part.

        Args:
            stopped: called after every frame; True ends the run and leaves the result unfinished.

        Raises:
            UsageError, RecordingError: no frames to track; no file is created.
            PosetrackError: the recording or the result fails; flushed frames stay in NAME.part.
        """
        began = _clock_s()
        with closing(self._frames()) as frames:
            first = next(frames, None)
            if first is None:
                raise nothing_to_track(self._recording)
            return (yield from self._track(chain((first,), frames), began, stopped))

    # Hooks for subclasses

    @abstractmethod
    def start_state(self, frame: Frame, rng: np.random.Generator) -> Any:
        """Return the tracker's state before the first frame."""

    def on_frame(self, frame: Frame) -> None:  # noqa: B027 - optional hook
        """Inspect every frame read, including those tracked before an interruption."""

    def vertices(self, estimate: Estimate, subject: int = 0) -> FloatArray | None:
        """Return the mesh (V, 3) of a subject's estimate, mm, camera axes; None for none."""
        return None

    def open_memory(self, writer: ResultWriter) -> AbstractContextManager[FrameMemory | None]:
        """Open the per-frame data of the smoothed track; None if there is no such track."""
        return nullcontext()

    def finish(self, writer: ResultWriter, state: Any) -> Mapping[str, str]:
        """Write the final parts of the result; return entries for its summary."""
        return {}

    def losses(self) -> tuple[Loss, ...]:
        """Return the data that could not be used."""
        return self._recording.losses

    def remarks(self, state: Any) -> tuple[str, ...]:
        """Return further notes for the user after the last frame, one line each."""
        return ()

    def evidence(self, frames: Sequence[Frame]) -> str:
        """Return what the frames show and the likeliest reason for hardly tracking any, as part of a line."""
        return ""

    # Hooks for runs with several passes

    def run_state_at(self, checkpoint: Checkpoint) -> RunState:
        """Return the state at an interruption.

        Raises:
            LayoutError, ResultError: the checkpoint has no such state.
        """
        reached = run_state_at(self.tracker, checkpoint, self.new_rng())
        for belief in reached.velocities:
            check_belief(belief, self.velocity_model)
        return reached

    def checkpoint(self, run_state: RunState, frames: int) -> Checkpoint:
        """Return the checkpoint after a frame, with ``frames`` estimates written."""
        return checkpoint_of(self.tracker, run_state, frames)

    def before_writing(self, writer: ResultWriter, run_state: RunState, stopped: Stopped) -> RunState | None:
        """Do the work before the written pass; return None if stopped."""
        return run_state

    # The loop

    def steps(self, frames: Iterable[Frame], run_state: RunState) -> Iterator[Step]:
        """Return the steps of one pass."""
        timings = self._options.timings
        return track_frames(self.tracker, frames, run_state, self.start_state, timings=timings)

    def new_rng(self) -> np.random.Generator:
        """Return the random generator in its initial state."""
        return np.random.default_rng(self._options.seed)

    def _track(
        self, frames: Iterable[Frame], began: float, stopped: Stopped
    ) -> Generator[Estimate, None, RunOutcome]:
        writer, run_state = self._open()
        with writer, _stopped_at_once(stopped):
            going_on = self.before_writing(writer, run_state, stopped)
            if going_on is None:
                return self._outcome(writer, began, stopped=True)
            run_state = going_on
            carrier = truth_carrier(iter(self._recording.truth()), writer)
            with closing(carrier) as truth, self.open_memory(writer) as memory:
                steps = self._remembered(self.steps(self._watched(frames), run_state), memory)
                if self.velocity_model is not None:
                    steps = with_velocities(steps, self.velocity_model, run_state.velocities)
                for step in steps:
                    truth.send(step.frame.stamp_ns)
                    run_state = step.after
                    self._write(writer, memory, step)
                    self._tracked += 1
                    self.current = step.estimates
                    yield step.estimate
                    if stopped():
                        return self._outcome(writer, began, stopped=True)
                self._ended_s = _clock_s()
                if memory is not None:
                    memory.finish(writer)
                remarks = self._stamps.remarks + self._recording.notes + self.remarks(run_state.state)
                failure = self._failure(writer)
                self._close(writer, run_state.state, (failure, *remarks) if failure else remarks)
            return replace(self._outcome(writer, began, stopped=False), remarks=remarks, failure=failure)
        return self._outcome(writer, began, stopped=True)

    def _watched(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """Yield the frames, inspecting each one."""
        for frame in frames:
            self.on_frame(frame)
            self._stamps.add(frame.index, frame.stamp_ns)
            yield frame

    def _remembered(self, steps: Iterable[Step], memory: FrameMemory | None) -> Iterator[Step]:
        """Yield the steps, storing each before the next step can overwrite its per-frame state."""
        for step in steps:
            if memory is not None:
                memory.remember(step.after.state, *step.estimates)
            yield step

    def _write(self, writer: ResultWriter, memory: FrameMemory | None, step: Step) -> None:
        """Write an estimate, and a checkpoint when the result was flushed."""
        meshes = [self.vertices(estimate, k) for k, estimate in enumerate(step.estimates)]
        if writer.write_frame(step.estimates, meshes):
            if memory is not None:
                memory.flush()
            writer.save_checkpoint(self.checkpoint(step.after, writer.frames_written))

    def _open(self) -> tuple[ResultWriter, RunState]:
        """Return the writer and the start state; a resumed state is checked before any file is changed."""
        options, flush = self._options, self._flush_frames
        camera, *others = self.cameras
        about = self.subjects, camera, self.record
        if options.resume:
            resumed: list[RunState] = []
            writer, _ = ResultWriter.resume(
                options.output,
                *about,
                others=others,
                flush_frames=flush,
                check=lambda checkpoint: resumed.append(self.run_state_at(checkpoint)),
            )
            return writer, resumed[0]
        overwrite = options.overwrite
        writer = ResultWriter(options.output, *about, others=others, flush_frames=flush, overwrite=overwrite)
        start = RunState(None, self.new_rng())
        writer.save_checkpoint(checkpoint_of(self.tracker, start, 0))
        return writer, start

    def _failure(self, writer: ResultWriter) -> str:
        """Return the reason if hardly any frame was tracked, based on some frames read again."""
        frames, lost = writer.frames_written, writer.count(Status.LOST)
        if not is_hardly_tracked(frames, lost):
            return ""
        return f"only {frames - lost} of {frames} frames tracked: {self.evidence(self.sampled(frames))}"

    def sampled(self, frames: int | None = None) -> list[Frame]:
        """Return a few decodable frames, evenly spaced over those read."""
        options = self._options
        known = self._tracked if frames is None else frames
        sample = self._recording.sample(
            FRAMES_SHOWN, start=options.start, stride=options.stride, frames=known
        )
        with suppress(RecordingError):
            return list(sample)
        return []

    def _frames(self) -> Any:
        options = self._options
        return self._recording.frames(start=options.start, end=options.end, stride=options.stride)

    def _close(self, writer: ResultWriter, state: Any, remarks: tuple[str, ...]) -> None:
        said, losses = self.finish(writer, state), self.losses()
        more = {"losses": loss_line(losses), "remarks": "; ".join(remarks)}
        writer.finish({**said, **{name: line for name, line in more.items() if line}})

    def _outcome(self, writer: ResultWriter, began: float, *, stopped: bool) -> RunOutcome:
        seconds = (self._ended_s or _clock_s()) - began
        lost = writer.count(Status.LOST)
        of_each = {subject.label: writer.count(Status.LOST, k) for k, subject in enumerate(self.subjects)}
        each = of_each if len(of_each) > 1 else {}
        return RunOutcome(
            writer.frames_written, self._tracked, lost, seconds, self.losses(), stopped, lost_by_label=each
        )


def _clock_s() -> float:
    """Return the wall-clock time without compilation, so that timings do not depend on the kernel cache."""
    return time.perf_counter() - compiling_s()


@contextmanager
def _stopped_at_once(stopped: Stopped) -> Iterator[None]:
    """End the run on KeyboardInterrupt (a second Ctrl-C, or one during compilation) as ``stopped`` does."""
    try:
        yield
    except KeyboardInterrupt:
        if not stopped():
            raise


def truth_carrier(messages: Iterator[TruthMessage], writer: ResultWriter) -> Generator[None, int]:
    """Return a coroutine that copies ground truth up to each stamp (ns) sent to it.

    Messages that a resumed result already contains are skipped.
    """
    carrier = _carry(messages, writer)
    next(carrier)
    return carrier


def _carry(messages: Iterator[TruthMessage], writer: ResultWriter) -> Generator[None, int]:
    messages = islice(messages, writer.truth_messages, None)
    message, stamp = next(messages, None), (yield)
    while True:
        while message is not None and message.log_time_ns <= stamp:
            writer.add_truth(message)
            message = next(messages, None)
        stamp = yield
