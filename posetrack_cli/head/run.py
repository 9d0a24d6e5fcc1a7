"""One run of a head tracker: all frames of a recording, in one pass or two, into a result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import real_path, write_output
from posetrack_cli.head.config import HeadMonoConfig, HeadStereoConfig, deviations_from_print
from posetrack_cli.head.evidence import FaceEvidence
from posetrack_cli.head.landmarks.faces import LandmarkFile
from posetrack_cli.head.model_file import ATTACHMENT, MEDIA_TYPE, load_model, model_bytes
from posetrack_cli.head.smoothing.frames import HeadMemory
from posetrack_cli.head.subject import track_model
from posetrack_cli.head.tracker.frame_tracker import HeadState
from posetrack_cli.outputs import check_output, check_target, part_path, state_path, whole_or_nothing
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.grey import PLAIN_BITS, Grey
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.keypoints.reading import KeypointUse
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking import options as tracking_options
from posetrack_cli.tracking.options import common_record, deviations_record
from posetrack_cli.tracking.run import FrameMemory, Report
from posetrack_cli.tracking.smoothing import smoothing_path
from posetrack_cli.tracking.two_pass import (
    Learned,
    LearningTracker,
    MakeTracker,
    NothingTrackedError,
    TwoPassRun,
)

LOOK_BACK_FRAMES, SHOWN_FRAMES = 60, 10
"""Frames before and after that in which a head was begun late, which are played backwards."""
LOOK_BACK_GAP_NS = 2_000_000_000
"""Time between the last frame of the recording and these: the head may be anywhere."""


@dataclass(frozen=True)
class HeadRunOptions(tracking_options.RunOptions):
    """Options of a head run besides recording and configuration.

    Attributes:
        load_model: model of the same person to start from.
        save_model: output file for the learned model.
        person: result that defines the person, for one camera.
        landmarks: face landmarks from another program.
    """

    load_model: Path | None = None
    save_model: Path | None = None
    person: Path | None = None
    landmarks: LandmarkFile | None = None


class HeadRun(TwoPassRun):
    """One run of a head tracker over a recording.

    Args:
        recording: images of calibrated cameras, the reference first.
        config: of the tracker, for the record.
        options: run options.
        name: of the tracker, for the record.
        subject: of the estimates.
        flush_frames: frames between two checkpoints.
        make_tracker: called for each pass.
        origin: (B,) coefficients of the neutral face in results; zeros by default.
        first_pass: called with each estimate of the first of two passes, none of which is written.
        extra_record: additional entries of the record, such as guessed intrinsics.

    Raises:
        UsageError: an output may not be written, there is no frame to track, or the model does not fit.
        ResultError: the model file cannot be read.
    """

    tracker: LearningTracker[Any]
    _options: HeadRunOptions

    def __init__(
        self,
        recording: Recording,
        config: HeadStereoConfig | HeadMonoConfig,
        options: HeadRunOptions,
        *,
        name: str,
        subject: Subject,
        flush_frames: int,
        make_tracker: MakeTracker,
        origin: FloatArray | None = None,
        first_pass: Report = lambda estimate: None,
        extra_record: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        check_head_run(recording, options)
        super().__init__(recording, options, flush_frames, config.run.passes, make_tracker, first_pass)
        self._config, self.velocity_model = config, track_model(config).velocity
        landmarks = options.landmarks
        self._use = None if landmarks is None else KeypointUse(landmarks.name, landmarks.sets, "landmarks")
        self._origin = np.zeros(len(subject.shape_names)) if origin is None else origin
        self.subjects, self._name, load = (subject,), name, options.load_model
        self._evidence: FaceEvidence | None = None
        self.tracker = make_tracker(None) if load is None else self._tracker_from_model(load)
        self.record = {**head_record(name, recording, config, options), **extra_record}

    def _tracker_from_model(self, path: Path) -> LearningTracker[Any]:
        """Return a tracker that starts from a model file; its errors name the file."""
        learned = load_model(path, self._recording.cameras, self._name)
        try:
            return self._make_tracker(learned)
        except ResultError as error:
            raise ResultError(str(error), where=path) from error

    def start_state(self, frame: Frame, rng: np.random.Generator) -> Any:
        """Return the state before the first frame."""
        return self.tracker.start(frame, rng)

    def after_first_pass(self, state: Any) -> Any:
        """Continue with the frames before the head was found, played backwards **[ours]**.

        A head that turns away is tracked farther than one that is found turned away. Frames for which the
        head was begun late are thus seen by a tracker that knows it, as if they followed the recording.
        """
        late = state.begun_late if isinstance(state, HeadState) else None
        if late is None:
            return state
        start, stride = self._options.start, self._options.stride
        first = start + stride * max((late - start) // stride - LOOK_BACK_FRAMES, 0)
        frames = list(self._recording.frames(start=first, end=late + SHOWN_FRAMES * stride, stride=stride))
        turn_ns, rng = state.track.stamp_ns + LOOK_BACK_GAP_NS + frames[-1].stamp_ns, self.new_rng()
        for frame in reversed(frames):
            state, _ = self.tracker.step(state, replace(frame, stamp_ns=turn_ns - frame.stamp_ns), rng)
        return state

    def learned_by(self, state: Any, *, for_second_pass: bool = False) -> Learned:
        """Return what the tracker learned of the face.

        Raises:
            NothingTrackedError: no face was found in any frame.
        """
        searched = self.tracker.not_found(state)
        if searched:
            # examined only after a failure, because it costs detections in several orientations
            evidence = self._evidence or self._examine(self.sampled())
            raise NothingTrackedError(
                "no face found",
                where=self._recording.path,
                found=f"{searched}; {evidence.seen}",
                hint=evidence.reason or _hint(self._recording),
            )
        return self.tracker.learned(state, for_second_pass=for_second_pass)

    @contextmanager
    def open_memory(self, writer: ResultWriter) -> Iterator[FrameMemory | None]:
        """Open the store of frames for smoothing; None without smoothing."""
        if not self._options.smooth:
            yield None
            return
        path, kept = smoothing_path(self._options.output), writer.frames_written
        about = self._config, self.subject, len(self.cameras), self._origin
        with HeadMemory(path, *about, kept) as memory:
            yield memory

    def finish(self, writer: ResultWriter, state: Any) -> dict[str, str]:
        """Attach the learned model to the result and write it to ``save_model`` if requested."""
        data = model_bytes(self.learned_by(state), self._recording.cameras, self._name)
        writer.attach(ATTACHMENT, MEDIA_TYPE, data)
        if self._options.save_model is not None:
            with whole_or_nothing(self._options.save_model) as part:
                write_output(part, data)
        return {"passes": str(self._config.run.passes)}

    def evidence(self, frames: Sequence[Frame]) -> str:
        """Return statistics of frames and the most likely cause of a poor track, as part of a line."""
        return self._examine(frames).line

    def _examine(self, frames: Sequence[Frame]) -> FaceEvidence:
        self._evidence = FaceEvidence(self._recording, self._config.start.detection, frames)
        return self._evidence

    def on_frame(self, frame: Frame) -> None:
        """Record whether the frame had landmarks."""
        if self._use is not None:
            self._use.see(frame.index, frame.stamp_ns)

    def remarks(self, state: Any) -> tuple[str, ...]:
        """Return the tracker's warnings, and one if few frames had landmarks."""
        unused = () if self._use is None else self._use.remarks
        return (*unused, *self.tracker.remarks(state))


