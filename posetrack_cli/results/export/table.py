"""Tables and fixed-rate frames of exports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.derived import (
    JOINT_ANGLES,
    MEANINGS,
    PIXELS,
    joint_angle_names,
    joint_angles,
    pixels,
)
from posetrack_cli.results.estimate import Subject, kind_of
from posetrack_cli.results.fields import BY_NAME, NUMBERS
from posetrack_cli.units import NS_PER_S

# Resampling to a fixed frame rate, for formats without stamps.
#
# Stamps jitter, frames are dropped, and lost frames may be left out. Frame i is the estimate nearest to the
# time ``i / rate`` after the first one, or empty if that is over half a frame away. Times are thus within
# half a frame over the whole recording, and no estimate is used twice.

SINGLE_HZ = 30.0
"""Nominal rate of a single frame."""


@dataclass(frozen=True, eq=False)
class FixedRate:
    """Assignment of estimates to frames of a fixed rate.

    Attributes:
        rate_hz: frame rate.
        rows: (F,) row of each frame's estimate; -1 for none.
        estimates: total number of estimates.
    """

    rate_hz: float
    rows: IntArray
    estimates: int

    @property
    def known(self) -> BoolArray:
        """(F,) whether the frame has an estimate."""
        return self.rows >= 0

    def notes(self, filled: str) -> Iterator[str]:
        """Yield notes for the user on empty frames, described by ``filled``, and on dropped estimates."""
        empty = int(np.sum(~self.known))
        left_out = self.estimates - (len(self.rows) - empty)
        if empty:
            yield f"{empty} of {len(self.rows)} frames at {self.rate_hz:.6g} Hz have no estimate: {filled}"
        if left_out:
            yield f"{left_out} of {self.estimates} estimates left out: less than a frame from others"


def fixed_rate(stamps_ns: IntArray, where: str) -> FixedRate:
    """Return frames at the mean rate of the stamps (N,).

    The median step gives the number of frames between neighbours, and the total duration the rate. A 30 Hz
    camera with millisecond stamps thus gets 30 Hz.

    Raises:
        ResultError: there are no stamps, or the gaps are too long.
    """
    if not len(stamps_ns):
        raise ResultError("has no estimates", where=where)
    order = np.argsort(stamps_ns, kind="stable")
    since = stamps_ns[order] - stamps_ns[order[0]]
    steps = np.diff(since)
    steps = steps[steps > 0]
    if not len(steps):
        return FixedRate(SINGLE_HZ, order[:1], len(stamps_ns))
    # Rounded step counts make the rate robust to dropped frames and jitter.
    step_ns = since[-1] / float(np.sum(np.rint(steps / np.median(steps))))
    places = since / step_ns
    count = round(float(places[-1])) + 1
    most = max(limits.EXPORT_FRAMES, limits.EXPORT_EXPANSION * len(stamps_ns))
    if count > most:
        raise ResultError(
            "gaps are too long for a format with a fixed frame rate",
            where=where,
            found=f"{count} frames at {NS_PER_S / step_ns:.6g} Hz for {len(stamps_ns)} estimates",
            expected=f"at most {most}",
            hint="csv, json and npz keep the stamp of every estimate",
        )
    return FixedRate(NS_PER_S / step_ns, _nearest(places, order, count), len(stamps_ns))


def _nearest(places: FloatArray, order: IntArray, count: int) -> IntArray:
    """Return the row nearest to each frame, -1 if none is within half a frame."""
    frames = np.rint(places).astype(np.int64)
    off = np.abs(places - frames)
    rows = np.full(count, -1, dtype=np.int64)
    farthest_first = np.argsort(-off, kind="stable")
    rows[frames[farthest_first]] = order[farthest_first]  # the last assignment, i.e. the nearest, wins
    return rows


# Columns of exported tables: names, units and descriptions. Reference CSV files use the same names.

POSITION = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qx", "qy", "qz", "qw")
LINEAR_VELOCITY = ("vx_mm_s", "vy_mm_s", "vz_mm_s")
ANGULAR_VELOCITY = ("wx_rad_s", "wy_rad_s", "wz_rad_s")


Values: TypeAlias = np.ndarray[Any, Any]


def point_columns(names: Iterable[str]) -> tuple[str, ...]:
    """Return three column names per point, in mm."""
    return tuple(f"{name}_{axis}_mm" for name in names for axis in "xyz")


def shape_columns(subject: Subject, *suffixes: str) -> tuple[str, ...]:
    """Return a column name per shape parameter: name, suffixes (such as ``sd``), unit if any."""
    unit = kind_of(subject.name).shape_unit
    return tuple("_".join(filter(None, (name, *suffixes, unit))) for name in subject.shape_names)


def rate_columns(subject: Subject, *suffixes: str) -> tuple[str, ...]:
    """Return a column name for the rate of each shape parameter, ``..._rad_s`` or ``..._per_s``."""
    unit = kind_of(subject.name).shape_unit or "per"
    return tuple("_".join((name, *suffixes, unit, "s")) for name in subject.shape_names)


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of one quantity.

    Attributes:
        names: column names.
        unit: unit of all columns; empty for none.
        meaning: description of the quantity.
        values: returns the (N, len(names)) values from columns of ``Result.columns``.
    """

    names: tuple[str, ...]
    unit: str
    meaning: str
    values: Callable[[Columns], Values]


