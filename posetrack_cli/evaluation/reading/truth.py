"""Loading of ground truth from files, folders and topics."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.errors import PosetrackError, TruthError, UsageError
from posetrack_cli.evaluation.reading.tracks import MOTION_FIELDS, Track, truth_of_columns
from posetrack_cli.evaluation.reading.truth_tables import check_point_names, load_csv_track
from posetrack_cli.evaluation.reading.truth_topics import (
    ODOMETRY_SCHEMA,
    POINTS_SCHEMA_NAME,
    odometry_topic,
    odometry_track,
    points_topic,
    points_track,
)
from posetrack_cli.geometry.rigid import rotation_from_rows
from posetrack_cli.geometry.rotations import canonical, quaternions_from_matrices
from posetrack_cli.head.dense.numbers import TRUE_NUMBERS
from posetrack_cli.head.subject import HEAD
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import McapFile, is_mcap
from posetrack_cli.recording.base import TRUTH_PREFIX
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.results.columns import Columns, column_blocks, empty_columns, joined
from posetrack_cli.results.estimate import Subject
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, json_of_estimate
from posetrack_cli.results.fields import NUMBERS as FURTHER
from posetrack_cli.results.fields import Sizes
from posetrack_cli.results.reader import Result, is_result, read_result
from posetrack_cli.units import NS_PER_S

# Biwi Kinect head pose data: a folder of ``frame_NNNNN_pose.txt``.
#
# A file has the head rotation, row by row, and the head centre in mm, in camera axes. The data set specifies
# neither the camera nor the origin of the head frame; ``--align rigid`` removes both constants.


HAND, LABEL_SUFFIXES = "hand", (".txt", ".mat")
POSE_FILE = re.compile(r"frame_([0-9]{1,9})_pose\.txt")
NUMBERS = 12
"""Numbers in a pose file: nine of the rotation, three of the centre."""


def holds_poses(folder: Path) -> bool:
    """Whether a folder has Biwi pose files."""
    try:
        return any(POSE_FILE.fullmatch(file.name) for file in folder.iterdir())
    except OSError:
        return False


def load_biwi_poses(folder: Path, run: Mapping[str, str]) -> Track:
    """Read the poses of a Biwi sequence, with the stamps of its images.

    Args:
        folder: folder of the sequence.
        run: run record of the evaluated result, which states the frame rate.

    Raises:
        TruthError: a file is invalid.
    """
    from posetrack_cli.recording.datasets.biwi import SENSOR
    from posetrack_cli.recording.datasets.layout import nominal_stamps, numbered

    try:
        files = numbered(folder, POSE_FILE)
        if len(files) > limits.KEYPOINT_SETS:
            raise TruthError("too many poses", where=folder, found=len(files), expected=limits.KEYPOINT_SETS)
        fps = run.get("input.fps")
        stamps, _, _ = nominal_stamps(files, float(fps) if fps else None, SENSOR)
        values = [_numbers(file) for file in files.values()]
        rotations = [rotation_from_rows(v[:9], str(f)) for v, f in zip(values, files.values(), strict=True)]
    except TruthError:
        raise
    except (PosetrackError, ValueError) as error:
        raise TruthError(str(error)) from error
    return Track(
        folder.name,
        HEAD,
        shape_names=(),
        point_names=(),
        point_parents=(),
        stamp_ns=np.array(stamps),
        position=np.array([v[9:] for v in values]),
        quaternion=canonical(quaternions_from_matrices(np.array(rotations))),
    )


def _numbers(file: Path) -> list[float]:
    from posetrack_cli.recording.datasets.layout import numbers_of

    values = numbers_of(file)
    if len(values) != NUMBERS or not np.isfinite(values).all() or np.abs(values).max() > limits.LENGTH_MM:
        expected = "nine numbers of a rotation and three of a centre, mm"
        raise TruthError("not a pose", where=file, found=f"{len(values)} numbers", expected=expected)
    return values


# Selection of the reader


def load_truth(
    result: Result,
    path: Path | None = None,
    *,
    time_offset_s: float = 0.0,
    losses: LossLog | None = None,
    label: str | None = None,
    columns: Columns | None = None,
) -> Track | None:
    """Return the ground truth of a result, with its points in the order of the result.

    Without a path, the topics ``/truth/<subject>/...`` of the result are used (``/truth/hand/left/...`` for
    one of several): complete estimates, else
    Odometry with optional JointStates (``odometry_track``), else points (``points_track``). With a path:

    - another result: its **estimates**, without lost ones, such as a stereo track as ground truth for a mono
      track; not its ``/truth`` topics;
    - another MCAP file, such as the recording: its ``/truth`` topics;
    - another file: read as a table (``load_csv_track``);
    - a folder, for heads: Biwi poses, or annotated landmarks (``image_points``);
    - for hands, a file or folder of a public dataset (``hand_labels``).

    Args:
        result: result to evaluate.
        path: file or folder; None for the ground truth in the result.
        time_offset_s: added to the ground-truth stamps, s.
        losses: receives unreadable parts of the file; those of the result are in ``result.losses``.
        label: label of the subject in the ground truth; None for that in the result.
        columns: columns of ``estimate_truth_topic``, if they are read already.

    Returns:
        None if the result has no ground truth and no path is given.

    Raises:
        UsageError: the path is the result itself, or the offset exceeds the range of stamps.
        TruthError: the file is invalid, or has another subject or other points.
        ResultError, RecordingError: an MCAP file cannot be read, or its stamps do not increase strictly.
    """
    log = LossLog() if losses is None else losses
    subject = result.subject if label is None else replace(result.subject, label=label)
    truth: Track | None
    if columns is not None:
        truth = _of_columns(columns, subject, result.path, "ground truth")
    elif path is None:
        truth = topics_truth(McapFile(result.path), subject, "ground truth")
    else:
        truth = _given(result, path, subject, log)
    if truth is None:
        return None
    truth = _shifted(truth, time_offset_s)
    # Metrics address points and shape entries by column, in the order of the subject.
    truth = _with_points_of(truth, subject, path or result.path)
    return _with_shape_of(truth, subject)


def estimate_truth_topic(result: Result, path: Path | None, label: str | None) -> str | None:
    """Return the topic of the true estimates in a result; None if ``load_truth`` reads other data."""
    subject = result.subject if label is None else replace(result.subject, label=label)
    topic = _estimate_topic(subject.topic)
    known = (channel.topic for schema, channel in result.channels if schema.name == ESTIMATE_SCHEMA_NAME)
    return topic if path is None and topic in known else None


def truth_labels(result: Result, path: Path | None = None) -> tuple[str, ...]:
    """Return the labels of the subjects with ground truth; see ``load_truth``.

    An only subject has an empty label. Tables and folders have one subject.
    """
    name = result.subjects[0].name
    if path is not None and not (path.is_file() and is_mcap(path)):
        return ("",)
    if path is not None and is_result(path):
        return tuple(one.label for one in read_result(path).subjects if one.name == name)
    kinds = "estimate|odometry|points"
    form = re.compile(rf"{TRUTH_PREFIX}{re.escape(name)}(?:/([A-Za-z0-9_-]+))?/(?:{kinds})", re.ASCII)
    found = (form.fullmatch(topic) for topic in _truth_topics(result.path if path is None else path))
    return tuple(sorted({match[1] or "" for match in found if match}))


def _given(result: Result, path: Path, subject: Subject, losses: LossLog) -> Track:
    if path.is_dir() and subject.name == HEAD:
        # imported here: other ground truth is read without OpenCV
        from posetrack_cli.evaluation.reading.image_points import load_image_points

        return load_biwi_poses(path, result.run) if holds_poses(path) else load_image_points(path, result)
    if subject.name == HAND and (path.is_dir() or path.suffix in LABEL_SUFFIXES):
        from posetrack_cli.evaluation.reading.hand_labels import is_labels, load_labels

        if is_labels(path):
            return load_labels(path, result)
    if not path.is_file():
        raise TruthError("not a file" if path.exists() else "no such file", where=path)
    # samefile also recognises links; all errors would be 0.
    if path.samefile(result.path):
        raise UsageError(
            "a result cannot be its own ground truth",
            where=path,
            hint="omit --truth to use the ground truth in the result",
        )
    if not is_mcap(path):
        return load_csv_track(path, subject)
    if is_result(path):
        return _estimates_of(path, subject, losses)
    truth = topics_truth(McapFile(path, losses), subject, path.name)
    if truth is None:
        raise TruthError(
            f"no ground truth of a {subject.name}",
            where=path,
            found=", ".join(_truth_topics(path)) or "no /truth topics",
            expected=", ".join(
                topic(subject.topic) for topic in (_estimate_topic, odometry_topic, points_topic)
            ),
        )
    return truth


def _estimates_of(path: Path, subject: Subject, losses: LossLog) -> Track:
    """Return the estimates of another result as ground truth."""
    other = read_result(path)
    other = other.of(subject.label) if len(other.subjects) > 1 else other
    if other.subject.name != subject.name:
        raise TruthError("wrong subject", where=path, found=other.subject.name, expected=subject.name)
    truth = truth_of_columns(other.columns(fields=MOTION_FIELDS), path.name, other.subject)
    losses.include(other.losses)
    return truth


def topics_truth(file: McapFile, subject: Subject, name: str) -> Track | None:
    """Return the ground truth on the topics of an MCAP file; None if there is none of this subject."""
    schemas = {c.topic: s.name for s, c in McapFile(file.path).channels() if s is not None}
    if schemas.get(_estimate_topic(subject.topic)) == ESTIMATE_SCHEMA_NAME:
        return _estimates_truth(file, subject, name)
    if schemas.get(odometry_topic(subject.topic)) == ODOMETRY_SCHEMA:
        return odometry_track(file, subject, schemas, name)
    if schemas.get(points_topic(subject.topic)) == POINTS_SCHEMA_NAME:
        return points_track(file, subject, name)
    return None


def _estimates_truth(file: McapFile, subject: Subject, name: str) -> Track:
    """Return the ground truth on a topic of ``posetrack.Estimate``."""
    items = file.messages([_estimate_topic(subject.topic)])
    fields, names = truth_fields(subject)
    messages = (json_of_estimate(item, names or subject.number_names) for item in items)
    columns = joined(column_blocks(messages, fields, number_names=names))
    sizes = Sizes.of(subject)._replace(numbers=len(names))
    return _of_columns(columns or empty_columns(fields, sizes), subject, file.path, name)


def truth_fields(subject: Subject) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the fields of true estimates that are read, and the names of their additional numbers."""
    return ((*MOTION_FIELDS, FURTHER), TRUE_NUMBERS) if subject.name == HEAD else (MOTION_FIELDS, ())


