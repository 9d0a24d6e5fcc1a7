"""The search for a hand that no prediction tells of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
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
from posetrack_cli.hand.fit.points import PlaceFitter, PlacesToFit
from posetrack_cli.hand.fit.skeleton import NO_INNER
from posetrack_cli.hand.fit.terms import Tile
from posetrack_cli.hand.keypoints.places import WRIST_MM
from posetrack_cli.hand.model.anatomy import ANGLES, FINGERS, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.detection import Detection, detect
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer, thin_part
from posetrack_cli.hand.observe.surfaces import jump_mm, surface_labels
from posetrack_cli.tracking.velocity import BodySpace

# Hands that an image's extended fingers tell of, without any prediction **[ours]**.
#
# A finger stands out of the palm where no disc as thick as a palm covers it. Around the palm fingers come in
# their order, from the thumb to the little finger or back, as the palm's front or its back is seen. Which of
# the five they are is open: every choice that keeps the order, either way around, is a hypothesis. A stiff
# hand is laid on each, and on the best a hand that bends (``hand.fit.points``), its other fingers closed.


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


# Finding a hand whose pose is unknown: at the start, and after a loss


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
_SURFACE_MM = 12.0  # from the skin to the bones of a palm
_IN_PLANE = _D * np.arange(0.0, 360.0, 30.0)
_KNUCKLES = [0, 5, 9, 13, 17]  # joints whose mean is the palm's middle
ITERATIONS = 7
"""Of Gauss-Newton from each hypothesis."""
SWAPPED = 6
"""So many of the best fits exchange their fingers."""
ACCEPT_MM = 18.0
"""What a hand that is found costs at most."""


def detected_poses(detection: Detection, anatomy: HandAnatomy) -> FloatArray:
    """Poses (H, 22) of a detected hand: turned about its length, tilted, open to closed **[ours]**.

    The fingers point away from the elbow; where no forearm is seen, in all directions of the image.
    """
    if detection.arm is not None:
        turns = _turned(detection.arm, _TILTS)
    else:
        ways = np.stack([np.sin(_IN_PLANE), -np.cos(_IN_PLANE), np.zeros(len(_IN_PLANE))], axis=1)
        turns = [rotation for way in ways for rotation in _turned(way, np.zeros(1))]
    middle = detection.palm + _SURFACE_MM * detection.palm / np.linalg.norm(detection.palm)
    return _placed(np.array(turns), middle, anatomy)


def turned_poses(pose: FloatArray, anatomy: HandAnatomy) -> FloatArray:
    """Poses (H, 22) that look much like one that was lost: turned about its length, and closed or opened."""
    palm = joint_positions(anatomy, pose[None])[0, _KNUCKLES].mean(axis=0)
    about = [rotations.exponential(np.array([0.0, turn, 0.0])) for turn in _TURNS]
    turns = np.array([rotations.multiply(pose[3:7], turn) for turn in about])
    return np.concatenate([_placed(turns, palm, anatomy), _placed(turns, palm, anatomy, pose[None, ANGLES])])


def _turned(along: FloatArray, tilts: FloatArray) -> list[FloatArray]:
    """Rotations of a hand whose forearm points along a unit vector."""
    arm = _pointing(along)
    return [
        rotations.multiply(
            rotations.multiply(arm, rotations.exponential(np.array([0.0, turn, 0.0]))),
            rotations.exponential(np.array([tilt, 0.0, 0.0])),
        )
        for turn, tilt in product(_TURNS, tilts)
    ]


def _pointing(along: FloatArray) -> FloatArray:
    """The smallest rotation (4,) that points the fingers, -y, along a unit vector."""
    up = np.array([0.0, -1.0, 0.0])
    axis, cosine = np.cross(up, along), float(up @ along)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return rotations.exponential(np.array([0.0, 0.0, 0.0 if cosine > 0 else np.pi]))
    return rotations.exponential(axis / sine * np.arctan2(sine, cosine))


def _placed(
    turns: FloatArray, middle: FloatArray, anatomy: HandAnatomy, shapes: FloatArray = _SHAPES
) -> FloatArray:
    """Every rotation (M, 4) with every shape (K, 15), the palm's middle at a point (3,): (M K, 22)."""
    poses = np.zeros((len(turns) * len(shapes), POSE_SIZE))
    poses[:, 3:7] = np.repeat(rotations.canonical(turns), len(shapes), axis=0)
    poses[:, ANGLES] = np.tile(shapes, (len(turns), 1))
    poses[:, :3] = middle - joint_positions(anatomy, poses)[:, _KNUCKLES].mean(axis=1)
    return poses


