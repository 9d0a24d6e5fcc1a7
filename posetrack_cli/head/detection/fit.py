"""Fits of a face to response maps: its pose, and its points jointly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.head.detection.appearance import Appearance, histograms
from posetrack_cli.head.detection.responses import MIDDLE, PIXELS_PER_MM
from posetrack_cli.head.face.points import FEATURES, FITTED, FITTED_NORMALS, MOUTH, POINT_COUNT

# Fit of a mean face to response maps **[ours]**.
#
# The projection is weak perspective. A pose has eight numbers: u, v (patch pixels of the head's origin),
# scale (pixels per mm), roll, yaw, pitch (rad, about the camera's z, y and x axes), and how much higher and
# wider than on an average face the mouth is, mm. A fixed cloud of poses is scored on the maps; the best poses
# become the centres of smaller clouds. The scores of turned heads leave out points on the far side.

IN_CAMERA = np.array([1.0, -1.0, -1.0])
"""The head's axes in camera axes, for a head that looks at the camera."""
POSE_SIZE = 8
PRIOR_MEAN = np.array([MIDDLE[0], MIDDLE[1], PIXELS_PER_MM, 0.0, 0.0, 0.0, 0.0, 0.0])
PRIOR_SD = np.array([4.0, 5.0, 0.09 * PIXELS_PER_MM, 0.18, 0.45, 0.25, 5.0, 3.0])
WEIGHTS = np.array([1.0, 1.0, 1.0, 1.0, 1.2, 1.2, 0.7, 0.7, 0.6, 0.6, 3.0])
HIDDEN_RESPONSE = 0.35
"""Response assumed of a hidden point, that of a moderate match."""
VISIBLE_FROM, VISIBLE_TO = 0.1, 0.4
"""Cosine between normal and view from which a point counts, and above which it counts fully."""
MOST_YAW = np.radians(60.0)
"""Beyond, too few points remain."""
# Added to responses, so that a single missing point cannot veto a pose.
LEAST_RESPONSE = 0.1
# Standard deviations of detected eyes, pixels of the patch, and the likelihood of a false detection.
EYE_SD = np.array([6.0, 3.0])
EYE_DOUBT = 0.05
FIRST_CLOUD = 3000
KEPT, CHILDREN = 20, 30
NARROWING = (0.4, 0.2, 0.1)


def projected(poses: FloatArray, shape: FloatArray = FITTED) -> FloatArray:
    """Project points (L, 3), mm, to patch pixels (N, L, 2) under poses (N, 8)."""
    rows = poses[:, 2, None, None] * (rotations_of(poses[:, 3:6]) * IN_CAMERA)[:, :2]
    pixels: FloatArray = np.einsum("nij,kj->nki", rows, shape) + poses[:, None, :2]
    up, out = rows[:, :, 1] * poses[:, 6, None], rows[:, :, 0] * poses[:, 7, None]
    pixels[:, MOUTH] += np.stack([up - out, up + out], axis=1)
    return pixels


def relief_of(angles: FloatArray, shape: FloatArray = FEATURES) -> FloatArray:
    """Return the depth (K,), mm, of each point relative to the head's origin.

    Args:
        angles: (3,) roll, yaw, pitch, rad.
        shape: (K, 3) mm in the head's frame.
    """
    relief: FloatArray = shape @ (rotations_of(angles[None]) * IN_CAMERA)[0, 2]
    return relief


def visible_shares(yaw: FloatArray) -> FloatArray:
    """Return the visibility (N, K + 1), 0 to 1, of the points of ``FITTED`` on heads with a yaw (N,), rad."""
    yaw = np.clip(yaw, -MOST_YAW, MOST_YAW)
    across, out = FITTED_NORMALS[:, 0], FITTED_NORMALS[:, 2]
    cosines = np.cos(yaw)[:, None] * out + np.sin(yaw)[:, None] * across
    shares: FloatArray = np.clip((cosines - VISIBLE_FROM) / (VISIBLE_TO - VISIBLE_FROM), 0.0, 1.0)
    return shares


