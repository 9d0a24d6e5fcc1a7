"""How well the images agree with particles: project, score maps, look up (thesis, 3.28 and 3.4).

The thesis correlates per particle and point (3.3.1). All particles see a point within a small box of the
image; there one cv2.matchTemplate gives every correlation at once, and particles look theirs up. The numbers
are the same, and the cost depends on the box, not on the number of particles.

A template has PATCH x PATCH pixels, at the offsets (column - 7.5, row - 7.5) from its point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.distortion import distort
from posetrack_cli.head.face.patches import PATCH
from posetrack_cli.head.face.pose import POSE_SIZE
from posetrack_cli.head.particles.kernels import (
    add_scores,
    write_pixels,
    write_rotations,
    write_shapes,
    write_transforms,
)
from posetrack_cli.head.particles.particles import HeadParticles

HALF = 0.5 * (PATCH - 1)
LARGEST_BOX = 160
"""Pixels a side. It is cut about its middle beyond; particles outside score 0."""


class Box(NamedTuple):
    """Pixels of top left corners that a template is laid at: columns left..right, rows top..bottom."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def is_empty(self) -> bool:
        """Whether there is no place in the image for the template."""
        return self.right < self.left or self.bottom < self.top

    def holds(self, other: Box) -> bool:
        """Whether another box lies in this one."""
        return (
            self.left <= other.left
            and self.top <= other.top
            and self.right >= other.right
            and self.bottom >= other.bottom
        )

    def grown(self, margin: int, size: tuple[int, ...]) -> Box:
        """Return the box with a margin around it, within an image of this (height, width)."""
        height, width = size
        return Box(
            max(self.left - margin, 0),
            max(self.top - margin, 0),
            min(self.right + margin, width - PATCH),
            min(self.bottom + margin, height - PATCH),
        )


class ScoreMap(NamedTuple):
    """Normalised correlations, -1 to 1.

    Attributes:
        scores: (H, W).
        left, top: pixel of the point, not of the corner, for scores[0, 0].
    """

    scores: Float32Array
    left: float
    top: float


def boxes_around(
    u: Float32Array, v: Float32Array, size: tuple[int, ...], largest: int = LARGEST_BOX
) -> list[Box]:
    """Return the places that the particles look at for each point, within the image.

    Args:
        u, v: (K, N) pixels of K points.
        size: (height, width) of the image.
        largest: side; what is larger is cut about its middle.
    """
    columns = zip(u.min(axis=1).tolist(), u.max(axis=1).tolist(), strict=True)
    rows = zip(v.min(axis=1).tolist(), v.max(axis=1).tolist(), strict=True)
    boxes = []
    for (left, right), (top, bottom) in zip(columns, rows, strict=True):
        first, last = _span(left, right, size[1], largest), _span(top, bottom, size[0], largest)
        boxes.append(Box(first[0], last[0], first[1], last[1]))
    return boxes


def score_map(image: ImageArray, template: ImageArray, box: Box) -> ScoreMap:
    """Return the normalised correlations (TM_CCOEFF_NORMED) of a template at every place of a box.

    Args:
        image: (height, width), grey.
        template: (PATCH, PATCH) float32; mean and norm do not matter.
        box: not empty.
    """
    window = image[box.top : box.bottom + PATCH, box.left : box.right + PATCH].astype(np.float32)
    scores = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    return ScoreMap(np.asarray(scores, np.float32), box.left + HALF, box.top + HALF)


def _span(low: float, high: float, size: int, largest: int) -> tuple[int, int]:
    """Return the first and the last corner for points between low and high on an axis of `size` pixels."""
    last = size - PATCH
    first = math.floor(min(max(low - HALF, 0.0), last + 1.0))
    final = math.ceil(max(min(high - HALF, last), -1.0))
    excess = final - first + 1 - largest
    if excess > 0:
        first += excess // 2
        final = first + largest - 1
    return first, final


MARGIN_PX = 2
"""What a map has around its particles, so that it often serves for the second weighing too."""


@dataclass(frozen=True, eq=False)
class PatchObservation:
    """What the particles of one frame are compared with.

    Attributes:
        images: one a camera, grey; None where a camera gave none.
        templates: (C, K, PATCH, PATCH) float32, warped to the predicted pose.
        visibility: (C, K) weights 0 to 1 of the correlations.
    """

    images: Sequence[ImageArray | None]
    templates: Float32Array
    visibility: FloatArray

    @property
    def weights(self) -> FloatArray:
        """(C, K) visibility, 0 where there is no image."""
        seen = np.array([image is not None for image in self.images])
        weights: FloatArray = self.visibility * seen[:, None]
        return weights


