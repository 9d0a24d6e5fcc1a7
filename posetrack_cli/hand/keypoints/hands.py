"""Hypotheses from keypoints: poses near the track, hands at other places, and the likelier side.

**[ours]** Keypoints only add hypotheses; each is scored against the depth image. A pose near the track is one
more start of a frame's fits. A hand elsewhere competes with the candidates of a search, with a small bonus.
Side labels change the log odds by a bounded amount, less than a certain side needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.anatomy_terms import RELAXED
from posetrack_cli.hand.fit.fitter import PosePrior
from posetrack_cli.hand.fit.local_fits import KEYPOINT_PRECISION, NO_EXTRA_STARTS
from posetrack_cli.hand.fit.points import JointTargets, TargetFitter, align_rigidly
from posetrack_cli.hand.keypoints.file import UNSURE, KeypointFile
from posetrack_cli.hand.keypoints.targets import targets_in_image, targets_in_space
from posetrack_cli.hand.model.anatomy import ANGLES, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.model.kinematics import joint_positions, mean_joint_distances
from posetrack_cli.hand.search import ACCEPT_MM, Acquisition, Candidate, depth_penalty, finger_bonus
from posetrack_cli.recording.base import Frame

MAX_HANDS = 4
"""Point sets per frame that are used, by score."""
NEAR_MM = 80.0
"""Mean joint distance up to which a set belongs to the tracked hand and gives a start of its fits."""
_EXTENDED, _BENT = 0.0, 2.5  # start shapes, as multiples of the relaxed angles
_PALM = (0, 1, 5, 9, 13, 17)
_MIN_EXTENT_MM = 8.0  # a fifth of a palm; points closer together fit a crumpled hand
_FAR_SD, _MIN_SHARE = 3.0, 0.6  # misfit of an outlier, and share of inliers a hand needs
_KEYPOINT_BONUS_MM = 2.0
"""Bonus of a candidate from keypoints, mm of cost: less than visible fingers are worth (``finger_bonus``)."""
_ITERATIONS = 8
_MAX_PER_FRAME, _MAX_TOTAL, _MAX_UNSURE = 0.8, 2.2, 0.8
"""Bounds on the log odds of a side from keypoints **[ours]**.

