"""What keypoints tell a tracker: poses near the track, hands at other places, and the likelier side.

**[ours]** None of it is believed. A pose is one more start of a frame's fits, and costs there what the image
says; a hand at another place competes with those that a search finds, some millimetres of cost ahead; labels
of sides move the odds by a bounded amount, less than what makes a side certain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.anatomy_terms import RELAXED
from posetrack_cli.hand.fit.fitter import PosePrior
from posetrack_cli.hand.fit.local_fits import NOT_TOLD, TOLD_PRECISION
from posetrack_cli.hand.fit.points import PlaceFitter, PlacesToFit, lay_on
from posetrack_cli.hand.keypoints.file import UNSURE, KeypointFile
from posetrack_cli.hand.keypoints.places import places_in_image, places_in_space
from posetrack_cli.hand.model.anatomy import ANGLES, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.model.kinematics import joint_positions, mean_joint_distances
from posetrack_cli.hand.search import ACCEPT_MM, Acquisition, Candidate, depth_doubt, fingers_bonus
from posetrack_cli.recording.base import Frame

MOST_HANDS = 4
"""Sets of one frame that are looked at, those of the highest scores."""
NEAR_MM = 80.0
"""Mean distance of the joints up to which a set is of the hand that is tracked, and a start of its fits."""
_OPEN, _BENT = 0.0, 2.5
"""Shapes that fits begin with, in relaxed angles."""
_PALM = (0, 1, 5, 9, 13, 17)
_LEAST_EXTENT_MM = 8.0  # a fifth of a palm's; a hand can be folded up about a single spot
_OFF_SD, _LEAST_ON = 3.0, 0.6
"""A point is off from so many standard deviations on; a set with fewer points on a hand is of none."""
_TOLD_MM = 2.0
"""What being told is worth, mm of cost: less than the fingers of a hand that are seen (``fingers_bonus``)."""
_ITERATIONS_THERE = 8
_A_FRAME, _IN_ALL, _UNSURE_LABELS, _PER_SHARE = 0.8, 2.2, 0.8, 6.0
"""Log odds of a side by keypoints, at most: detectors err in one frame of three at worst (.69), in a whole
recording alike: one in ten is labelled the wrong way round by convention (.9), and three in ten where
versions of one program differ (.69). And what one more share of points on a hand is worth."""


@dataclass(frozen=True, eq=False)
class ToldHand:
    """A hand that keypoints tell of.

    Attributes:
        pose: (22,) fitted to them.
        right: probability that it is said to be a right one; NaN where nothing is said.
        score: mean of its points'.
    """

    pose: FloatArray
    right: float
    score: float


def pose_of_places(about: PlacesToFit, anatomy: HandAnatomy) -> tuple[FloatArray, float] | None:
    """Return the pose (22,) of a hand whose joints are at places, and the share of these that it is on.

    None where no palm can be laid on them.
    """
    palm = np.array(_PALM)[about.precision[list(_PALM), 0] > 0.0]
    known = palm if len(palm) >= 4 else np.flatnonzero(about.precision[:, 0] > 0.0)
    if len(known) < 4 or _extent(about.places[known]) < _LEAST_EXTENT_MM:
        return None
    fitter = PlaceFitter(anatomy, all_told=True)
    found: list[tuple[float, FloatArray]] = []
    weights = about.precision[:, 0] / about.precision[:, 0].sum()
    for bend in (_OPEN, _BENT):
        pose = _laid_on(about, known, anatomy, bend)
        fitter.fit(about, pose)
        off = fitter.misfits(about, pose)
        if np.isfinite(pose).all():
            found.append((float(weights @ (off < _OFF_SD) - weights @ np.minimum(off, 10.0) * 1e-2), pose))
    if not found:
        return None
    pose = max(found, key=lambda one: one[0])[1]
    return pose, float(weights @ (fitter.misfits(about, pose) < _OFF_SD))


def _extent(places: FloatArray) -> float:
    """How far places (K, 3) lie from their mean, rms, mm."""
    return float(np.sqrt(np.square(places - places.mean(axis=0)).sum(axis=1).mean()))


def _laid_on(about: PlacesToFit, known: IntArray, anatomy: HandAnatomy, bend: float) -> FloatArray:
    """The pose (22,) of a hand of one shape that is laid on places as well as a rigid one can be."""
    pose = np.zeros(POSE_SIZE)
    pose[6] = 1.0
    pose[ANGLES] = bend * RELAXED
    lay_on(about, known, joint_positions(anatomy, pose[None])[0], pose)
    return pose


class ToldHands:
    """What keypoints tell of the frames of a recording, for one hand.

    Args:
        keypoints: the file.
        camera: of the depth images.
        anatomy: the hand that is fitted to them.
    """

    def __init__(self, keypoints: KeypointFile, camera: Camera, anatomy: HandAnatomy) -> None:
        self._file, self._camera, self._anatomy = keypoints, camera, anatomy

    def of(self, frame: Frame) -> tuple[ToldHand, ...]:
        """Return the hands that a frame's sets tell of; what is like no hand is left out."""
        sets = self._file.sets
        rows = sets.of(frame.index, frame.stamp_ns)
        best = rows.start + np.argsort(-sets.scores[rows].mean(axis=1), kind="stable")[:MOST_HANDS]
        return tuple(hand for k in best if (hand := self._hand(frame.depth, int(k))) is not None)

    def shares(self, frame: Frame) -> list[float]:
        """Return for each of a frame's sets which share of its points lies on the hand."""
        sets = self._file.sets
        rows = range(*sets.of(frame.index, frame.stamp_ns).indices(len(sets)))
        fitted = (self._fitted(frame.depth, k) for k in rows)
        return [one[1] for one in fitted if one is not None]

    def _hand(self, depth: ImageArray, k: int) -> ToldHand | None:
        fitted = self._fitted(depth, k)
        if fitted is None or fitted[1] < _LEAST_ON:
            return None
        sets = self._file.sets
        known = np.isfinite(sets.points[k, :, 0])
        return ToldHand(fitted[0], float(sets.right[k]), float(sets.scores[k][known].mean()))

    def _fitted(self, depth: ImageArray, k: int) -> tuple[FloatArray, float] | None:
        """The pose (22,) of a set, and the share of its points that is on it."""
        points, scores = self._file.sets.points[k], self._file.sets.scores[k]
        if self._file.in_pixels:
            about = places_in_image(points[:, :2], scores, depth, self._camera, self._anatomy)
        else:
            about = places_in_space(points, scores)
        return None if about is None else pose_of_places(about, self._anatomy)