def _hint(recording: Recording) -> str:
    # more than 8 bits are more often depth than infrared
    if any(isinstance(pixels, Grey) and pixels.bits > PLAIN_BITS for pixels in recording.pixels):
        return "if these are depth images, use posetrack hand run"
    return "start from clicked points with --init FILE, or try --detector yunet"


def check_head_run(recording: Recording, options: HeadRunOptions) -> None:
    """Check outputs before reading any frame.

    Raises:
        UsageError: an output may not be written, or result and model are the same file.
    """
    # a resumed run continues its own files, so they may exist
    replace = options.overwrite or options.resume
    check_output(options.output, overwrite=replace, source=recording.path)
    if options.save_model is not None:
        own = (options.output, part_path(options.output), state_path(options.output))
        if real_path(options.save_model) in [real_path(path) for path in own]:
            raise UsageError("result and model must be different files", where=options.save_model)
        if not options.overwrite and state_path(options.save_model).exists():
            where = part_path(options.save_model)
            raise UsageError(
                "file of an interrupted run", where=where, hint="choose another name for the model"
            )
        check_target(options.save_model, overwrite=replace, source=recording.path)


def head_record(
    tracker: str,
    recording: Recording,
    config: HeadStereoConfig | HeadMonoConfig,
    options: HeadRunOptions,
) -> dict[str, str]:
    """Return the run record: everything that determines the bytes of the result, except the machine.

    Args:
        tracker: its name.
        recording: recorded by identity, not by path.
        config: resolved, with defaults.
        options: frames and seed; files by name and digest, as their contents may change.
    """
    init = None if options.init is None else Path(options.init)
    files = {"init": init, "load_model": options.load_model, "person": options.person}
    given = {key: path for key, path in files.items() if path is not None}
    return {
        **common_record(tracker, recording, recording.cameras[0], config, options),
        **deviations_record(deviations_from_print(config)),
        "init": "auto",
        "passes": str(config.run.passes),
        **{key: shown_name(path) for key, path in given.items()},
        **{f"{key}.sha256": file_digest(path)[1] for key, path in given.items()},
        **({} if options.landmarks is None else options.landmarks.record()),
    }