A detector mislabels at most one frame in three (p = .69). Over a recording its errors are systematic: one in
ten recordings uses the opposite convention (.9), three in ten where versions of one program differ (.69).
"""
_PER_SHARE = 6.0  # log odds for a difference of 1 in the share of points on the hand


@dataclass(frozen=True, eq=False)
class KeypointHand:
    """A hand fitted to keypoints.

    Attributes:
        pose: (22,) fitted pose.
        right: probability of a right hand by its label; NaN without one.
        score: mean score of its points.
    """

    pose: FloatArray
    right: float
    score: float


def fit_to_targets(targets: JointTargets, anatomy: HandAnatomy) -> tuple[FloatArray, float] | None:
    """Return the pose (22,) that fits joint targets, and the weighted share of targets it meets.

    None if the targets do not determine a palm.
    """
    palm = np.array(_PALM)[targets.precision[list(_PALM), 0] > 0.0]
    known = palm if len(palm) >= 4 else np.flatnonzero(targets.precision[:, 0] > 0.0)
    if len(known) < 4 or _extent(targets.positions[known]) < _MIN_EXTENT_MM:
        return None
    fitter = TargetFitter(anatomy, all_known=True)
    found: list[tuple[float, FloatArray]] = []
    weights = targets.precision[:, 0] / targets.precision[:, 0].sum()
    for bend in (_EXTENDED, _BENT):
        pose = _rigid_start(targets, known, anatomy, bend)
        fitter.fit(targets, pose)
        off = fitter.misfits(targets, pose)
        if np.isfinite(pose).all():
            found.append((float(weights @ (off < _FAR_SD) - weights @ np.minimum(off, 10.0) * 1e-2), pose))
    if not found:
        return None
    pose = max(found, key=lambda one: one[0])[1]
    return pose, float(weights @ (fitter.misfits(targets, pose) < _FAR_SD))


def _extent(places: FloatArray) -> float:
    """Return the rms distance of points (K, 3) from their mean, mm."""
    return float(np.sqrt(np.square(places - places.mean(axis=0)).sum(axis=1).mean()))


def _rigid_start(targets: JointTargets, known: IntArray, anatomy: HandAnatomy, bend: float) -> FloatArray:
    """Return a pose (22,) of fixed shape, aligned rigidly with the targets."""
    pose = np.zeros(POSE_SIZE)
    pose[6] = 1.0
    pose[ANGLES] = bend * RELAXED
    align_rigidly(targets, known, joint_positions(anatomy, pose[None])[0], pose)
    return pose


class KeypointHands:
    """Hands fitted to a recording's keypoints, for one hand model.

    Args:
        keypoints: the file.
        camera: of the depth images.
        anatomy: the hand that is fitted.
        alone: whether no other hand is tracked; else sets that are surely the other side's are left out.
    """

    def __init__(
        self, keypoints: KeypointFile, camera: Camera, anatomy: HandAnatomy, *, alone: bool = True
    ) -> None:
        self._file, self._camera, self._anatomy = keypoints, camera, anatomy
        self._trusts_labels = not alone and keypoints.sides != UNSURE

    def of(self, frame: Frame) -> tuple[KeypointHand, ...]:
        """Return the hands fitted to a frame's sets, without sets that fit no hand."""
        sets = self._file.sets
        rows = sets.of(frame.index, frame.stamp_ns)
        best = rows.start + np.argsort(-sets.scores[rows].mean(axis=1), kind="stable")[:MAX_HANDS]
        if self._trusts_labels:
            best = best[~(sets.right[best] > 0.5 if self._anatomy.is_left else sets.right[best] < 0.5)]
        return tuple(hand for k in best if (hand := self._hand(frame.depth, int(k))) is not None)

    def shares(self, frame: Frame) -> list[float]:
        """Return the share of points on the fitted hand, for each of a frame's sets."""
        sets = self._file.sets
        rows = range(*sets.of(frame.index, frame.stamp_ns).indices(len(sets)))
        fitted = (self._fitted(frame.depth, k) for k in rows)
        return [one[1] for one in fitted if one is not None]

    def _hand(self, depth: ImageArray, k: int) -> KeypointHand | None:
        fitted = self._fitted(depth, k)
        if fitted is None or fitted[1] < _MIN_SHARE:
            return None
        sets = self._file.sets
        known = np.isfinite(sets.points[k, :, 0])
        return KeypointHand(fitted[0], float(sets.right[k]), float(sets.scores[k][known].mean()))

    def _fitted(self, depth: ImageArray, k: int) -> tuple[FloatArray, float] | None:
        """Return the pose (22,) fitted to a set, and the share of its points on it."""
        points, scores = self._file.sets.points[k], self._file.sets.scores[k]
        if self._file.in_pixels:
            targets = targets_in_image(points[:, :2], scores, depth, self._camera, self._anatomy)
        else:
            targets = targets_in_space(points, scores)
        return None if targets is None else fit_to_targets(targets, self._anatomy)


def split_by_distance(
    hands: Sequence[KeypointHand], pose: FloatArray, anatomy: HandAnatomy
) -> tuple[FloatArray, tuple[KeypointHand, ...]]:
    """Return the poses (K, 22) of hands near a pose (22,), and the hands elsewhere."""
    if not hands:
        return NO_EXTRA_STARTS, ()
    apart = mean_joint_distances(anatomy, pose, np.array([hand.pose for hand in hands]))
    near = [hand.pose for hand, mm in zip(hands, apart, strict=True) if mm < NEAR_MM]
    elsewhere = tuple(hand for hand, mm in zip(hands, apart, strict=True) if mm >= NEAR_MM)
    return np.array(near).reshape(-1, POSE_SIZE), elsewhere


def fit_candidates(finder: Acquisition, depth: ImageArray, hands: Sequence[KeypointHand]) -> list[Candidate]:
    """Fit hands to a depth image (height, width), mm, and return those it supports."""
    found = (_fit_candidate(finder, depth, hand) for hand in hands)
    return [one for one in found if one is not None]


def keypoint_candidates(
    keypoints: KeypointFile | None, camera: Camera, finder: Acquisition, frame: Frame
) -> list[Candidate]:
    """Return the candidates from a frame's keypoints, for the finder's hand."""
    if keypoints is None:
        return []
    hands = KeypointHands(keypoints, camera, finder.observer.anatomy).of(frame)
    return fit_candidates(finder, frame.depth, hands)


