"""Writing of results that are readable at any time, resumable, and reproducible to the bit."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.outputs import check_free, check_not_written, check_place, part_path, state_path
from posetrack_cli.recording.base import RUN_RECORD, TruthMessage
from posetrack_cli.recording.camera_record import CAMERAS_RECORD, cameras_to_record
from posetrack_cli.results import spool
from posetrack_cli.results.channels import ResultChannels, StampOrder
from posetrack_cli.results.columns import COUNTS, LayoutError, check_numbers
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.records import SUMMARY_RECORD, subjects_to_records
from posetrack_cli.results.replay import Replay, check_same_run
from posetrack_cli.results.spool import Checkpoint, Progress
from posetrack_cli.results.topics import SMOOTHED


class ResultWriter:
    """Writer of one run's estimates to an MCAP file.

    The file is NAME.part until ``finish``. Every ``flush_frames`` estimates the chunk ends and all data is
    handed to the operating system. This counts frames, never seconds, so equal runs give equal bytes::

        with ResultWriter(path, subject, camera, run) as writer:
            for frame in frames:
                if writer.write(estimate, vertices):
                    writer.save_checkpoint(Checkpoint(frame.index, writer.frames_written, arrays, state))
            writer.finish({"skipped": "0"})

    Leaving the ``with`` block without ``finish`` aborts: NAME.part is kept and can be read and resumed.

    A smoothed track, which also uses later frames, follows the filtered one on its own topics
    (``write_smoothed``). Up to there the bytes equal those of a run without it.

    Args:
        path: path of the finished result.
        subject: tracked subject, or several with unique labels.
        camera: reference camera of the estimates.
        others: further cameras, with poses relative to it.
        run: run record: input, configuration, seed, version; must not contain anything that differs between
            equal runs.
        flush_frames: estimates per flush.
        overwrite: whether an existing result or an interrupted run may be replaced.

    Raises:
        UsageError: a result or an interrupted run exists and may not be replaced, or another process is
            writing it.
        ResultError: camera names are not unique; here and in every method: the file cannot be written.
            Flushed data stays readable.
    """

    _path: Path  # finished result
    _part: Path  # open file
    _sink: McapSink
    _channels: ResultChannels
    _run: dict[str, str]
    _flush_frames: int
    _subjects: tuple[Subject, ...]
    _cameras: tuple[Camera, ...]
    _statuses: dict[str, int]  # number of estimates per subject and status, see _counted
    _truth_messages: int
    _attached: set[str]
    _smoothed: tuple[StampOrder, ...]  # smoothed track of each subject
    _last_index: int
    _flushed: tuple[int, int]  # frame index and number of frames at the last flush
    _progress: Progress  # at the last flush
    _calibrated: bool
    _closed: bool

    def __init__(
        self,
        path: Path,
        subject: Subject | Sequence[Subject],
        camera: Camera,
        run: Mapping[str, str],
        *,
        others: Sequence[Camera] = (),
        flush_frames: int = 10,
        overwrite: bool = False,
    ) -> None:
        if not overwrite:
            check_free(path)
        check_not_written(part_path(path))
        with _reported(path):
            state_path(path).unlink(missing_ok=True)  # a stale checkpoint of the file replaced now
        self._begin(path, part_path(path), _as_tuple(subject), (camera, *others), run, flush_frames)

    @classmethod
    def resume(
        cls,
        path: Path,
        subject: Subject | Sequence[Subject],
        camera: Camera,
        run: Mapping[str, str],
        *,
        others: Sequence[Camera] = (),
        flush_frames: int = 10,
        check: Callable[[Checkpoint], object] = lambda checkpoint: None,
    ) -> tuple[ResultWriter, Checkpoint]:
        """Continue an interrupted run so that the finished file equals an uninterrupted run's.

        Frames after the checkpoint are dropped and must be tracked again. Earlier attachments and truth
        messages are copied; ``truth_messages`` is their number, so that the caller can skip them. To be
        able to resume before the first flush, save a checkpoint of frame -1 at the start.

        Args:
            path, subject, camera, run, others, flush_frames: see the class.
            check: checks the tracker's part of the checkpoint before any file is changed; raises
                LayoutError or ResultError if it is unusable.

        Returns:
            The writer, and the checkpoint of its last frame.

        Raises:
            UsageError: run record, subject, camera or ``flush_frames`` differ from the interrupted run's.
            ResultError: the unfinished result or the checkpoint is missing, damaged or inconsistent.
        """
        subjects = _as_tuple(subject)
        records = _first_records(run, subjects, (camera, *others))
        check_not_written(part_path(path))
        check_same_run(part_path(path), records)
        checkpoint, progress = spool.load(state_path(path))
        _check_checkpoint(path, checkpoint, progress, run, flush_frames, subjects)
        try:
            check(checkpoint)
        except (LayoutError, ResultError) as error:
            raise _unusable(path, error) from error
        writer = cls.__new__(cls)
        copy = path.with_name(path.name + ".part.copy")
        writer._begin(path, copy, subjects, (camera, *others), run, flush_frames)
        try:
            writer._restore(checkpoint, progress)
        except BaseException:
            writer._abandon()
            copy.unlink(missing_ok=True)
            raise
        return writer, checkpoint

    @property
    def frames_written(self) -> int:
        """Number of frames written, including those before a resume."""
        return _frames(self._statuses, self._subjects)

    def count(self, status: Status, subject: int | None = None) -> int:
        """Return the number of estimates with a status, including those before a resume.

        Args:
            status: the status.
            subject: number of a subject; None for the one with the fewest.
        """
        of = self._subjects if subject is None else self._subjects[subject : subject + 1]
        return min(self._statuses[_counted(one, status)] for one in of)

    @property
    def truth_messages(self) -> int:
        """Number of truth messages written, including those before a resume."""
        return self._truth_messages

    def write(self, estimate: Estimate, vertices: FloatArray | None = None) -> bool:
        """Write one estimate, with the mesh's vertices (V, 3) in mm and camera axes if it is to be drawn.

        Returns:
            Whether the file was flushed, i.e. a checkpoint can be saved now.

        Raises:
            ResultError: see the class; also if arrays do not fit the subject or are not finite, or the
                smoothed track has begun.
        """
        return self.write_frame((estimate,), (vertices,))

    def write_frame(
        self, estimates: Sequence[Estimate], vertices: Sequence[FloatArray | None] | None = None
    ) -> bool:
        """Write the estimates of all subjects at one frame; see ``write``."""
        meshes = [None] * len(estimates) if vertices is None else vertices
        return self._add_filtered(estimates, lambda: self._channels.write_estimates(estimates, meshes))

    def copy(self, messages: Iterable[tuple[str, int, bytes]], estimate: Estimate) -> bool:
        """Write a frame's messages from another result of the same kind, like ``write``.

        Args:
            messages: topic, log time and bytes of each.
            estimate: the estimate among them.
        """
        return self._add_filtered((estimate,), lambda: self._channels.copy(messages))

    def write_smoothed(
        self, estimate: Estimate, vertices: FloatArray | None = None, subject: int = 0
    ) -> None:
        """Write one estimate of a smoothed track, after the filtered tracks are complete; see ``write``.

        With several subjects, the whole track of one follows that of another. Frames come in order or, from
        a backward pass, in reverse, each at its own log time. Checkpoints do not cover them: a run
        interrupted here restarts the smoothed track.

        Raises:
            ResultError: see ``write``; or the stamp breaks the order.
        """
        write = self._channels.write_smoothed
        self._add_smoothed(estimate, lambda: write(estimate, vertices, subject), subject)

    def copy_smoothed(self, messages: Iterable[tuple[str, int, bytes]], estimate: Estimate) -> None:
        """Write a frame's smoothed messages from another result, like ``write_smoothed``."""
        self._add_smoothed(estimate, lambda: self._channels.copy(messages, SMOOTHED), 0)

    def _add_filtered(self, estimates: Sequence[Estimate], write: Callable[[], None]) -> bool:
        self._check_frame(estimates)
        estimate = estimates[0]
        if self._has_smoothed:
            raise ResultError("filtered frame after the smoothed track began", where=self._part)
        with self._guarded():
            if not self._calibrated:
                self._channels.write_calibration(estimate.stamp_ns)
                self._calibrated = True
            write()
        for subject, one in zip(self._subjects, estimates, strict=True):
            self._statuses[_counted(subject, one.status)] += 1
        self._last_index = estimate.frame_index
        if self.frames_written % self._flush_frames:
            return False
        self._flush()
        return True

    def _check_frame(self, estimates: Sequence[Estimate]) -> None:
        """Raise ResultError unless there is one estimate per subject, all of one frame."""
        stamps = {estimate.stamp_ns for estimate in estimates}
        if len(estimates) != len(self._subjects) or len(stamps) != 1:
            found, expected = f"{len(estimates)} at {len(stamps)} stamps", f"{len(self._subjects)} at one"
            raise ResultError(
                "estimates are not of one frame", where=self._part, found=found, expected=expected
            )

    @property
    def _has_smoothed(self) -> bool:
        return any(order.count for order in self._smoothed)

    def _add_smoothed(self, estimate: Estimate, write: Callable[[], None], subject: int) -> None:
        order = self._smoothed[subject]
        with self._guarded():
            if not self._has_smoothed:
                self._flush()  # keeps the bytes up to here equal to a run without smoothing
            order.check(estimate.stamp_ns, self._part)
            write()
        order.add(estimate.stamp_ns)
        if order.count % self._flush_frames == 0:
            self._flush()

    def restart(self, subjects: Sequence[Subject]) -> None:
        """Begin again with other subjects; nothing may have been written yet."""
        self._check_open()
        if self.frames_written or self._truth_messages:
            raise ResultError("subjects change after the first frame", where=self._part)
        self._sink.close()
        self._begin(self._path, self._part, tuple(subjects), self._cameras, self._run, self._flush_frames)

    def add_truth(self, message: TruthMessage) -> None:
        """Copy a message of a ``/truth/...`` topic unchanged."""
        with self._guarded():
            self._channels.write_truth(message)
        self._truth_messages += 1

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach the bytes of a file, such as a model.

        Names that are already attached are skipped, so a resumed run may attach everything again.
        """
        if name in self._attached:
            return
        self._attached.add(name)
        with self._guarded():
            self._sink.attachment(name, media_type, data, 0)

    def save_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Save the tracker's state after the flushed frame, right after ``write`` returned True.

        Before the first frame, a checkpoint with frame_index -1 and frames_written 0 can be saved.

        Raises:
            ResultError: it cannot be saved, or is not of the last flushed frame.
        """
        self._check_open()
        if self._has_smoothed:
            raise ResultError("checkpoint after the smoothed track began", where=self._part)
        if (checkpoint.frame_index, checkpoint.frames_written) != self._flushed:
            raise ResultError(
                "checkpoint is not of the last flushed frame",
                where=self._part,
                found=f"frame {checkpoint.frame_index}, {checkpoint.frames_written} written",
                expected=f"frame {self._flushed[0]}, {self._flushed[1]} written",
            )
        _sync(self._part)  # the checkpoint must never be newer than the file, even after a power cut
        marked = replace(checkpoint, fingerprint=spool.fingerprint(self._run))
        spool.save(state_path(self._path), marked, self._progress)

    def finish(self, summary: Mapping[str, str]) -> None:
        """Write summary and index, and rename the file to its final name.

        Args:
            summary: summary of the run, such as skipped frames; must not contain anything that differs
                between equal runs, such as durations. Numbers of frames, lost, reinitialised and smoothed
                frames are added; with several subjects the fewest, and those of each, such as ``1.lost``.
        """
        counts = {"frames": self.frames_written}
        counts |= {status: self.count(status) for status in (Status.LOST, Status.REINITIALISED)}
        if self._has_smoothed:
            counts[SMOOTHED] = min(order.count for order in self._smoothed)
        if len(self._subjects) > 1:
            of_each = (Status.LOST.value, Status.REINITIALISED.value)
            counts |= {name: n for name, n in self._statuses.items() if name.endswith(of_each)}
        record = {str(key): str(count) for key, count in counts.items()} | dict(summary)
        with self._guarded():
            self._sink.flush()
            self._sink.metadata(SUMMARY_RECORD, dict(sorted(record.items())))
            self._sink.finish()
        self._closed = True
        with _reported(self._path):
            _sync(self._part)
            self._part.replace(self._path)
            state_path(self._path).unlink(missing_ok=True)

    def abort(self) -> None:
        """Close the file with index and footer but no summary, and keep it as NAME.part.

        Does nothing after ``finish``, a previous ``abort`` or a failed write.
        """
        if self._closed:
            return
        with self._guarded():
            self._sink.finish()
        self._closed = True

    def __enter__(self) -> ResultWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.abort()
        else:
            with suppress(ResultError):  # the first error is the one to report
                self.abort()

    def _begin(
        self,
        path: Path,
        written: Path,
        subjects: tuple[Subject, ...],
        cameras: Sequence[Camera],
        run: Mapping[str, str],
        flush_frames: int,
    ) -> None:
        """Open ``written`` and write the initial records."""
        if flush_frames < 1:
            raise ResultError("invalid flush_frames", found=flush_frames, expected="1 or more")
        self._path, self._part = path, written
        self._run, self._flush_frames = dict(run), flush_frames
        self._subjects, self._cameras = subjects, tuple(cameras)
        self._statuses = dict.fromkeys(_counters(subjects), 0)
        self._truth_messages = 0
        self._attached = set()
        self._smoothed = tuple(StampOrder() for _ in subjects)
        self._last_index = -1
        self._flushed = (-1, 0)
        self._closed = self._calibrated = False
        self._progress = Progress(0, flush_frames, 0, dict(self._statuses))
        check_place(path)
        records = _first_records(run, subjects, cameras)
        self._sink = McapSink(written)
        with self._guarded():
            for name, record in records.items():
                self._sink.metadata(name, record)
            self._channels = ResultChannels(self._sink, subjects, cameras)
        self._flush()

    def _restore(self, checkpoint: Checkpoint, progress: Progress) -> None:
        """Copy the flushed part of the interrupted file, replace it and restore the counters."""
        with self._guarded():
            replay = Replay(part_path(self._path), self._sink, self._channels)
            replay.run(progress.file_bytes)
        self._attached = replay.attached
        found = self._channels.estimates_replayed, self._channels.truth_replayed
        if found != (checkpoint.frames_written, progress.truth_messages):
            raise _unusable(self._path, "{} estimates and {} truth messages in the result".format(*found))
        self._statuses |= progress.statuses
        self._truth_messages = progress.truth_messages
        self._calibrated = self.frames_written > 0
        self._last_index = checkpoint.frame_index
        self._flush()
        with _reported(self._path):
            _sync(self._part)
            self._part.replace(part_path(self._path))
        self._part = self._sink.path = part_path(self._path)

    def _flush(self) -> None:
        with self._guarded():
            self._sink.flush()
        self._flushed = (self._last_index, self.frames_written)
        self._progress = Progress(
            file_bytes=self._part.stat().st_size,
            flush_frames=self._flush_frames,
            truth_messages=self._truth_messages,
            statuses=dict(self._statuses),
        )

    def _check_open(self) -> None:
        if self._closed:
            raise ResultError("result is closed", where=self._part)

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Refuse to write to a closed file, and close it if writing fails."""
        self._check_open()
        try:
            yield
        except ResultError as error:
            if isinstance(error.__cause__, OSError):
                self._abandon()
            raise

    def _abandon(self) -> None:
        """Close after a failure and truncate the file to the last flush."""
        self._closed = True
        with suppress(ResultError):
            self._sink.close()
        if self._progress.file_bytes:
            with suppress(OSError):
                os.truncate(self._part, self._progress.file_bytes)


def _as_tuple(subject: Subject | Sequence[Subject]) -> tuple[Subject, ...]:
    return (subject,) if isinstance(subject, Subject) else tuple(subject)


def _counted(subject: Subject, status: Status) -> str:
    """Return the name of a counter: ``lost``, or ``left.lost`` for one of several subjects."""
    return f"{subject.label}.{status.value}" if subject.label else status.value


def _counters(subjects: Sequence[Subject]) -> list[str]:
    return [_counted(subject, status) for subject in subjects for status in Status]


def _frames(statuses: Mapping[str, int], subjects: Sequence[Subject]) -> int:
    return sum(statuses[_counted(subjects[0], status)] for status in Status)


def _first_records(
    run: Mapping[str, str], subjects: Sequence[Subject], cameras: Sequence[Camera]
) -> dict[str, Mapping[str, str]]:
    """Return the initial metadata, sorted, since their order affects the bytes."""
    about: dict[str, Mapping[str, str]] = {
        RUN_RECORD: dict(sorted(run.items())),
        **subjects_to_records(subjects),
    }
    return about if len(cameras) == 1 else {**about, CAMERAS_RECORD: cameras_to_record(cameras)}


def _check_checkpoint(
    path: Path,
    checkpoint: Checkpoint,
    progress: Progress,
    run: Mapping[str, str],
    flush_frames: int,
    subjects: Sequence[Subject],
) -> None:
    """Check that the checkpoint belongs to this run, has the same flush interval, and is consistent."""
    if checkpoint.fingerprint != spool.fingerprint(run):
        raise ResultError(
            "checkpoint belongs to another run", where=state_path(path), hint=spool.RESTART_HINT
        )
    if progress.flush_frames != flush_frames:
        raise UsageError(
            "the unfinished result has another flush interval",
            where=part_path(path),
            found=f"{progress.flush_frames} frames",
            expected=f"{flush_frames} frames",
            hint=f"resume with its original options, or {spool.RESTART_HINT}",
        )
    try:
        check_numbers(progress.statuses, dict.fromkeys(_counters(subjects), COUNTS))
    except LayoutError as error:
        raise _unusable(path, error) from error
    written = checkpoint.frames_written
    if written != _frames(progress.statuses, subjects) or (written > 0) != (checkpoint.frame_index >= 0):
        raise _unusable(path, f"{written} estimates up to frame {checkpoint.frame_index}")


def _unusable(path: Path, found: object) -> ResultError:
    """Return the error for a readable but inconsistent checkpoint."""
    return ResultError(
        "checkpoint cannot be used", where=state_path(path), found=found, hint=spool.RESTART_HINT
    )


def _sync(path: Path) -> None:
    """Sync the file to disk."""
    with _reported(path), path.open("rb") as stream:
        os.fsync(stream.fileno())


@contextmanager
def _reported(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ResultError("cannot be written", where=path, found=error.strerror or error) from error
