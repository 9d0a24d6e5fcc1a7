"""A hand run: every frame of a recording through the tracker into a result."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli import __version__
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.model import MESH_DIGEST, hand_model
from posetrack_cli.hand.smoothing import SmoothedTrack, make_smoother
from posetrack_cli.hand.start import centre_pose, read_pose
from posetrack_cli.hand.tracker import dynamics
from posetrack_cli.hand.trackers import Tracker, make_tracker
from posetrack_cli.recording.base import Frame, Loss, Recording, TruthMessage
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.losses import loss_line
from posetrack_cli.recording.output import check_output
from posetrack_cli.rendering.context import describe
from posetrack_cli.results.checkpoint import Checkpoint
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.writer import ResultWriter

INIT_METHODS = ("auto", "center")
Report = Callable[[Estimate], None]
_SMOOTHING_STREAM = 1  # of random numbers: what is filtered does not depend on whether it is smoothed


@dataclass(frozen=True)
class RunOptions:
    """What a run depends on besides recording and configuration.

    Attributes:
        output: the result's path.
        seed: of the random generator.
        init: ``auto``, ``center`` or the path of a pose (see ``read_pose``); None as configured.
        start, end, stride: which frames.
        resume: go on with an interrupted run.
        overwrite: replace an existing result.
        smooth: also write the smoothed track.
        timings: write each frame's milliseconds; then two runs differ in their bytes.
    """

    output: Path
    seed: int = 0
    init: str | None = None
    start: int = 0
    end: int | None = None
    stride: int = 1
    resume: bool = False
    overwrite: bool = False
    timings: bool = False
    smooth: bool = False


@dataclass(frozen=True)
class RunOutcome:
    """What came of a run.

    Attributes:
        frames: estimates in the result, also those of a run that was resumed.
        tracked: frames tracked now.
        lost: estimates in the result with status lost.
        seconds: wall-clock time.
        losses: data that could not be used.
        stopped: whether it was interrupted.
    """

    frames: int
    tracked: int
    lost: int
    seconds: float
    losses: tuple[Loss, ...]
    stopped: bool


class HandRun:
    """One run of the hand tracker over a recording.

    Args:
        recording: depth frames.
        config: parameters.
        options: the rest.
        context: GL context.

    Raises:
        UsageError: the output may not be written, no frame to track, or no start pose in ``options.init``.
        RenderingError: a window that this GL cannot draw.
    """

    def __init__(self, recording: Recording, config: HandConfig, options: RunOptions, context: Any) -> None:
        self._recording, self._config, self._options = recording, with_method(config, options), options
        config = self._config
        check_run(recording, config, options)
        if frames_ahead(recording, options) == 0:
            raise self._nothing_to_track()  # before a file is made that would have to be overwritten
        hand = hand_model(config.hand)
        self._anatomy = hand.anatomy
        self._camera = recording.cameras[0]
        self.tracker = make_tracker(config, hand, self._camera, context)
        self._mesh = None if config.output.mesh == "none" else hand.skin(config.output.mesh)
        self._start_pose = _given_pose(options)
        renderer = str(describe(context))
        self._record = run_record(recording, self._camera, config, options, renderer, self._start_pose)
        self._blank: list[int] = []

    def track(self, report: Report, stopped: Callable[[], bool] = lambda: False) -> RunOutcome:
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
                raise self._nothing_to_track()
            return self._track(chain((first,), frames), began, report, stopped)

    def _track(
        self, frames: Iterable[Frame], began: float, report: Report, stopped: Callable[[], bool]
    ) -> RunOutcome:
        tracked = 0
        writer, state, rng, last = self._open()
        with writer, closing(self._truth(writer)) as truth, self._memory(writer) as memory:
            for frame in frames:
                self._note_blank(frame)
                if frame.index <= last:
                    continue  # tracked before the interruption
                state = state or self._started(frame, rng)
                state, estimate = self._timed_step(state, frame, rng)
                truth.send(frame.stamp_ns)
                if memory is not None:
                    memory.remember(state.particles, estimate, state.dt, state.cut, state.modes)
                if writer.write(estimate, self._vertices(estimate)):
                    if memory is not None:
                        memory.flush()
                    checkpoint = _checkpoint(self.tracker, state, rng, frame.index, writer.frames_written)
                    writer.save_checkpoint(checkpoint)
                report(estimate)
                tracked += 1
                if stopped():
                    return self._outcome(writer, tracked, began, stopped=True)
            if memory is not None:
                for estimate in memory.backward():
                    writer.write_smoothed(estimate, self._vertices(estimate))
                memory.delete()
            self._finish(writer)
        return self._outcome(writer, tracked, began, stopped=False)

    @contextmanager
    def _memory(self, writer: ResultWriter) -> Iterator[SmoothedTrack | None]:
        """What is kept of every frame for the way back; None where nothing is smoothed."""
        if not self._options.smooth:
            yield None
            return
        rng = np.random.default_rng([self._options.seed, _SMOOTHING_STREAM])
        smoother = make_smoother(self._config, dynamics(self._config), rng)
        path = smoothing_path(self._options.output)
        with SmoothedTrack(path, smoother, self._anatomy, writer.frames_written) as memory:
            yield memory

    def _open(self) -> tuple[ResultWriter, Any, np.random.Generator, int]:
        """The writer, and where to go on: state if there is one, random generator, last frame written."""
        options, flush = self._options, self._config.output.flush_frames
        rng = np.random.default_rng(options.seed)
        if options.resume:
            writer, checkpoint = ResultWriter.resume(
                options.output, self._subject(), self._camera, self._record, flush_frames=flush
            )
            return writer, *_restored(self.tracker, checkpoint, rng)
        writer = ResultWriter(
            options.output,
            self._subject(),
            self._camera,
            self._record,
            flush_frames=flush,
            overwrite=options.overwrite,
        )
        writer.save_checkpoint(_checkpoint(self.tracker, None, rng, -1, 0))
        return writer, None, rng, -1

    def _frames(self) -> Any:
        options = self._options
        return self._recording.frames(start=options.start, end=options.end, stride=options.stride)

    def _truth(self, writer: ResultWriter) -> Any:
        """A coroutine that carries truth over up to each stamp (ns) it is sent."""
        carried = _carry_truth(self._recording.truth(), writer)
        next(carried)
        return carried

    def _started(self, frame: Frame, rng: np.random.Generator) -> Any:
        """The tracker's state before the first frame."""
        if self._start_pose is not None:
            return self.tracker.start(self._start_pose, frame.stamp_ns, rng)
        init = self._config.init
        pose = centre_pose(frame.depth, self._camera, self._anatomy, init.depth_mm)
        if init.method == "auto":
            return self.tracker.start_unknown(pose, frame, rng)
        return self.tracker.start(pose, frame.stamp_ns, rng)

    def _timed_step(self, state: Any, frame: Frame, rng: np.random.Generator) -> tuple[Any, Estimate]:
        began = time.perf_counter()
        state, estimate = self.tracker.step(state, frame, rng)
        if self._options.timings:
            estimate = replace(estimate, milliseconds=1e3 * (time.perf_counter() - began))
        return state, estimate

    def _vertices(self, estimate: Estimate) -> FloatArray | None:
        if self._mesh is None:
            return None
        pose = np.concatenate([estimate.position, estimate.quaternion, estimate.shape])
        transforms = skinning_transforms(self._anatomy, pose[None]).astype(np.float64)
        vertices: FloatArray = self._mesh.posed(transforms)[0]
        return vertices

    def _note_blank(self, frame: Frame) -> None:
        if not frame.depth.any():
            self._blank.append(frame.index)

    def _losses(self) -> tuple[Loss, ...]:
        blank = self._blank
        where = f"frame {blank[0]}" if blank else ""
        return self._recording.losses + (
            (Loss("frames without any reading", len(blank), where),) if blank else ()
        )

    def _finish(self, writer: ResultWriter) -> None:
        losses = self._losses()
        writer.finish({"losses": loss_line(losses)} if losses else {})

    def _nothing_to_track(self) -> UsageError | RecordingError:
        losses = self._recording.losses
        if losses:
            return RecordingError(
                "no frame can be tracked", where=self._recording.path, found=loss_line(losses)
            )
        count = self._recording.frame_count
        found = "none that can be read" if count is None else f"{count} frames"
        where, hint = self._recording.path, "check --start and --end"
        return UsageError("no frame to track", where=where, found=found, hint=hint)

    def _outcome(self, writer: ResultWriter, tracked: int, began: float, *, stopped: bool) -> RunOutcome:
        seconds = time.perf_counter() - began
        lost = writer.count(Status.LOST)
        return RunOutcome(writer.frames_written, tracked, lost, seconds, self._losses(), stopped)

    def _subject(self) -> Subject:
        triangles = None if self._mesh is None else self._mesh.triangles
        return Subject("hand", self._camera.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS, triangles)


