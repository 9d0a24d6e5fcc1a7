"""Where keypoints are in the camera's axes."""

from __future__ import annotations

import re

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, undistort
from posetrack_cli.hand.fit.points import PlacesToFit
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, HandAnatomy
from posetrack_cli.recording.keypoints.layout import PointKind, same_order

# The 21 points of a hand in files of keypoints: ours, which are MediaPipe's in its order


POINTS = len(JOINT_NAMES)


_THEIRS = re.compile(
    r"(?:(?:left|right|l|r)_)?(?:hand_)?(thumb|index|middle|ring|little)_?(cmc|mcp|ip|pip|dip|tip|[1-4])"
)
_THUMB, _FINGER = ("cmc", "mcp", "ip", "tip"), ("mcp", "pip", "dip", "tip")


def _plain(name: str) -> str:
    """Return another program's name as ours.

    MediaPipe has ``HandLandmark.INDEX_FINGER_TIP`` and ``PINKY_MCP``, COCO ``forefinger1`` and ``thumb4``;
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


# Where in the camera's axes a set of keypoints is, and how surely: pixels get their depth from the image.
#
# The readings in a small patch about a pixel, without what is not near the set's median depth, tell the
# skin's depth there; the joint lies a finger's radius behind it along the line of sight. Where the skin at
# that pixel is another finger's or the palm's, the joint lies farther behind, so a joint behind its place is
# hardly off it.


PIXEL_SD, CONVENTION_SD_MM = 3.0, 6.0
"""Of a good detector's points, pixels, and of where programs put a joint, mm."""
SPACE_SD_MM = 8.0
"""Of points in space, beside the convention."""
_SKIN_SD_MM, _BEHIND_SD_MM, _UNKNOWN_SD_MM = 10.0, 40.0, 60.0
"""Of a joint's depth before and behind the place that the skin tells; and about the others' median where no
reading tells it."""
_PATCH_MM, _MOST_PX = 6.0, 8
"""Half a patch's side, in the scene and at most in the image."""
_COARSE_PX = 3
_HAND_DEEP_MM = 120.0
"""From the set's median depth to a reading that is still of its hand."""
_SURFACE_MM = 15.0
"""As deep a patch's nearest surface is."""
_NEAR_PERCENT = 25.0
WRIST_MM, _KNUCKLE_MM = 18.0, 13.0
"""From the skin to the joint at the wrist, and where fingers begin, of a hand of scale 1."""
FEWEST = 8
"""Known points of a set that is used."""


def skin_to_joint(anatomy: HandAnatomy) -> FloatArray:
    """Return how far behind the skin each joint (21,) is, mm: half as far at a tip, which is the skin's."""
    depths = anatomy.radii.copy()
    depths[1:, 0] = _KNUCKLE_MM * anatomy.scale
    depths[:, 3] *= 0.5
    return np.concatenate([[WRIST_MM * anatomy.scale], depths.ravel()])


def places_in_space(points: FloatArray, scores: FloatArray) -> PlacesToFit | None:
    """Return places of points (21, 3), mm, NaN where unknown; None for too few."""
    known = np.isfinite(points[:, 0]) & (scores > 0.0)
    if np.count_nonzero(known) < FEWEST:
        return None
    precision = scores / (SPACE_SD_MM**2 + CONVENTION_SD_MM**2)
    axes = np.broadcast_to(np.eye(3), (POINTS, 3, 3)).copy()
    rows = np.where(known, precision, 0.0)[:, None] * np.ones(3)
    return PlacesToFit(np.where(known[:, None], points, 0.0), axes, rows, np.ones(POINTS))


def places_in_image(
    pixels: FloatArray, scores: FloatArray, depth: ImageArray, camera: Camera, anatomy: HandAnatomy
) -> PlacesToFit | None:
    """Return places of points in an image; None where too few are known, or no reading tells a depth.

    Args:
        pixels: (21, 2) of the image as it is, with its lens's distortion; NaN where unknown.
        scores: (21,).
        depth: (height, width) mm.
        camera: of the image.
        anatomy: the hand.
    """
    inside = np.isfinite(pixels[:, 0]) & (scores > 0.0)
    if np.count_nonzero(inside) < FEWEST:
        return None
    surface = skin_depths(np.where(inside[:, None], pixels, -1e6), depth, camera)
    read = inside & np.isfinite(surface)
    if not read.any():
        return None
    middle = float(np.median(surface[read]))
    joint = np.where(read, surface, middle) + skin_to_joint(anatomy)
    rays = _rays(pixels, inside, camera)
    places = rays * joint[:, None]
    aside = (PIXEL_SD * joint / np.sqrt(camera.fx * camera.fy)) ** 2 + CONVENTION_SD_MM**2
    along = np.where(read, _SKIN_SD_MM, _UNKNOWN_SD_MM) ** 2
    precision = np.where(inside, scores, 0.0)[:, None] / np.stack([aside, aside, along], axis=1)
    behind = np.where(read, (_SKIN_SD_MM / _BEHIND_SD_MM) ** 2, 1.0)
    return PlacesToFit(places, _axes_of(rays), precision, behind)


def skin_depths(pixels: FloatArray, depth: ImageArray, camera: Camera) -> FloatArray:
    """Return the skin's depth (21,), mm, at pixels (21, 2) that may lie anywhere; NaN where none is read."""
    first = np.array([_nearest_surface(depth, pixel, _COARSE_PX, 0.0, np.inf) for pixel in pixels])
    if np.isnan(first).all():
        return first
    middle = float(np.nanmedian(first))
    half = int(np.clip(round(_PATCH_MM * camera.fx / middle), 1, _MOST_PX))
    near, far = middle - _HAND_DEEP_MM, middle + _HAND_DEEP_MM
    return np.array([_nearest_surface(depth, pixel, half, near, far) for pixel in pixels])


def _nearest_surface(depth: ImageArray, pixel: FloatArray, half: int, near: float, far: float) -> float:
    """Median of the nearest surface in a patch about a pixel, between two depths, mm; NaN where none is."""
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
    """Points (21, 3) at depth 1 on the lines of sight of pixels; of unknown ones straight ahead."""
    x = np.where(inside, (pixels[:, 0] - camera.cx) / camera.fx, 0.0)
    y = np.where(inside, (pixels[:, 1] - camera.cy) / camera.fy, 0.0)
    x, y = undistort(camera, x, y)
    sane = np.isfinite(x) & np.isfinite(y) & (np.hypot(x, y) < 10.0)
    return np.stack([np.where(sane, x, 0.0), np.where(sane, y, 0.0), np.ones(POINTS)], axis=1)


def _axes_of(rays: FloatArray) -> FloatArray:
    """Orthonormal rows (21, 3, 3): two across each line of sight, and the line."""
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    first = np.cross(np.array([0.0, 1.0, 0.0]), along)
    first /= np.linalg.norm(first, axis=1, keepdims=True)  # no line of sight is the image's vertical
    return np.stack([first, np.cross(along, first), along], axis=1)
