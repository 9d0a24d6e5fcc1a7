"""Search for a hand without a prediction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations, product
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.fitter import HandFitter, PosePrior, fit_starts
from posetrack_cli.hand.fit.gauss_newton import FREE_THUMB, Fit, ThumbPrior
from posetrack_cli.hand.fit.local_fits import LocalFitter, fit_terms
from posetrack_cli.hand.fit.points import JointTargets, TargetFitter
from posetrack_cli.hand.fit.skeleton import NO_INNER
from posetrack_cli.hand.fit.terms import Tile
from posetrack_cli.hand.keypoints.targets import WRIST_MM
from posetrack_cli.hand.model.anatomy import ANGLES, FINGERS, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.detection import Detection, detect
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer, thin_part
from posetrack_cli.hand.observe.surfaces import jump_mm, surface_labels
from posetrack_cli.tracking.velocity import BodySpace

# Hypotheses from extended fingers **[ours]**
#
# Fingers are the parts of the hand that no palm-thick disc covers. They surround the palm in anatomical
# order, clockwise or counterclockwise for its front or back. Every order-preserving assignment to the five
# fingers is a hypothesis: a rigid hand is aligned with each, and a bending hand is fitted to the best ones
# (``hand.fit.points``), with the unassigned fingers closed.

MIN_FINGERS = 3
"""Extended fingers needed to determine the hand's rotation."""
_MIN_LENGTH_MM, _MIN_WIDTH_MM, _MIN_ASPECT = 20.0, 6.0, 1.2
"""Smallest length, width and aspect ratio of an extended finger, for a hand of scale 1."""
_TIP_MM = 8.0
"""Points this close to a finger's farthest point belong to its tip."""
_INSIDE_PALM_MM = 15.0
"""Length of a straight finger that is covered by the palm's disc."""
_SEEN_SD_MM, _UNSEEN_SD_MM, _WRIST_SD_MM = 8.0, 14.0, 25.0
"""Of a joint along the visible part of a finger, of one behind it, where the finger may bend, and of the
wrist."""
_MAX_FITTED = 6
"""Hypotheses that are fitted with a bending hand."""
_CLOSED = (1.2, 1.5)  # MCP and PIP flexion, rad
_BLOCK = np.ones((3, 3), np.uint8)


class ExtendedFinger(NamedTuple):
    """A finger outside the palm, on its skin.

    Attributes:
        tip: (3,) its farthest point, camera axes, mm.
        base: (3,) where it leaves the palm, mm.
    """

    tip: FloatArray
    base: FloatArray


class _Hypotheses(NamedTuple):
    """Assignments of fingers, with a rigid hand aligned to each; the first axis is over hypotheses.

    Attributes:
        which: the assigned finger (0 to 4) of each extended one.
        positions: (H, 21, 3) joint targets, mm; 0 if unknown.
        precision: (H, 21) 1 / mm^2; 0 if unknown.
        poses: (H, 22) of the rigid hand.
        misfits: (H,) mean squared distance of joints and targets, in standard deviations.
    """

    which: Sequence[tuple[int, ...]]
    positions: FloatArray
    precision: FloatArray
    poses: FloatArray
    misfits: FloatArray


def poses_from_fingers(observation: Observation, anatomy: HandAnatomy, camera: Camera) -> FloatArray:
    """Return pose hypotheses (H, 22) from the extended fingers of an observation, likeliest first.

    Args:
        observation: with at least one target pixel.
        anatomy: the hand.
        camera: of the depth image.

    Returns:
        No pose for fewer than ``MIN_FINGERS`` or more than five fingers.
    """
    fingers = extended_fingers(observation, anatomy.scale, camera)
    if not MIN_FINGERS <= len(fingers) <= len(FINGERS):
        return np.empty((0, POSE_SIZE))
    hypotheses, fitter = _hypotheses(fingers, observation, anatomy), TargetFitter(anatomy, all_known=False)
    likeliest = np.argsort(hypotheses.misfits, kind="stable")[:_MAX_FITTED]
    poses = hypotheses.poses[likeliest]
    for k, pose in zip(likeliest.tolist(), poses, strict=True):
        fitter.fit(_targets_of(hypotheses.positions[k], hypotheses.precision[k]), pose)
        for finger in set(range(1, len(FINGERS))) - set(hypotheses.which[k]):
            pose[[7 + 3 * finger, 9 + 3 * finger]] = _CLOSED
    return poses