def _of_columns(columns: Columns, subject: Subject, path: Path, name: str) -> Track:
    """Return the ground truth of true estimates; ``name`` is that of the track."""
    sizes = Sizes.of(subject)
    subject = replace(subject, number_names=truth_fields(subject)[1])
    found = columns["shape"].shape[1], columns["points"].shape[1]
    if found == (0, sizes.points):  # heads, whose deformation is only given by the points
        subject = replace(subject, shape_names=())
    elif found != sizes[:2]:
        raise TruthError(
            "ground truth has a different number of shape entries or points",
            where=f"{path}, {_estimate_topic(subject.topic)}",
            found=f"{found[0]} and {found[1]}",
            expected=f"{sizes.shape} and {sizes.points}",
        )
    return truth_of_columns(columns, name, subject)


def _estimate_topic(subject: str) -> str:
    return f"{TRUTH_PREFIX}{subject}/estimate"


def _truth_topics(path: Path) -> Sequence[str]:
    topics = (channel.topic for _, channel in McapFile(path).channels())
    return sorted(topic for topic in topics if topic.startswith(TRUTH_PREFIX))


def _shifted(truth: Track, offset_s: float) -> Track:
    """Return the ground truth with the offset added to its stamps."""
    if offset_s == 0.0 or not len(truth):
        return truth
    if truth.frame_index is not None:
        raise UsageError(
            "time offset does not apply: annotations are matched by frame number",
            hint="omit --time-offset-s",
        )
    offset = round(offset_s * NS_PER_S)
    if max(abs(int(truth.stamp_ns[0]) + offset), abs(int(truth.stamp_ns[-1]) + offset)) > LATEST_NS:
        raise UsageError("time offset exceeds the range of 64-bit stamps", found=f"{offset_s} s")
    return replace(truth, stamp_ns=truth.stamp_ns + offset)


def _with_points_of(truth: Track, subject: Subject, where: Path) -> Track:
    if truth.points is None or truth.point_names == subject.point_names:
        return truth
    known = tuple(name for name in subject.point_names if name in truth.point_names)
    # Annotations of hands may have some of the joints, which are compared by name.
    if subject.name != HAND or not known:
        check_point_names(subject.point_names, truth.point_names, where)
    columns = [truth.point_names.index(name) for name in known]
    points = truth.points[:, columns] if columns else None
    parents = subject.point_parents if known == subject.point_names else ()
    return replace(truth, point_names=known, point_parents=parents, points=points)


def _with_shape_of(truth: Track, subject: Subject) -> Track:
    if (
        truth.shape is None
        or truth.shape_names == subject.shape_names
        or sorted(truth.shape_names) != sorted(subject.shape_names)
    ):
        return truth
    columns = np.array([truth.shape_names.index(name) for name in subject.shape_names], dtype=np.int64)
    twist = truth.twist  # its last K columns are the shape rates, in the same order
    if twist is not None:
        twist = np.hstack([twist[:, :6], twist[:, 6 + columns]])
    return replace(truth, shape_names=subject.shape_names, shape=truth.shape[:, columns], twist=twist)