def split(
    hands: Sequence[ToldHand], pose: FloatArray, anatomy: HandAnatomy
) -> tuple[FloatArray, tuple[ToldHand, ...]]:
    """Return the poses (K, 22) of hands near a pose (22,), and the hands elsewhere."""
    if not hands:
        return NOT_TOLD, ()
    apart = mean_joint_distances(anatomy, pose, np.array([hand.pose for hand in hands]))
    near = [hand.pose for hand, mm in zip(hands, apart, strict=True) if mm < NEAR_MM]
    elsewhere = tuple(hand for hand, mm in zip(hands, apart, strict=True) if mm >= NEAR_MM)
    return np.array(near).reshape(-1, POSE_SIZE), elsewhere


def candidates(finder: Acquisition, depth: ImageArray, hands: Sequence[ToldHand]) -> list[Candidate]:
    """Return what hands cost in an image (height, width), mm, once they are fitted to it."""
    found = (_candidate(finder, depth, hand) for hand in hands)
    return [one for one in found if one is not None]


def told_candidates(
    keypoints: KeypointFile | None, camera: Camera, finder: Acquisition, frame: Frame
) -> list[Candidate]:
    """Return the candidates that keypoints tell of in a frame, for the hand that is searched for."""
    if keypoints is None:
        return []
    hands = ToldHands(keypoints, camera, finder.observer.anatomy).of(frame)
    return candidates(finder, frame.depth, hands)


