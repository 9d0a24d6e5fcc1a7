"""Exported tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Subject, kind_of
from posetrack_cli.results.fields import BY_NAME, NUMBERS
from posetrack_cli.units import NS_PER_S

# Estimates as frames of a fixed rate, for formats that know no other times.
#
# Stamps jitter, frames are dropped, tracks are left out while they are lost: frame i is what was estimated
# nearest to the time ``i / rate`` after the first estimate, or nothing if that is more than half a frame off.
# So times are right to half a frame over the whole recording, and no frame is told twice.


SINGLE_HZ = 30.0
"""Rate that is stated of a single frame, which has none."""


@dataclass(frozen=True, eq=False)
class FixedRate:
    """Which estimate each frame is.

    Attributes:
        rate_hz: of the frames.
        rows: (F,) row of each frame's estimate; -1 where there is none.
        estimates: how many there were.
    """

    rate_hz: float
    rows: IntArray
    estimates: int

    @property
    def known(self) -> BoolArray:
        """(F,) whether there is an estimate."""
        return self.rows >= 0

    def notes(self, filled: str) -> Iterator[str]:
        """Yield what a user must know: frames without estimate, which are ``filled``; estimates left out."""
        empty = int(np.sum(~self.known))
        left_out = self.estimates - (len(self.rows) - empty)
        if empty:
            yield f"{empty} of {len(self.rows)} frames at {self.rate_hz:.6g} Hz have no estimate: {filled}"
        if left_out:
            yield f"{left_out} of {self.estimates} estimates left out: nearer than a frame to others"


def fixed_rate(stamps_ns: IntArray, where: str) -> FixedRate:
    """Return frames of the rate that stamps (N,) have on the whole.

    The median step tells how many frames lie between neighbours, and all of them together the rate: that of a
    30 Hz camera whose stamps are whole milliseconds is 30 Hz.

    Raises:
        ResultError: there is no stamp, or the gaps are too long for what there is.
    """
    if not len(stamps_ns):
        raise ResultError("holds no estimate", where=where)
    order = np.argsort(stamps_ns, kind="stable")
    since = stamps_ns[order] - stamps_ns[order[0]]
    steps = np.diff(since)
    steps = steps[steps > 0]
    if not len(steps):
        return FixedRate(SINGLE_HZ, order[:1], len(stamps_ns))
    step_ns = since[-1] / float(np.sum(np.rint(steps / np.median(steps))))
    places = since / step_ns
    count = round(float(places[-1])) + 1
    most = max(limits.EXPORT_FRAMES, limits.EXPORT_EXPANSION * len(stamps_ns))
    if count > most:
        raise ResultError(
            "gaps are too long for a format of fixed frame rate",
            where=where,
            found=f"{count} frames at {NS_PER_S / step_ns:.6g} Hz for {len(stamps_ns)} estimates",
            expected=f"{most} at most",
            hint="csv, json and npz state every estimate's time",
        )
    return FixedRate(NS_PER_S / step_ns, _nearest(places, order, count), len(stamps_ns))


def _nearest(places: FloatArray, order: IntArray, count: int) -> IntArray:
    """The row of the place nearest to each whole number, -1 where none is within a half."""
    frames = np.rint(places).astype(np.int64)
    off = np.abs(places - frames)
    rows = np.full(count, -1, dtype=np.int64)
    farthest_first = np.argsort(-off, kind="stable")
    rows[frames[farthest_first]] = order[farthest_first]  # of several the last one that is assigned stays
    return rows


# The columns of an exported table: names, units and meanings, stated once for every format.
#
# A truth in CSV is read by the same names.


POSITION = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qx", "qy", "qz", "qw")
LINEAR_VELOCITY = ("vx_mm_s", "vy_mm_s", "vz_mm_s")
ANGULAR_VELOCITY = ("wx_rad_s", "wy_rad_s", "wz_rad_s")


Values: TypeAlias = np.ndarray[Any, Any]


def point_columns(names: Iterable[str]) -> tuple[str, ...]:
    """Return three columns for each point, in mm."""
    return tuple(f"{name}_{axis}_mm" for name in names for axis in "xyz")


def shape_columns(subject: Subject, *suffixes: str) -> tuple[str, ...]:
    """Return a column for each shape entry: its name, suffixes (such as ``sd``), its unit if it has one."""
    unit = kind_of(subject.name).shape_unit
    return tuple("_".join(filter(None, (name, *suffixes, unit))) for name in subject.shape_names)


def rate_columns(subject: Subject, *suffixes: str) -> tuple[str, ...]:
    """Return a column for the rate of each shape entry, ``..._rad_s`` or ``..._per_s``."""
    unit = kind_of(subject.name).shape_unit or "per"
    return tuple("_".join((name, *suffixes, unit, "s")) for name in subject.shape_names)


@dataclass(frozen=True)
class ColumnGroup:
    """Columns that mean the same of different components.

    Attributes:
        names: of the columns.
        unit: of all of them, empty for none.
        meaning: of all of them.
        values: makes the (N, len(names)) values from columns of ``Result.columns``.
    """

    names: tuple[str, ...]
    unit: str
    meaning: str
    values: Callable[[Columns], Values]


def table_of(subject: Subject) -> tuple[ColumnGroup, ...]:
    """Return the columns of a subject's table, in order; groups without columns are left out."""
    groups = (
        *_frame_groups(),
        *_pose_groups(subject),
        *_velocity_groups(subject),
        *_deviation_groups(subject),
        _point_group(subject),
        *_filter_groups(),
        _further_group(subject),
    )
    return tuple(group for group in groups if group.names)


