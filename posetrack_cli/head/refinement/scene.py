"""One frame as the kernels of the refinement read it: images, optics, templates and what is compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import RefinementSettings
from posetrack_cli.head.face.patches import GRID
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.face.rig_images import Projection, RigImages, project
from posetrack_cli.head.face.templates import (
    TemplateSet,
    tangents,
    unwarped,
    visibility,
    warped,
    warps_between,
)

REFERENCE, KEYFRAME, PREVIOUS = 1.0, 2.0, 1.0
"""Weights of comparisons: with the first frame, with that in which the face looked nearest the same way, and
with the frame before."""
BETWEEN_CAMERAS = 4.3
"""The same of one camera with another."""
VISIBILITY_POWER = 0.3
"""Of the cosine of skin normal and view, which a comparison's weight is multiplied by."""
PATCH_SD = 0.4
"""Of the difference of two patches, as vectors of zero mean and unit norm, per unit of weight."""
CORRELATION_FLOOR, CORRELATION_POWER = 0.2, 6.0
"""A comparison is believed as ((ncc - floor) / (1 - floor)) ^ power."""
MARGIN = 48
"""Pixels kept around the predicted points: half a patch and how far a point may be refined."""


class Images(NamedTuple):
    """The part of each camera's image that shows the face.

    Attributes:
        windows: (C, h, w), h and w the largest over the cameras.
        corners: (C, 2) column and row of a window's first pixel in the image.
        sizes: (C, 2) width and height of the part that is filled; 0 where a camera gave no image.
    """

    windows: ImageArray
    corners: FloatArray
    sizes: IntArray


class Optics(NamedTuple):
    """C cameras; their lenses are linearised about the predicted points.

    Attributes:
        transforms: (C, 3, 4) camera_T_reference, mm.
        intrinsics: (C, 4) fx, fy, cx, cy, pixels.
        lenses: (C, K, 2, 3) of ``Projection``.
    """

    transforms: FloatArray
    intrinsics: FloatArray
    lenses: FloatArray


class Targets(NamedTuple):
    """What the patches of the frame are compared with.

    Attributes:
        patches: (S, C, K, SIZE) warped templates, that of the frame before, if there is one, the last.
        stored: number of the sets that are not of the frame before.
        weights: (S, C, K) of each comparison, visibility included; 0 where there is no template.
        pairs: (P, 2) cameras whose patches are compared with each other: of the first, with the second's.
        pair_warps: (P, K, 2, 2) from the first's patch to the second's image; NaN where there is none.
        pair_weights: (P, K).
    """

    patches: FloatArray
    stored: int
    weights: FloatArray
    pairs: IntArray
    pair_warps: FloatArray
    pair_weights: FloatArray


class Robustness(NamedTuple):
    """How far a comparison is believed: precision x ((ncc - floor) / (1 - floor)) ^ power.

    One with the frame before also counts by how like its stored templates the point is, ncc ^ likeness.
    """

    precision: float
    floor: float
    power: float
    likeness: float


class Scene(NamedTuple):
    """All of it.

    Attributes:
        raw: (2, C, K, GRID, GRID) intensities of the reference and of the frame before, not warped, NaN where
            there are none; empty where only the thesis's recalculation would need them.
    """

    images: Images
    optics: Optics
    targets: Targets
    robustness: Robustness
    raw: FloatArray


@dataclass(frozen=True, eq=False)
class ComparedFrame:
    """The images of a frame, and what the points on them are compared with.

    Attributes:
        images: of all cameras.
        templates: of the reference, then of keyframes.
        previous: templates of the frame before; None without one.
        settings: weights, priors, steps.
    """

    images: RigImages
    templates: Sequence[TemplateSet]
    previous: TemplateSet | None
    settings: RefinementSettings

    def scene(self, pose: HeadPose, shape: FloatArray) -> tuple[Scene, FloatArray]:
        """Return the frame about a predicted pose and shape (K, 3), and its points' visibility (C, K)."""
        projection = project(self.images.cameras, pose.points(shape))
        there = np.array([image is not None for image in self.images.images])
        seen = visibility(projection, pose) * there[:, None]
        weights = seen**VISIBILITY_POWER
        return Scene(
            _cut_images(self.images.images, projection.pixels),
            _optics(self.images.cameras, projection),
            self._targets(tangents(projection, pose), weights),
            self._robustness,
            self._raw,
        ), seen

    def _targets(self, now: FloatArray, seen: FloatArray) -> Targets:
        weights = [REFERENCE, *[KEYFRAME] * (len(self.templates) - 1)]
        found = [warped(one, now) for one in self.templates]
        if self.previous is not None:
            weights.append(PREVIOUS)
            found.append(warped(self.previous, now))
        patches = np.stack([one[0] for one in found])
        known = np.stack([one[1] for one in found])
        return Targets(
            patches,
            len(self.templates),
            np.array(weights)[:, None, None] * seen * known,
            *_pairs(now, seen),
        )

    @property
    def _robustness(self) -> Robustness:
        likeness = self.settings.previous_likeness
        return Robustness(PATCH_SD**-2, CORRELATION_FLOOR, CORRELATION_POWER, likeness)

    @property
    def _raw(self) -> FloatArray:
        """Intensities as ``Scene.raw`` has them."""
        shape, previous = (*self.templates[0].seen.shape, GRID, GRID), self.previous
        if self.settings.recalculation != "printed":
            return np.zeros((0, *shape))
        before = np.full(shape, np.nan) if previous is None else unwarped(previous)
        return np.stack([unwarped(self.templates[0]), before])


def _cut_images(images: Sequence[ImageArray | None], pixels: FloatArray) -> Images:
    """Copy the boxes around the points (C, K, 2), clipped to the images."""
    corners, sizes = np.zeros((len(images), 2)), np.zeros((len(images), 2), dtype=np.int64)
    for c, image in enumerate(images):
        if image is not None:
            limit = np.array(image.shape[::-1])
            first = np.clip(np.floor(pixels[c].min(axis=0)) - MARGIN, 0, limit)
            last = np.clip(np.ceil(pixels[c].max(axis=0)) + MARGIN, first, limit)
            corners[c], sizes[c] = first, last - first
    width, height = sizes.max(axis=0)
    windows = np.zeros((len(images), height, width), dtype=np.uint8)
    for c, image in enumerate(images):
        if image is not None:
            (x, y), (w, h) = corners[c].astype(int), sizes[c]
            windows[c, :h, :w] = image[y : y + h, x : x + w]
    return Images(windows, corners, sizes)


def _optics(cameras: Sequence[Camera], projection: Projection) -> Optics:
    transforms = np.array([camera.camera_T_reference for camera in cameras])
    intrinsics = np.array([(camera.fx, camera.fy, camera.cx, camera.cy) for camera in cameras])
    return Optics(transforms, intrinsics, projection.lenses)


def _pairs(now: FloatArray, seen: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Compare each camera with the first that gave an image."""
    there = np.flatnonzero(seen.any(axis=1))
    pairs = np.array([(c, there[0]) for c in there[1:]], dtype=np.int64).reshape(-1, 2)
    warps = warps_between(now[pairs[:, 0]], now[pairs[:, 1]])
    weights = BETWEEN_CAMERAS * np.minimum(seen[pairs[:, 0]], seen[pairs[:, 1]])
    return pairs, warps, np.where(np.isnan(warps[..., 0, 0]), 0.0, weights)
