"""Source of an export, and the header of exported files."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import chain, islice
from typing import Any, NamedTuple

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.losses import loss_line
from posetrack_cli.results.columns import Columns, empty_columns, joined
from posetrack_cli.results.estimate import Estimate, Status, kind_of
from posetrack_cli.results.export.table import ColumnGroup, table_of
from posetrack_cli.results.fields import BY_NAME, Sizes
from posetrack_cli.results.reader import Result
from posetrack_cli.units import NS_PER_S


@dataclass(frozen=True)
class ExportSource:
    """Estimates to export.

    Attributes:
        result: result file.
        topic: topic of the estimates, or of ground truth with the same schema.
        lost: whether lost frames are included.
        session_start_ns: UNIX time at which the session began, for formats with dates; None if not given.
    """

    result: Result
    topic: str
    lost: bool = True
    session_start_ns: int | None = None

    @property
    def where(self) -> str:
        """File and topic, for errors."""
        return f"{self.result.path}, {self.topic}"

    def blocks(self, fields: Collection[str] | None = None) -> Iterator[Columns]:
        """Yield columns as ``Result.column_blocks`` does.

        Raises:
            ResultError: see there; or array sizes differ from the subject's.
        """
        wanted = {"status", "shape", "points", *(fields or self.result.field_names)}
        in_order = [name for name in BY_NAME if name in wanted]  # the order affects the output's bytes
        for block in self.result.column_blocks(self.topic, in_order):
            self._check(block)
            if self.lost:
                yield block
            else:
                kept = block["status"] != Status.LOST.value
                yield {name: column[kept] for name, column in block.items()}

    def columns(self, fields: Collection[str] | None = None) -> Columns:
        """Return all columns at once, or the given ones plus those that ``blocks`` needs."""
        return joined(self.blocks(fields)) or self.empty_columns(fields)

    def empty_columns(self, fields: Collection[str] | None = None) -> Columns:
        """Return columns without rows."""
        sizes = Sizes(*self._counts, len(self.result.subject.number_names))
        return empty_columns(fields or self.result.field_names, sizes)

    def estimates(self) -> Iterator[Estimate]:
        """Yield estimates one by one.

        Raises:
            ResultError: see ``blocks``.
        """
        for estimate in self.result.estimates(self.topic):
            self._check_counts((len(estimate.shape), len(estimate.points)))
            if self.lost or estimate.status is not Status.LOST:
                yield estimate

    def begun_blocks(self, fields: Collection[str] | None = None) -> Iterator[Columns]:
        """Return ``blocks`` with the first one already read, so that errors occur before any output."""
        blocks = self.blocks(fields)
        return chain(list(islice(blocks, 1)), blocks)

    @property
    def table(self) -> tuple[ColumnGroup, ...]:
        """Columns of exported tables."""
        return table_of(self.result.subject, self.result.image_cameras)

    @property
    def _counts(self) -> tuple[int, int]:
        return len(self.result.subject.shape_names), len(self.result.subject.point_names)

    def _check(self, block: Columns) -> None:
        self._check_counts((block["shape"].shape[1], block["points"].shape[1]))

    def _check_counts(self, found: tuple[int, int]) -> None:
        if found != self._counts:
            raise ResultError(
                "estimates do not fit the subject",
                where=f"{self.result.path}, {self.topic}",
                found="{} shape parameters and {} points".format(*found),
                expected="{} and {}".format(*self._counts),
            )


def export_source(
    result: Result, topic: str | None = None, *, lost: bool = True, session_start_ns: int | None = None
) -> ExportSource:
    """Return the estimates of a result to export.

    Args:
        result: result file.
        topic: any topic of ``posetrack.Estimate``, such as ground truth; default: the result's own.
        lost: whether lost frames are included.
        session_start_ns: see ``ExportSource``.

    Raises:
        ResultError: unknown topic.
    """
    return ExportSource(result, result.topic_of_estimates(topic), lost, session_start_ns)


class SessionTime(NamedTuple):
    """Times of frames in a session.

    Attributes:
        start: of the session; None if unknown.
        seconds: (N,) since the start, or since the first frame if it is unknown.
    """

    start: datetime | None
    seconds: FloatArray


FIRST_UNIX_NS = 946_684_800 * NS_PER_S
"""2000-01-01. Smaller stamps count from the start of a device or recording."""
_NS_PER_US = 1000


def session_time(source: ExportSource, stamps_ns: IntArray) -> SessionTime:
    """Return the times of frames with these stamps (N,), N > 0.

    Stamps that are UNIX time determine the start, the first frame's, unless one is given. Others count from
    the first frame, which the given start then belongs to.

    Raises:
        UsageError: the given start is after the first frame.
    """
    first_ns, start_ns = int(stamps_ns.min()), source.session_start_ns
    if first_ns < FIRST_UNIX_NS:
        base_ns, start_ns = first_ns, start_ns
    else:
        base_ns = start_ns = first_ns // _NS_PER_US * _NS_PER_US if start_ns is None else start_ns
    if base_ns > first_ns:
        found, expected = f"{utc(base_ns)}", f"{utc(first_ns)} or earlier"
        raise UsageError("session starts after its first frame", found=found, expected=expected)
    return SessionTime(None if start_ns is None else utc(start_ns), (stamps_ns - base_ns) / NS_PER_S)


def utc(stamp_ns: int) -> datetime:
    """Return the date and time of a stamp, to the microsecond."""
    return datetime.fromtimestamp(0, UTC) + timedelta(microseconds=stamp_ns // _NS_PER_US)


CAMERA_AXES = "x right, y down, z forward"
_SHORT_RECORDS = ("tracker", "version", "sources", "seed", "input.name", "input.sha256")


def header_lines(source: ExportSource) -> Iterator[str]:
    """Yield the comment lines above a trajectory."""
    result = source.result
    yield f"posetrack export of {result.path.name}, topic {source.topic}"
    yield (
        f"subject: {result.subject.name}, {len(result.subject.shape_names)} shape entries, "
        f"{len(result.subject.point_names)} points; camera frame {result.subject.camera_frame}"
    )
    records = {key: result.run[key] for key in _SHORT_RECORDS if key in result.run}
    yield f"run: {json.dumps(records, ensure_ascii=False)}{'' if result.finished else ', unfinished'}"
    yield f"lost frames: {'included' if source.lost else 'left out'}"
    if result.losses:
        yield f"missing data: {loss_line(result.losses)}"
    yield f"camera axes: {CAMERA_AXES}"


def header_values(source: ExportSource) -> dict[str, Any]:
    """Return the header of JSON and npz exports as plain values.

    ``losses`` are those known when the file is opened.
    """
    result = source.result
    groups = source.table
    return {
        "format": "posetrack.export",
        "version": 1,
        "result": result.path.name,
        "topic": source.topic,
        "finished": result.finished,
        "lost_frames": "in" if source.lost else "out",
        "subject": result.subject.name,
        **({"label": result.subject.label} if result.subject.label else {}),
        "camera_frame": result.subject.camera_frame,
        "camera_axes": CAMERA_AXES,
        "cameras": [
            camera.values() | {"camera_T_reference": camera.camera_T_reference}
            for camera in result.image_cameras
        ],
        "euler_order": kind_of(result.subject.name).euler_order,
        "shape_names": list(result.subject.shape_names),
        "point_names": list(result.subject.point_names),
        "point_parents": list(result.subject.point_parents),
        "units": {name: group.unit for group in groups for name in group.names},
        "meanings": {name: group.meaning for group in groups for name in group.names},
        "run": dict(result.run),
        "summary": dict(result.summary),
        "losses": loss_line(result.losses),
    }