def with_method(config: HandConfig, options: RunOptions) -> HandConfig:
    """The configuration with the way to start that the options ask for."""
    if options.init not in INIT_METHODS:
        return config
    return config.model_copy(update={"init": config.init.model_copy(update={"method": options.init})})


def smoothing_path(output: Path) -> Path:
    """The file beside a result in which a run remembers what it will smooth."""
    return output.with_name(f"{output.name}.part.frames")


def _given_pose(options: RunOptions) -> FloatArray | None:
    known = options.init is None or options.init in INIT_METHODS
    return None if known else read_pose(Path(str(options.init)))


def check_run(recording: Recording, config: HandConfig, options: RunOptions) -> None:
    """Refuse what can be refused without looking at a frame.

    Raises:
        UsageError: the output may not be written, or cannot be smoothed.
    """
    if options.smooth and config.filter.kind == "pso":
        raise UsageError(
            "--smooth cannot be used",
            found="--filter pso, which states no distribution",
            expected="rbpf or pf",
        )
    check_output(options.output, overwrite=options.overwrite or options.resume, source=recording.path)


def frames_ahead(recording: Recording, options: RunOptions) -> int | None:
    """How many frames of the recording a run goes through, None when that shows only in reading it."""
    count = recording.frame_count
    if count is None:
        return None
    end = count if options.end is None else min(count, options.end)
    return len(range(options.start, end, options.stride))