def best_candidate(found: Sequence[Candidate], most_mm: float = np.inf) -> Candidate | None:
    """Return the candidate of least total cost among those whose cost is within a limit."""
    return min((one for one in found if one.cost <= most_mm), key=lambda one: one.total_cost, default=None)


def _fit_candidate(finder: Acquisition, depth: ImageArray, hand: KeypointHand) -> Candidate | None:
    observation = finder.observer.observe(depth, hand.pose)
    if observation.target_pixels == 0 or observation.reversed:
        return None
    fitter = finder.local_fitter.fitter
    tile = fitter.tile(observation)
    starts = np.concatenate([hand.pose[None], fitter.aligned(tile, hand.pose[None])])
    fits = fitter.descend(
        tile, starts, [PosePrior(start, KEYPOINT_PRECISION) for start in starts], _ITERATIONS
    )
    best = min(fits, key=lambda fit: float(fit.cost[0]))
    # at the fitted pose the limb may continue beyond the fingers, or more of it may be uncovered
    refit = finder.observer.observe(depth, best.pose)
    if refit.target_pixels == 0 or refit.reversed:
        return None
    cost = max(float(best.cost[0]), float(fitter.assessed(fitter.tile(refit), best.pose).cost[0]))
    if cost > ACCEPT_MM:
        return None
    fingers = finger_bonus(finder.observer.fingers_mm2(observation))
    bonus = _bonus(hand, is_left=finder.observer.anatomy.is_left)
    return Candidate(best.pose.copy(), cost, cost - fingers + depth_penalty(float(best.pose[2])) - bonus)


def _bonus(hand: KeypointHand, *, is_left: bool) -> float:
    """Return the bonus of a candidate, mm of cost; negative if its label is the other side."""
    ours = 1.0 if np.isnan(hand.right) else (1.0 - hand.right if is_left else hand.right)
    return _KEYPOINT_BONUS_MM * hand.score * (2.0 * ours - 1.0)


class KeypointSide:
    """Bounded log odds of a right hand from the labels and points of frames.

    Points in space fit a hand of their own side better than its mirror image: with o the share of points on
    the hand, a frame adds ``_PER_SHARE`` (o_right - o_left), bounded by ``_MAX_PER_FRAME`` like a label.

    Args:
        keypoints: the file; without one the log odds stay 0.
        camera: of the depth images.
    """

    def __init__(self, keypoints: KeypointFile | None, camera: Camera) -> None:
        self._file, self._camera = keypoints, camera
        self._by_labels = self._by_points = 0.0

    def add_frame(self, frame: Frame, right: HandAnatomy, left: HandAnatomy) -> None:
        """Add a frame's evidence; contradicting labels, as of two hands, are ignored.

        Args:
            frame: with the depth image.
            right, left: the hand model of either side.
        """
        if self._file is None:
            return
        rows = self._file.sets.of(frame.index, frame.stamp_ns)
        labels = self._file.sets.right[rows]
        labels = labels[np.isfinite(labels)]
        if labels.size and ((labels > 0.5).all() or (labels < 0.5).all()):
            odds = np.log((labels + 1e-3) / (1.0 - labels + 1e-3))
            self._by_labels += float(np.clip(odds[np.argmin(np.abs(odds))], -_MAX_PER_FRAME, _MAX_PER_FRAME))
        if rows.stop - rows.start == 1:
            hands = (KeypointHands(self._file, self._camera, anatomy) for anatomy in (right, left))
            shares = [share for fitted in hands for share in fitted.shares(frame)]
            if len(shares) == 2 and max(shares) >= _MIN_SHARE:
                self._by_points += float(
                    np.clip(_PER_SHARE * (shares[0] - shares[1]), -_MAX_PER_FRAME, _MAX_PER_FRAME)
                )

    @property
    def log_odds(self) -> float:
        """Return the log odds of a right hand."""
        unsure = self._file is not None and self._file.sides == UNSURE
        most = _MAX_UNSURE if unsure else _MAX_TOTAL
        by_labels = float(np.clip(self._by_labels, -most, most))
        return float(np.clip(by_labels + self._by_points, -_MAX_TOTAL, _MAX_TOTAL))
