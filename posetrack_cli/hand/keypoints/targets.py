"""Joint targets in camera axes from keypoints."""

from __future__ import annotations

import re

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, undistort
from posetrack_cli.hand.fit.points import JointTargets
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, HandAnatomy
from posetrack_cli.recording.keypoints.layout import PointKind, same_order

# Names and order of the 21 points in keypoint files

POINTS = len(JOINT_NAMES)  # the same as MediaPipe's, in its order
_THEIRS = re.compile(
    r"(?:(?:left|right|l|r)_)?(?:hand_)?(thumb|index|middle|ring|little)_?(cmc|mcp|ip|pip|dip|tip|[1-4])"
)
_THUMB, _FINGER = ("cmc", "mcp", "ip", "tip"), ("mcp", "pip", "dip", "tip")


def _plain(name: str) -> str:
    """Return another program's point name as ours.

    MediaPipe uses ``HandLandmark.INDEX_FINGER_TIP`` and ``PINKY_MCP``, COCO ``forefinger1`` and ``thumb4``;
    annotators write ``IndexMCP``.
    """
    plain = name.removeprefix("handlandmark.").replace("forefinger", "index").replace("pinky", "little")
    plain = plain.replace("_finger", "")
    if plain.endswith("hand_root"):
        return "wrist"
    found = _THEIRS.fullmatch(plain)
    if found is None:
        return plain
    finger, joint = found.groups()
    number = int(joint) - 1 if joint.isdecimal() else -1
    return f"{finger}_{(_THUMB if finger == 'thumb' else _FINGER)[number] if number >= 0 else joint}"


HAND_POINTS = PointKind(
    subject="hand",
    names=JOINT_NAMES,
    counted={POINTS: same_order(POINTS)},
    several=("hands", "multi_hand_landmarks", "hand_landmarks", "handLandmarks"),
    command="posetrack hand run --help",
    plain=_plain,
    flat={"hand_left_keypoints_2d": "left", "hand_right_keypoints_2d": "right"},
    parts={"left": slice(91, 112), "right": slice(112, 133)},
    ends=("wrist", "tip of the little finger"),
)


# Joint targets with covariances
#
# An image point gets its depth from a patch of readings around its pixel, restricted to the set's median
# depth; the joint lies a finger's radius behind that skin along the line of sight. The skin may belong to
# another finger or the palm in front of the joint, so errors behind the target have a larger deviation.

PIXEL_SD, CONVENTION_SD_MM = 3.0, 6.0
"""Of a good detector's points, pixels, and between programs' joint definitions, mm."""
SPACE_SD_MM = 8.0
"""Of points in space, in addition to the difference of conventions."""
_SKIN_SD_MM, _BEHIND_SD_MM, _UNKNOWN_SD_MM = 10.0, 40.0, 60.0
"""Of a joint's depth in front of and behind the position given by the skin, and around the median of the
others where there is no reading."""
_PATCH_MM, _MAX_PX = 6.0, 8
"""Half side of a patch in the scene, and its limit in the image."""
_COARSE_PX = 3
_HAND_DEPTH_MM = 120.0
"""Largest distance of a hand's readings from the set's median depth."""
_SURFACE_MM = 15.0
"""Depth range of a patch's nearest surface."""
_NEAR_PERCENT = 25.0
WRIST_MM, _KNUCKLE_MM = 18.0, 13.0
"""From skin to joint at the wrist and at the knuckles, for a hand of scale 1."""
MIN_POINTS = 8
"""Known points needed to use a set."""


def skin_to_joint(anatomy: HandAnatomy) -> FloatArray:
    """Return the depth of each joint (21,) behind the skin, mm; half a radius at the tips."""
    depths = anatomy.radii.copy()
    depths[1:, 0] = _KNUCKLE_MM * anatomy.scale
    depths[:, 3] *= 0.5
    return np.concatenate([[WRIST_MM * anatomy.scale], depths.ravel()])


def targets_in_space(points: FloatArray, scores: FloatArray) -> JointTargets | None:
    """Return targets for points (21, 3), mm, NaN where unknown; None for too few points."""
    known = np.isfinite(points[:, 0]) & (scores > 0.0)
    if np.count_nonzero(known) < MIN_POINTS:
        return None
    precision = scores / (SPACE_SD_MM**2 + CONVENTION_SD_MM**2)
    axes = np.broadcast_to(np.eye(3), (POINTS, 3, 3)).copy()
    rows = np.where(known, precision, 0.0)[:, None] * np.ones(3)
    return JointTargets(np.where(known[:, None], points, 0.0), axes, rows, np.ones(POINTS))


