"""A head run: every frame of a recording through a head tracker into a result, in one pass or two."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from posetrack_cli.configuration import Settings
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import real_path
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.model_file import ATTACHMENT, MEDIA_TYPE, Learned, load_model, model_bytes, save_model
from posetrack_cli.head.passes import (
    first_pass_checkpoint,
    learned_before,
    reached_in_pass,
    second_pass_checkpoint,
)
from posetrack_cli.head.protocol import HeadTracker, NoFaceError
from posetrack_cli.outputs import check_output, check_target, part_path, state_path
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results.checkpoint import Checkpoint
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.writer import ResultWriter
from posetrack_cli.tracking import options as tracking_options
from posetrack_cli.tracking.checkpoints import Reached
from posetrack_cli.tracking.options import RunOutcome
from posetrack_cli.tracking.record import common_record
from posetrack_cli.tracking.run import Report, Run, Stopped

MakeTracker = Callable[[Learned | None], HeadTracker[Any]]
"""Makes a tracker that begins with what another has learned, or with nothing."""


@dataclass(frozen=True)
class HeadRunOptions(tracking_options.RunOptions):
    """What a head run depends on besides recording and configuration.

    Attributes:
        init: a file with clicked points; None finds the face.
        passes: 2 tracks twice: the second pass begins with the model and the templates that the first one has
            learned, and is the result (thesis, 4.5).
        load_model: begin with what an earlier run of the same person has learned.
        save_model: write what this one has.
    """

    passes: int = 1
    load_model: Path | None = None
    save_model: Path | None = None


class HeadRun(Run):
    """One run of a head tracker over a recording.

    Args:
        recording: images of calibrated cameras, the reference first.
        config: the tracker's, for the record.
        options: the rest.
        name: of the tracker, for the record.
        subject: what its estimates are of.
        flush_frames: estimates between two checkpoints.
        make_tracker: of each pass.
        first_pass: called with every estimate of the first of two passes; none of them is written.
        stated: what the record says besides, such as that intrinsics were guessed.

    Raises:
        UsageError: an output may not be written, no frame to track, or a model that cannot be used.
        ResultError: a model file that cannot be read.
    """

    tracker: HeadTracker[Any]
    _options: HeadRunOptions

    def __init__(
        self,
        recording: Recording,
        config: Settings,
        options: HeadRunOptions,
        *,
        name: str,
        subject: Subject,
        flush_frames: int,
        make_tracker: MakeTracker,
        first_pass: Report = lambda estimate: None,
        stated: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        check_head_run(recording, options)
        super().__init__(recording, options, flush_frames)
        self._of, self._make_tracker, self._first_pass_report = subject, make_tracker, first_pass
        self._learned: Learned = {}  # in the first of two passes, once the second has begun
        self._name, load = name, options.load_model
        self.tracker = make_tracker(None) if load is None else self._knowing(load)
        self._record = {**head_record(name, recording, config, options), **stated}

    def track(self, report: Report, stopped: Stopped = lambda: False) -> RunOutcome:
        """Track every frame; see ``Run.track``.

        Raises:
            NoFaceError: no face was found in any frame; nothing is left that would have to be overwritten,
                but for what was interrupted before.
        """
        try:
            return super().track(report, stopped)
        except NoFaceError:
            if not self._options.resume:  # what is resumed is never deleted, whatever is found in it
                for path in (part_path(self._options.output), state_path(self._options.output)):
                    path.unlink(missing_ok=True)
            raise

    def _knowing(self, path: Path) -> HeadTracker[Any]:
        """Return a tracker that begins with a model file, by whose name whatever is wrong with it is told."""
        learned = load_model(path, self._recording.cameras, self._name)
        try:
            return self._make_tracker(learned)
        except ResultError as error:
            raise ResultError(str(error), where=path) from error

    def _subject(self) -> Subject:
        return self._of

    def _cameras(self) -> tuple[Camera, ...]:
        return self._recording.cameras

    def _noted(self, frame: Frame) -> None:
        """The recording counts itself which camera's images are missing."""

    def _started(self, frame: Frame, rng: np.random.Generator) -> Any:
        return self.tracker.start(frame, rng)

    def _reached(self, checkpoint: Checkpoint) -> Reached:
        learned = learned_before(checkpoint)
        if learned:
            self._learn(learned)
        return reached_in_pass(self.tracker, checkpoint, self._rng())

    def _begun(self, writer: ResultWriter, reached: Reached, stopped: Stopped) -> Reached | None:
        if self._options.passes == 1 or self._learned:
            return reached
        first = self._first_pass(writer, reached, stopped)
        if first is None:
            return None
        self._learn(first)
        begun = Reached(None, self._rng())
        writer.save_checkpoint(self._saved(begun, 0))
        return begun

    def _first_pass(self, writer: ResultWriter, reached: Reached, stopped: Stopped) -> Learned | None:
        """Track without writing; return what was learned, None if stopped."""
        state, rng, last = reached
        with closing(self._frames()) as frames:
            for frame in frames:
                if frame.index <= last:
                    continue
                if state is None:
                    state = self._started(frame, rng)
                state, estimate = self._timed_step(state, frame, rng)
                self._first_pass_report(estimate)
                self._tracked += 1
                if self._tracked % self._flush_frames == 0:
                    reached = Reached(state, rng, frame.index)
                    writer.save_checkpoint(first_pass_checkpoint(self.tracker, reached))
                if stopped():
                    return None
        return self._learned_by(state)

    def _learned_by(self, state: Any) -> Learned:
        """What the tracker has learned; NoFaceError if it never found a face."""
        searched = self.tracker.not_found(state)
        if searched:
            raise NoFaceError(
                "no face found",
                where=self._recording.path,
                found=searched,
                hint="--init FILE begins with clicked points; --detector yunet finds faces that haar misses",
            )
        return self.tracker.learned(state)

    def _learn(self, learned: Learned) -> None:
        """Begin the second pass."""
        self._learned = learned
        self.tracker = self._make_tracker(learned)

    def _saved(self, reached: Reached, frames: int) -> Checkpoint:
        return second_pass_checkpoint(self.tracker, reached, frames, self._learned)

    def _ended(self, writer: ResultWriter, state: Any) -> dict[str, str]:
        data = model_bytes(self._learned_by(state), self._recording.cameras, self._name)
        writer.attach(ATTACHMENT, MEDIA_TYPE, data)
        if self._options.save_model is not None:
            save_model(self._options.save_model, data)
        return {"passes": str(self._options.passes)}

    def _remarks(self, state: Any) -> tuple[str, ...]:
        return self.tracker.remarks(state)