_FREE_PRECISION: FloatArray = 1.0 / np.square(np.repeat([60.0, 0.8, 0.7], [3, 3, 15]))
"""(21,) of a pose about a hypothesis, 1 / mm^2 and 1 / rad^2: hypotheses are 30 degrees and a shape apart."""
_APART_RAD, _APART_BEND = np.deg2rad(25.0), 0.15
_SCATTER_SEED = 0  # a search depends on nothing but the image


_USUAL_FINGERS_MM2, _FINGERS_PER_MM2, _FINGERS_MM = 800.0, 3.0 / 500.0, (-3.0, 4.5)
_USUAL_SCORE, _PER_SCORE_MM, _PER_DEPTH = 0.94, 20.0, 0.005


def fingers_bonus(fingers_mm2: float) -> float:
    """What fingers are worth that a place shows or does not show, mm of cost **[ours]**.

    A foreign hand's cost and an elbow's are alike, 5 to 12 mm. Of 14 people (600-617 of the synthetic
    strangers, motions alike) half of the hands show 1340 mm^2 of what is thin as fingers are, a quarter below
    830; of 152 elbows and upper arms half show 400, one in twenty 960. With this bonus, with what a
    detection's score lacks and its depth, the right place is the cheapest in 81 of 83 single frames, without
    in 53.
    """
    low, high = _FINGERS_MM
    return float(np.clip((fingers_mm2 - _USUAL_FINGERS_MM2) * _FINGERS_PER_MM2, low, high))


def _doubt_of(detection: Detection) -> float:
    """What speaks against a hand at a place before anything is fitted there, mm of cost."""
    lacking = _PER_SCORE_MM * max(0.0, _USUAL_SCORE - detection.score)
    return lacking - fingers_bonus(detection.fingers_mm2) + depth_doubt(float(detection.palm[2]))


_HOPELESS_MM, _CLOSE_MM, _ALIKE_MM = 8.0, 2.0, 4.0
"""Costs of what is fitted differ by less than the first; what is closer to the best than the second is looked
at in all turns and folds, which takes longer than all else. What is closer than the third may be the best for
a hand of another side or size."""


_SIZES = (0.66, 1.25)
"""Of hands, from a child of three years to the largest men."""
_ONE_PLACE_MM = 60.0
"""Distance of two wrists up to which what was found and what was told are one hand."""


def depth_doubt(depth_mm: float) -> float:
    """What a place's depth speaks against it, mm of cost: of two hands alike the nearer one is meant."""
    return _PER_DEPTH * depth_mm


@dataclass(frozen=True, eq=False)
class Candidate:
    """A hand that was found.

    Attributes:
        pose: (22,).
        cost: union cost D of the smooth skin, mm.
        doubt: the cost and what else speaks against a hand at this place, mm.
        inner: (6,) its inner numbers (``hand.fit.skeleton``).
    """

    pose: FloatArray
    cost: float
    doubt: float = np.inf
    inner: FloatArray = field(default_factory=NO_INNER.copy)


_OF_FINGERS = 2
"""Hands that fingers tell of which a frame's fits begin at: palm and back of an open hand."""


_ROUGH_STEP, _LEAST_TILE_PX = 2, 48
"""A search looks at every second pixel in both directions, but at all of a small observation."""