def pixel_columns(names: Iterable[str], camera: str = "") -> tuple[str, ...]:
    """Return two column names per point, in px: ``wrist_u_px``, or ``wrist_in_left_u_px`` in a rig."""
    place = f"_in_{camera}" if camera else ""
    return tuple(f"{name}{place}_{axis}_px" for name in names for axis in "uv")


def table_of(subject: Subject, cameras: Sequence[Camera] = ()) -> tuple[ColumnGroup, ...]:
    """Return the column groups of a subject's table in order, without empty ones.

    Args:
        subject: whose estimates are listed.
        cameras: list the points in the images of these.
    """
    groups = (
        *_frame_groups(),
        *_pose_groups(subject),
        *_velocity_groups(subject),
        *_deviation_groups(subject),
        _point_group(subject),
        *_filter_groups(),
        _further_group(subject),
        *_pixel_groups(subject, cameras),
        _joint_angle_group(subject),
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
    """Yield standard deviations, the square roots of the covariance diagonals."""
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
    """Return points in camera axes, or in the body's own axes for a rigid subject."""
    names = point_columns(subject.point_names)
    if not kind_of(subject.name).rigid:
        return ColumnGroup(names, "mm", "points in camera axes", lambda block: _flat(block["points"]))
    meaning = f"points in the {subject.name}'s own axes"
    return ColumnGroup(names, "mm", meaning, lambda block: _flat(_in_own_axes(block)))


def _in_own_axes(block: Columns) -> FloatArray:
    """Return the points (N, P, 3), mm, in the subject's own axes."""
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
    """Return the tracker's additional numbers, whose names include units."""
    meaning = "additional numbers of this tracker, empty where unknown"
    return ColumnGroup(subject.number_names, "", meaning, lambda block: block[NUMBERS])


def _pixel_groups(subject: Subject, cameras: Sequence[Camera]) -> Iterable[ColumnGroup]:
    """Yield the points in each camera's images; the columns of several cameras have their names."""
    for camera in cameras:
        names = pixel_columns(subject.point_names, camera.name.strip("/") if len(cameras) > 1 else "")
        yield ColumnGroup(names, "px", MEANINGS[PIXELS], partial(_flat_pixels, camera=camera))


def _flat_pixels(block: Columns, camera: Camera) -> FloatArray:
    found = pixels(block, camera)
    return found.reshape(len(found), 2 * found.shape[1])


def _joint_angle_group(subject: Subject) -> ColumnGroup:
    names = tuple(f"{name}_deg" for name in joint_angle_names(subject))
    return ColumnGroup(names, "deg", MEANINGS[JOINT_ANGLES], lambda block: joint_angles(block, subject))


def _field(name: str) -> ColumnGroup:
    """Return the column of a scalar field."""
    return ColumnGroup((name,), BY_NAME[name].unit, BY_NAME[name].meaning, _one(name))


def _one(name: str) -> Callable[[Columns], Values]:
    return lambda block: block[name][:, None]


def _part(names: tuple[str, ...], unit: str, meaning: str, field: str, first: int = 0) -> ColumnGroup:
    """Return columns of a field, starting at ``first``."""
    return ColumnGroup(names, unit, meaning, lambda block: block[field][:, first : first + len(names)])


def _deviation(names: tuple[str, ...], unit: str, of: str, field: str, first: int) -> ColumnGroup:
    part = slice(first, first + len(names))
    return ColumnGroup(names, unit, f"standard deviation {of}", lambda block: np.sqrt(block[field][:, part]))


def _flat(points: Values) -> Values:
    return points.reshape(len(points), 3 * points.shape[1])
