"""Reading of results, including unfinished, truncated and damaged ones."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import IO, TYPE_CHECKING

from mcap.records import Attachment, Channel, Metadata, Schema

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError, ResultError, nearest_name
from posetrack_cli.files import hint_of_missing, open_input
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import Loss, LossLog, loss_line
from posetrack_cli.mcap.records import MAGIC
from posetrack_cli.mcap.stream import (
    DAMAGED,
    TRUNCATED,
    McapFile,
    McapItem,
    Topics,
)
from posetrack_cli.mcap.summary import read_summary
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import RUN_RECORD, TRUTH_PREFIX, TruthMessage, truth_message
from posetrack_cli.recording.camera_record import CAMERAS_RECORD, camera_from_json, cameras_from_record
from posetrack_cli.results.columns import (
    FEW_FRAMES,
    BlockReader,
    Columns,
    Joiner,
    column_blocks,
    empty_columns,
)
from posetrack_cli.results.derived import derived, joint_angle_names, range_of_motion
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_from_json, json_of_estimate
from posetrack_cli.results.fields import FIELD_NAMES, NUMBERS, Sizes
from posetrack_cli.results.records import (
    SUBJECT_RECORD,
    SUMMARY_RECORD,
    check_run_record,
    subjects_from_records,
)
from posetrack_cli.results.topics import (
    CALIBRATION_TOPIC,
    FILTERED,
    SMOOTHED,
    SMOOTHED_PREFIX,
    TRACKS,
    estimate_topic,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PATTERN = "the shell expands patterns only if they are not quoted"
NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")
NO_ESTIMATES = "the file has no estimates: the run ended before its first flush"


NO_NAMES: Mapping[str, Sequence[str]] = MappingProxyType({})


class ResultWarning(UserWarning):
    """Warning that a truncated or damaged result was read incompletely."""


@dataclass(frozen=True)
class Result:
    """Result file; messages are read on demand, one chunk in memory at a time.

    Truncated or damaged files are read as far as possible; ``losses`` lists what is missing.

    Attributes:
        path: the file, NAME or NAME.part.
        subjects: tracked subjects.
        run: run record.
        summary: written at the end; empty for an unfinished run.
        truncated: whether the file has no footer, as after a killed run. All flushed estimates are
            readable.
        several_cameras: all cameras, the reference first; () if there is only one.
    """

    path: Path
    subjects: tuple[Subject, ...]
    run: Mapping[str, str]
    summary: Mapping[str, str]
    truncated: bool
    several_cameras: tuple[Camera, ...] = ()
    _losses: LossLog = field(default_factory=LossLog, repr=False, compare=False)

    @property
    def subject(self) -> Subject:
        """The tracked subject.

        Raises:
            ResultError: there are several; choose one with ``of``.
        """
        if len(self.subjects) > 1:
            found, hint = f"{', '.join(self.labels)}", "choose one with --of NAME, in Python result.of(NAME)"
            raise ResultError("has several tracks", where=self.path, found=found, hint=hint)
        return self.subjects[0]

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the subjects, such as ``left`` and ``right``; empty text for an only one."""
        return tuple(subject.label for subject in self.subjects)

    def of(self, label: str) -> Result:
        """Return the part of a result that belongs to one subject.

        Raises:
            ResultError: no subject has this label.
        """
        chosen = tuple(subject for subject in self.subjects if subject.label == label)
        if not chosen:
            named = [repr(known) for known in self.labels if known]
            found = f"tracks {', '.join(named)}" if named else "a single track without a name"
            raise ResultError(f"has no track '{label}'", where=self.path, found=found)
        return replace(self, subjects=chosen)

    @property
    def parts(self) -> tuple[Result, ...]:
        """The parts of each subject."""
        return tuple(replace(self, subjects=(subject,)) for subject in self.subjects)

    @property
    def finished(self) -> bool:
        """Whether the run finished."""
        return bool(self.summary)

    @property
    def field_names(self) -> tuple[str, ...]:
        """Fields of this subject's estimates, including additional numbers if it has any."""
        return (*FIELD_NAMES, NUMBERS) if self.subject.number_names else FIELD_NAMES

    @property
    def estimate_topic(self) -> str:
        """Topic of this result's filtered estimates."""
        return estimate_topic(self.subject.topic)

    @property
    def tracks(self) -> tuple[str, ...]:
        """Names of its tracks: ``filtered``, and ``smoothed`` if the backward pass was completed."""
        topics = {channel.topic for _, channel in self.channels}
        smoothed = self.finished and estimate_topic(self.subjects[0].topic, SMOOTHED) in topics
        return TRACKS if smoothed else (FILTERED,)

    def topic_of_track(self, track: str = FILTERED) -> str:
        """Return the topic of a track's estimates.

        Raises:
            ResultError: unknown track, or the result does not have it. An unfinished run has no smoothed
                track, as its backward pass did not reach the first frame.
        """
        topic = estimate_topic(self.subject.topic, track)
        if track not in self.tracks:
            what = f"has no {track} track{'' if self.finished else ': the run did not finish'}"
            raise ResultError(what, where=self.path, hint="posetrack hand run --smooth writes one")
        return topic

    @cached_property
    def channels(self) -> tuple[tuple[Schema, Channel], ...]:
        """All channels with their schemas, ordered by topic."""
        with self._reading() as file:
            found = [(schema or NO_SCHEMA, channel) for schema, channel in file.channels()]
        return tuple(sorted(found, key=lambda pair: (pair[1].topic, pair[1].id)))

    @property
    def truth_topics(self) -> tuple[str, ...]:
        """Topics of ground truth."""
        topics = (channel.topic for _, channel in self.channels)
        return tuple(topic for topic in topics if topic.startswith(TRUTH_PREFIX))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Data that could not be read so far: a truncated tail, damaged chunks.

        Updated by reading; complete after a pass over the whole file.
        """
        return self._losses.losses

    def topic_of_estimates(self, topic: str | None = None) -> str:
        """Return the given topic after checking it, or this result's own by default.

        Raises:
            ResultError: it is not a topic of ``posetrack.Estimate``.
        """
        if topic is None:
            return self.estimate_topic
        known = {c.topic for s, c in self.channels if s.name == ESTIMATE_SCHEMA_NAME}
        if topic not in known:
            hint = nearest_name(topic, known) if known else NO_ESTIMATES
            raise ResultError(f"no estimates on topic '{topic}'", where=self.path, hint=hint)
        return topic

    def estimates(self, topic: str | None = None) -> Iterator[Estimate]:
        """Yield the estimates in file order; unreadable ones are skipped and listed in ``losses``.

        Smoothed estimates are ordered by stamp regardless of the order of writing, if the file has its
        index.

        Args:
            topic: any topic of ``posetrack.Estimate``, such as ground truth or another track
                (``topic_of_track``); default: the result's own.

        Raises:
            ResultError: unknown topic, or a message on it is not an estimate.
        """
        topic = self.topic_of_estimates(topic)
        own = not topic.startswith(TRUTH_PREFIX)
        for item in self._messages([topic]):
            where = f"{self.path}, {topic} at {item[2].log_time} ns"
            estimate = estimate_from_json(self._json(item), where, self.subject.number_names)
            if own:
                self._check_sizes(topic, {"shape": len(estimate.shape), "points": len(estimate.points)})
            yield estimate

    def column_blocks(
        self, topic: str | None = None, fields: Collection[str] | None = None
    ) -> Iterator[Columns]:
        """Yield ``columns`` in blocks of 1000 frames, in constant memory."""
        topic, fields = self.topic_of_estimates(topic), fields or self.field_names
        messages = map(self._json, self._messages([topic]))
        blocks = column_blocks(
            messages, fields, where=f"{self.path}, {topic}", number_names=self.subject.number_names
        )
        # map instead of a loop: the loop variable would keep a block alive while the next one grows
        yield from map(partial(self._checked, topic), blocks)

    def _json(self, item: McapItem) -> bytes:
        return json_of_estimate(item, self.subject.number_names)

    def _checked(self, topic: str, block: Columns) -> Columns:
        """Return a block after checking the array sizes of a track against the subject."""
        if not topic.startswith(TRUTH_PREFIX):
            sized = (name for name in ("shape", "points") if name in block)
            self._check_sizes(topic, {name: block[name].shape[1] for name in sized})
        return block

    def _check_sizes(self, topic: str, sizes: Mapping[str, int]) -> None:
        names = {"shape": self.subject.shape_names, "points": self.subject.point_names}
        for field_name, found in sizes.items():
            expected = len(names[field_name])
            if found != expected:
                raise ResultError(
                    f"size of {field_name} differs from the subject's",
                    where=f"{self.path}, {topic}",
                    found=f"{found} entries",
                    expected=expected,
                )

    def columns(self, topic: str | None = None, fields: Collection[str] | None = None) -> Columns:
        """Return all estimates as arrays, in file order; unreadable ones are skipped, see ``losses``.

        Args:
            topic: see ``estimates``.
            fields: fields of ``Estimate`` to return; default: ``field_names``.

        Returns:
            One array per field, frames (N) along the first axis; ``status`` as text; missing costs, times
            and velocities as NaN.

        Raises:
            ResultError: see ``estimates``; or array sizes differ between messages or, on tracks, from the
                subject's.
        """
        topic = self.topic_of_estimates(topic)
        return self.columns_of({topic: fields or self.field_names})[topic]

    def columns_of(
        self,
        wanted: Mapping[str, Collection[str]],
        names: Mapping[str, Sequence[str]] = NO_NAMES,
        single: Collection[str] = (),
    ) -> dict[str, Columns]:
        """Return the ``columns`` of several topics, read in one pass over the file.

        Args:
            wanted: fields by topic.
            names: names of the additional numbers to return by topic, by default the subject's.
            single: fields to return in single precision.
        """
        numbers = {topic: names.get(topic, self.subject.number_names) for topic in wanted}
        readers = {
            topic: BlockReader(fields, FEW_FRAMES, f"{self.path}, {topic}", numbers[topic])
            for topic, fields in wanted.items()
        }
        grown = {topic: Joiner(single) for topic in wanted}
        for item in self._messages(tuple(wanted)):
            topic = item[1].topic
            if (block := readers[topic].add(json_of_estimate(item, numbers[topic]))) is not None:
                grown[topic].add(self._checked(topic, block))
        for topic, reader in readers.items():
            if (block := reader.rest()) is not None:
                grown[topic].add(self._checked(topic, block))
        sizes = Sizes.of(self.subject)
        return {topic: one.columns() or empty_columns(wanted[topic], sizes) for topic, one in grown.items()}

    def to_numpy(self, track: str = FILTERED) -> Columns:
        """Return a track as arrays by field, frames (N) along the first axis; see ``columns``.

        In addition there are ``pixels`` (N, C, P, 2), the points in the images of the C ``image_cameras``,
        and for hands ``joint_angles_deg`` (N, A), in the order of ``angle_names``.

        Raises:
            ResultError: see ``topic_of_track`` and ``columns``.
        """
        columns = self.columns(self.topic_of_track(track))
        return columns | derived(columns, self.subject, self.image_cameras)

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of the joint angles of a hand, () for other subjects."""
        return joint_angle_names(self.subject)

    def range_of_motion(self, track: str = FILTERED) -> Columns:
        """Return range and speed of each joint angle, or of a head's roll, pitch and yaw.

        Returns:
            Arrays with one value per angle; see ``results.derived.range_of_motion``.

        Raises:
            ResultError: the subject has no angles; or see ``to_numpy``.
        """
        return range_of_motion(self.columns(self.topic_of_track(track)), self.subject)

    def to_pandas(self, track: str = FILTERED) -> pd.DataFrame:
        """Return a track as a table with one row per frame, indexed by ``stamp_ns``.

        Columns have the names and units of exported CSV files.

        Raises:
            UsageError: pandas is not installed.
            ResultError: see ``to_numpy``.
        """
        from posetrack_cli.results.export.frames import to_pandas

        return to_pandas(self.columns(self.topic_of_track(track)), self.subject, self.image_cameras)

    def to_xarray(self, track: str = FILTERED) -> xr.Dataset:
        """Return a track as a dataset with labelled axes, points and parameters.

        Raises:
            UsageError: xarray is not installed.
            ResultError: see ``to_numpy``.
        """
        from posetrack_cli.results.export.frames import to_xarray

        return to_xarray(self.to_numpy(track), self.subject, self.image_cameras, self.run)

    def numbers(self) -> dict[str, FloatArray]:
        """Return the additional numbers of the result's own estimates, (N,) by name; NaN where unknown.

        Raises:
            ResultError: see ``columns``.
        """
        names = self.subject.number_names
        if not names:
            return {}
        return dict(zip(names, self.columns(fields=(NUMBERS,))[NUMBERS].T, strict=True))

    def truth(self) -> Iterator[TruthMessage]:
        """Return the ground truth messages undecoded, in file order."""
        return map(truth_message, self._messages(lambda topic: topic.startswith(TRUTH_PREFIX)))

    def camera(self) -> Camera:
        """Return the reference camera of the estimates; its name is the frame id.

        Raises:
            ResultError: the file ends before its first flush.
        """
        if self.several_cameras:
            return self.several_cameras[0]
        for _, _, message in self._messages([CALIBRATION_TOPIC]):
            return self._calibrated(message.data)
        raise ResultError("has no camera calibration", where=self.path)

    def _calibrated(self, data: bytes) -> Camera:
        # reading estimates needs neither protobuf nor OpenCV, which are slow to load
        from google.protobuf.message import DecodeError

        from posetrack_cli.recording.message_cameras import camera_from_message
        from posetrack_cli.results.messages import CameraCalibration

        where = f"{self.path}, {CALIBRATION_TOPIC}"
        if len(data) > limits.MESSAGE_BYTES:
            raise ResultError("invalid camera calibration", where=where, found=f"{len(data)} bytes")
        try:
            calibration = CameraCalibration.FromString(data)
            camera = camera_from_message(calibration, calibration.frame_id, CALIBRATION_TOPIC)
        except (DecodeError, PosetrackError) as error:
            raise ResultError("invalid camera calibration", where=where, found=error) from error
        if camera.width * camera.height > limits.IMAGE_PIXELS:
            found = f"images of {camera.width}x{camera.height}"
            raise ResultError("invalid camera calibration", where=where, found=found)
        return camera

    def cameras(self) -> tuple[Camera, ...]:
        """Return all cameras, the reference first, the others with poses relative to it.

        Raises:
            ResultError: the file ends before its first flush.
        """
        return self.several_cameras or (self.camera(),)

    @cached_property
    def image_cameras(self) -> tuple[Camera, ...]:
        """Cameras of the recorded images, read from metadata if possible; () if the calibration is lost."""
        try:
            if self.several_cameras or "camera" not in self.run:
                return self.cameras()
            return (camera_from_json(self.run["camera"]),)
        except (ValueError, PosetrackError):
            return ()

    def attachment(self, name: str) -> bytes:
        """Return the bytes of an attachment, such as a model.

        Raises:
            ResultError: there is no such attachment.
        """
        with self._reading() as file:
            found = {record.name: record.data for record in file.extras() if isinstance(record, Attachment)}
        if name not in found:
            raise ResultError(
                f"has no attachment '{name}'", where=self.path, found=", ".join(found) or "none"
            )
        return found[name]

    def _messages(self, topics: Topics) -> Iterator[McapItem]:
        """Yield messages in file order, those of a smoothed track (written in reverse) by log time."""
        with self._reading() as file:
            backward = not callable(topics) and any(name.startswith(SMOOTHED_PREFIX) for name in topics or ())
            yield from file.messages(topics, in_file_order=not backward)

    @contextmanager
    def _reading(self) -> Iterator[McapFile]:
        """Open the file and collect its losses, even if the pass ends early."""
        file = McapFile(self.path)
        try:
            with opened(self.path):
                yield file
        finally:
            self._losses.include(file.losses.losses)


