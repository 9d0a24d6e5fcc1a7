"""Hands that an image's extended fingers tell of, without any prediction **[ours]**.

A finger stands out of the palm where no disc as thick as a palm covers it. Around the palm fingers come in
their order, from the thumb to the little finger or back, as the palm's front or its back is seen. Which of
the five they are is open: every choice that keeps the order, either way around, is a hypothesis. A stiff hand
is laid on each, and on the best a hand that bends (``fitting.points``), its other fingers closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.hand.anatomy import FINGERS, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.fitting.points import PlaceFitter, PlacesToFit
from posetrack_cli.hand.keypoints.places import WRIST_MM
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.observation import Observation
from posetrack_cli.hand.observer import thin_part
from posetrack_cli.hand.segmentation.surfaces import jump_mm, surface_labels

FEWEST = 3
"""Extended fingers that tell how a hand is turned."""
_LEAST_MM, _LEAST_WIDE_MM, _SLIMMEST = 20.0, 6.0, 1.2
"""How far a finger of a hand of scale 1 stands out at least, how wide it is, how much longer than wide."""
_TIP_MM = 8.0
"""What lies so near to a finger's farthest point is its tip."""
_INSIDE_PALM_MM = 15.0
"""So far a straight finger goes on in what a palm's disc covers."""
_SEEN_SD_MM, _UNSEEN_SD_MM, _WRIST_SD_MM = 8.0, 14.0, 25.0
"""Of a joint along a finger that is seen, of one farther back, where it may be bent, and of the wrist."""
_LIKELIEST = 6
"""Hypotheses that a bending hand is laid on."""
_CLOSED = (1.2, 1.5)  # MCP and PIP flexion, rad
_BLOCK = np.ones((3, 3), np.uint8)


class ExtendedFinger(NamedTuple):
    """A finger that stands out of the palm, on its skin.

    Attributes:
        tip: (3,) its farthest point, camera axes, mm.
        base: (3,) where it leaves the palm, mm.
    """

    tip: FloatArray
    base: FloatArray


class _Hypotheses(NamedTuple):
    """Which fingers are extended, and a stiff hand laid on them; the first axis is that of the hypotheses.

    Attributes:
        which: of the five, in the order of the fingers that are seen.
        places: (H, 21, 3) where their joints are then, mm; 0 where nothing is said.
        precision: (H, 21) 1 / mm^2; 0 where nothing is said.
        poses: (H, 22) of the stiff hand.
        misfits: (H,) mean squared distance of its joints from their places, in standard deviations.
    """

    which: Sequence[tuple[int, ...]]
    places: FloatArray
    precision: FloatArray
    poses: FloatArray
    misfits: FloatArray


def poses_of_fingers(observation: Observation, anatomy: HandAnatomy, camera: Camera) -> FloatArray:
    """Return poses (H, 22) of a hand that the extended fingers of an observation tell of, likeliest first.

    Args:
        observation: with at least one target pixel.
        anatomy: the hand.
        camera: of the depth image.

    Returns:
        None of fewer than ``FEWEST`` fingers, or of more than a hand has.
    """
    fingers = extended_fingers(observation, anatomy.scale, camera)
    if not FEWEST <= len(fingers) <= len(FINGERS):
        return np.empty((0, POSE_SIZE))
    made, fitter = _hypotheses(fingers, observation, anatomy), PlaceFitter(anatomy, all_told=False)
    likeliest = np.argsort(made.misfits, kind="stable")[:_LIKELIEST]
    poses = made.poses[likeliest]
    for k, pose in zip(likeliest.tolist(), poses, strict=True):
        fitter.fit(_places_to_fit(made.places[k], made.precision[k]), pose)
        for finger in set(range(1, len(FINGERS))) - set(made.which[k]):
            pose[[7 + 3 * finger, 9 + 3 * finger]] = _CLOSED
    return poses


def extended_fingers(observation: Observation, scale: float, camera: Camera) -> list[ExtendedFinger]:
    """Return the fingers that stand out of the palm, clockwise in the image.

    They begin beyond the arm, or where none is seen, after the widest gap between two of them.

    Args:
        observation: of a hand, with at least one target pixel.
        scale: of the hand.
        camera: of the depth image.
    """
    image, (points, apart, hand, thin) = observation.image, thin_part(observation, camera, scale)
    palm = hand & ~thin
    if not palm.any():
        return []
    steepest = jump_mm(np.full(image.shape, apart, dtype=np.float32))
    count, numbers = surface_labels(np.where(thin, image, np.float32(0.0)), steepest)
    beside = cv2.dilate(palm.astype(np.uint8), _BLOCK) > 0
    parts = (_finger(numbers == k, beside, points, apart, scale) for k in range(1, count))
    fingers = [finger for finger in parts if finger is not None]
    return _clockwise(fingers, points[_middle_of(palm)], observation.inner[:3]) if fingers else []


def _finger(
    part: BoolArray, beside: BoolArray, points: FloatArray, apart: float, scale: float
) -> ExtendedFinger | None:
    """The finger that a thin part (h, w) of a hand is; None of anything else, such as a palm's rim.

    Args:
        part: its pixels.
        beside: (h, w) the palm's pixels and those next to them.
        points: (h, w, 3) of all pixels, mm.
        apart: distance of neighbouring pixels, mm.
        scale: of the hand.
    """
    roots = points[part & beside]
    if not len(roots):
        return None
    inside, base = points[part], roots.mean(axis=0)
    away = np.linalg.norm(inside - base, axis=1)
    length = float(away.max())
    width = len(inside) * apart * apart / max(length, apart)
    if length < _LEAST_MM * scale or not _LEAST_WIDE_MM * scale <= width <= length / _SLIMMEST:
        return None
    near_tip = np.linalg.norm(inside - inside[np.argmax(away)], axis=1) < _TIP_MM * scale
    ahead = inside[near_tip].mean(axis=0) - base
    return ExtendedFinger(base + length / np.linalg.norm(ahead) * ahead, base)


