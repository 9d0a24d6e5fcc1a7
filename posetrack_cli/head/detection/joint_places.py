"""The ten points of a face, chosen together **[ours]**.

Each point's log-odds about where it is expected make a distribution over pixels; a face's shape, of an
average one with the modes in which faces differ, is fitted to the ten means of these distributions, each
narrowed about the shape's present point (regularised landmark mean shift: Saragih, Lucey and Cohn 2011). No
point alone can leave the others for something that merely looks like it, and no impossible face comes out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.head.detection.appearance import Appearance, histograms
from posetrack_cli.head.detection.fit import IN_CAMERA, rotations_of
from posetrack_cli.head.face.points import FEATURES, POINT_COUNT

REACH = 15
"""Pixels of the patch about where a point is expected that are looked at."""
WIDTHS = (5.0, 3.5, 2.5, 1.8)
"""Standard deviations, pixels, of a point about the shape's: one round each, two steps of the shape."""
STEPS = 2
BACKGROUND = -1.0
"""Log-odds of a point that is hidden or looks like nobody's, at every pixel."""
UNSURE_PX = 1.0
"""Standard deviation of the mean of a distribution in itself."""
POSE_SIZE = 6
TURN_PRIOR = np.array([0.45, 0.3])
"""Standard deviations, rad, of yaw and pitch."""
STEP = 1e-4


@dataclass(frozen=True, eq=False)
class JointPlaces:
    """Where the points of one face are.

    Attributes:
        pixels: (K, 2) in the patch.
        probabilities: (K,) that the point's surroundings look like the point's, at the best place near.
        pose: (6,) u, v, scale (pixels per mm), roll, yaw, pitch of the shape.
        misfit_px: root mean square of how far the places are from the shape's.
    """

    pixels: FloatArray
    probabilities: FloatArray
    pose: FloatArray
    misfit_px: float


def find_jointly(grey: ImageArray, expected: FloatArray, pose: FloatArray, looks: Appearance) -> JointPlaces:
    """Find the points in an upright patch.

    Args:
        grey: (height, width) uint8.
        expected: (K, 2) pixels, roughly.
        pose: (6,) of an average face there: u, v, scale, roll, yaw, pitch.
        looks: what points look like.
    """
    picture = histograms(grey)
    windows = [_Window.about(picture, k, place, looks) for k, place in enumerate(expected)]
    return _settled(windows, expected, pose, looks)


def _settled(
    windows: Sequence[_Window], expected: FloatArray, pose: FloatArray, looks: Appearance
) -> JointPlaces:
    """Return where the points come to rest from a start."""
    shape = _Shape(np.array(pose, dtype=np.float64), np.zeros(len(looks.shape_modes)), looks.shape_modes)
    shape = shape.fitted(expected, np.full(POINT_COUNT, WIDTHS[0]))
    places = expected
    for width in WIDTHS:
        for _ in range(STEPS):
            means = [window.mean(at, width) for window, at in zip(windows, shape.points, strict=True)]
            places = np.array([mean for mean, _ in means])
            doubt = np.array([share for _, share in means])
            shape = shape.fitted(places, np.hypot(UNSURE_PX, width * doubt))
    best = np.array([window.best(at, WIDTHS[-1]) for window, at in zip(windows, shape.points, strict=True)])
    misfit = float(np.sqrt(np.mean(np.sum((places - shape.points) ** 2, axis=1))))
    return JointPlaces(places, 1.0 / (1.0 + np.exp(-best)), shape.pose, misfit)


@dataclass(frozen=True, eq=False)
class _Window:
    """Log-odds (n, n) about a place, and the pixels (n, n, 2) they are of."""

    log_odds: Float32Array
    pixels: FloatArray

    @classmethod
    def about(cls, picture: Float32Array, k: int, place: FloatArray, looks: Appearance) -> _Window:
        left, top = (round(float(value)) - REACH for value in place)
        side = 2 * REACH + 1
        y, x = np.mgrid[top : top + side, left : left + side]
        pixels = np.stack([x, y], axis=-1).astype(np.float64)
        return cls(looks.log_odds(picture, k, (left, top), side), pixels)

    def mean(self, at: FloatArray, width: float) -> tuple[FloatArray, float]:
        """Return the mean place (2,) near ``at``, and the share of the prior's variance that is left."""
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
        """Return the log-odds of the likeliest place near ``at``."""
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
        """Return the shape after one Gauss-Newton step towards places (K, 2) of deviations (K,)."""
        face = FEATURES + np.tensordot(self.coefficients, self.modes, axes=1)
        now = _projected(self.pose, face)
        turned = [
            (_projected(self.pose + step, face) - now).ravel() / STEP for step in STEP * np.eye(POSE_SIZE)
        ]
        rows = _rows(self.pose)
        moved = [(mode @ rows.T).ravel() for mode in self.modes]
        jacobian = np.array([*turned, *moved]).T
        weights = np.repeat(deviations**-2, 2)
        prior = np.concatenate([np.full(4, 1e-9), TURN_PRIOR**-2, np.ones(len(self.modes))])
        at = np.concatenate([np.zeros(4), self.pose[4:], self.coefficients])
        matrix = jacobian.T @ (weights[:, None] * jacobian) + np.diag(prior)
        step = np.linalg.solve(matrix, jacobian.T @ (weights * (places - now).ravel()) - prior * at)
        pose = self.pose + step[:POSE_SIZE]
        return _Shape(pose, self.coefficients + step[POSE_SIZE:], self.modes)


def _rows(pose: FloatArray) -> FloatArray:
    """(2, 3) what a mm in the head's frame is in the patch."""
    rows: FloatArray = pose[2] * (rotations_of(pose[None, 3:6])[0] * IN_CAMERA)[:2]
    return rows


def _projected(pose: FloatArray, shape: FloatArray) -> FloatArray:
    return shape @ _rows(pose).T + pose[:2]
