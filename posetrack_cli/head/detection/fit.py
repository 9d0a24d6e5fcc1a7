"""A mean face laid over response maps: which pose in the image explains them best **[ours]**.

The projection is weak perspective. A pose has eight numbers: u, v (patch pixels of the head's origin), scale
(pixels per mm), roll, yaw, pitch (rad, about the camera's z, y and x axes), and how much higher and wider
than an average face's the mouth is, mm. Scores of a fixed cloud of poses are read off the maps; the best
are the centres of smaller clouds.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.head.detection.responses import MIDDLE, PIXELS_PER_MM
from posetrack_cli.head.face.points import FEATURES, FITTED, MOUTH

IN_CAMERA = np.array([1.0, -1.0, -1.0])
"""The head's axes in the camera's, of a head that looks at the camera."""
POSE_SIZE = 8
PRIOR_MEAN = np.array([MIDDLE[0], MIDDLE[1], PIXELS_PER_MM, 0.0, 0.0, 0.0, 0.0, 0.0])
PRIOR_SD = np.array([4.0, 5.0, 0.09 * PIXELS_PER_MM, 0.18, 0.45, 0.25, 5.0, 3.0])
WEIGHTS = np.array([1.0, 1.0, 1.0, 1.0, 1.2, 1.2, 0.7, 0.7, 0.6, 0.6, 3.0])
# What a point contributes where its map is 0: no point may veto a pose.
LEAST_RESPONSE = 0.1
# Detectors' eyes lie within these of the truth, pixels of the patch; now and then they are something else.
EYE_SD = np.array([6.0, 3.0])
EYE_DOUBT = 0.05
FIRST_CLOUD = 3000
KEPT, CHILDREN = 20, 30
NARROWING = (0.4, 0.2, 0.1)


def projected(poses: FloatArray, shape: FloatArray = FITTED) -> FloatArray:
    """Return the patch pixels (N, L, 2) of points (L, 3), mm, under poses (N, 8)."""
    rows = poses[:, 2, None, None] * (rotations_of(poses[:, 3:6]) * IN_CAMERA)[:, :2]
    pixels: FloatArray = np.einsum("nij,kj->nki", rows, shape) + poses[:, None, :2]
    up, out = rows[:, :, 1] * poses[:, 6, None], rows[:, :, 0] * poses[:, 7, None]
    pixels[:, MOUTH] += np.stack([up - out, up + out], axis=1)
    return pixels


def relief_of(angles: FloatArray, shape: FloatArray = FEATURES) -> FloatArray:
    """Return how much farther from the camera than the head's origin each point is, (K,) mm.

    Args:
        angles: (3,) roll, yaw, pitch, rad.
        shape: (K, 3) mm in the head's frame.
    """
    relief: FloatArray = shape @ (rotations_of(angles[None]) * IN_CAMERA)[0, 2]
    return relief


def fit_face(
    maps: Float32Array, eyes: tuple[FloatArray, FloatArray], start: FloatArray | None = None
) -> FloatArray:
    """Return the pose (8,) that explains response maps (K + 1, height, width) best.

    Args:
        maps: one map per feature of ``FITTED``.
        eyes: (n, 2) patch pixels of possible eye centres, right and left; empty where nothing is known.
        start: (8,) a pose near which to search; without it the whole prior is searched.
    """
    coarse, fine = _blurred(maps, 5, 2.0), _blurred(maps, 3, 1.0)
    if start is None:
        poses = PRIOR_MEAN + PRIOR_SD * _normal(FIRST_CLOUD)
        scores = _scores(poses, coarse, eyes)
    else:
        poses, scores = start[None], _scores(start[None], fine, eyes)
    for narrowing in NARROWING:
        best = poses[np.argsort(-scores, kind="stable")[:KEPT]]
        cloud = narrowing * PRIOR_SD * _normal(len(best) * CHILDREN)
        poses = np.concatenate([best, np.repeat(best, CHILDREN, axis=0) + cloud])
        scores = _scores(poses, fine, eyes)
    pose: FloatArray = poses[np.argmax(scores)]
    return pose


def _scores(poses: FloatArray, maps: Float32Array, eyes: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return (N,) log-scores: weighted log responses, the eyes a detector found, half the prior."""
    pixels = projected(poses)
    height, width = maps.shape[1:]
    columns = np.clip(np.rint(pixels[..., 0]).astype(int), 0, width - 1)
    rows = np.clip(np.rint(pixels[..., 1]).astype(int), 0, height - 1)
    responses = maps[np.arange(len(maps)), rows, columns]
    prior = -0.5 * np.sum(((poses - PRIOR_MEAN) / PRIOR_SD) ** 2, axis=1)
    scores: FloatArray = np.log(LEAST_RESPONSE + responses) @ WEIGHTS + 0.5 * prior
    for found, centres in zip(eyes, (pixels[:, 0:2].mean(axis=1), pixels[:, 2:4].mean(axis=1)), strict=True):
        scores = scores + 0.5 * _eye_score(centres, found)
    return scores


def _eye_score(centres: FloatArray, found: FloatArray) -> FloatArray:
    """Return (N,) logarithms of how near an eye's centre (N, 2) is to the nearest one found (n, 2)."""
    if not len(found):
        return np.zeros(len(centres))
    squares: FloatArray = np.sum(((centres[:, None] - found) / EYE_SD) ** 2, axis=2).min(axis=1)
    score: FloatArray = np.log(np.maximum(np.exp(-0.5 * squares), EYE_DOUBT))
    return score


def _blurred(maps: Float32Array, spread: int, sigma: float) -> Float32Array:
    """Widen every peak, so that a pose nearby scores too."""
    box = np.ones((spread, spread), np.uint8)
    return np.stack([cv2.GaussianBlur(cv2.dilate(one, box), (0, 0), sigma) for one in maps])


@cache
def _normal(count: int) -> FloatArray:
    """Return (count, POSE_SIZE) standard normal numbers, always the same: no start depends on chance."""
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