def _middle_of(palm: BoolArray) -> tuple[int, int]:
    """Row and column of the pixel that is farthest from a mask's rim."""
    inside = cv2.distanceTransform(np.pad(palm, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
    return int(row), int(column)


def _clockwise(fingers: Sequence[ExtendedFinger], palm: FloatArray, arm: FloatArray) -> list[ExtendedFinger]:
    """Fingers in their order around a palm (3,), from the direction (3,) of its arm or the widest gap on."""
    middles = np.array([0.5 * (finger.tip + finger.base) - palm for finger in fingers])
    angles = np.arctan2(middles[:, 1], middles[:, 0])
    if arm[:2].any():
        first = float(np.arctan2(arm[1], arm[0]))
    else:
        ordered = np.sort(angles)
        gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
        first = float(ordered[np.argmax(gaps)] + 0.5 * gaps.max())
    order = np.argsort(np.mod(angles - first, 2.0 * np.pi), kind="stable")
    return [fingers[k] for k in order]


def _hypotheses(
    fingers: Sequence[ExtendedFinger], observation: Observation, anatomy: HandAnatomy
) -> _Hypotheses:
    """Every choice of fingers that keeps the order, either way around.

    Joints are along each finger, as deep as it is thick; so is the wrist, where an arm is seen.
    """
    laid = [_joints_along(finger, anatomy) for finger in fingers]
    chosen = list(combinations(range(len(FINGERS)), len(fingers)))
    which, count = 2 * chosen, len(chosen)
    places, precision = np.zeros((2 * count, 21, 3)), np.zeros((2 * count, 21))
    for n, (order, these) in enumerate(product((laid, laid[::-1]), chosen)):
        for (joints, sharpness), f in zip(order, these, strict=True):
            rows = slice(1 + 4 * f, 5 + 4 * f)
            places[n, rows], precision[n, rows] = joints[f], sharpness[f]
    if observation.inner[:3].any():
        places[:, :1] = _behind(observation.wrist[None], np.array([WRIST_MM * anatomy.scale]))
        precision[:, 0] = 1.0 / (_WRIST_SD_MM * anatomy.scale) ** 2
    return _Hypotheses(which, places, precision, *_stiff_hands(places, precision, anatomy))


def _stiff_hands(
    places: FloatArray, precision: FloatArray, anatomy: HandAnatomy
) -> tuple[FloatArray, FloatArray]:
    """Poses (H, 22) of a hand that does not bend, laid on places (H, 21, 3), and their misfits (H,).

    Args:
        places: of joints, mm.
        precision: (H, 21) of them, for all hypotheses of as many joints.
        anatomy: the hand.
    """
    poses = np.zeros((len(places), POSE_SIZE))
    poses[:, 6] = 1.0
    joints = joint_positions(anatomy, poses[:1])[0]
    known = np.nonzero(precision)[1].reshape(len(places), -1)
    there, weights = (
        np.take_along_axis(a, k, axis=1) for a, k in ((places, known[..., None]), (precision, known))
    )
    turns, poses[:, :3] = rigid_alignment(joints[known], there, weights)
    poses[:, 3:7] = rotations.canonical(rotations.quaternions_from_matrices(turns))
    laid = joints[known] @ np.swapaxes(turns, 1, 2) + poses[:, None, :3]
    return poses, (weights * np.square(laid - there).sum(axis=2)).mean(axis=1)


def _joints_along(finger: ExtendedFinger, anatomy: HandAnatomy) -> tuple[FloatArray, FloatArray]:
    """Where the joints (5, 4, 3) are of an extended finger that is any of the five, and precisions (5, 4)."""
    reach = float(np.linalg.norm(finger.base - finger.tip))
    from_tip = np.zeros((len(FINGERS), 4))  # of MCP, PIP, DIP and tip
    from_tip[:, :3] = np.cumsum(anatomy.segments[:, ::-1], axis=1)[:, ::-1]
    skin = finger.tip + from_tip[..., None] / reach * (finger.base - finger.tip)
    depths = anatomy.radii * [1.0, 1.0, 1.0, 0.5]  # a tip is the skin's
    seen = from_tip <= reach + _INSIDE_PALM_MM * anatomy.scale
    return _behind(skin, depths), 1.0 / np.square(np.where(seen, _SEEN_SD_MM, _UNSEEN_SD_MM) * anatomy.scale)


def _places_to_fit(places: FloatArray, precision: FloatArray) -> PlacesToFit:
    """Places (21, 3) that are told with a precision (21,) in all directions."""
    axes = np.broadcast_to(np.eye(3), (21, 3, 3)).copy()
    return PlacesToFit(places, axes, np.repeat(precision[:, None], 3, axis=1), np.ones(21))


def _behind(skin: FloatArray, depths: FloatArray) -> FloatArray:
    """Points (..., 3) so far (...) behind others, as the camera sees them, mm."""
    farther: FloatArray = skin * (1.0 + depths / np.linalg.norm(skin, axis=-1))[..., None]
    return farther