def targets_in_image(
    pixels: FloatArray, scores: FloatArray, depth: ImageArray, camera: Camera, anatomy: HandAnatomy
) -> JointTargets | None:
    """Return targets for image points; None with too few points or without any depth reading.

    Args:
        pixels: (21, 2) in the distorted image; NaN where unknown.
        scores: (21,).
        depth: (height, width) mm.
        camera: of the image.
        anatomy: the hand.
    """
    inside = np.isfinite(pixels[:, 0]) & (scores > 0.0)
    if np.count_nonzero(inside) < MIN_POINTS:
        return None
    surface = skin_depths(np.where(inside[:, None], pixels, -1e6), depth, camera)
    read = inside & np.isfinite(surface)
    if not read.any():
        return None
    middle = float(np.median(surface[read]))
    joint = np.where(read, surface, middle) + skin_to_joint(anatomy)
    rays = _rays(pixels, inside, camera)
    positions = rays * joint[:, None]
    aside = (PIXEL_SD * joint / np.sqrt(camera.fx * camera.fy)) ** 2 + CONVENTION_SD_MM**2
    along = np.where(read, _SKIN_SD_MM, _UNKNOWN_SD_MM) ** 2
    precision = np.where(inside, scores, 0.0)[:, None] / np.stack([aside, aside, along], axis=1)
    behind = np.where(read, (_SKIN_SD_MM / _BEHIND_SD_MM) ** 2, 1.0)
    return JointTargets(positions, _axes_of(rays), precision, behind)


def skin_depths(pixels: FloatArray, depth: ImageArray, camera: Camera) -> FloatArray:
    """Return the depth (21,), mm, of the skin at pixels (21, 2), which may lie outside; NaN without a
    reading."""
    first = np.array([_nearest_surface(depth, pixel, _COARSE_PX, 0.0, np.inf) for pixel in pixels])
    if np.isnan(first).all():
        return first
    middle = float(np.nanmedian(first))
    half = int(np.clip(round(_PATCH_MM * camera.fx / middle), 1, _MAX_PX))
    near, far = middle - _HAND_DEPTH_MM, middle + _HAND_DEPTH_MM
    return np.array([_nearest_surface(depth, pixel, half, near, far) for pixel in pixels])


def _nearest_surface(depth: ImageArray, pixel: FloatArray, half: int, near: float, far: float) -> float:
    """Return the median depth of the nearest surface in a patch, between two depths, mm; NaN without one."""
    column, row = np.rint(pixel)
    height, width = depth.shape
    if not (-half <= column < width + half and -half <= row < height + half):
        return float("nan")
    top, left = max(int(row) - half, 0), max(int(column) - half, 0)
    patch = depth[top : int(row) + half + 1, left : int(column) + half + 1]
    read = np.sort(patch[(patch > near) & (patch < far)])
    if not read.size:
        return float("nan")
    first = read[int(_NEAR_PERCENT / 100.0 * (read.size - 1))]
    surface = read[np.abs(read - first) <= _SURFACE_MM]
    return float(surface[surface.size // 2])


def _rays(pixels: FloatArray, inside: BoolArray, camera: Camera) -> FloatArray:
    """Return points (21, 3) at depth 1 on the lines of sight; straight ahead for unknown pixels."""
    x = np.where(inside, (pixels[:, 0] - camera.cx) / camera.fx, 0.0)
    y = np.where(inside, (pixels[:, 1] - camera.cy) / camera.fy, 0.0)
    x, y = undistort(camera, x, y)
    sane = np.isfinite(x) & np.isfinite(y) & (np.hypot(x, y) < 10.0)
    return np.stack([np.where(sane, x, 0.0), np.where(sane, y, 0.0), np.ones(POINTS)], axis=1)


def _axes_of(rays: FloatArray) -> FloatArray:
    """Return orthonormal rows (21, 3, 3): two across each line of sight, and the line itself."""
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    first = np.cross(np.array([0.0, 1.0, 0.0]), along)
    first /= np.linalg.norm(first, axis=1, keepdims=True)  # no line of sight is the image's vertical
    return np.stack([first, np.cross(along, first), along], axis=1)