def fit_face(
    maps: Float32Array,
    eyes: tuple[FloatArray, FloatArray],
    start: FloatArray | None = None,
    yaw: float = 0.0,
) -> FloatArray:
    """Return the pose (8,) that fits response maps (K + 1, height, width) best.

    Args:
        maps: one map per feature of ``FITTED``.
        eyes: (n, 2) patch pixels of candidate eye centres, right and left; empty if unknown.
        start: (8,) a pose near which to search; by default the whole prior is searched.
        yaw: rad, mean of the prior; points on the far side of a turned head are ignored.
    """
    coarse, fine = _blurred(maps, 5, 2.0), _blurred(maps, 3, 1.0)
    if start is None:
        poses = PRIOR_MEAN + PRIOR_SD * _normal(FIRST_CLOUD)
        poses[:, 4] += yaw
        scores = _scores(poses, coarse, eyes, yaw)
    else:
        poses, scores = start[None], _scores(start[None], fine, eyes, yaw)
    for narrowing in NARROWING:
        best = poses[np.argsort(-scores, kind="stable")[:KEPT]]
        cloud = narrowing * PRIOR_SD * _normal(len(best) * CHILDREN)
        poses = np.concatenate([best, np.repeat(best, CHILDREN, axis=0) + cloud])
        scores = _scores(poses, fine, eyes, yaw)
    pose: FloatArray = poses[np.argmax(scores)]
    return pose


def _scores(
    poses: FloatArray, maps: Float32Array, eyes: tuple[FloatArray, FloatArray], yaw: float
) -> FloatArray:
    """Return (N,) log-scores: weighted log responses, detected eyes and half the log-prior."""
    pixels = projected(poses)
    height, width = maps.shape[1:]
    columns = np.clip(np.rint(pixels[..., 0]).astype(int), 0, width - 1)
    rows = np.clip(np.rint(pixels[..., 1]).astype(int), 0, height - 1)
    responses = maps[np.arange(len(maps)), rows, columns]
    mean = PRIOR_MEAN + yaw * (np.arange(POSE_SIZE) == 4)
    prior = -0.5 * np.sum(((poses - mean) / PRIOR_SD) ** 2, axis=1)
    if yaw:
        responses = HIDDEN_RESPONSE + visible_shares(poses[:, 4]) * (responses - HIDDEN_RESPONSE)
    scores: FloatArray = np.log(LEAST_RESPONSE + responses) @ WEIGHTS + 0.5 * prior
    for found, centres in zip(eyes, (pixels[:, 0:2].mean(axis=1), pixels[:, 2:4].mean(axis=1)), strict=True):
        scores = scores + 0.5 * _eye_score(centres, found)
    return scores


def _eye_score(centres: FloatArray, found: FloatArray) -> FloatArray:
    """Return (N,) log-likelihoods of eye centres (N, 2) given the nearest detected one (n, 2)."""
    if not len(found):
        return np.zeros(len(centres))
    squares: FloatArray = np.sum(((centres[:, None] - found) / EYE_SD) ** 2, axis=2).min(axis=1)
    score: FloatArray = np.log(np.maximum(np.exp(-0.5 * squares), EYE_DOUBT))
    return score


def _blurred(maps: Float32Array, spread: int, sigma: float) -> Float32Array:
    """Widen every peak, so that nearby poses score as well."""
    box = np.ones((spread, spread), np.uint8)
    return np.stack([cv2.GaussianBlur(cv2.dilate(one, box), (0, 0), sigma) for one in maps])


@cache
def _normal(count: int) -> FloatArray:
    """Return (count, POSE_SIZE) fixed standard normal numbers: initialisation must be deterministic."""
    numbers = np.random.default_rng(0).normal(size=(count, POSE_SIZE))
    numbers.setflags(write=False)
    return numbers


