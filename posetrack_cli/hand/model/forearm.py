"""Forearm behind a hand, and its confidence."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.skeleton import empty_posed, pose_many, skeleton_of
from posetrack_cli.hand.model.anatomy import ARM_BONE, BONE_COUNT, HandAnatomy
from posetrack_cli.rendering.mesh import SkinnedMesh, bound_to, merged
from posetrack_cli.rendering.port import Window

# Skin of the forearm **[ours]**
#
# It explains the pixels beyond the wrist, so the limb need not be cut at an unknown wrist: a hand that slid
# along its arm would leave the fingertips unexplained. The forearm is a tapered tube of elliptic rings around
# an axis through the wrist joint, with three unknowns per frame in addition to the hand's 22: direction (two)
# and girth, a factor on both half axes.

SEEN_MM = 80.0
"""Length of the forearm behind the predicted wrist that is observed, at scale 1."""
LENGTH_MM = 160.0
"""Of the tube: longer than observed, for wrists found farther out."""
_WIDTH_PER_MM, _DEPTH_PER_MM = 0.0020, 0.0045
"""Relative growth of the forearm's width and thickness per mm from the wrist: from a flat wrist, 57 x 40 mm,
to a nearly round forearm of 1.3 times the circumference 100 mm behind it."""
_END_MM = 10.0
"""Length of the hand's skin, from its end, that determines the wrist's ellipse."""
_INSIDE = 0.92
"""Half axes of the first two rings, inside the hand, relative to the wrist's."""
_INTO_HAND_MM = 13.0
"""Distance of the first ring in front of the wrist joint or the skin's end; it moves with the palm, as a
file's hand may end at the joint, where a bent wrist would open."""


def with_forearm(
    hand: SkinnedMesh, smooth: SkinnedMesh, anatomy: HandAnatomy, sides: int, rings: int
) -> SkinnedMesh:
    """Return a hand's skin with a forearm bound to its own bone, ``ARM_BONE``.

    Args:
        hand: bound to the 16 bones.
        smooth: skin that determines the wrist's ellipse for all levels of detail: with few vertices the wrist
            appears up to a third too narrow.
        anatomy: of the hand.
        sides, rings: points per ring, and number of rings.
    """
    return merged([bound_to(hand, BONE_COUNT + 1), _tube(smooth, anatomy, sides, rings)])


def _tube(hand: SkinnedMesh, anatomy: HandAnatomy, sides: int, rings: int) -> SkinnedMesh:
    """Return a tube along y, closed at its far end, bound to 17 bones.

    Its first ring moves with the palm, the others with the forearm.
    """
    low, high = _wrist(hand, anatomy.scale)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    end = float(hand.vertices[:, 1].max())
    wrist = min(end, 0.0)
    beyond_hand = np.linspace(end, end + LENGTH_MM * anatomy.scale, rings - 2)
    along = np.concatenate([[wrist - _INTO_HAND_MM * anatomy.scale, wrist], beyond_hand])
    beyond = np.maximum(along - end, 0.0) / anatomy.scale
    size = np.stack([1.0 + _WIDTH_PER_MM * beyond, 1.0 + _DEPTH_PER_MM * beyond], axis=1) * half
    size[:2] *= _INSIDE
    angle = 2.0 * np.pi * np.arange(sides) / sides
    x = middle[0] + size[:, :1] * np.cos(angle)
    z = middle[1] + size[:, 1:] * np.sin(angle)
    points = np.stack([x, np.broadcast_to(along[:, None], x.shape), z], axis=2).reshape(-1, 3)
    last = np.array([[middle[0], along[-1], middle[1]]])
    faces = []
    for ring in range(rings - 1):
        for k in range(sides):
            a, b = ring * sides + k, ring * sides + (k + 1) % sides
            faces += [(a, a + sides, b), (b, a + sides, b + sides)]
    first = (rings - 1) * sides
    faces += [(first + k, rings * sides, first + (k + 1) % sides) for k in range(sides)]
    vertices = np.concatenate([points, last])
    weights = np.zeros((len(vertices), BONE_COUNT + 1))
    weights[:sides, 0], weights[sides:, ARM_BONE] = 1.0, 1.0
    return SkinnedMesh(vertices, weights, np.array(faces, dtype=np.int64))