def _frame_groups() -> Iterable[ColumnGroup]:
    return map(_field, ("frame_index", "stamp_ns", "status", "confidence"))


def _pose_groups(subject: Subject) -> Iterable[ColumnGroup]:
    kind = kind_of(subject.name)
    yield _part(POSITION, "mm", f"origin of the {subject.name} in camera axes", "position")
    yield _part(
        QUATERNION,
        "",
        f"rotation from {subject.name} to camera axes, unit quaternion, qw >= 0",
        "quaternion",
    )
    yield ColumnGroup(
        ("roll_deg", "pitch_deg", "yaw_deg"),
        "deg",
        "the same rotation in Euler angles",
        lambda block: np.degrees(kind.euler_angles(block["quaternion"])),
    )
    meaning = "angles of the shape" if kind.shape_unit else "coefficients of the shape"
    yield _part(shape_columns(subject), kind.shape_unit, meaning, "shape")


def _velocity_groups(subject: Subject) -> Iterable[ColumnGroup]:
    yield _part(LINEAR_VELOCITY, "mm/s", "velocity of the origin in camera axes", "twist")
    yield _part(
        ANGULAR_VELOCITY,
        "rad/s",
        f"angular velocity in the {subject.name}'s own axes",
        "twist",
        3,
    )
    unit = f"{kind_of(subject.name).shape_unit or '1'}/s"
    yield _part(rate_columns(subject), unit, "rate of the shape", "twist", 6)


def _deviation_groups(subject: Subject) -> Iterable[ColumnGroup]:
    """Standard deviations: roots of the diagonals of the covariances."""
    unit = kind_of(subject.name).shape_unit
    yield _deviation(tuple(f"{axis}_sd_mm" for axis in "xyz"), "mm", "of the position", "pose_variance", 0)
    yield _deviation(
        tuple(f"r{axis}_sd_rad" for axis in "xyz"),
        "rad",
        f"of a small rotation about the {subject.name}'s own axes",
        "pose_variance",
        3,
    )
    yield _deviation(shape_columns(subject, "sd"), unit, "of the shape", "pose_variance", 6)
    yield _deviation(
        tuple(f"v{axis}_sd_mm_s" for axis in "xyz"), "mm/s", "of the velocity", "twist_variance", 0
    )
    yield _deviation(
        tuple(f"w{axis}_sd_rad_s" for axis in "xyz"), "rad/s", "of the angular velocity", "twist_variance", 3
    )
    rates = rate_columns(subject, "sd")
    yield _deviation(rates, f"{unit or '1'}/s", "of the rate of the shape", "twist_variance", 6)


def _point_group(subject: Subject) -> ColumnGroup:
    """Points in camera axes; of a rigid subject in its own, where they stand still."""
    names = point_columns(subject.point_names)
    if not kind_of(subject.name).rigid:
        return ColumnGroup(names, "mm", "points in camera axes", lambda block: _flat(block["points"]))
    meaning = f"points in the {subject.name}'s own axes"
    return ColumnGroup(names, "mm", meaning, lambda block: _flat(_in_own_axes(block)))


def _in_own_axes(block: Columns) -> FloatArray:
    """The points (N, P, 3), mm, in the subject's own axes."""
    return in_object(block["points"], block["position"][:, None], block["quaternion"][:, None])


def _filter_groups() -> Iterable[ColumnGroup]:
    return (
        _field("effective_sample_size"),
        _field("resampled"),
        replace(_field("cost"), names=("cost_mm",)),
        _field("milliseconds"),
        _field("evaluations"),
    )


def _further_group(subject: Subject) -> ColumnGroup:
    """What a tracker states beyond that; the names hold the units."""
    meaning = "further numbers of this tracker, empty where not known"
    return ColumnGroup(subject.number_names, "", meaning, lambda block: block[NUMBERS])


def _field(name: str) -> ColumnGroup:
    """The column of a field that is one value."""
    return ColumnGroup((name,), BY_NAME[name].unit, BY_NAME[name].meaning, _one(name))


def _one(name: str) -> Callable[[Columns], Values]:
    return lambda block: block[name][:, None]


def _part(names: tuple[str, ...], unit: str, meaning: str, field: str, first: int = 0) -> ColumnGroup:
    """Columns ``first`` and so on of a field."""
    return ColumnGroup(names, unit, meaning, lambda block: block[field][:, first : first + len(names)])


def _deviation(names: tuple[str, ...], unit: str, of: str, field: str, first: int) -> ColumnGroup:
    part = slice(first, first + len(names))
    return ColumnGroup(names, unit, f"standard deviation {of}", lambda block: np.sqrt(block[field][:, part]))


def _flat(points: Values) -> Values:
    return points.reshape(len(points), 3 * points.shape[1])
