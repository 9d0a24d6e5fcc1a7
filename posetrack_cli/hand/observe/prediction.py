"""A predicted hand and its silhouette, drawn with thick bones."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.skeleton import NO_THUMB
from posetrack_cli.hand.model.anatomy import JOINT_PARENTS, HandAnatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.rendering.port import Window


@dataclass(frozen=True, eq=False)
class PredictedHand:
    """A hand at its predicted pose.

    Attributes:
        pose: (22,).
        joints: (21, 3) mm, camera axes, in the order of ``JOINT_NAMES``.
        scale: of the hand; lengths in settings refer to scale 1.
    """

    pose: FloatArray
    joints: FloatArray
    scale: float

    @classmethod
    def of(cls, anatomy: HandAnatomy, pose: FloatArray, thumb: FloatArray = NO_THUMB) -> PredictedHand:
        """Return the hand of an anatomy in a pose (22,), with inner angles (2,) of its thumb."""
        return cls(pose, joint_positions(anatomy, pose[None], thumb)[0], anatomy.scale)

    @property
    def wrist(self) -> FloatArray:
        """Return the wrist joint (3,), mm."""
        return np.asarray(self.joints[0], dtype=np.float64)

    @property
    def towards_elbow(self) -> FloatArray:
        """Return the unit vector (3,) along the palm, from knuckles to wrist."""
        return np.asarray(rotations.matrices_from_quaternions(self.pose[3:7])[:, 1], dtype=np.float64)


_FINGER_MM, _PALM_MM = 14.0, 24.0
"""Thickness of drawn bones: fingers, and the palm's five, which together cover it."""
_PALM_SKIN_MM, _FINGER_SKIN_MM = 15.0, 7.0
"""Depth of the bones behind the skin."""
_PIECES = 2
"""Pieces per bone, each drawn at constant depth."""
_CHILDREN = np.arange(1, 21)
_PARENTS = np.array(JOINT_PARENTS[1:])
_OF_PALM = _PARENTS == 0
_TIPS = np.arange(3, 20, 4)
_SUBPIXEL_BITS = 4
_FARTHEST_PX = 4000.0


@dataclass(frozen=True, eq=False)
class Silhouette:
    """A predicted hand in a window.

    Attributes:
        mask: (h, w) its pixels.
        depth: (h, w) of its skin, mm; elsewhere that of the nearest covered pixel.
        outside_px: (h, w) distance to the mask, pixels; 0 inside.
    """

    mask: BoolArray
    depth: Float32Array
    outside_px: Float32Array

    @classmethod
    def of(cls, depth: Float32Array) -> Silhouette:
        """Return the silhouette of a drawn hand's depth (h, w), mm, 0 outside and positive somewhere."""
        mask = depth > 0
        outside, nearest = cv2.distanceTransformWithLabels(
            (~mask).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        return cls(mask, _spread(depth, mask, nearest), outside.astype(np.float32, copy=False))

    def hidden_by(self, tile: Float32Array) -> BoolArray:
        """Return the pixels (h, w) of a tile where another hand, of negative readings, is in front."""
        hidden: BoolArray = (tile < 0.0) & (-tile < self.depth)
        return hidden


def silhouette_of(joints: FloatArray, scale: float, window: Window, camera: Camera) -> Silhouette | None:
    """Draw a hand with joints (21, 3), mm; None outside the window."""
    depth = np.zeros((window.height, window.width), dtype=np.float32)
    for start, end, z, thickness in _pieces(joints, scale, window, camera):
        cv2.line(depth, start, end, z, thickness, cv2.LINE_8, _SUBPIXEL_BITS)
    return Silhouette.of(depth) if depth.any() else None


def _spread(depth: Float32Array, mask: BoolArray, nearest: ImageArray) -> Float32Array:
    """Assign to every pixel the depth of the nearest covered pixel."""
    of_label = np.zeros(int(nearest.max()) + 1, dtype=np.float32)
    of_label[nearest[mask]] = depth[mask]
    spread: Float32Array = of_label[nearest]
    return spread


def _pieces(
    joints: FloatArray, scale: float, window: Window, camera: Camera
) -> list[tuple[tuple[int, int], tuple[int, int], float, int]]:
    """Return start, end (fixed point), depth and thickness of the pieces, the farthest first."""
    shares = np.linspace(0.0, 1.0, _PIECES + 1)[:, None, None]
    starts, ends = joints[_PARENTS], joints[_CHILDREN].copy()
    ends[_TIPS] -= _inwards(ends[_TIPS] - starts[_TIPS], 0.5 * _FINGER_MM * scale)
    stations = (1.0 - shares) * starts + shares * ends  # (pieces + 1, 20, 3)
    safe = stations[..., 2] > 1.0
    pixels, _ = camera.pixels_from_points(np.where(safe[..., None], stations, 1.0))
    tile = (pixels - [window.left, window.top]) / window.step
    fixed = np.rint(np.clip(tile, -_FARTHEST_PX, _FARTHEST_PX) * (1 << _SUBPIXEL_BITS)).astype(int)
    middle = 0.5 * (stations[:-1, :, 2] + stations[1:, :, 2])
    thick = np.where(_OF_PALM, _PALM_MM, _FINGER_MM) * scale
    across = np.sqrt(camera.fx * camera.fy) / window.step * thick / np.maximum(middle, 1.0)
    widths = np.maximum(1, np.rint(np.minimum(across, 255.0))).astype(int)
    skin = np.maximum(middle - np.where(_OF_PALM, _PALM_SKIN_MM, _FINGER_SKIN_MM) * scale, 1.0)
    drawn, order = (safe[:-1] & safe[1:]).ravel(), np.argsort(-middle, axis=None, kind="stable")
    order = order[drawn[order]]
    columns = fixed[:-1].reshape(-1, 2), fixed[1:].reshape(-1, 2), skin.ravel(), widths.ravel()
    begin, end, depths, across_px = (
        column[order].tolist() for column in columns
    )  # OpenCV needs Python numbers
    return list(zip(map(tuple, begin), map(tuple, end), depths, across_px, strict=True))


def _inwards(bones: FloatArray, mm: float) -> FloatArray:
    """Return vectors of a length along bones (N, 3), by which a thick line overshoots its end."""
    lengths = np.linalg.norm(bones, axis=1, keepdims=True)
    return np.asarray(bones * np.minimum(1.0, mm / np.maximum(lengths, 1e-9)), dtype=np.float64)