class Acquisition:
    """Looks for a hand without a prediction: of many hypotheses the best are fitted, roughly and then fully.

    Args:
        config: parameters.
        hand: the model.
        camera: of the depth images.
        thumb: what is expected of its thumb.

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
        self._step = _ROUGH_STEP if size >= _LEAST_TILE_PX else 1
        rough_px, terms = -(-size // self._step), fit_terms(config)
        self._rough = HandFitter(hand, camera, rough_px, terms, skin=hand.lean_with_arm, thumb=thumb)

    def search(self, depth: ImageArray, told: Sequence[Candidate] = ()) -> Candidate | None:
        """Return what is most like a hand in a whole image, if it fits well enough.

        Args:
            depth: (height, width) mm.
            told: further candidates, found otherwise.
        """
        likely = with_told([one for _, one in self._likely(depth, self.detect(depth))], told)
        fitting = [one for one in likely if one.cost <= ACCEPT_MM]
        return min(fitting, key=lambda one: one.doubt, default=None)

    def appraise(
        self, depth: ImageArray, places: Sequence[Detection], told: Sequence[Candidate] = ()
    ) -> tuple[float, list[Detection]]:
        """Return what the place most like a hand costs, mm, and which places it may be for another hand.

        The cost is the most there is where no place is like a hand.

        Args:
            depth: (height, width) mm.
            places: of ``detect``.
            told: further candidates, found otherwise.
        """
        found = self._likely(depth, places)
        candidates = with_told([one for _, one in found], told)
        if not candidates:
            return self._config.observation.clamp_mm, list(places)
        best = min(candidates, key=lambda one: one.doubt)
        near = [place for place, one in found if one.doubt < best.doubt + _ALIKE_MM]
        return min(best.cost, self._config.observation.clamp_mm), near or list(places)

    def detect(self, depth: ImageArray) -> list[Detection]:
        """Return the places in a whole image that may be hands.

        Of a hand that is larger or smaller than any, the depth is in another unit than mm: the image is then
        looked at as if it were of usual size.
        """
        low, high = _SIZES
        scale = self._hand.anatomy.scale
        unit = 1.0 if low <= scale <= high else scale
        image = depth if unit == 1.0 else depth / np.float32(unit)
        places = detect(image, self._camera, self._config.detection, self.observer.sampler)
        return places if unit == 1.0 else [place.enlarged(unit) for place in places]

    def _likely(self, depth: ImageArray, places: Sequence[Detection]) -> list[tuple[Detection, Candidate]]:
        """What is fitted to places that may be hands, but those that no cost could make the likeliest."""
        doubts = [_doubt_of(place) for place in places]
        least = min(doubts, default=0.0)
        near = [(d, place) for d, place in zip(doubts, places, strict=True) if d < least + _HOPELESS_MM]
        fitted = ((doubt, place, self._fitted(depth, place)) for doubt, place in near)
        found = [(p, replace(one, doubt=one.cost + doubt)) for doubt, p, one in fitted if one is not None]
        best = min((one.doubt for _, one in found), default=0.0)
        return [
            (place, self._settled(depth, one) if one.doubt < best + _CLOSE_MM else one)
            for place, one in found
        ]

    def _settled(self, depth: ImageArray, found: Candidate) -> Candidate:
        """A candidate, or what looks like it and costs less where it fits badly."""
        if found.cost <= self._config.status.sure_mm:
            return found
        other = self.reconsider(self.observer.observe(depth, found.pose), found.pose)
        if other is None or other.cost >= found.cost:
            return found
        return replace(other, doubt=found.doubt + other.cost - found.cost)

    def reconsider(self, observation: Observation, pose: FloatArray) -> Candidate | None:
        """Return the best fit to an observation among hands that look much like a pose (22,)."""
        if observation.target_pixels == 0:
            return None
        hypotheses = turned_poses(pose, self._hand.anatomy), self._of_fingers(observation)
        return self._best(observation, np.concatenate(hypotheses))

    def starts_of_fingers(self, observation: Observation) -> FloatArray:
        """Return the likeliest poses (K, 22) that extended fingers tell of: starts of a frame's fits."""
        poses, fitter = self._of_fingers(observation), self.local_fitter.fitter
        if not len(poses):
            return poses
        costs = fitter.costs(fitter.tile(observation), poses)
        return poses[np.argsort(costs, kind="stable")[:_OF_FINGERS]]

    def _of_fingers(self, observation: Observation) -> FloatArray:
        return poses_of_fingers(observation, self._hand.anatomy, self._camera)

    def _fitted(self, depth: ImageArray, detection: Detection) -> Candidate | None:
        observation = self.observer.observe_detection(depth, detection)
        if observation.target_pixels == 0:
            return None
        hypotheses = detected_poses(detection, self._hand.anatomy), self._of_fingers(observation)
        first = self._roughly(observation, np.concatenate(hypotheses))
        again = self.observer.observe(depth, first[0].pose)  # with the wrist where the fit has it
        if again.target_pixels == 0:
            return self._finished(observation, first)
        if again.reversed:
            return None
        return self._best(again, first[0].pose[None])

    def _best(self, observation: Observation, poses: FloatArray) -> Candidate:
        """The best fit among hypotheses (H, 22)."""
        return self._finished(observation, self._roughly(observation, poses))

    def _roughly(self, observation: Observation, poses: FloatArray) -> list[Fit]:
        """Fits to some pixels from the most different of the best hypotheses, refined; the best first."""
        settings, fitter = self._settings, self._rough
        tile = fitter.tile(observation.every(self._step))
        poses = fitter.aligned(tile, poses)
        starts = poses[distinct(poses, fitter.costs(tile, poses), settings.fitted)]
        fits = self._descended(fitter, tile, starts[None])
        rng, none = np.random.default_rng(_SCATTER_SEED), np.empty((0, POSE_SIZE))
        around = np.array(
            [
                fit_starts(fit.pose, none, settings.scattered, self._space, rng, ahead=True)
                for fit in _most_different(fits, settings.refined)
            ]
        )
        aligned = fitter.aligned(tile, around.reshape(-1, POSE_SIZE)).reshape(around.shape)
        fits += self._descended(fitter, tile, aligned)
        return _most_different(fits, settings.finished)

    def _finished(self, observation: Observation, rough: Sequence[Fit]) -> Candidate:
        """The best of rough fits once they are fitted to all pixels."""
        fitter, poses = self.local_fitter.fitter, np.array([fit.pose for fit in rough])
        fits = self._descended(fitter, fitter.tile(observation), poses[None])
        best = min(fits, key=_cost)
        return Candidate(best.pose.copy(), _cost(best), inner=best.inner.copy())

    def _descended(self, fitter: HandFitter, tile: Tile, groups: FloatArray) -> list[Fit]:
        """Fits from groups of starts (G, K, 22), and from the best of each with fingers of its others."""
        size = groups.shape[1]
        fits = self._freely(fitter, tile, groups.reshape(-1, POSE_SIZE))
        parts = [fits[first : first + size] for first in range(0, len(fits), size)]
        likeliest = [sorted(part, key=_cost)[:SWAPPED] for part in parts]
        return fits + self._freely(fitter, tile, fitter.swapped(tile, likeliest))

    def _freely(self, fitter: HandFitter, tile: Tile, starts: FloatArray) -> list[Fit]:
        """Fits from starts (K, 22), each with a wide prior about itself."""
        priors = [PosePrior(start, _FREE_PRECISION) for start in starts]
        return fitter.descend(tile, starts, priors, ITERATIONS)


