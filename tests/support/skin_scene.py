"""A smooth face covered with waves, drawn exactly, and frames of it whose poses are told with an error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.head.adjustment.adjuster import PointView
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_COUNT, HeadPose
from posetrack_cli.head.skin.map import cut_view
from posetrack_cli.head.skin.matching import SkinView

CAMERA = Camera(480, 400, 800.0, 800.0, 240.0, 200.0)
FRAME_NS = 250_000_000
WAVES = 40
TOP = np.array([0.0, -20.0, 25.0])
"""(3,) mm, of the face: nearest to the camera."""
BENT = np.array([90.0, 160.0])
"""mm: x^2 / 90 + y^2 / 160 is how far it recedes, about as the mean face does."""
OUTLINE = np.array([68.0, 90.0])
"""Half its width and height, mm."""
FACING = HeadPose(np.array([5.0, -8.0, 640.0]), np.array([1.0, 0.0, 0.0, 0.0]))


def depths(places: FloatArray) -> FloatArray:
    """The z (...) of the face at x and y (..., 2), mm in the head's frame."""
    receded: FloatArray = TOP[2] - np.sum((places - TOP[:2]) ** 2 / BENT, axis=-1)
    return receded


SHAPE = np.column_stack([MEAN_SHAPE[:, :2], depths(MEAN_SHAPE[:, :2])])
"""Its ten points; they are not drawn."""


@lru_cache
def waves() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of 6 to 25 mm in all directions, their phases and strengths."""
    rng = np.random.default_rng(1)
    lengths, directions = rng.uniform(6.0, 25.0, WAVES), rng.uniform(0.0, np.pi, WAVES)
    along = 2 * np.pi / lengths[:, None] * np.column_stack([np.cos(directions), np.sin(directions)])
    return along, rng.uniform(0.0, 2 * np.pi, WAVES), rng.uniform(3.0, 6.0, WAVES)


def drawn(pose: HeadPose, noise: float = 1.0, seed: int = 0) -> ImageArray:
    """The image of the face: where each pixel's ray first meets it."""
    image = np.full((CAMERA.height, CAMERA.width), 110.0)
    u, v = np.meshgrid(np.arange(CAMERA.width), np.arange(CAMERA.height))
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], axis=-1)
    d, o = rays @ pose.rotation, -TOP - pose.position @ pose.rotation  # in the head's axes, from the top
    # o_z + s d_z = -(o_x + s d_x)^2 / bent_x - (o_y + s d_y)^2 / bent_y: the nearer solution s
    a = np.sum(d[..., :2] ** 2 / BENT, axis=-1)
    b = d[..., 2] + 2 * np.sum(o[:2] * d[..., :2] / BENT, axis=-1)
    c = o[2] + np.sum(o[:2] ** 2 / BENT)
    root = b**2 - 4 * a * c
    s = 2 * c / (np.sqrt(np.maximum(root, 0.0)) - b)
    places = o[:2] + s[..., None] * d[..., :2]
    there = (root > 0.0) & (np.sum((places / OUTLINE) ** 2, axis=-1) < 1.0)
    along, phases, strengths = waves()
    image[there] = 120.0 + np.cos(places[there] @ along.T + phases) @ strengths
    image += noise * np.random.default_rng(seed).standard_normal(image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def even() -> ImageArray:
    """An image without anything."""
    return np.full((CAMERA.height, CAMERA.width), 120, np.uint8)


def pose_at(index: float) -> HeadPose:
    """A head that turns by 14 degrees, nods by 8 and moves aside."""
    turn = [0.14 * np.sin(0.9 * index), 0.24 * np.sin(0.5 * index), 0.06 * np.sin(0.7 * index)]
    return FACING.moved(np.array([12.0 * np.sin(0.4 * index), 5.0 * np.cos(0.6 * index), 0.0, *turn]))


@dataclass(frozen=True, eq=False)
class Shown:
    """Frames with their true poses.

    Attributes:
        views: whose poses are told with an error.
        true: poses.
    """

    views: list[SkinView]
    true: list[HeadPose]


def told_at(index: float, error_deg: float) -> HeadPose:
    """The pose with an error of its yaw that varies slowly, otherwise than the yaw itself."""
    error = np.radians(error_deg) * np.sin(0.31 * index + 0.8)
    return pose_at(index).moved(np.array([0.0, 0.0, 0.0, 0.0, error, 0.0]))


@lru_cache
def shown(count: int, error_deg: float) -> Shown:
    """So many frames of a head."""
    views = []
    for index in range(count):
        pose = told_at(index, error_deg)
        pixels = pixels_wherever(CAMERA, pose.points(SHAPE))
        view = PointView(index * FRAME_NS, pixels, np.ones(POINT_COUNT), pose, np.zeros(5))
        views.append(cut_view((drawn(pose_at(index), seed=index),), (CAMERA,), view))
    return Shown(views, [pose_at(index) for index in range(count)])