def rotations_of(angles: FloatArray) -> FloatArray:
    """Return Rz(roll) Ry(yaw) Rx(pitch), (N, 3, 3), of angles (N, 3) rad."""
    (cz, cy, cx), (sz, sy, sx) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


# Joint localisation of the ten points **[ours]**.
#
# Each point's log-odds near its expected place define a distribution over pixels. A face shape, the average
# with modes of variation, is fitted to the means of these distributions, each narrowed about the shape's
# current point (regularised landmark mean shift: Saragih, Lucey and Cohn 2011). The shape prevents single
# points from moving to similar-looking places.

REACH = 15
"""Search radius about the expected place, pixels of the patch."""
WIDTHS = (5.0, 3.5, 2.5, 1.8)
"""Standard deviations, pixels, of a point about the shape's: one round each, with two steps of the shape."""
STEPS = 2
BACKGROUND = -1.0
"""Log-odds, at every pixel, of a hidden or atypical point."""
UNSURE_PX = 1.0
"""Standard deviation of the mean of a distribution."""
JOINT_POSE_SIZE = 6
LEAST_VISIBLE = 0.05
VISIBLE = np.ones(POINT_COUNT)
"""(K,) visibility of the points of a head that looks at the camera."""
TURN_PRIOR = np.array([0.45, 0.3])
"""Standard deviations, rad, of yaw and pitch."""
STEP = 1e-4


@dataclass(frozen=True, eq=False)
class JointFit:
    """Jointly located points of a face.

    Attributes:
        pixels: (K, 2) in the patch.
        probabilities: (K,) that the best place nearby is the point.
        pose: (6,) u, v, scale (pixels per mm), roll, yaw, pitch of the shape.
        misfit_px: RMS distance of the places from the shape's.
    """

    pixels: FloatArray
    probabilities: FloatArray
    pose: FloatArray
    misfit_px: float


def fit_jointly(
    grey: ImageArray,
    expected: FloatArray,
    pose: FloatArray,
    appearance: Appearance,
    visible: FloatArray = VISIBLE,
) -> JointFit:
    """Locate the points in an upright patch.

    Args:
        grey: (height, width) uint8.
        expected: (K, 2) pixels, approximate.
        pose: (6,) of an average face there: u, v, scale, roll, yaw, pitch.
        appearance: appearance model.
        visible: (K,) 0 to 1; hidden points follow the others.
    """
    picture = histograms(grey)
    windows = [_Window.about(picture, k, place, appearance) for k, place in enumerate(expected)]
    return _mean_shift(windows, expected, pose, appearance, visible)


def _mean_shift(
    windows: Sequence[_Window],
    expected: FloatArray,
    pose: FloatArray,
    appearance: Appearance,
    visible: FloatArray,
) -> JointFit:
    """Iterate means and shape from a start."""
    shape = _Shape(
        np.array(pose, dtype=np.float64), np.zeros(len(appearance.shape_modes)), appearance.shape_modes
    )
    unseen = 1.0 / np.maximum(visible, LEAST_VISIBLE)
    shape = shape.fitted(expected, np.full(POINT_COUNT, WIDTHS[0]))
    places = expected
    for width in WIDTHS:
        for _ in range(STEPS):
            means = [window.mean(at, width) for window, at in zip(windows, shape.points, strict=True)]
            places = np.array([mean for mean, _ in means])
            doubt = np.array([share for _, share in means])
            shape = shape.fitted(places, unseen * np.hypot(UNSURE_PX, width * doubt))
    best = np.array([window.best(at, WIDTHS[-1]) for window, at in zip(windows, shape.points, strict=True)])
    misfit = float(np.sqrt(np.mean(np.sum((places - shape.points) ** 2, axis=1))))
    return JointFit(places, 1.0 / (1.0 + np.exp(-best)), shape.pose, misfit)