def _cost(fit: Fit) -> float:
    return float(fit.cost[0])


def _most_different(fits: Sequence[Fit], count: int) -> list[Fit]:
    """The best fits that differ (``distinct``), the best first."""
    poses, costs = np.array([fit.pose for fit in fits]), np.array([_cost(fit) for fit in fits])
    return [fits[k] for k in distinct(poses, costs, count)]


def better_of(first: Candidate | None, second: Candidate | None) -> Candidate | None:
    """The candidate that costs less, if there is any."""
    both = [candidate for candidate in (first, second) if candidate is not None]
    return min(both, key=lambda candidate: candidate.cost, default=None)


def with_told(found: Sequence[Candidate], told: Sequence[Candidate]) -> list[Candidate]:
    """Candidates and those that were told; of two at one place the cheaper pose, and the lesser doubt."""
    merged = list(found)
    for one in told:
        near = [
            k
            for k, other in enumerate(merged)
            if np.linalg.norm(other.pose[:3] - one.pose[:3]) < _ONE_PLACE_MM
        ]
        for k in near:
            best = one if one.cost < merged[k].cost else merged[k]
            merged[k] = replace(best, doubt=min(one.doubt, merged[k].doubt))
        merged += [] if near else [one]
    return merged


def distinct(poses: FloatArray, costs: FloatArray, count: int) -> list[int]:
    """Return the best of poses (H, 22) that differ in rotation or shape, then the best of the rest."""
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