def extended_fingers(observation: Observation, scale: float, camera: Camera) -> list[ExtendedFinger]:
    """Return the fingers outside the palm, clockwise in the image.

    The order starts beyond the arm or, if none is visible, after the widest gap between fingers.

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
    adjacent = cv2.dilate(palm.astype(np.uint8), _BLOCK) > 0
    parts = (_finger(numbers == k, adjacent, points, apart, scale) for k in range(1, count))
    fingers = [finger for finger in parts if finger is not None]
    return _sort_clockwise(fingers, points[_middle_of(palm)], observation.inner[:3]) if fingers else []


def _finger(
    part: BoolArray, adjacent: BoolArray, points: FloatArray, apart: float, scale: float
) -> ExtendedFinger | None:
    """Return the finger of a thin part (h, w) of a hand; None for other parts, such as a palm's rim.

    Args:
        part: its pixels.
        adjacent: (h, w) pixels of the palm and those next to them.
        points: (h, w, 3) of all pixels, mm.
        apart: distance of neighbouring pixels, mm.
        scale: of the hand.
    """
    roots = points[part & adjacent]
    if not len(roots):
        return None
    inside, base = points[part], roots.mean(axis=0)
    away = np.linalg.norm(inside - base, axis=1)
    length = float(away.max())
    width = len(inside) * apart * apart / max(length, apart)
    if length < _MIN_LENGTH_MM * scale or not _MIN_WIDTH_MM * scale <= width <= length / _MIN_ASPECT:
        return None
    near_tip = np.linalg.norm(inside - inside[np.argmax(away)], axis=1) < _TIP_MM * scale
    ahead = inside[near_tip].mean(axis=0) - base
    return ExtendedFinger(base + length / np.linalg.norm(ahead) * ahead, base)


def _middle_of(palm: BoolArray) -> tuple[int, int]:
    """Return row and column of the mask's pixel farthest from its rim."""
    inside = cv2.distanceTransform(np.pad(palm, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
    return int(row), int(column)


def _sort_clockwise(
    fingers: Sequence[ExtendedFinger], palm: FloatArray, arm: FloatArray
) -> list[ExtendedFinger]:
    """Sort fingers around a palm (3,), from the direction (3,) of the arm or from the widest gap."""
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
    """Return all order-preserving assignments of the fingers, in both orders.

    Joints lie along each finger, half its thickness behind the skin; so does the wrist if an arm is visible.
    """
    along = [_joints_along(finger, anatomy) for finger in fingers]
    chosen = list(combinations(range(len(FINGERS)), len(fingers)))
    which, count = 2 * chosen, len(chosen)
    positions, precision = np.zeros((2 * count, 21, 3)), np.zeros((2 * count, 21))
    for n, (order, these) in enumerate(product((along, along[::-1]), chosen)):
        for (joints, sharpness), f in zip(order, these, strict=True):
            rows = slice(1 + 4 * f, 5 + 4 * f)
            positions[n, rows], precision[n, rows] = joints[f], sharpness[f]
    if observation.inner[:3].any():
        positions[:, :1] = _behind(observation.wrist[None], np.array([WRIST_MM * anatomy.scale]))
        precision[:, 0] = 1.0 / (_WRIST_SD_MM * anatomy.scale) ** 2
    return _Hypotheses(which, positions, precision, *_align_stiff_hands(positions, precision, anatomy))


def _align_stiff_hands(
    positions: FloatArray, precision: FloatArray, anatomy: HandAnatomy
) -> tuple[FloatArray, FloatArray]:
    """Return poses (H, 22) of a rigid hand aligned with targets (H, 21, 3), and misfits (H,).

    Args:
        positions: of joints, mm.
        precision: (H, 21); every hypothesis has the same number of known joints.
        anatomy: the hand.
    """
    poses = np.zeros((len(positions), POSE_SIZE))
    poses[:, 6] = 1.0
    joints = joint_positions(anatomy, poses[:1])[0]
    known = np.nonzero(precision)[1].reshape(len(positions), -1)
    goals, weights = (
        np.take_along_axis(a, k, axis=1) for a, k in ((positions, known[..., None]), (precision, known))
    )
    turns, poses[:, :3] = rigid_alignment(joints[known], goals, weights)
    poses[:, 3:7] = rotations.canonical(rotations.quaternions_from_matrices(turns))
    aligned = joints[known] @ np.swapaxes(turns, 1, 2) + poses[:, None, :3]
    return poses, (weights * np.square(aligned - goals).sum(axis=2)).mean(axis=1)


def _joints_along(finger: ExtendedFinger, anatomy: HandAnatomy) -> tuple[FloatArray, FloatArray]:
    """Return joints (5, 4, 3) and precisions (5, 4) of an extended finger, for each of the five it may be."""
    reach = float(np.linalg.norm(finger.base - finger.tip))
    from_tip = np.zeros((len(FINGERS), 4))  # of MCP, PIP, DIP and tip
    from_tip[:, :3] = np.cumsum(anatomy.segments[:, ::-1], axis=1)[:, ::-1]
    skin = finger.tip + from_tip[..., None] / reach * (finger.base - finger.tip)
    depths = anatomy.radii * [1.0, 1.0, 1.0, 0.5]  # a tip is the skin's
    seen = from_tip <= reach + _INSIDE_PALM_MM * anatomy.scale
    return _behind(skin, depths), 1.0 / np.square(np.where(seen, _SEEN_SD_MM, _UNSEEN_SD_MM) * anatomy.scale)


def _targets_of(positions: FloatArray, precision: FloatArray) -> JointTargets:
    """Return isotropic targets at positions (21, 3) with precision (21,)."""
    axes = np.broadcast_to(np.eye(3), (21, 3, 3)).copy()
    return JointTargets(positions, axes, np.repeat(precision[:, None], 3, axis=1), np.ones(21))


def _behind(skin: FloatArray, depths: FloatArray) -> FloatArray:
    """Return points (..., 3) at distances (...) behind others along the line of sight, mm."""
    farther: FloatArray = skin * (1.0 + depths / np.linalg.norm(skin, axis=-1))[..., None]
    return farther


# Hypotheses from detections

_D = np.pi / 180.0
# Thumb CMC and MCP flexion, abduction; then MCP flexion, abduction, PIP flexion of each finger, degrees.
_FOLDED = (80.0, 0.0, 95.0)
_SHAPES: FloatArray = _D * np.array(
    [
        (-5, 5, 0, 3, 5, 5, 3, 0, 5, 3, -4, 5, 4, -8, 6),  # open
        (8, 20, 0, 30, 2, 40, 30, 0, 42, 32, -2, 43, 35, -5, 44),  # half closed
        (14, 47, -9, *_FOLDED, *_FOLDED, *_FOLDED, *_FOLDED),  # fist
        (33, 37, -13, 3, 5, 5, 3, -5, 5, *_FOLDED, *_FOLDED),  # two fingers
    ]
)
_TURNS = _D * np.arange(0.0, 360.0, 30.0)  # about the hand's own length
_TILTS = _D * np.array([-35.0, 0.0, 35.0])  # of the wrist, towards palm and back
_SURFACE_MM = 12.0  # depth of a palm's bones behind its skin
_IN_PLANE = _D * np.arange(0.0, 360.0, 30.0)
_KNUCKLES = [0, 5, 9, 13, 17]  # their mean is the palm's centre
ITERATIONS = 7
"""Gauss-Newton iterations per hypothesis."""
MAX_SWAPPED = 6
"""Best fits of a group that exchange fingers."""
ACCEPT_MM = 18.0
"""Largest cost of a detected hand."""


def detected_poses(detection: Detection, anatomy: HandAnatomy) -> FloatArray:
    """Return pose hypotheses (H, 22) for a detection: turned about its length, tilted, open to closed
    **[ours]**.

    The fingers point away from the elbow or, without a visible forearm, in all directions of the image.
    """
    arm = detection.arm
    turns = _rotations_in_plane() if arm is None else _rotations_along(arm, _TILTS)
    middle = detection.palm + _SURFACE_MM * detection.palm / np.linalg.norm(detection.palm)
    return _poses_at(turns, middle, anatomy)


@cache
def _rotations_in_plane() -> FloatArray:
    """Return rotations (M, 4) of hands that point in all directions of the image."""
    ways = np.stack([np.sin(_IN_PLANE), -np.cos(_IN_PLANE), np.zeros(len(_IN_PLANE))], axis=1)
    return np.concatenate([_rotations_along(way, np.zeros(1)) for way in ways])


def turned_poses(pose: FloatArray, anatomy: HandAnatomy) -> FloatArray:
    """Return poses (H, 22) that look like a given one: turned about its length, open to closed."""
    palm = _palm_of(pose, anatomy)
    turns = rotations.multiply(pose[3:7], rotations.exponential(_TURNS[:, None] * [0.0, 1.0, 0.0]))
    return np.concatenate(
        [_poses_at(turns, palm, anatomy), _poses_at(turns, palm, anatomy, pose[None, ANGLES])]
    )


def _palm_of(pose: FloatArray, anatomy: HandAnatomy) -> FloatArray:
    """Return the centre (3,) of the palm of a pose (22,), mm."""
    palm: FloatArray = joint_positions(anatomy, pose[None])[0, _KNUCKLES].mean(axis=0)
    return palm


def _rotations_along(along: FloatArray, tilts: FloatArray) -> FloatArray:
    """Return rotations (M, 4) of a hand whose forearm points along a unit vector."""
    turned = rotations.multiply(_pointing(along), rotations.exponential(_TURNS[:, None] * [0.0, 1.0, 0.0]))
    tilted = rotations.multiply(turned[:, None], rotations.exponential(tilts[:, None] * [1.0, 0.0, 0.0]))
    return tilted.reshape(-1, 4)


def _pointing(along: FloatArray) -> FloatArray:
    """Return the smallest rotation (4,) that points the fingers, -y, along a unit vector."""
    up = np.array([0.0, -1.0, 0.0])
    axis, cosine = np.cross(up, along), float(up @ along)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return rotations.exponential(np.array([0.0, 0.0, 0.0 if cosine > 0 else np.pi]))
    return rotations.exponential(axis / sine * np.arctan2(sine, cosine))


def _poses_at(
    turns: FloatArray, middle: FloatArray, anatomy: HandAnatomy, shapes: FloatArray = _SHAPES
) -> FloatArray:
    """Combine all rotations (M, 4) and shapes (K, 15), the palm's centre at a point (3,): (M K, 22)."""
    poses = np.zeros((len(turns) * len(shapes), POSE_SIZE))
    poses[:, 3:7] = np.repeat(rotations.canonical(turns), len(shapes), axis=0)
    poses[:, ANGLES] = np.tile(shapes, (len(turns), 1))
    poses[:, :3] = middle - joint_positions(anatomy, poses)[:, _KNUCKLES].mean(axis=1)
    return poses


_FREE_PRECISION: FloatArray = 1.0 / np.square(np.repeat([60.0, 0.8, 0.7], [3, 3, 15]))
"""(21,) precision around a hypothesis, 1 / mm^2 and 1 / rad^2; hypotheses are 30 degrees apart."""
_APART_RAD, _APART_BEND = np.deg2rad(25.0), 0.15
_SCATTER_SEED = 0  # fixed, so that a search depends on the image alone

_USUAL_FINGERS_MM2, _FINGERS_PER_MM2, _FINGERS_MM = 800.0, 3.0 / 500.0, (-3.0, 4.5)
_USUAL_SCORE, _PER_SCORE_MM, _PER_DEPTH = 0.94, 20.0, 0.005


def finger_bonus(fingers_mm2: float) -> float:
    """Return the cost bonus for the finger area visible at a place, mm; negative for few fingers **[ours]**.

    With a model of another shape, hand and elbow fit at about the same cost, 5 to 12 mm. Half of all hands
    show more than 1340 mm^2 of finger-thin area and a quarter less than 830; half of all elbows and upper
    arms show less than 400 (people 600-617 of the synthetic strangers).
    """
    low, high = _FINGERS_MM
    return float(np.clip((fingers_mm2 - _USUAL_FINGERS_MM2) * _FINGERS_PER_MM2, low, high))


def detection_penalty(detection: Detection) -> float:
    """Return the penalty of a detection before any fit, mm of cost."""
    lacking = _PER_SCORE_MM * max(0.0, _USUAL_SCORE - detection.score)
    return lacking - finger_bonus(detection.fingers_mm2) + depth_penalty(float(detection.palm[2]))


# Total costs above the best: not worth a fit; resolved with all turns and folds, which is expensive; possibly
# the best place for a hand of another side or size.
_HOPELESS_MM, _CLOSE_MM, _ALIKE_MM = 8.0, 2.0, 4.0

_SIZES = (0.66, 1.25)
"""Range of hand scales, from a three-year-old to the largest men."""
SAME_WRIST_MM = 60.0
"""Wrist distance up to which two candidates are the same hand."""
LIKELY_PAIR_MM = 16.0
"""Largest cautious cost of a hand in a recording that is known to show two."""
_HERE_MM = 100.0
"""Distance of palms up to which a detection may lead to a given hand: of 81 that did in two real recordings,
one was farther."""
_ONE_ARM_MM, _ASIDE_MM = 200.0, 40.0
"""Largest distance of a wrist along the other hand's forearm, and aside, on one arm **[ours]**: the hand and
its elbow, taken for another hand, are 60 to 110 mm apart and at most 30 mm aside."""


def depth_penalty(depth_mm: float) -> float:
    """Return the penalty for depth, mm of cost: of two similar hands the nearer one is preferred."""
    return _PER_DEPTH * depth_mm


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hand found without a prediction.

    Attributes:
        pose: (22,).
        cost: union cost D of the smooth skin, mm.
        total_cost: cost with the penalties of its place, mm.
        inner: (6,) inner numbers (``hand.fit.skeleton``).
    """

    pose: FloatArray
    cost: float
    total_cost: float = np.inf
    inner: FloatArray = field(default_factory=NO_INNER.copy)

    @property
    def cautious_cost(self) -> float:
        """Return the cost with twice the penalties of its place, mm: low only for what looks like a hand."""
        return 2.0 * self.total_cost - self.cost


_FINGER_STARTS = 2
"""Starts from extended fingers per frame: palm and back of an open hand."""


_ROUGH_STEP, _MIN_ROUGH_TILE_PX = 2, 48
"""Rough fits use every second pixel in both directions, unless the tile is small."""


_QUICK_SEARCH = {"scattered": 4, "finished": 3}


_ROUGH_EXCESS_MM = 0.75
"""By how much a first rough fit may cost more than a fit to all pixels that starts from it."""


class Bar(NamedTuple):
    """Costs, mm, one of which a hand has to stay below to be of use; others are only fitted roughly.

    Attributes:
        cost: of the hand.
        total_cost: with the penalties of its place.
    """

    cost: float = np.inf
    total_cost: float = -np.inf

    def at(self, penalty_mm: float) -> float:
        """Return the bar for the cost at a place with a penalty."""
        return max(self.cost, self.total_cost - penalty_mm)


NO_BAR = Bar()


def quick_search(config: HandConfig) -> HandConfig:
    """Return the configuration of a search for comparisons that do not need the last 0.1 mm."""
    quick = config.acquisition.model_copy(update=_QUICK_SEARCH)
    never = config.status.model_copy(update={"doubt_above_mm": config.observation.clamp_mm})
    return config.model_copy(update={"acquisition": quick, "status": never})


class Acquisition:
    """Finds hands without a prediction: the best of many hypotheses are fitted, first roughly, then fully.

    Args:
        config: parameters.
        hand: the model.
        camera: of the depth images.
        thumb: prior of its thumb.

    Attributes:
        observer: cuts out and segments windows.
        local_fitter: makes local fits.
    """

    def __init__(
        self, config: HandConfig, hand: HandModel, camera: Camera, thumb: ThumbPrior = FREE_THUMB
    ) -> None:
        self._config, self._settings = config, config.acquisition
        self._hand, self._camera, self._space = hand, camera, BodySpace()
        self.observer = Observer(config, hand.anatomy, camera, segment=True, with_arm=True)
        self.local_fitter = LocalFitter(config, hand, camera, thumb)
        size = config.observation.tile_px
        self._step = _ROUGH_STEP if size >= _MIN_ROUGH_TILE_PX else 1
        rough_px, terms = -(-size // self._step), fit_terms(config)
        self._rough = HandFitter(hand, camera, rough_px, terms, skin=hand.lean_with_arm, thumb=thumb)

    def search(
        self,
        depth: ImageArray,
        extra: Sequence[Candidate] = (),
        bar: Bar = NO_BAR,
        around: FloatArray | None = None,
    ) -> Candidate | None:
        """Return the best hand in a whole image, None if none fits.

        Args:
            depth: (height, width) mm.
            extra: further candidates, such as from keypoints.
            bar: what the hand is needed for.
            around: (22,) pose, if only hands at its place are of use.
        """
        detections = self.detect(depth)
        if around is not None:
            palm = _palm_of(around, self._hand.anatomy)
            detections = [one for one in detections if np.linalg.norm(one.palm - palm) < _HERE_MM]
        found = [one for _, one in self._fit_places(depth, detections, bar, _ALIKE_MM)]
        return best_of(merge_candidates(found, extra))

    def best_at(self, depth: ImageArray, detections: Sequence[Detection]) -> Candidate | None:
        """Return the best hand at detections in an image (height, width), mm, None if none fits."""
        return best_of([one for _, one in self._fit_places(depth, detections, beyond_mm=_ALIKE_MM)])

    def candidates(self, depth: ImageArray) -> list[Candidate]:
        """Return the hands that fit a whole image (height, width), mm, one per place."""
        return [one for one in self.candidates_at(depth, self.detect(depth)) if one.cost <= ACCEPT_MM]

    def candidates_at(self, depth: ImageArray, detections: Sequence[Detection]) -> list[Candidate]:
        """Return the hands at detections in an image (height, width), mm, that may be the best."""
        return [one for _, one in self._fit_places(depth, detections)]

    def appraise(
        self,
        depth: ImageArray,
        detections: Sequence[Detection],
        extra: Sequence[Candidate] = (),
        below_mm: float = np.inf,
    ) -> tuple[float, list[Detection]]:
        """Return the cost of the best hand, mm, and the detections that may be best for another side or size.

        Without a candidate the cost is c_max.

        Args:
            depth: (height, width) mm.
            detections: of ``detect``.
            extra: further candidates, such as from keypoints.
            below_mm: cost above which a rough one is sufficient.
        """
        found = self._fit_places(depth, detections, Bar(below_mm), _ALIKE_MM)
        candidates = merge_candidates([one for _, one in found], extra)
        if not candidates:
            return self._config.observation.clamp_mm, list(detections)
        best = min(candidates, key=lambda one: one.total_cost)
        near = [detection for detection, one in found if one.total_cost < best.total_cost + _ALIKE_MM]
        return min(best.cost, self._config.observation.clamp_mm), near or list(detections)

    def detect(self, depth: ImageArray, *, is_sized: bool = False) -> list[Detection]:
        """Return possible hands in a whole image.

        A scale outside that of people means that depth is in another unit than mm; the image is then rescaled
        to a hand of usual size. So it is if the hand has the size that is searched (``is_sized``): a child's
        elbow is as wide as an adult's palm.
        """
        low, high = _SIZES
        scale = self._hand.anatomy.scale
        unit = 1.0 if low <= scale <= high and not is_sized else scale
        image = depth if unit == 1.0 else depth / np.float32(unit)
        detections = detect(image, self._camera, self._config.detection, self.observer.sampler)
        return detections if unit == 1.0 else [detection.enlarged(unit) for detection in detections]

    def _fit_places(
        self,
        depth: ImageArray,
        detections: Sequence[Detection],
        bar: Bar = NO_BAR,
        beyond_mm: float = np.inf,
    ) -> list[tuple[Detection, Candidate]]:
        """Fit the detections, the likeliest first, without those whose penalty no cost could make up for.

        Hands that cost ``beyond_mm`` more than the best are only fitted roughly.
        """
        penalties = [detection_penalty(detection) for detection in detections]
        found: list[tuple[Detection, Candidate]] = []
        best = np.inf
        for k in np.argsort(penalties, kind="stable"):
            penalty, detection = penalties[k], detections[k]
            if penalty >= min(penalties) + _HOPELESS_MM:
                break
            one = self._fit_detection(depth, detection, min(bar.at(penalty), best + beyond_mm - penalty))
            if one is not None:
                found.append((detection, replace(one, total_cost=one.cost + penalty)))
                best = min(best, found[-1][1].total_cost)
        return [
            (detection, self._resolve(depth, one, bar) if one.total_cost < best + _CLOSE_MM else one)
            for detection, one in found
        ]

    def _resolve(self, depth: ImageArray, found: Candidate, bar: Bar) -> Candidate:
        """Return the candidate, or a cheaper lookalike if it fits poorly."""
        if found.cost <= self._config.status.doubt_above_mm:
            return found
        needed_mm = bar.at(found.total_cost - found.cost)
        other = self.lookalike(depth, found, min(found.cost, needed_mm))
        return found if other is None or other.cost >= found.cost else other

    def lookalike(self, depth: ImageArray, place: Candidate, below_mm: float = np.inf) -> Candidate | None:
        """Return the best fit among hands that look like a candidate, of either side (``reconsider``)."""
        other = self.reconsider(self.observer.observe(depth, place.pose), place.pose, below_mm)
        penalty = place.total_cost - place.cost
        return None if other is None else replace(other, total_cost=other.cost + penalty)

    def reconsider(
        self, observation: Observation, pose: FloatArray, below_mm: float = np.inf
    ) -> Candidate | None:
        """Return the best fit among hands that look like a pose (22,); None without a target pixel.

        It is a rough one if even a full one would probably cost more than ``below_mm``.
        """
        if observation.target_pixels == 0:
            return None
        hypotheses = turned_poses(pose, self._hand.anatomy), self._poses_from_fingers(observation)
        return self._best_fit(observation, np.concatenate(hypotheses), below_mm)

    def refit(self, depth: ImageArray, pose: FloatArray) -> Candidate | None:
        """Return the best fit around a pose (22,) in an image (height, width), mm; None without a target."""
        observation = self.observer.observe(depth, pose)
        return None if observation.target_pixels == 0 else self._best_fit(observation, pose[None])

    def starts_from_fingers(self, observation: Observation) -> FloatArray:
        """Return the best poses (K, 22) from extended fingers, as starts of a frame's fits."""
        poses, fitter = self._poses_from_fingers(observation), self.local_fitter.fitter
        if not len(poses):
            return poses
        costs = fitter.costs(fitter.tile(observation), poses)
        return poses[np.argsort(costs, kind="stable")[:_FINGER_STARTS]]

    def _poses_from_fingers(self, observation: Observation) -> FloatArray:
        return poses_from_fingers(observation, self._hand.anatomy, self._camera)

    def _fit_detection(self, depth: ImageArray, detection: Detection, below_mm: float) -> Candidate | None:
        observation = self.observer.observe_detection(depth, detection)
        if observation.target_pixels == 0:
            return None
        hypotheses = detected_poses(detection, self._hand.anatomy), self._poses_from_fingers(observation)
        first = self._fit_roughly(observation, np.concatenate(hypotheses), below_mm)
        if _is_too_costly(first[0], below_mm):
            return _candidate(first[0])
        again = self.observer.observe(depth, first[0].pose)  # cut at the fitted wrist
        if again.target_pixels == 0:
            return self._fit_fully(observation, first)
        if again.reversed:
            return None
        return self._best_fit(again, first[0].pose[None])

    def _best_fit(self, observation: Observation, poses: FloatArray, below_mm: float = np.inf) -> Candidate:
        rough = self._fit_roughly(observation, poses, below_mm)
        is_rough = _is_too_costly(rough[0], below_mm)
        return _candidate(rough[0]) if is_rough else self._fit_fully(observation, rough)

    def _fit_roughly(
        self, observation: Observation, poses: FloatArray, below_mm: float = np.inf
    ) -> list[Fit]:
        """Fit the best distinct hypotheses to a subset of pixels and refine them; best first.

        They are not refined if even the best is far from ``below_mm``.
        """
        settings, fitter = self._settings, self._rough
        tile = fitter.tile(observation.every(self._step))
        poses = fitter.aligned(tile, poses)
        starts = poses[distinct(poses, fitter.costs(tile, poses), settings.fitted)]
        fits = self._descend_groups(fitter, tile, starts[None])
        if _is_too_costly(min(fits, key=_cost), below_mm):
            return _most_different(fits, settings.finished)
        rng, none = np.random.default_rng(_SCATTER_SEED), np.empty((0, POSE_SIZE))
        around = np.array(
            [
                fit_starts(fit.pose, none, settings.scattered, self._space, rng, ahead=True)
                for fit in _most_different(fits, settings.refined)
            ]
        )
        aligned = fitter.aligned(tile, around.reshape(-1, POSE_SIZE)).reshape(around.shape)
        fits += self._descend_groups(fitter, tile, aligned)
        return _most_different(fits, settings.finished)

    def _fit_fully(self, observation: Observation, rough: Sequence[Fit]) -> Candidate:
        """Fit rough fits to all pixels and return the best."""
        fitter, poses = self.local_fitter.fitter, np.array([fit.pose for fit in rough])
        fits = self._descend_groups(fitter, fitter.tile(observation), poses[None])
        return _candidate(min(fits, key=_cost))

    def _descend_groups(self, fitter: HandFitter, tile: Tile, groups: FloatArray) -> list[Fit]:
        """Fit groups of starts (G, K, 22), and for each group the best fit with the fingers of the others."""
        size = groups.shape[1]
        fits = self._descend_freely(fitter, tile, groups.reshape(-1, POSE_SIZE))
        parts = [fits[first : first + size] for first in range(0, len(fits), size)]
        likeliest = [sorted(part, key=_cost)[:MAX_SWAPPED] for part in parts]
        return fits + self._descend_freely(fitter, tile, fitter.swapped(tile, likeliest))

    def _descend_freely(self, fitter: HandFitter, tile: Tile, starts: FloatArray) -> list[Fit]:
        """Fit starts (K, 22), each with a wide prior around itself."""
        priors = [PosePrior(start, _FREE_PRECISION) for start in starts]
        return fitter.descend(tile, starts, priors, ITERATIONS)


def _cost(fit: Fit) -> float:
    return float(fit.cost[0])


def _candidate(fit: Fit) -> Candidate:
    return Candidate(fit.pose.copy(), _cost(fit), inner=fit.inner.copy())


def _is_too_costly(rough: Fit, below_mm: float) -> bool:
    """Return whether a full fit that starts from a rough one probably costs more than a bound."""
    return _cost(rough) > below_mm + _ROUGH_EXCESS_MM


def best_of(candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate of least total cost among those that fit; None if none does."""
    return min(
        (one for one in candidates if one.cost <= ACCEPT_MM), key=lambda one: one.total_cost, default=None
    )


def _most_different(fits: Sequence[Fit], count: int) -> list[Fit]:
    """Return the best distinct fits (``distinct``), best first."""
    poses, costs = np.array([fit.pose for fit in fits]), np.array([_cost(fit) for fit in fits])
    return [fits[k] for k in distinct(poses, costs, count)]


def cheapest_pair(
    first: Sequence[Candidate], second: Sequence[Candidate]
) -> tuple[Candidate | None, Candidate | None]:
    """Return the places of two hands: of all pairs of candidates at different places, the cheapest.

    Args:
        first, second: candidates of either hand; a hand without a place costs ``ACCEPT_MM``.
    """
    pairs = [
        (a, b)
        for a, b in product([*first, None], [*second, None])
        if a is None or b is None or (_are_apart(a, b) and not _are_on_one_arm(a, b))
    ]
    return min(pairs, key=lambda pair: sum(ACCEPT_MM if one is None else one.total_cost for one in pair))


def lead_of(
    pair: Sequence[Candidate | None], first: Sequence[Candidate], second: Sequence[Candidate]
) -> float:
    """Return by how much a pair of places costs less than the exchanged hands at the same places, mm."""
    here = sum(one.total_cost for one in pair if one is not None)
    exchanged = zip((second, first), pair, strict=True)
    return sum(least_cost_at(place, found) for found, place in exchanged if place is not None) - here


def least_cost_at(place: Candidate, candidates: Sequence[Candidate]) -> float:
    """Return the least total cost of candidates at a place, mm; ``ACCEPT_MM`` without one."""
    costs = [one.total_cost for one in candidates if not _are_apart(one, place)]
    return min(costs, default=ACCEPT_MM)


def _are_apart(first: Candidate, second: Candidate) -> bool:
    """Return whether two candidates are at different places."""
    return bool(np.linalg.norm(first.pose[:3] - second.pose[:3]) > SAME_WRIST_MM)


def _are_on_one_arm(first: Candidate, second: Candidate) -> bool:
    """Return whether the forearms of two candidates point at each other's wrist: a hand and its elbow."""
    between = second.pose[:3] - first.pose[:3]
    for arm, way in ((first.inner[:3], between), (second.inner[:3], -between)):
        length = float(np.linalg.norm(arm))
        along = float(arm @ way) / length if length > 0.0 else -1.0
        if not 0.0 < along < _ONE_ARM_MM or along**2 + _ASIDE_MM**2 < float(way @ way):
            return False
    return True


def cheaper_of(first: Candidate | None, second: Candidate | None) -> Candidate | None:
    """Return the candidate of lower cost, if any."""
    both = [candidate for candidate in (first, second) if candidate is not None]
    return min(both, key=lambda candidate: candidate.cost, default=None)


def merge_candidates(found: Sequence[Candidate], extra: Sequence[Candidate]) -> list[Candidate]:
    """Merge candidates; of two at one place, keep the cheaper pose and the lower total cost."""
    merged = list(found)
    for one in extra:
        near = [
            k
            for k, other in enumerate(merged)
            if np.linalg.norm(other.pose[:3] - one.pose[:3]) < SAME_WRIST_MM
        ]
        for k in near:
            best = one if one.cost < merged[k].cost else merged[k]
            merged[k] = replace(best, total_cost=min(one.total_cost, merged[k].total_cost))
        merged += [] if near else [one]
    return merged


def distinct(poses: FloatArray, costs: FloatArray, count: int) -> list[int]:
    """Return indices of the best poses (H, 22) that differ in rotation or shape, then of the rest."""
    order = np.argsort(costs, kind="stable")
    kept: list[int] = []
    for k in order:
        if len(kept) == count:
            return kept
        turned = 2.0 * np.arccos(np.clip(np.abs(poses[kept, 3:7] @ poses[k, 3:7]), 0.0, 1.0))
        bent = np.abs(poses[kept, ANGLES] - poses[k, ANGLES]).mean(axis=1)
        if not np.any((turned < _APART_RAD) & (bent < _APART_BEND)):
            kept.append(int(k))
    rest = [int(k) for k in order if int(k) not in kept]
    return kept + rest[: count - len(kept)]