def run_record(
    recording: Recording,
    camera: Camera,
    config: HandConfig,
    options: RunOptions,
    renderer: str,
    start_pose: FloatArray | None = None,
) -> dict[str, str]:
    """What a result states about its run: all that its bytes depend on but the machine, nothing else.

    Args:
        recording: its identity is stated, not its path.
        camera: intrinsics that are used.
        config: resolved, with the defaults.
        options: frames, seed and start.
        renderer: the driver's names.
        start_pose: (22,) if it was read from a file; stated as ``init.pose``, for the file may change.
    """
    return {
        "tracker": "hand",
        "version": __version__,
        "configuration": json.dumps(config.model_dump(mode="json")),
        "seed": str(options.seed),
        "init": config.init.method if start_pose is None else shown_name(Path(str(options.init))),
        "start": str(options.start),
        "end": "" if options.end is None else str(options.end),
        "stride": str(options.stride),
        "timings": str(options.timings).lower(),
        "camera": json.dumps(camera.values()),
        "renderer": renderer,
        **({} if config.hand.mesh is None else {MESH_DIGEST: file_digest(Path(config.hand.mesh))[1]}),
        **({} if start_pose is None else {"init.pose": json.dumps(start_pose.tolist())}),
        **{f"input.{key}": value for key, value in recording.identity().items()},
    }


def _carry_truth(messages: Iterator[TruthMessage], writer: ResultWriter) -> Any:
    """Write the truth up to each stamp sent; leave out what a resumed result holds already."""
    for _ in range(writer.truth_messages):
        next(messages, None)
    message, stamp = next(messages, None), (yield)
    while True:
        while message is not None and message.log_time_ns <= stamp:
            writer.add_truth(message)
            message = next(messages, None)
        stamp = yield


def _checkpoint(
    tracker: Tracker[Any], state: Any, rng: np.random.Generator, index: int, frames: int
) -> Checkpoint:
    record: dict[str, Any] = {"rng": rng.bit_generator.state}
    if state is None:
        return Checkpoint(index, frames, {}, record)
    arrays, numbers = tracker.state_parts(state)
    return Checkpoint(index, frames, arrays, record | {"numbers": numbers})


def _restored(
    tracker: Tracker[Any], checkpoint: Checkpoint, rng: np.random.Generator
) -> tuple[Any, np.random.Generator, int]:
    record = checkpoint.state
    rng.bit_generator.state = record["rng"]
    if not checkpoint.arrays:
        return None, rng, checkpoint.frame_index
    state = tracker.state_from_parts(checkpoint.arrays, record["numbers"])
    return state, rng, checkpoint.frame_index