def read_result(path: Path | str) -> Result:
    """Open a result, finished or not, including truncated and damaged files.

    Raises:
        ResultError: it is missing, not an MCAP file, or not written by posetrack.
    """
    path = Path(path)
    if not path.exists() and part_path(path).exists():
        raise ResultError("does not exist", where=path, hint=f"found an unfinished run, {part_path(path)}")
    file = McapFile(path)
    with opened(path):
        metadata = {r.name: r.metadata for r in file.extras() if isinstance(r, Metadata)}
    if RUN_RECORD not in metadata or not any(name.startswith(SUBJECT_RECORD) for name in metadata):
        raise ResultError(
            "is not a posetrack result",
            where=path,
            found=loss_line(file.losses.losses),
            expected=f"metadata {RUN_RECORD}",
        )
    try:
        subjects = subjects_from_records(metadata)
        check_run_record(metadata[RUN_RECORD])
        cameras = cameras_from_record(metadata[CAMERAS_RECORD]) if CAMERAS_RECORD in metadata else ()
    except ResultError as error:
        raise ResultError(str(error), where=path) from error
    truncated = any(loss.what in (TRUNCATED, DAMAGED) for loss in file.losses.losses)
    summary = metadata.get(SUMMARY_RECORD, {})
    return Result(path, subjects, metadata[RUN_RECORD], summary, truncated, cameras, file.losses)


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Open an MCAP file; convert OS errors during reading into a ResultError.

    Raises:
        ResultError: the file cannot be read or is not an MCAP file.
    """
    try:
        with open_input(path) as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise ResultError("is not an MCAP file", where=path, hint="results are .mcap files")
            yield stream
    except OSError as error:
        hint = "" if path.exists() else hint_of_missing(path, PATTERN)
        found = error.strerror or error
        raise ResultError("cannot be read", where=path, found=found, hint=hint) from error


def is_result(path: Path) -> bool:
    """Return whether an MCAP file is a result, i.e. has a run record."""
    summary = read_summary(path)
    if summary is not None:
        return any(index.name == RUN_RECORD for index in summary.metadata_indexes)
    return any(isinstance(r, Metadata) and r.name == RUN_RECORD for r in McapFile(path).extras())


def load_arrays(path: Path | str, topic: str | None = None) -> Columns:
    """Load all estimates of a result as arrays::

        from posetrack_cli.results import load_arrays
        result = load_arrays("result.mcap")
        print(result["position"])

    Truncated or damaged files are read as far as possible, with a ``ResultWarning``.

    Args:
        path: result file.
        topic: see ``Result.estimates``.

    Returns:
        See ``Result.columns``.

    Raises:
        ResultError: see ``read_result`` and ``Result.columns``.
    """
    result = read_result(path)
    columns = result.columns(topic)
    if result.losses:
        warnings.warn(f"{path}: {loss_line(result.losses)}", ResultWarning, stacklevel=2)
    return columns