@dataclass(frozen=True, eq=False)
class _Window:
    """Log-odds (n, n) near a place, and their pixels (n, n, 2)."""

    log_odds: Float32Array
    pixels: FloatArray

    @classmethod
    def about(cls, picture: Float32Array, k: int, place: FloatArray, appearance: Appearance) -> _Window:
        left, top = (round(float(value)) - REACH for value in place)
        side = 2 * REACH + 1
        y, x = np.mgrid[top : top + side, left : left + side]
        pixels = np.stack([x, y], axis=-1).astype(np.float64)
        return cls(appearance.log_odds(picture, k, (left, top), side), pixels)

    def mean(self, at: FloatArray, width: float) -> tuple[FloatArray, float]:
        """Return the mean place (2,) near ``at``, and its standard deviation over the prior's."""
        squares = np.sum((self.pixels - at) ** 2, axis=-1) / width**2
        near = np.exp(-0.5 * squares)
        weights = near * (np.exp(np.minimum(self.log_odds, 30.0)) + np.exp(BACKGROUND))
        total = float(weights.sum())
        if not total > 0.0:
            return at, 1.0
        mean = np.tensordot(weights, self.pixels, axes=2) / total
        spread = float(np.sum(weights * np.sum((self.pixels - mean) ** 2, axis=-1)) / total)
        return mean, float(np.sqrt(min(spread / (2.0 * width**2), 1.0)))

    def best(self, at: FloatArray, width: float) -> float:
        """Return the log-odds of the most likely place near ``at``."""
        squares = np.sum((self.pixels - at) ** 2, axis=-1) / width**2
        return float(self.log_odds.flat[int(np.argmax(self.log_odds - 0.5 * squares))])


@dataclass(frozen=True, eq=False)
class _Shape:
    """A face's points in the patch: pose (6,) and coefficients (M,) of its modes (M, K, 3)."""

    pose: FloatArray
    coefficients: FloatArray
    modes: FloatArray

    @property
    def points(self) -> FloatArray:
        """(K, 2) pixels."""
        return _projected(self.pose, FEATURES + np.tensordot(self.coefficients, self.modes, axes=1))

    def fitted(self, places: FloatArray, deviations: FloatArray) -> _Shape:
        """Take one Gauss-Newton step towards places (K, 2) with standard deviations (K,)."""
        face = FEATURES + np.tensordot(self.coefficients, self.modes, axes=1)
        now = _projected(self.pose, face)
        turned = [
            (_projected(self.pose + step, face) - now).ravel() / STEP
            for step in STEP * np.eye(JOINT_POSE_SIZE)
        ]
        rows = _rows(self.pose)
        moved = [(mode @ rows.T).ravel() for mode in self.modes]
        jacobian = np.array([*turned, *moved]).T
        weights = np.repeat(deviations**-2, 2)
        prior = np.concatenate([np.full(4, 1e-9), TURN_PRIOR**-2, np.ones(len(self.modes))])
        at = np.concatenate([np.zeros(4), self.pose[4:], self.coefficients])
        matrix = jacobian.T @ (weights[:, None] * jacobian) + np.diag(prior)
        step = np.linalg.solve(matrix, jacobian.T @ (weights * (places - now).ravel()) - prior * at)
        pose = self.pose + step[:JOINT_POSE_SIZE]
        return _Shape(pose, self.coefficients + step[JOINT_POSE_SIZE:], self.modes)


def _rows(pose: FloatArray) -> FloatArray:
    """Return (2, 3) the weak-perspective projection from the head's frame, mm, to patch pixels."""
    rows: FloatArray = pose[2] * (rotations_of(pose[None, 3:6])[0] * IN_CAMERA)[:2]
    return rows


def _projected(pose: FloatArray, shape: FloatArray) -> FloatArray:
    return shape @ _rows(pose).T + pose[:2]
