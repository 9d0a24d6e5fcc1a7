"""A face of textured planes, one through each feature point, drawn exactly: to test the refinement on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from posetrack_cli.geometry.camera import Camera, undistort
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_NORMALS, HeadPose

SHAPE = MEAN_SHAPE.copy()
SHAPE[6:8, 0] *= 2.2
"""Nostrils apart, so that no patch reaches into another's plane."""
FACING = HeadPose(np.array([-10.0, 5.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
"""A head that looks at the reference camera, 70 cm away."""
REACH = 26
"""Pixels about a point that show its plane."""
WAVES = 7


def pose_at(index: int) -> HeadPose:
    """A head that turns, nods and moves aside, up to 1.4 mm and 0.5 degrees a frame."""
    t = index / 30.0
    turn = np.array([0.12 * np.sin(1.3 * t), 0.2 * np.sin(1.1 * t), 0.05 * np.sin(0.9 * t)])
    return FACING.moved(np.concatenate([[30.0 * np.sin(t), 10.0 * np.sin(1.7 * t), 20.0 * np.sin(t)], turn]))


def turned_camera(name: str, baseline_mm: float, **lens) -> Camera:
    """A camera beside the reference, turned towards a head 700 mm away."""
    angle = np.arctan2(baseline_mm, 700.0)
    R, _ = cv2.Rodrigues(np.array([0.0, angle, 0.0]))
    t = -R @ np.array([baseline_mm, 0.0, 0.0])
    transform = tuple(tuple(float(x) for x in row) for row in np.column_stack([R, t]))
    return Camera(640, 480, 1000.0, 1000.0, 320.0, 240.0, name=name, camera_T_reference=transform, **lens)


def stereo(count: int = 2, **lens) -> list[Camera]:
    """Cameras 120 mm apart."""
    return [turned_camera(f"camera{c}", 120.0 * c, **lens) for c in range(count)]


@dataclass(frozen=True, eq=False)
class TexturedFace:
    """Waves on each point's plane: (K, WAVES) directions and lengths of 8 to 20 mm, phases, strengths."""

    waves: np.ndarray
    phases: np.ndarray
    strengths: np.ndarray

    def render(self, cameras, pose, shape, noise=0.0, seed=0, gain=1.0, offset=0.0):
        """Return one uint8 image a camera."""
        rng = np.random.default_rng(seed)
        images = []
        for camera in cameras:
            image = self._image(camera, pose, shape) * gain + offset
            image += noise * rng.standard_normal(image.shape)
            images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
        return images

    def _image(self, camera, pose, shape):
        image = np.full((camera.height, camera.width), 110.0)
        nearest = np.full(image.shape, np.inf)
        transform = np.array(camera.camera_T_reference)
        R, t = transform[:, :3], transform[:, 3]
        points = pose.points(shape) @ R.T + t
        normals = POINT_NORMALS @ (R @ pose.rotation).T
        across, down = plane_axes()
        for k in range(len(points)):
            rows, columns = self._box(camera, points[k])
            box = np.ix_(rows, columns)
            u, v = np.meshgrid(columns.astype(float), rows.astype(float))
            x, y = undistort(camera, (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
            rays = np.stack([x, y, np.ones_like(x)], axis=-1)
            depth = (points[k] @ normals[k]) / (rays @ normals[k])
            local = (rays * depth[..., None] - points[k]) @ (R @ pose.rotation)
            away = np.linalg.norm(local, axis=-1)
            texture = self._texture(k, local @ across[k], local @ down[k])
            image[box] = np.where(away < nearest[box], texture, image[box])
            nearest[box] = np.minimum(away, nearest[box])
        return image

    def _box(self, camera, point):
        pixel, _ = cv2.projectPoints(
            point[None], np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion or [0.0] * 4)
        )
        column, row = np.rint(pixel.ravel()).astype(int)
        rows = np.arange(max(row - REACH, 0), min(row + REACH + 1, camera.height))
        return rows, np.arange(max(column - REACH, 0), min(column + REACH + 1, camera.width))

    def _texture(self, k, a, b):
        angle = a[..., None] * self.waves[k, :, 0] + b[..., None] * self.waves[k, :, 1] + self.phases[k]
        return 120.0 + np.cos(angle) @ self.strengths[k]


def plane_axes():
    """Two unit vectors (K, 3) in each point's tangent plane, in the head's frame."""
    across = np.cross(POINT_NORMALS, [0.0, 0.0, 1.0]) + np.array([1e-9, 0.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(POINT_NORMALS, across)


def textured_face(seed: int = 3) -> TexturedFace:
    rng = np.random.default_rng(seed)
    count = (len(MEAN_SHAPE), WAVES)
    lengths, directions = rng.uniform(8.0, 20.0, count), rng.uniform(0.0, np.pi, count)
    waves = 2 * np.pi / lengths[..., None] * np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    return TexturedFace(waves, rng.uniform(0.0, 2 * np.pi, count), rng.uniform(5.0, 20.0, count))


@lru_cache(maxsize=128)
def moving(
    face: TexturedFace, cameras: tuple[Camera, ...], index: int, noise: float
) -> tuple[np.ndarray, ...]:
    """Return the images of a frame with a face at ``pose_at``: many tests go through the same frames."""
    return tuple(face.render(cameras, pose_at(index), SHAPE, noise=noise, seed=index))
