"""Hands that an image's extended fingers tell of, without any prediction **[ours]**.

A finger stands out of the palm where no disc as thick as a palm covers it. Around the palm fingers come in
their order, from the thumb to the little finger or back, as the palm's front or its back is seen. Which of
the five they are is open: every choice that keeps the order, either way around, is a hypothesis. A stiff hand
is laid on each, and on the best a hand that bends (``fitting.points``), its other fingers closed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import FINGERS, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.fitting.points import PlaceFitter, PlacesToFit, lay_on
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
_STEEPEST = 3.0
"""Neighbours farther apart in depth than so many pixels are of two fingers."""
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


class _Hypothesis(NamedTuple):
    """Which fingers are extended, and a stiff hand laid on them.

    Attributes:
        which: of the five, in the order of ``about``'s places.
        about: where their joints are then.
        pose: (22,) of the stiff hand.
        misfit: mean squared distance of its joints from their places, in standard deviations.
    """

    which: tuple[int, ...]
    about: PlacesToFit
    pose: FloatArray
    misfit: float


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
    likeliest = sorted(_hypotheses(fingers, observation, anatomy), key=lambda one: one.misfit)[:_LIKELIEST]
    fitter = PlaceFitter(anatomy)
    for which, about, pose, _ in likeliest:
        fitter.fit(about, pose)
        for finger in set(range(1, len(FINGERS))) - set(which):
            pose[[7 + 3 * finger, 9 + 3 * finger]] = _CLOSED
    return np.array([one.pose for one in likeliest])


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
    steepest = jump_mm(np.full(image.shape, apart, dtype=np.float32), _STEEPEST)
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
) -> Iterator[_Hypothesis]:
    """Every choice of fingers that keeps the order, either way around."""
    stiff = np.zeros(POSE_SIZE)
    stiff[6] = 1.0
    joints = joint_positions(anatomy, stiff[None])[0]
    laid = [[_joints_along(finger, f, anatomy) for f in range(len(FINGERS))] for finger in fingers]
    for order in (laid, laid[::-1]):
        for which in combinations(range(len(FINGERS)), len(fingers)):
            about, pose = _places(order, which, observation, anatomy), stiff.copy()
            known = np.flatnonzero(about.precision[:, 0])
            turn = lay_on(about, known, joints, pose)
            off = np.square(joints[known] @ turn.T + pose[:3] - about.places[known]).sum(axis=1)
            yield _Hypothesis(which, about, pose, float((about.precision[known, 0] * off).mean()))


def _joints_along(finger: ExtendedFinger, f: int, anatomy: HandAnatomy) -> tuple[FloatArray, FloatArray]:
    """Where the joints (4, 3) are of an extended finger that is the hand's f-th, and precisions (4,)."""
    reach = float(np.linalg.norm(finger.base - finger.tip))
    from_tip = np.append(np.cumsum(anatomy.segments[f, ::-1])[::-1], 0.0)  # of MCP, PIP, DIP and tip
    skin = finger.tip + from_tip[:, None] / reach * (finger.base - finger.tip)
    depths = anatomy.radii[f] * [1.0, 1.0, 1.0, 0.5]  # a tip is the skin's
    seen = from_tip <= reach + _INSIDE_PALM_MM * anatomy.scale
    return _behind(skin, depths), 1.0 / np.square(np.where(seen, _SEEN_SD_MM, _UNSEEN_SD_MM) * anatomy.scale)


def _places(
    laid: Sequence[Sequence[tuple[FloatArray, FloatArray]]],
    which: tuple[int, ...],
    observation: Observation,
    anatomy: HandAnatomy,
) -> PlacesToFit:
    """Where joints are if these are the extended fingers: along each, as deep as it is thick; the wrist.

    Args:
        laid: of the fingers that are seen, in order: their joints as each of the five (``_joints_along``).
        which: of the five they are.
        observation: tells the wrist.
        anatomy: the hand.
    """
    places, precision = np.zeros((21, 3)), np.zeros((21, 3))
    for of_finger, f in zip(laid, which, strict=True):
        rows = slice(1 + 4 * f, 5 + 4 * f)
        places[rows], precision[rows] = of_finger[f][0], of_finger[f][1][:, None]
    if observation.inner[:3].any():
        places[:1] = _behind(observation.wrist[None], np.array([WRIST_MM * anatomy.scale]))
        precision[0] = 1.0 / (_WRIST_SD_MM * anatomy.scale) ** 2
    return PlacesToFit(places, np.tile(np.eye(3), (21, 1, 1)), precision, np.ones(21))


def _behind(skin: FloatArray, depths: FloatArray) -> FloatArray:
    """Points (N, 3) so far (N,) behind others, as the camera sees them, mm."""
    farther: FloatArray = skin * (1.0 + depths / np.linalg.norm(skin, axis=1))[:, None]
    return farther
