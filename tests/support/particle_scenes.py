"""A face of textured spots in front of two cameras, and what the particle filter is handed of it."""

from __future__ import annotations

import cv2
import numpy as np

from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_from_points
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT, HeadPose, ShapeModel
from posetrack_cli.head.particles.scores import PatchObservation

SPOT = 48
"""Side of a point's texture, pixels."""
FACING = HeadPose(np.array([15.0, 10.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
LENS = (-0.25, 0.08, 0.001, -0.002, 0.01)


def cameras(distortion=(), lens="plumb_bob"):
    turn = cv2.Rodrigues(np.array([0.0, 0.17, 0.0]))[0]
    beside = tuple(map(tuple, np.hstack([turn, [[-118.0], [2.0], [20.0]]])))
    left = Camera(640, 480, 1000.0, 990.0, 322.0, 238.0, distortion, lens, "left")
    return left, Camera(640, 480, 1010.0, 1000.0, 318.0, 243.0, distortion, lens, "right", beside)


def model(size=2, seed=0):
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(3 * POINT_COUNT, 3 * POINT_COUNT)))[0]
    return ShapeModel(
        MEAN_SHAPE, basis[:, :size].reshape(POINT_COUNT, 3, size), np.array([8.0, 4.0, 2.0])[:size]
    )


def pixels(camera, pose, shape):
    return pixels_from_points(camera, in_camera_axes(camera, pose.points(shape)))[0]


def spots(seed=5):
    """(K, SPOT, SPOT) smooth textures: their correlation falls over some pixels."""
    noise = np.random.default_rng(seed).normal(size=(POINT_COUNT, SPOT, SPOT))
    smooth = np.array([cv2.GaussianBlur(one, (0, 0), 2.0) for one in noise])
    return (128.0 + 40.0 * smooth / smooth.std()).astype(np.float32)


def picture(camera, pose, shape):
    """Each point's texture, shifted to where the camera sees it to a fraction of a pixel, on grey."""
    image = np.full((camera.height, camera.width), 128.0, np.float32)
    for spot, (u, v) in zip(spots(), pixels(camera, pose, shape), strict=True):
        centre = 0.5 * (SPOT - 1)
        shift = np.float32([[1.0, 0.0, u - centre], [0.0, 1.0, v - centre]])
        size = (camera.width, camera.height)
        mask = cv2.warpAffine(np.ones_like(spot), shift, size)
        drawn = cv2.warpAffine(spot, shift, size, flags=cv2.INTER_LINEAR)
        image = np.where(mask > 0.99, drawn, image)
    return np.clip(image, 0, 255).astype(np.uint8)


def observation(pose, shape, used, visibility=None):
    corner = (SPOT - 16) // 2
    middles = spots()[:, corner : corner + 16, corner : corner + 16]
    away = middles - middles.mean(axis=(1, 2), keepdims=True)
    templates = np.array([away / np.linalg.norm(away, axis=(1, 2), keepdims=True)] * len(used))
    visible = np.ones((len(used), POINT_COUNT)) if visibility is None else visibility
    return PatchObservation([picture(camera, pose, shape) for camera in used], templates, visible)
