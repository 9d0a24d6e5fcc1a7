"""Feature points of a face, head poses, shape models, and image scaling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import (
    canonical,
    conjugate,
    exponential,
    logarithm,
    matrices_from_quaternions,
    multiply,
)
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.columns import floats, units

# Feature points.
#
# The head's frame: x to the subject's left, y up, z out of the face, mm; the origin is the mean of the four
# eye corners of the neutral face. A shape is (K, 3), K = 10 rows in the order of ``POINT_NAMES``.
#
# Means and deviations are statistics of ten landmarks over 4000 samples of ICT-FaceKit's identity model (USC
# Institute for Creative Technologies, MIT licence).

POINT_NAMES = (
    "right_eye_outer",
    "right_eye_inner",
    "left_eye_inner",
    "left_eye_outer",
    "right_mouth_corner",
    "left_mouth_corner",
    "right_nostril",
    "left_nostril",
    "right_brow_inner",
    "left_brow_inner",
)
POINT_COUNT = len(POINT_NAMES)
EYES, MOUTH, NOSTRILS, BROWS = slice(0, 4), slice(4, 6), slice(6, 8), slice(8, 10)
MIRRORED = (3, 2, 1, 0, 5, 4, 7, 6, 9, 8)
"""Index of each point's mirror image."""
LINES = ((0, 1), (2, 3), (4, 5), (6, 7), (8, 9))
"""Pairs drawn as lines: eyes, mouth, nose and brows."""

MEAN_SHAPE = np.array(
    [
        [-44.6, 0.9, -3.0],
        [-18.4, -0.9, 3.0],
        [18.4, -0.9, 3.0],
        [44.6, 0.9, -3.0],
        [-25.4, -68.7, 12.9],
        [25.4, -68.7, 12.9],
        [-6.0, -44.8, 25.2],
        [6.0, -44.8, 25.2],
        [-11.7, 25.7, 18.4],
        [11.7, 25.7, 18.4],
    ]
)
"""(K, 3) mean over identities, neutral, mm."""

SHAPE_SD = np.array(
    [
        [2.6, 1.8, 1.9],
        [1.7, 1.5, 1.6],
        [1.7, 1.5, 1.6],
        [2.6, 1.8, 1.9],
        [2.0, 3.3, 1.4],
        [2.0, 3.3, 1.4],
        [0.7, 1.7, 2.0],
        [0.7, 1.7, 2.0],
        [0.8, 2.3, 2.0],
        [0.8, 2.3, 2.0],
    ]
)
"""(K, 3) standard deviations between identities, mm, after rigid alignment."""
_OUT = np.array(
    [
        [-0.8, 0.0, 1.0],
        [-0.1, 0.0, 1.0],
        [0.1, 0.0, 1.0],
        [0.8, 0.0, 1.0],
        [-0.54, 0.0, 1.0],
        [0.54, 0.0, 1.0],
        [-0.2, -0.5, 1.0],
        [0.2, -0.5, 1.0],
        [-0.1, 0.1, 1.0],
        [0.1, 0.1, 1.0],
    ]
)
POINT_NORMALS = _OUT / np.linalg.norm(_OUT, axis=1, keepdims=True)
"""(K, 3) approximate unit normals of the skin at each point **[ours]**; not from statistics."""

FEATURES = MEAN_SHAPE.copy()
"""(K, 3) mm: places of the image features of an average face in the head's frame.

They differ from ``MEAN_SHAPE`` in two pairs: the detected feature of a nostril is its opening, above the
sill, and that of a brow its dark inner end, below the ridge with the statistics' landmark."""
FEATURES[NOSTRILS] = [[-8.5, -42.0, 26.0], [8.5, -42.0, 26.0]]
FEATURES[BROWS] = [[-15.5, 19.0, 19.0], [15.5, 19.0, 19.0]]

NOSE_BASE = np.array([0.0, -37.0, 26.0])
"""mm: centre of the arc formed by the wings and base of the nose; used in fits only."""
FITTED = np.vstack([FEATURES, NOSE_BASE])
"""(K + 1, 3) mm: points of the average face used in fits."""
FITTED_NORMALS = np.vstack([POINT_NORMALS, [0.0, 0.0, 1.0]])
"""(K + 1, 3) their unit normals."""

FEATURE_SD = np.array([3.5, 3.0, 3.0, 3.5, 6.0, 6.0, 5.0, 5.0, 6.0, 6.0])
"""(K,) mm: combined deviation of identity, expression and detection, for one coordinate **[ours]**."""


