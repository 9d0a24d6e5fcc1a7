"""A face's points, their pose, and the scale of its images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, NamedTuple

import cv2
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

# Ten feature points of a face: their names, their order, and what faces have in common.
#
# The head's frame: x to the subject's left, y up, z out of the face, mm; the origin is the mean of the four
# eye corners of the neutral face. A shape is (K, 3), K = 10 rows in the order of ``POINT_NAMES``.
#
# The figures are statistics of ten landmarks over 4000 samples of ICT-FaceKit's identity model (USC Institute
# for Creative Technologies, MIT licence).


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
"""Which point each becomes in a mirror."""
LINES = ((0, 1), (2, 3), (4, 5), (6, 7), (8, 9))
"""Pairs that are drawn as lines, each an eye, the mouth, the nose or the brows."""

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
"""(K, 3) unit vectors out of the skin about each point, roughly, **[ours]**: no statistics give them."""

FEATURES = MEAN_SHAPE.copy()
"""(K, 3) mm: where the image features of an average face lie in the head's frame.

They are ``MEAN_SHAPE`` but for two pairs: what a detector sees of a nostril is its opening, above the sill,
and of a brow its dark inner end, below the ridge that the statistics' landmark is on.
"""
FEATURES[NOSTRILS] = [[-8.5, -42.0, 26.0], [8.5, -42.0, 26.0]]
FEATURES[BROWS] = [[-15.5, 19.0, 19.0], [15.5, 19.0, 19.0]]

NOSE_BASE = np.array([0.0, -37.0, 26.0])
"""mm: middle of the arc that the nose's wings and base form. It guides the fit; no shape has it."""
FITTED = np.vstack([FEATURES, NOSE_BASE])
"""(K + 1, 3) mm: what a mean face is fitted by."""

FEATURE_SD = np.array([3.5, 3.0, 3.0, 3.5, 6.0, 6.0, 5.0, 5.0, 6.0, 6.0])
"""(K,) mm: identity, expression and the detector's error of one coordinate together **[ours]**."""


def of_kinds(*, eyes: ArrayLike, mouth: ArrayLike, nostrils: ArrayLike, brows: ArrayLike) -> FloatArray:
    """Return (K, ...) the value of each point's kind."""
    return np.array([eyes] * 4 + [mouth] * 2 + [nostrils] * 2 + [brows] * 2, dtype=np.float64)


for _figures in (MEAN_SHAPE, SHAPE_SD, POINT_NORMALS, FEATURES, FITTED, FEATURE_SD):
    _figures.setflags(write=False)


# A head's pose ``camera_T_head``, how small changes of it are counted, and how its face deforms.
#
# The camera is the recording's reference camera (x right, y down, z forward). A tangent vector has six
# entries: translation in camera axes, mm, then a rotation vector w in camera axes, rad, about the head's
# origin: t' = t + d[:3], R' = exp(w) R. For a head that looks at the camera w is (pitch, yaw, roll) to first
# order.


POSE_SIZE = 6
COEFFICIENTS = "coefficients?"
"""Name of how many coefficients the deformation of a tracked face has, in layouts."""


@dataclass(frozen=True, eq=False)
class HeadPose:
    """Where one head is, or, with n before each shape, where it is in n frames.

    Attributes:
        position: (3,) of the head's origin in the reference camera's axes, mm.
        quaternion: (4,) x y z w, w >= 0, rotation of ``camera_T_head``.
    """

    position: Annotated[FloatArray, floats(3)]
    quaternion: Annotated[FloatArray, units(4)]

    @classmethod
    def stacked(cls, poses: Sequence[HeadPose]) -> HeadPose:
        """Return the poses of some frames as one."""
        return cls(np.array([one.position for one in poses]), np.array([one.quaternion for one in poses]))

    def of_frame(self, index: int) -> HeadPose:
        """Return the pose in one of several frames."""
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
        """Return R m + t, (..., 3) mm in camera axes, of points m (..., 3) in the frame of one head."""
        points: FloatArray = shape @ self.rotation.T + self.position
        return points

    def moved(self, tangent: FloatArray) -> HeadPose:
        """Return the pose after a tangent vector (6,)."""
        turned = multiply(exponential(tangent[..., 3:]), self.quaternion)
        return HeadPose(self.position + tangent[..., :3], canonical(turned))

    def difference(self, other: HeadPose) -> FloatArray:
        """Return the tangent vector (6,) that takes this pose to the other."""
        turn = logarithm(multiply(other.quaternion, conjugate(self.quaternion)))
        return np.concatenate([other.position - self.position, turn], axis=-1)


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Mean shape and deformation directions of one face.

    Attributes:
        mean: (K, 3) neutral shape in the head's frame, mm.
        basis: (K, 3, B) orthonormal directions of deformation; B = 0 is a rigid face.
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
    """Return the model of a face (K, 3) that does not deform."""
    return ShapeModel(mean, np.zeros((*mean.shape, 0)), np.zeros(0))