def likeliest(found: Sequence[Candidate], most_mm: float = np.inf) -> Candidate | None:
    """Return the candidate against which least speaks, of those that cost no more than a limit."""
    return min((one for one in found if one.cost <= most_mm), key=lambda one: one.doubt, default=None)


def _candidate(finder: Acquisition, depth: ImageArray, hand: ToldHand) -> Candidate | None:
    observation = finder.observer.observe(depth, hand.pose)
    if observation.target_pixels == 0 or observation.reversed:
        return None
    fitter = finder.local_fitter.fitter
    tile = fitter.tile(observation)
    starts = np.concatenate([hand.pose[None], fitter.aligned(tile, hand.pose[None])])
    fits = fitter.descend(
        tile, starts, [PosePrior(start, TOLD_PRECISION) for start in starts], _ITERATIONS_THERE
    )
    best = min(fits, key=lambda fit: float(fit.cost[0]))
    # where the fit went the limb may go on beyond the fingers, or more of it may be left uncovered
    there = finder.observer.observe(depth, best.pose)
    if there.target_pixels == 0 or there.reversed:
        return None
    cost = max(float(best.cost[0]), float(fitter.assessed(fitter.tile(there), best.pose).cost[0]))
    if cost > ACCEPT_MM:
        return None
    fingers = fingers_bonus(finder.observer.fingers_mm2(observation))
    worth = _worth(hand, is_left=finder.observer.anatomy.is_left)
    return Candidate(best.pose.copy(), cost, cost - fingers + depth_doubt(float(best.pose[2])) - worth)


def _worth(hand: ToldHand, *, is_left: bool) -> float:
    """What being told of a hand is worth, mm of cost; against it where it is said to be of the other side."""
    ours = 1.0 if np.isnan(hand.right) else (1.0 - hand.right if is_left else hand.right)
    return _TOLD_MM * hand.score * (2.0 * ours - 1.0)


class ToldSide:
    """The log odds of a right hand by the labels and the points of frames, bounded.

    Points in space lie better on a hand of their own side than on its mirror image: with o the share of them
    that is on the hand a frame tells ``_PER_SHARE`` (o_right - o_left), at most ``_A_FRAME``, as labels do.

    Args:
        keypoints: the file; None for none, which tells nothing.
        camera: of the depth images.
    """

    def __init__(self, keypoints: KeypointFile | None, camera: Camera) -> None:
        self._file, self._camera = keypoints, camera
        self._by_labels = self._by_points = 0.0

    def ask(self, frame: Frame, right: HandAnatomy, left: HandAnatomy) -> None:
        """Add what a frame tells; nothing where its labels contradict each other, as those of two hands do.

        Args:
            frame: with the depth image.
            right, left: a hand of either side.
        """
        if self._file is None:
            return
        rows = self._file.sets.of(frame.index, frame.stamp_ns)
        said = self._file.sets.right[rows]
        said = said[np.isfinite(said)]
        if said.size and ((said > 0.5).all() or (said < 0.5).all()):
            odds = np.log((said + 1e-3) / (1.0 - said + 1e-3))
            self._by_labels += float(np.clip(odds[np.argmin(np.abs(odds))], -_A_FRAME, _A_FRAME))
        if rows.stop - rows.start == 1:
            hands = (ToldHands(self._file, self._camera, anatomy) for anatomy in (right, left))
            shares = [share for told in hands for share in told.shares(frame)]
            if len(shares) == 2 and max(shares) >= _LEAST_ON:
                self._by_points += float(np.clip(_PER_SHARE * (shares[0] - shares[1]), -_A_FRAME, _A_FRAME))

    @property
    def log_odds(self) -> float:
        """Of a right hand."""
        unsure = self._file is not None and self._file.sides == UNSURE
        most = _UNSURE_LABELS if unsure else _IN_ALL
        by_labels = float(np.clip(self._by_labels, -most, most))
        return float(np.clip(by_labels + self._by_points, -_IN_ALL, _IN_ALL))
