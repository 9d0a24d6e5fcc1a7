"""Several hands in one image: which readings each of them explains **[ours]**.

Trackers of several hands see the same image, each without what the others explain: one tracker per object,
with the others' last renderings as context, is nearly as good as a joint state at linear cost (Kyriazis and
Argyros 2014). The joint likelihood factors over pixels: a pixel belongs to the hand whose surface is nearest
to the reading. For every other hand it is a foreign surface, which hides what is behind it and is no evidence
against it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.skeleton import THUMB
from posetrack_cli.hand.model.forearm import LENGTH_MM, transforms_with_forearm
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.prediction import Silhouette
from posetrack_cli.hand.observe.surfaces import pixel_mm
from posetrack_cli.rendering.port import RenderingDevice, Window

_TILE_PX = 128
_EXPLAINED_MM = 25.0
"""Distance of a reading from a hand's surface up to which the hand explains it, for scale 1."""
_MARGIN_MM = 55.0
"""Margin around the joints of a hand: half a forearm, and ``_EXPLAINED_MM``."""


@dataclass(frozen=True, eq=False)
class SeenHand:
    """A hand in an image.

    Attributes:
        drawer: of its model.
        pose: (22,).
        inner: (6,) inner numbers (``hand.fit.skeleton``), with the forearm's direction if visible.
        is_sure: whether its place is probably right; of two hands, the sure one explains a reading first.
    """

    drawer: HandDrawer
    pose: FloatArray
    inner: FloatArray
    is_sure: bool = True

    @property
    def scale(self) -> float:
        """Return the hand's scale."""
        return self.drawer.scale


class HandDrawer:
    """Draws a hand with its forearm.

    Args:
        device: renders.
        hand: the model.
        camera: pinhole camera of the images.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera) -> None:
        self._renderer = device.depth_renderer(hand.lean_with_arm, (_TILE_PX, _TILE_PX), 1)
        self._anatomy, self._camera, self.scale = hand.anatomy, camera, hand.anatomy.scale

    def window(self, pose: FloatArray, inner: FloatArray) -> Window | None:
        """Return the part of the image around a hand in a pose (22,); None behind or outside the image."""
        joints = joint_positions(self._anatomy, pose[None], inner[THUMB])[0]
        points = np.concatenate([joints, joints[:1] + LENGTH_MM * self.scale * inner[:3]])
        nearest, camera = float(points[:, 2].min()), self._camera
        if nearest <= 1.0:
            return None
        pixels, _ = camera.pixels_from_points(points)
        margin = _MARGIN_MM * self.scale * max(camera.fx, camera.fy) / nearest
        size = np.array([camera.width, camera.height])
        low = np.floor(np.clip(pixels.min(axis=0) - margin, 0, size)).astype(int)
        extent = np.ceil(np.clip(pixels.max(axis=0) + margin, 0, size)).astype(int) - low
        if extent.min() <= 0:
            return None
        step = max(1, -(-int(extent.max()) // _TILE_PX))
        return Window(int(low[0]), int(low[1]), step, _TILE_PX, _TILE_PX)

    def drawn(self, pose: FloatArray, inner: FloatArray, window: Window) -> Silhouette | None:
        """Return the hand in a window; None if it lies outside."""
        transforms = transforms_with_forearm(self._anatomy, pose[None], inner)
        depth = self._renderer.depth(transforms, self._camera, window)[0]
        return Silhouette.of(depth) if depth.any() else None


def without_others(
    depth: ImageArray, own: SeenHand | None, others: Sequence[SeenHand], camera: Camera
) -> ImageArray:
    """Return a depth image whose readings are negative where another hand explains them.

    Args:
        depth: (height, width) mm, 0 = no reading.
        own: the hand that is to be tracked, if its place is known: it keeps what is nearer to it.
        others: further hands.
        camera: pinhole camera of the image.
    """
    out = np.array(depth, dtype=np.float32) if others else depth
    for other in others:
        window = other.drawer.window(other.pose, other.inner)
        if window is None:
            continue
        reach = window.step * _TILE_PX
        part = out[window.top : window.top + reach, window.left : window.left + reach]
        coarse = np.abs(part[:: window.step, :: window.step])
        distance = _distance_mm(coarse, other, window, camera)
        explained = (coarse > 0.0) & (distance < _EXPLAINED_MM * other.scale)
        if own is not None and (own.is_sure or not other.is_sure):
            nearest = distance if own.is_sure == other.is_sure else _EXPLAINED_MM * own.scale
            explained &= _distance_mm(coarse, own, window, camera) > nearest
        fine = _enlarged(explained, window.step, part)
        # at outlines, the pixels between two compared ones may read another surface
        fine &= np.abs(np.abs(part) - _enlarged(coarse, window.step, part)) < _EXPLAINED_MM * other.scale
        part[fine] = -np.abs(part[fine])
    return out


def _enlarged(image: ImageArray, step: int, like: ImageArray) -> ImageArray:
    """Return an image with every pixel repeated, cut to the size of another one."""
    return image.repeat(step, axis=0).repeat(step, axis=1)[: like.shape[0], : like.shape[1]]


def _distance_mm(depth: Float32Array, hand: SeenHand, window: Window, camera: Camera) -> Float32Array:
    """Return the distance (h, w) of readings from the surface of a hand, mm; far outside the window."""
    drawn = hand.drawer.drawn(hand.pose, hand.inner, window)
    if drawn is None:
        return np.full(depth.shape, np.inf, dtype=np.float32)
    rows, columns = (slice(size) for size in depth.shape)
    aside = drawn.outside_px[rows, columns] * pixel_mm(depth, window, camera).astype(np.float32)
    return np.asarray(np.hypot(aside, depth - drawn.depth[rows, columns]), dtype=np.float32)