def _wrist(hand: SkinnedMesh, scale: float) -> tuple[FloatArray, FloatArray]:
    """Return the least and greatest x and z (2,) of a hand's skin at its end, mm."""
    y = hand.vertices[:, 1]
    ends = hand.vertices[y > y.max() - _END_MM * scale][:, [0, 2]]
    return ends.min(axis=0), ends.max(axis=0)


def transforms_with_forearm(anatomy: HandAnatomy, poses: FloatArray, inner: FloatArray) -> Float32Array:
    """Return camera_T_rest (N, 17, 3, 4) of hands in poses (N, 22) with a forearm.

    Args:
        anatomy: the hand.
        poses: (N, 22).
        inner: (6,) the same for all (``hand.fit.skeleton``).
    """
    bones = np.empty((len(poses), BONE_COUNT + 1, 3, 4), dtype=np.float32)
    each = np.tile(inner, (len(poses), 1))
    pose_many(skeleton_of(anatomy), np.ascontiguousarray(poses), each, empty_posed(), bones)
    return bones


# Confidence of a drawn forearm **[ours]**
#
# With E the area, mm^2 of a hand of scale 1, of the drawn forearm whose readings lie within ``NEAR_MM`` of
# it, W that of all other readings there, in front or behind, and U that without a reading:
#
#     confidence = E / (E + W + w U + E_0)
#
# with the weight w of a missing reading in the likelihood's cost. Parts outside the image or behind the hand
# do not count, so a hardly visible forearm has little weight against ``E_0``. On synthetic people, 0.5
# separates directions within 10 degrees of the truth from those off by 15 or more.

LEAST_CONFIDENCE = 0.5
"""Forearms below this confidence are not drawn."""
NEAR_MM = 15.0
"""Distance of readings explained by the tube; forearms are not exact tubes."""
_ENOUGH_MM2 = 300.0
"""E_0: a 6 mm strip of the forearm, too short for a direction."""
_HALF_WIDTH_MM, _NEAREST_MM = 60.0, 50.0
"""Half width of the window around the forearm, and its nearest depth."""


def forearm_window(
    wrist: FloatArray, direction: FloatArray, scale: float, camera: Camera, tile: int
) -> Window:
    """Return the window of (tile, tile) pixels around a drawn forearm.

    Args:
        wrist: (3,) mm, camera axes.
        direction: (3,) unit vector from wrist to elbow.
        scale: of the hand.
        camera: of the depth image.
        tile: width and height, pixels.
    """
    ends = wrist + np.array([[0.0], [LENGTH_MM * scale]]) * direction
    ends[:, 2] = np.maximum(ends[:, 2], _NEAREST_MM)
    half = _HALF_WIDTH_MM * scale * camera.fx / ends[:, 2:]
    pixels, limit = camera.pixels_from_points(ends)[0], 2.0 * np.array([camera.width, camera.height])
    low, high = (np.clip(at, -limit, 2.0 * limit) for at in ((pixels - half).min(0), (pixels + half).max(0)))
    step = max(1, int(np.ceil((high - low).max() / tile)))
    return Window.around(0.5 * (low + high), tile, step)


def forearm_confidence(
    drawn: Float32Array,
    readings: Float32Array,
    inside: BoolArray,
    mm_per_pixel: FloatArray,
    unread_weight: float,
) -> float:
    """Return the confidence of a forearm, 0 to 1.

    Args:
        drawn: (h, w) its depth, mm, 0 where not visible.
        readings: (h, w) of the image, mm, 0 for none.
        inside: (h, w) pixels inside the image.
        mm_per_pixel: (h, w) pixel distance on the forearm, mm at scale 1.
        unread_weight: w.
    """
    arm, read = (drawn > 0) & inside, readings > 0
    near = np.abs(readings - drawn) <= NEAR_MM
    area = np.square(mm_per_pixel)
    explained, other, unread = (float(area[arm & part].sum()) for part in (read & near, read & ~near, ~read))
    return explained / (explained + other + unread_weight * unread + _ENOUGH_MM2)