def of_kinds(*, eyes: ArrayLike, mouth: ArrayLike, nostrils: ArrayLike, brows: ArrayLike) -> FloatArray:
    """Expand one value per kind of point to (K, ...)."""
    return np.array([eyes] * 4 + [mouth] * 2 + [nostrils] * 2 + [brows] * 2, dtype=np.float64)


for _figures in (MEAN_SHAPE, SHAPE_SD, POINT_NORMALS, FEATURES, FITTED, FITTED_NORMALS, FEATURE_SD):
    _figures.setflags(write=False)


# Poses ``camera_T_head`` and shape models.
#
# The camera is the recording's reference camera (x right, y down, z forward). A tangent vector has six
# entries: translation in camera axes, mm, then a rotation vector w in camera axes, rad, about the head's
# origin: t' = t + d[:3], R' = exp(w) R. For a head that looks at the camera w is (pitch, yaw, roll) to first
# order.

POSE_SIZE = 6
COEFFICIENTS = "coefficients?"
"""Name of the dimension of deformation coefficients in layouts."""


@dataclass(frozen=True, eq=False)
class HeadPose:
    """Pose of a head, or, with a leading dimension n, its poses in n frames.

    Attributes:
        position: (3,) of the head's origin in the reference camera's axes, mm.
        quaternion: (4,) x y z w, w >= 0, rotation of ``camera_T_head``.
    """

    position: Annotated[FloatArray, floats(3)]
    quaternion: Annotated[FloatArray, units(4)]

    @classmethod
    def stacked(cls, poses: Sequence[HeadPose]) -> HeadPose:
        """Stack the poses of several frames."""
        return cls(np.array([one.position for one in poses]), np.array([one.quaternion for one in poses]))

    def of_frame(self, index: int) -> HeadPose:
        """Return the pose of one of several frames."""
        return HeadPose(self.position[index], self.quaternion[index])

    @cached_property
    def rotation(self) -> FloatArray:
        """The (3, 3) rotation matrix R."""
        return matrices_from_quaternions(self.quaternion)

    @cached_property
    def facing(self) -> FloatArray:
        """(3,) unit vector out of the face, in camera axes."""
        return self.rotation[:, 2]

    def points(self, shape: FloatArray) -> FloatArray:
        """Return R m + t, (..., 3) mm in camera axes, of points m (..., 3) in the head's frame."""
        points: FloatArray = shape @ self.rotation.T + self.position
        return points

    def moved(self, tangent: FloatArray) -> HeadPose:
        """Return the pose moved by a tangent vector (6,)."""
        turned = multiply(exponential(tangent[..., 3:]), self.quaternion)
        return HeadPose(self.position + tangent[..., :3], canonical(turned))

    def difference(self, other: HeadPose) -> FloatArray:
        """Return the tangent vector (6,) from this pose to another."""
        turn = logarithm(multiply(other.quaternion, conjugate(self.quaternion)))
        return np.concatenate([other.position - self.position, turn], axis=-1)


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Mean shape and deformation basis of one face.

    Attributes:
        mean: (K, 3) neutral shape in the head's frame, mm.
        basis: (K, 3, B) orthonormal deformation directions; B = 0 for a rigid face.
        deviations: (B,) mu, standard deviation of each coefficient, mm, descending.
    """

    mean: Annotated[FloatArray, floats(POINT_COUNT, 3)]
    basis: Annotated[FloatArray, floats(POINT_COUNT, 3, COEFFICIENTS)]
    deviations: Annotated[FloatArray, floats(COEFFICIENTS, least=0.0)]

    @property
    def size(self) -> int:
        """B, the number of deformation coefficients."""
        return len(self.deviations)

    def shapes(self, coefficients: FloatArray) -> FloatArray:
        """Return the shapes (..., K, 3), mm, of deformation coefficients (..., B), mm."""
        moved = coefficients @ self.basis.reshape(self.mean.size, -1).T
        return self.mean + moved.reshape(*moved.shape[:-1], *self.mean.shape)


def rigid_model(mean: FloatArray) -> ShapeModel:
    """Return the model of a rigid face (K, 3)."""
    return ShapeModel(mean, np.zeros((*mean.shape, 0)), np.zeros(0))


# Image scaling **[ours]**.
#
# The thesis chose patches of 16 x 16 pixels for eye distances of some 60 to 90 pixels. On a larger face they
# cover only a piece of a lid, which a blink or smile changes completely; on a smaller one half of the face,
# with points at different depths, so that rotations are missed. Images are therefore reduced, or magnified
# around the face, once a face was found and again when its distance changes much. Poses in millimetres are
# not affected.

UNSCALED = 1.0
"""Scale of recorded images."""
LEAST_REDUCTION = 0.8
"""Scales between this and its inverse are replaced by 1."""
STEP = 0.25
"""Magnifications are multiples of this, so that every fourth pixel edge coincides with an edge of the
magnified image."""
LARGEST_SIDE_PX = 8192
"""Maximum side of a magnified image."""
RESCALE_RATIO = 1.6
"""The scale changes when the eye distance is off by this factor; a hysteresis against switching."""
MARGIN_PX = 160
"""Margin around a face's points in magnified images: twice the eye distance, farther than patches and windows
reach in a frame."""
_EVERY = round(1.0 / STEP)


class Scaling(NamedTuple):
    """Scaling of a camera's images.

    Attributes:
        wanted_px: target eye distance.
        largest: maximum magnification; 1 disables it.
        camera: unscaled.
    """

    wanted_px: float
    largest: float
    camera: Camera

    def for_face(self, eye_distance_px: float) -> float:
        """Return the scale that brings the eye distance of an unscaled face near the target."""
        scale = self.wanted_px / eye_distance_px
        return UNSCALED if LEAST_REDUCTION < scale <= 1.0 / LEAST_REDUCTION else self.usable(scale)

    def usable(self, scale: float) -> float:
        """Return the nearest supported scale."""
        if scale <= UNSCALED:
            return scale
        largest = min(self.largest, LARGEST_SIDE_PX / max(self.camera.width, self.camera.height))
        return max(min(round(scale / STEP), int(largest / STEP)) * STEP, UNSCALED)

    def updated(self, scale: float, eye_distance_px: float) -> float:
        """Return the scale to use next: unchanged unless the unscaled eye distance requires another."""
        fits = 1.0 / RESCALE_RATIO <= scale * eye_distance_px / self.wanted_px <= RESCALE_RATIO
        return scale if fits else self.for_face(eye_distance_px)


def reduced(frame: Frame, scale: float) -> Frame:
    """Return a frame with its image reduced; unchanged for a scale of 1 or more."""
    (image,) = frame.images
    if scale >= UNSCALED or image is None:
        return frame
    import cv2  # evaluation also works without it

    height, width = (_length(side, scale) for side in image.shape)
    return replace(frame, images=(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA),))


def enlarged(frame: Frame, scale: float, pixels: FloatArray) -> Frame:
    """Return a frame with its image magnified around a face, and black elsewhere.

    Args:
        frame: unscaled.
        scale: above 1, a multiple of ``STEP``.
        pixels: (K, 2) approximate points of the face in the magnified image.
    """
    import cv2

    (image,) = frame.images
    if image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    canvas: ImageArray = np.zeros((height, width), dtype=image.dtype)
    low, high = (np.nan_to_num(end) for end in (np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)))
    sides = np.array(image.shape[::-1])
    # start at a multiple of _EVERY, where the magnified region begins at a whole pixel
    first = np.clip((low - MARGIN_PX) / scale, 0, sides).astype(int) // _EVERY * _EVERY
    behind = np.clip(-(-(high + MARGIN_PX) // scale), 0, sides).astype(int)
    if np.all(behind > first):
        part = image[first[1] : behind[1], first[0] : behind[0]]
        large = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        left, top = np.rint(first * scale).astype(int)
        there = canvas[top : top + large.shape[0], left : left + large.shape[1]]
        there[:] = large[: there.shape[0], : there.shape[1]]
    return replace(frame, images=(canvas,))


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """Return the camera of scaled images: pixel u becomes (u + 1/2) w'/w - 1/2."""
    if scale == UNSCALED:
        return camera
    width, height = _length(camera.width, scale), _length(camera.height, scale)
    across, down = (scale, scale) if scale > UNSCALED else (width / camera.width, height / camera.height)
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * down - 0.5,
    )


def scaled_pixels(pixels: FloatArray, scale: float) -> FloatArray:
    """Return pixels (..., 2) after scaling; for reductions accurate to a thousandth of the image."""
    return pixels if scale == UNSCALED else (pixels + 0.5) * scale - 0.5


def _length(side: int, scale: float) -> int:
    return max(round(side * scale), 1)
