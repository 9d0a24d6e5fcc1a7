"""Read a result, also one that is unfinished, damaged, or whose writer was killed."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import IO

from google.protobuf.message import DecodeError
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
from posetrack_cli.recording.message_cameras import camera_from_message
from posetrack_cli.results.channels import (
    CALIBRATION_TOPIC,
    FILTERED,
    SMOOTHED,
    SMOOTHED_PREFIX,
    TRACKS,
    estimate_topic,
)
from posetrack_cli.results.columns import Columns, column_blocks, empty_columns, joined
from posetrack_cli.results.estimate import Estimate, Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_from_json
from posetrack_cli.results.fields import FIELD_NAMES, NUMBERS, Sizes
from posetrack_cli.results.messages import CameraCalibration
from posetrack_cli.results.records import (
    CAMERAS_RECORD,
    SUBJECT_RECORD,
    SUMMARY_RECORD,
    cameras_from_record,
    check_run_record,
    subject_from_record,
)

PATTERN = "a shell fills in patterns that are not quoted"
NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")
NO_ESTIMATES = "there are none at all: it ends before the first, or was never begun"


class ResultWarning(UserWarning):
    """A result was read that is truncated or damaged: some of it is missing."""


@dataclass(frozen=True)
class Result:
    """A result file; its messages are read when they are asked for, one chunk in memory at a time.

    A truncated or damaged file is read as far as it goes: ``losses`` tells what was missing.

    Attributes:
        path: the file, NAME or NAME.part.
        subject: what was tracked.
        run: the run record.
        summary: written at the end; empty for a run that did not finish.
        truncated: whether the file ends without a footer, as a killed writer leaves it. Every flushed
            estimate can be read all the same.
        several_cameras: all of them, the reference first; () for a result from one camera.
    """

    path: Path
    subject: Subject
    run: Mapping[str, str]
    summary: Mapping[str, str]
    truncated: bool
    several_cameras: tuple[Camera, ...] = ()
    _losses: LossLog = field(default_factory=LossLog, repr=False, compare=False)

    @property
    def finished(self) -> bool:
        """Whether the run came to its end."""
        return bool(self.summary)

    @property
    def field_names(self) -> tuple[str, ...]:
        """The fields of this subject's estimates: those of all, and its further numbers if it has some."""
        return (*FIELD_NAMES, NUMBERS) if self.subject.number_names else FIELD_NAMES

    @property
    def estimate_topic(self) -> str:
        """The topic of this result's own, filtered estimates."""
        return estimate_topic(self.subject.name)

    @property
    def tracks(self) -> tuple[str, ...]:
        """The names of the tracks in it: ``filtered``, and ``smoothed`` where the run made one to its end."""
        topics = {channel.topic for _, channel in self.channels}
        smoothed = self.finished and estimate_topic(self.subject.name, SMOOTHED) in topics
        return TRACKS if smoothed else (FILTERED,)

    def topic_of_track(self, track: str = FILTERED) -> str:
        """Return the topic of a track's estimates.

        Raises:
            ResultError: there is no such track, or the result has none; a run that did not finish has no
                smoothed one, as its backward pass did not come to the first frame.
        """
        topic = estimate_topic(self.subject.name, track)
        if track not in self.tracks:
            what = f"has no {track} track{'' if self.finished else ': the run did not finish'}"
            raise ResultError(what, where=self.path, hint="posetrack hand run --smooth writes one")
        return topic

    @cached_property
    def channels(self) -> tuple[tuple[Schema, Channel], ...]:
        """Every channel with its schema, ordered by topic."""
        with self._reading() as file:
            found = [(schema or NO_SCHEMA, channel) for schema, channel in file.channels()]
        return tuple(sorted(found, key=lambda pair: (pair[1].topic, pair[1].id)))

    @property
    def truth_topics(self) -> tuple[str, ...]:
        """The topics of ground truth."""
        topics = (channel.topic for _, channel in self.channels)
        return tuple(topic for topic in topics if topic.startswith(TRUTH_PREFIX))

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What could not be read so far: the rest of a truncated file, damaged chunks. Empty if all is well.

        Filled by reading: a pass that goes through the whole file tells all of it.
        """
        return self._losses.losses

    def topic_of_estimates(self, topic: str | None = None) -> str:
        """Return a topic that is asked for, by default this result's own.

        Raises:
            ResultError: it is no topic of ``posetrack.Estimate``.
        """
        if topic is None:
            return self.estimate_topic
        known = {c.topic for s, c in self.channels if s.name == ESTIMATE_SCHEMA_NAME}
        if topic not in known:
            hint = nearest_name(topic, known) if known else NO_ESTIMATES
            raise ResultError(f"no estimates on topic '{topic}'", where=self.path, hint=hint)
        return topic

    def estimates(self, topic: str | None = None) -> Iterator[Estimate]:
        """Yield the estimates in file order; what cannot be read is left out and told in ``losses``.

        Those of a smoothed track come by their stamps, whichever way they were written, as long as the file
        has its index.

        Args:
            topic: any topic of ``posetrack.Estimate``, such as that of a truth or another track
                (``topic_of_track``); by default the result's own.

        Raises:
            ResultError: there is no such topic, or a message on it is no estimate.
        """
        topic = self.topic_of_estimates(topic)
        own = not topic.startswith(TRUTH_PREFIX)
        for _, _, message in self._messages([topic]):
            where = f"{self.path}, {topic} at {message.log_time} ns"
            estimate = estimate_from_json(message.data, where, self.subject.number_names)
            if own:
                self._check_sizes(topic, {"shape": len(estimate.shape), "points": len(estimate.points)})
            yield estimate

    def column_blocks(
        self, topic: str | None = None, fields: Collection[str] | None = None
    ) -> Iterator[Columns]:
        """Yield ``columns`` 1000 frames at a time (the last block has fewer); memory does not grow."""
        topic, fields = self.topic_of_estimates(topic), fields or self.field_names
        messages = (message.data for _, _, message in self._messages([topic]))
        blocks = column_blocks(
            messages, fields, where=f"{self.path}, {topic}", number_names=self.subject.number_names
        )
        own = not topic.startswith(TRUTH_PREFIX)
        # map, as a loop's variable would keep each block while the next one grows
        yield from map(partial(self._checked, topic), blocks) if own else blocks

    def _checked(self, topic: str, block: Columns) -> Columns:
        """Return a block if its estimates have the shape entries and points that the subject record names."""
        sized = ("shape", "points")
        self._check_sizes(topic, {name: block[name].shape[1] for name in sized if name in block})
        return block

    def _check_sizes(self, topic: str, sizes: Mapping[str, int]) -> None:
        names = {"shape": self.subject.shape_names, "points": self.subject.point_names}
        for field_name, found in sizes.items():
            expected = len(names[field_name])
            if found != expected:
                raise ResultError(
                    f"estimates have other {field_name} than the subject",
                    where=f"{self.path}, {topic}",
                    found=f"{found} entries",
                    expected=expected,
                )

    def columns(self, topic: str | None = None, fields: Collection[str] | None = None) -> Columns:
        """Return all estimates as arrays, in file order; what cannot be read is left out, see ``losses``.

        Args:
            topic: as of ``estimates``.
            fields: of ``Estimate``, those that are wanted; by default ``field_names``.

        Returns:
            One array per field, under its name, with the frames (N) along the first axis; ``status`` as text;
            a cost, time or velocity that a message does not have as NaN.

        Raises:
            ResultError: as of ``estimates``, or messages differ in their numbers of shape entries or points,
                on the topics of tracks from those of the subject, too.
        """
        fields = fields or self.field_names
        return joined(self.column_blocks(topic, fields)) or empty_columns(fields, Sizes.of(self.subject))

    def numbers(self) -> dict[str, FloatArray]:
        """Return the further numbers of the result's own estimates, (N,) by name; NaN where one is not known.

        Raises:
            ResultError: as of ``columns``.
        """
        names = self.subject.number_names
        if not names:
            return {}
        return dict(zip(names, self.columns(fields=(NUMBERS,))[NUMBERS].T, strict=True))

    def truth(self) -> Iterator[TruthMessage]:
        """Return the messages of ground truth undecoded, in file order."""
        return map(truth_message, self._messages(lambda topic: topic.startswith(TRUTH_PREFIX)))

    def camera(self) -> Camera:
        """Return the camera that the estimates are relative to; its name is the frame id.

        Raises:
            ResultError: the file ends before its first flush.
        """
        if self.several_cameras:
            return self.several_cameras[0]
        for _, _, message in self._messages([CALIBRATION_TOPIC]):
            return self._calibrated(message.data)
        raise ResultError("holds no camera calibration", where=self.path)

    def _calibrated(self, data: bytes) -> Camera:
        where = f"{self.path}, {CALIBRATION_TOPIC}"
        if len(data) > limits.MESSAGE_BYTES:
            raise ResultError("camera calibration cannot be used", where=where, found=f"{len(data)} bytes")
        try:
            calibration = CameraCalibration.FromString(data)
            camera = camera_from_message(calibration, calibration.frame_id, CALIBRATION_TOPIC)
        except (DecodeError, PosetrackError) as error:
            raise ResultError("camera calibration cannot be used", where=where, found=error) from error
        if camera.width * camera.height > limits.IMAGE_PIXELS:
            found = f"images of {camera.width}x{camera.height}"
            raise ResultError("camera calibration cannot be used", where=where, found=found)
        return camera

    def cameras(self) -> tuple[Camera, ...]:
        """Return all cameras, that of the estimates first, the others placed relative to it.

        Raises:
            ResultError: the file ends before its first flush.
        """
        return self.several_cameras or (self.camera(),)

    def attachment(self, name: str) -> bytes:
        """Return the bytes of an attached file, such as a model.

        Raises:
            ResultError: there is none of this name.
        """
        with self._reading() as file:
            found = {record.name: record.data for record in file.extras() if isinstance(record, Attachment)}
        if name not in found:
            raise ResultError(
                f"holds no attachment '{name}'", where=self.path, found=", ".join(found) or "none"
            )
        return found[name]

    def _messages(self, topics: Topics) -> Iterator[McapItem]:
        """Yield the messages on some topics in file order, those of a smoothed track by their log times."""
        with self._reading() as file:
            backward = not callable(topics) and any(name.startswith(SMOOTHED_PREFIX) for name in topics or ())
            yield from file.messages(topics, in_file_order=not backward)

    @contextmanager
    def _reading(self) -> Iterator[McapFile]:
        """Whatever a pass loses is told in ``losses``, also by a pass that ends early."""
        file = McapFile(self.path)
        try:
            with opened(self.path):
                yield file
        finally:
            self._losses.include(file.losses.losses)


def read_result(path: Path | str) -> Result:
    """Open a result file, finished or not, also one that is truncated or damaged.

    Raises:
        ResultError: it is missing, no MCAP file, or not written by posetrack.
    """
    path = Path(path)
    if not path.exists() and part_path(path).exists():
        raise ResultError("does not exist", where=path, hint=f"an unfinished run left {part_path(path)}")
    file = McapFile(path)
    with opened(path):
        metadata = {r.name: r.metadata for r in file.extras() if isinstance(r, Metadata)}
    if RUN_RECORD not in metadata or SUBJECT_RECORD not in metadata:
        raise ResultError(
            "is no result of posetrack",
            where=path,
            found=loss_line(file.losses.losses),
            expected=f"metadata {RUN_RECORD}",
        )
    try:
        subject = subject_from_record(metadata[SUBJECT_RECORD])
        check_run_record(metadata[RUN_RECORD])
        cameras = cameras_from_record(metadata[CAMERAS_RECORD]) if CAMERAS_RECORD in metadata else ()
    except ResultError as error:
        raise ResultError(str(error), where=path) from error
    truncated = any(loss.what in (TRUNCATED, DAMAGED) for loss in file.losses.losses)
    summary = metadata.get(SUMMARY_RECORD, {})
    return Result(path, subject, metadata[RUN_RECORD], summary, truncated, cameras, file.losses)


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Open an MCAP file; whatever the operating system refuses while it is read is one line.

    Raises:
        ResultError: the file cannot be read, or is no MCAP file.
    """
    try:
        with open_input(path) as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise ResultError("is no MCAP file", where=path, hint="results are .mcap files")
            yield stream
    except OSError as error:
        hint = "" if path.exists() else hint_of_missing(path, PATTERN)
        found = error.strerror or error
        raise ResultError("cannot be read", where=path, found=found, hint=hint) from error


def is_result(path: Path) -> bool:
    """Whether an MCAP file has a run record: a result has one, a recording has none."""
    summary = read_summary(path)
    if summary is not None:
        return any(index.name == RUN_RECORD for index in summary.metadata_indexes)
    return any(isinstance(r, Metadata) and r.name == RUN_RECORD for r in McapFile(path).extras())


def load_arrays(path: Path | str, topic: str | None = None) -> Columns:
    """Load all estimates of a result as arrays, in three lines of Python::

        from posetrack_cli.results import load_arrays
        result = load_arrays("result.mcap")
        print(result["position"])

    A file that is truncated or damaged gives what can be read, with a ``ResultWarning``.

    Args:
        path: the result.
        topic: as of ``Result.estimates``.

    Returns:
        As ``Result.columns``.

    Raises:
        ResultError: as of ``read_result`` and ``Result.columns``.
    """
    result = read_result(path)
    columns = result.columns(topic)
    if result.losses:
        warnings.warn(f"{path}: {loss_line(result.losses)}", ResultWarning, stacklevel=2)
    return columns
