"""Quantities derived from estimates: image points, joint angles of a hand, and ranges of motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_from_points
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status, Subject, kind_of
from posetrack_cli.results.fields import NUMBERS
from posetrack_cli.units import NS_PER_S

PIXELS, JOINT_ANGLES = "pixels", "joint_angles_deg"
UNITS = {PIXELS: "px", JOINT_ANGLES: "deg"}
"""Units of the arrays of ``derived``."""
MEANINGS = {
    PIXELS: "point in the recorded image, with lens distortion; empty where lost or behind the camera",
    JOINT_ANGLES: (
        "joint angle; 0 for straight fingers in the plane of the palm, flexion positive towards the palm, "
        "abduction positive towards the thumb's side"
    ),
}


def derived(columns: Columns, subject: Subject, cameras: Sequence[Camera]) -> Columns:
    """Return the image points (N, C, P, 2), px, and the joint angles (N, A), deg, of hands."""
    found: Columns = {}
    if cameras:
        found[PIXELS] = np.stack([pixels(columns, camera) for camera in cameras], axis=1)
    if joint_angle_names(subject):
        found[JOINT_ANGLES] = joint_angles(columns, subject)
    return found


# Image points


def pixels(columns: Columns, camera: Camera) -> FloatArray:
    """Return the points (N, P, 2) in a camera's recorded images, px; the first pixel's centre is (0, 0).

    They may lie outside of the image. NaN in lost frames, and behind or too far beside the camera.
    """
    found, valid = pixels_from_points(camera, in_camera_axes(camera, columns["points"]))
    known = valid & is_tracked(columns)[:, None]
    return np.where(known[..., None], found, np.nan)


def is_tracked(columns: Columns) -> BoolArray:
    """Return (N,) whether a frame is not lost."""
    tracked: BoolArray = columns["status"] != Status.LOST.value
    return tracked


# Joint angles of a hand
#
# Zero pose and signs are those of the hand model (``hand.model.anatomy``). Its skeleton couples the last
# joints: a DIP joint bends half as far as its PIP, the thumb's IP half as far as its MCP, plus an offset.

_DISTAL_SHARE = 0.5
_FINGERS = ("index", "middle", "ring", "little")
_THUMB_ANGLES = ("cmc_flexion", "cmc_abduction", "mcp_flexion", "mcp_abduction", "ip_flexion")
_FINGER_ANGLES = ("mcp_flexion", "mcp_abduction", "pip_flexion", "dip_flexion")
_NAMES = (
    *(f"thumb_{angle}" for angle in _THUMB_ANGLES),
    *(f"{finger}_{angle}" for finger in _FINGERS for angle in _FINGER_ANGLES),
)
_OFFSET = "thumb_ip_offset"
_NUMBERS = (_OFFSET, "thumb_mcp_abduction")
"""Angles of the thumb, rad, that some trackers estimate in addition; 0 for others."""
_COUPLED = {"thumb_ip_flexion": "thumb_mcp_flexion"} | {
    f"{finger}_dip_flexion": f"{finger}_pip_flexion" for finger in _FINGERS
}
_SHAPE = frozenset(_NAMES).difference(_COUPLED, _NUMBERS)


def joint_angle_names(subject: Subject) -> tuple[str, ...]:
    """Return the names of a hand's joint angles, thumb first; () for other subjects."""
    return _NAMES if set(subject.shape_names) >= _SHAPE else ()


def joint_angles(columns: Columns, subject: Subject) -> FloatArray:
    """Return a hand's joint angles (N, 21), deg, in the order of ``joint_angle_names``."""
    shape, numbers = columns["shape"], columns.get(NUMBERS)
    known = dict.fromkeys(_NUMBERS, np.zeros(len(shape)))
    known |= dict(zip(subject.shape_names, shape.T, strict=True))
    if numbers is not None:
        stated = dict(zip(subject.number_names, numbers.T, strict=True))
        known |= {name: np.nan_to_num(stated[name]) for name in _NUMBERS if name in stated}
    known |= {name: _DISTAL_SHARE * known[other] for name, other in _COUPLED.items()}
    known["thumb_ip_flexion"] = known["thumb_ip_flexion"] + known[_OFFSET]
    return np.degrees(np.stack([known[name] for name in _NAMES], axis=1))


# Range of motion


def range_of_motion(columns: Columns, subject: Subject) -> Columns:
    """Return range and speed of each angle over the frames that are not lost.

    Angles are the joint angles of a hand, or roll, pitch and yaw of a head. Speeds are differences of
    successive tracked frames by time; the step into a reinitialised frame does not count.

    Returns:
        One value per angle: ``angle`` (name), ``frames``, minimum, quantiles and maximum in deg, maximum and
        95 % quantile of the speed in deg/s; NaN without frames.

    Raises:
        ResultError: the subject has no angles.
    """
    kind = kind_of(subject.name)
    names, angles = joint_angle_names(subject), np.zeros((0, 0))
    order = np.argsort(columns["stamp_ns"], kind="stable")
    if names:
        angles = joint_angles(columns, subject)[order]
    elif kind.rigid:
        names, angles = ("roll", "pitch", "yaw"), np.degrees(kind.euler_angles(columns["quaternion"]))[order]
    else:
        raise ResultError(f"a {subject.name} has no angles", expected="a result of a hand or a head")
    tracked, status = is_tracked(columns)[order], columns["status"][order]
    seconds = np.diff(columns["stamp_ns"][order]) / NS_PER_S
    moving = tracked[1:] & tracked[:-1] & (status[1:] != Status.REINITIALISED.value) & (seconds > 0.0)
    turns = (np.diff(angles, axis=0)[moving] + 180.0) % 360.0 - 180.0  # roll and yaw jump at half a turn
    low, q05, q50, q95, high = _quantiles(angles[tracked], 0.0, 0.05, 0.5, 0.95, 1.0)
    q95_speed, peak = _quantiles(np.abs(turns) / seconds[moving, None], 0.95, 1.0)
    return {
        "angle": np.array(names),
        "frames": np.full(len(names), np.count_nonzero(tracked)),
        "minimum_deg": low,
        "q05_deg": q05,
        "median_deg": q50,
        "q95_deg": q95,
        "maximum_deg": high,
        "q95_speed_deg_s": q95_speed,
        "peak_speed_deg_s": peak,
    }


def _quantiles(values: FloatArray, *shares: float) -> FloatArray:
    """Return quantiles (len(shares), A) of values (N, A); NaN without values."""
    if not len(values):
        return np.full((len(shares), values.shape[1]), np.nan)
    found: FloatArray = np.quantile(values, shares, axis=0)
    return found