def check_head_run(recording: Recording, options: HeadRunOptions) -> None:
    """Refuse what can be refused without looking at a frame.

    Raises:
        UsageError: an output may not be written, or result and model are one file.
    """
    replace = options.overwrite or options.resume
    check_output(options.output, overwrite=replace, source=recording.path)
    if options.save_model is not None:
        own = (options.output, part_path(options.output), state_path(options.output))
        if real_path(options.save_model) in [real_path(path) for path in own]:
            raise UsageError("result and model cannot be one file", where=options.save_model)
        if not options.overwrite and state_path(options.save_model).exists():
            where = part_path(options.save_model)
            raise UsageError(
                "is of an interrupted run", where=where, hint="choose another name for the model"
            )
        check_target(options.save_model, overwrite=replace, source=recording.path)


def head_record(
    tracker: str, recording: Recording, config: Settings, options: HeadRunOptions
) -> dict[str, str]:
    """What a result states about its run: all that its bytes depend on but the machine, nothing else.

    Args:
        tracker: its name.
        recording: its identity is stated, not its path.
        config: resolved, with the defaults.
        options: frames, seed, passes; of files their names and contents, as these may change.
    """
    init = None if options.init is None else Path(options.init)
    files = {"init": init, "load_model": options.load_model}
    given = {key: path for key, path in files.items() if path is not None}
    return {
        **common_record(tracker, recording, recording.cameras[0], config, options),
        "init": "auto",
        "passes": str(options.passes),
        **{key: shown_name(path) for key, path in given.items()},
        **{f"{key}.sha256": file_digest(path)[1] for key, path in given.items()},
    }