# Images scaled to the size that patches are made for **[ours]**.
#
# Patches have 16 x 16 pixels, which the thesis chose for faces whose eyes are some 60 to 90 pixels apart. Of
# a face that fills a large image they show a piece of a lid: a blink or a smile changes all of it. Of a small
# one they show half of the face, so that points which lie at different depths are found to move alike, and a
# turn is lost. Images are reduced, or the face's part of them is enlarged, once it was first found, and anew
# where it comes much nearer or goes away. Poses are in millimetres and do not change.


WHOLE = 1.0
"""The scale of images as recorded."""
LEAST_REDUCTION = 0.8
"""Images that would become hardly smaller, or hardly larger, stay as they are."""
STEP = 0.25
"""Images are enlarged by multiples: then every fourth pixel's edge falls on one of the enlarged image."""
LARGEST_SIDE_PX = 8192
"""No image is enlarged beyond."""
TOO_FAR = 1.6
"""A face is looked at at another scale where its eyes are so many times farther apart than wanted, or as much
less: from thence back it is a long way, so that no head at one place is looked at now so, now so."""
MARGIN_PX = 160
"""Enlarged is what lies no farther from a face's points: twice the eyes' distance, farther than patches and
windows reach in a frame."""
_EVERY = round(1.0 / STEP)


class Scaling(NamedTuple):
    """How a camera's images are scaled.

    Attributes:
        wanted_px: between the eyes of a face.
        largest: no image is enlarged by more; 1 leaves small faces as they are.
        camera: as recorded.
    """

    wanted_px: float
    largest: float
    camera: Camera

    def of_face(self, eye_distance_px: float) -> float:
        """Return the scale that brings a face's eyes, as recorded, to the distance wanted, or nearly so."""
        scale = self.wanted_px / eye_distance_px
        return WHOLE if LEAST_REDUCTION < scale <= 1.0 / LEAST_REDUCTION else self.usable(scale)

    def usable(self, scale: float) -> float:
        """Return the nearest scale that images are looked at at."""
        if scale <= WHOLE:
            return scale
        largest = min(self.largest, LARGEST_SIDE_PX / max(self.camera.width, self.camera.height))
        return max(min(round(scale / STEP), int(largest / STEP)) * STEP, WHOLE)

    def fitting(self, scale: float, eye_distance_px: float) -> float:
        """Return the scale to go on with: the same unless eyes so far apart, as recorded, ask for another."""
        fits = 1.0 / TOO_FAR <= scale * eye_distance_px / self.wanted_px <= TOO_FAR
        return scale if fits else self.of_face(eye_distance_px)


def reduced(frame: Frame, scale: float) -> Frame:
    """Return a frame with its image reduced; as it is for a scale of 1 or more."""
    (image,) = frame.images
    if scale >= WHOLE or image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    return replace(frame, images=(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA),))


def enlarged(frame: Frame, scale: float, pixels: FloatArray) -> Frame:
    """Return a frame with its image enlarged about a face, and black elsewhere.

    Args:
        frame: as recorded.
        scale: above 1, a multiple of ``STEP``.
        pixels: (K, 2) of the face, about, in the enlarged image.
    """
    (image,) = frame.images
    if image is None:
        return frame
    height, width = (_length(side, scale) for side in image.shape)
    canvas: ImageArray = np.zeros((height, width), dtype=image.dtype)
    low, high = (np.nan_to_num(end) for end in (np.nanmin(pixels, axis=0), np.nanmax(pixels, axis=0)))
    sides = np.array(image.shape[::-1])
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
    """Return the camera of scaled images: pixel u is at (u + 1/2) w'/w - 1/2, of enlarged ones exactly."""
    if scale == WHOLE:
        return camera
    width, height = _length(camera.width, scale), _length(camera.height, scale)
    across, down = (scale, scale) if scale > WHOLE else (width / camera.width, height / camera.height)
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
    """Return where pixels (..., 2) are after scaling; after a reduction to a thousandth of the image."""
    return pixels if scale == WHOLE else (pixels + 0.5) * scale - 0.5


def _length(side: int, scale: float) -> int:
    return max(round(side * scale), 1)