class ParticleScores:
    """Scores particles on the images of one frame at a time; keeps its arrays from frame to frame."""

    def __init__(self, cameras: Sequence[Camera], between: bool) -> None:
        """Score on images of these cameras, looked up bilinearly if `between`, else at the nearest place."""
        self._projection = ParticleProjection(cameras)
        self._between = between
        self._maps: dict[tuple[int, int], tuple[Box, ScoreMap]] = {}

    def observe(self, observation: PatchObservation, particles: HeadParticles) -> None:
        """Take a frame, and what the deviations of particles are counted from."""
        self._observation, self._weights = observation, observation.weights
        self._projection.set_reference(particles)
        self._maps.clear()

    @property
    def visible(self) -> float:
        """Sum of the weights: CK where all points are visible."""
        return float(self._weights.sum())

    def missing(self, deviations: FloatArray) -> FloatArray:
        """Return CK - c, (N,): the sum over cameras and points of visibility (1 - correlation), (3.28).

        A point that is not on the image correlates by 0.

        Args:
            deviations: (N, 6 + B) of particles from the reference.
        """
        total = np.zeros(len(deviations))
        self._projection.set_particles(deviations)
        for c, image in enumerate(self._observation.images):
            if image is not None and self._weights[c].any():
                self._add(c, image, total)
        missing: FloatArray = self.visible - total
        return missing

    def _add(self, c: int, image: ImageArray, total: FloatArray) -> None:
        """Add what each particle's points score on one camera's image."""
        u, v = self._projection.pixels(c)
        boxes = boxes_around(u, v, image.shape)
        for k in np.flatnonzero(self._weights[c]).tolist():
            if not boxes[k].is_empty:
                scores, left, top = self._map(c, k, image, boxes[k])
                weight = float(self._weights[c, k])
                add_scores(scores, left, top, u[k], v[k], weight, self._between, total)

    def _map(self, c: int, k: int, image: ImageArray, box: Box) -> ScoreMap:
        """Return a map of at least this box: the one at hand if it is large enough."""
        if (c, k) in self._maps:
            known, scores = self._maps[c, k]
            if known.holds(box):
                return scores
        wide = box.grown(MARGIN_PX, image.shape)
        scores = score_map(image, self._observation.templates[c, k], wide)
        self._maps[c, k] = wide, scores
        return scores


NORMALISED = np.array([1.0, 1.0, 0.0, 0.0], np.float32)


class ParticleProjection:
    """Projects particles, given as deviations from a reference; keeps its arrays from call to call."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._cameras = cameras
        self._transforms = [np.array(camera.camera_T_reference) for camera in cameras]
        self._shape = 0, 0

    def set_reference(self, particles: HeadParticles) -> None:
        """Count deviations from the pose and deformation that these particles are about."""
        self._pose, model = particles.pose, particles.model
        rotation = self._pose.rotation
        points = model.shapes(particles.coefficients) @ rotation.T
        directions = np.tensordot(model.basis, rotation, axes=(1, 1)).transpose(0, 2, 1)
        self._points = points.ravel().astype(np.float32)
        self._directions = np.ascontiguousarray(directions.reshape(points.size, -1), np.float32)

    def set_particles(self, deviations: FloatArray) -> None:
        """Take particles (N, 6 + B): tangent vectors from the reference pose, and coefficients beyond it."""
        parts = np.ascontiguousarray(deviations.T, np.float32)
        self._allocate(len(self._points) // 3, len(deviations))
        self._shifts = parts[:3]
        write_rotations(parts[3:POSE_SIZE], self._rotations)
        write_shapes(self._points, self._directions, parts[POSE_SIZE:], self._shapes)

    def pixels(self, camera: int) -> tuple[Float32Array, Float32Array]:
        """Return the columns and rows (K, N) where a camera sees the points; overwritten by the next call."""
        lens, transform = self._cameras[camera], self._transforms[camera]
        origin = transform[:, :3] @ self._pose.position + transform[:, 3]
        to_camera = np.ascontiguousarray(transform[:, :3], np.float32)
        write_transforms(self._shifts, self._rotations, to_camera, origin.astype(np.float32), self._in_camera)
        intrinsics = np.array([lens.fx, lens.fy, lens.cx, lens.cy], np.float32)
        pinhole = NORMALISED if lens.is_distorted else intrinsics
        write_pixels(self._shapes, self._in_camera, pinhole, self._u, self._v)
        if lens.is_distorted:
            x, y = distort(lens, self._u, self._v)
            np.add(intrinsics[0] * x, intrinsics[2], out=self._u)
            np.add(intrinsics[1] * y, intrinsics[3], out=self._v)
        return self._u, self._v

    def _allocate(self, points: int, count: int) -> None:
        if self._shape == (points, count):
            return
        self._shape = points, count
        self._shapes = np.empty((3 * points, count), np.float32)
        self._rotations = np.empty((9, count), np.float32)
        self._in_camera = np.empty((12, count), np.float32)
        self._u, self._v = np.empty((points, count), np.float32), np.empty((points, count), np.float32)
