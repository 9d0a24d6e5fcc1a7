"""Window of a depth image, as used by the likelihood."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera, pixel_map
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.skeleton import NO_INNER
from posetrack_cli.rendering.port import Window

_MIN_SHARE = 0.8
"""Smallest window, as a share of ``window_mm``."""
_MARGIN_MM = 12.0
"""Margin around the joints: a finger's radius and some motion."""


IGNORED = -1.0
"""Value of ignored pixels: readings so near that they may hide anything."""


@dataclass(frozen=True, eq=False)
class Observation:
    """A segmented window of a depth image.

    Attributes:
        window: its pixels.
        image: (tile, tile) float32 depth of target pixels, mm: the hand's, and its forearm's if modelled;
            negative: other readings, ``IGNORED`` for pixels that do not count; 0: no reading.
        target_pixels: number of target pixels.
        inner: (6,) inner numbers (``hand.fit.skeleton``), predicted or fitted; the forearm's direction is 0
            without one.
        wrist: (3,) expected boundary of hand and forearm, mm.
        reversed: whether the limb continues where fingers are expected, and ends where the forearm is.
        hidden: share of the predicted hand that another hand hides.
    """

    window: Window
    image: Float32Array
    target_pixels: int
    inner: FloatArray = field(default_factory=NO_INNER.copy)
    wrist: FloatArray = field(default_factory=NO_INNER[:3].copy)
    reversed: bool = False
    hidden: float = 0.0

    def every(self, step: int) -> Observation:
        """Return the observation at every ``step``-th pixel in both directions."""
        image = np.ascontiguousarray(self.image[::step, ::step])
        shape, window = image.shape, self.window
        coarser = Window(window.left, window.top, step * window.step, shape[1], shape[0])
        return replace(self, window=coarser, image=image, target_pixels=int(np.count_nonzero(image > 0)))


class PixelSampler:
    """Samples depth images at the undistorted pixels of a window; 0 outside the image.

    Nearest pixel, as interpolated depth between hand and wall exists nowhere. In images of several hands, a
    negative reading is explained by another hand (``observe.others``): it is a surface that may hide the
    hand, but never its own.
    """

    def __init__(self, camera: Camera) -> None:
        self._size = (camera.height, camera.width)
        self._lookup = _undistorting_lookup(camera) if camera.is_distorted else None

    def sample(self, depth: ImageArray, window: Window) -> Float32Array:
        """Return the (height, width) float32 tile of a depth image, mm."""
        tile = np.zeros((window.height, window.width), dtype=np.float32)
        into, part = zip(*map(_inside, (window.rows(), window.columns()), self._size), strict=True)
        tile[into] = self._at(depth, part)
        return tile

    def _at(self, depth: ImageArray, part: tuple[slice, ...]) -> ImageArray:
        if self._lookup is None:
            return depth[part]
        rows, columns = (axis[part] for axis in self._lookup)
        valid = (rows >= 0) & (rows < self._size[0]) & (columns >= 0) & (columns < self._size[1])
        return np.where(valid, depth[np.where(valid, rows, 0), np.where(valid, columns, 0)], 0.0)


def _inside(index: IntArray, size: int) -> tuple[slice, slice]:
    """Return which of equally spaced pixels of an axis are inside the image, and these pixels."""
    inside = np.flatnonzero((index >= 0) & (index < size))
    if not inside.size:
        return slice(0), slice(0)
    first, last = int(inside[0]), int(inside[-1])
    step = int(index[1] - index[0]) if len(index) > 1 else 1
    return slice(first, last + 1), slice(int(index[first]), int(index[last]) + 1, step)


def _undistorting_lookup(camera: Camera) -> tuple[IntArray, IntArray]:
    """Return row and column in the distorted image for every undistorted pixel."""
    if camera.distortion_model == "inverse_brown_conrady":  # which OpenCV does not have
        across, down = pixel_map(replace(camera, distortion=()), camera)
        return _nearest(down, camera.height), _nearest(across, camera.width)
    size = (camera.width, camera.height)
    coefficients = np.asarray(camera.distortion)
    fisheye = camera.distortion_model == "equidistant"
    make_maps: Any = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    across, down = make_maps(camera.matrix, coefficients, np.eye(3), camera.matrix, size, cv2.CV_32FC1)
    return _nearest(down, camera.height), _nearest(across, camera.width)


def _nearest(at: Float32Array, size: int) -> IntArray:
    """Return the nearest of ``size`` pixels; -1 or ``size`` where the distortion leads outside the image."""
    inside = np.clip(np.nan_to_num(at, nan=-1.0), -1.0, size)
    return np.rint(inside).astype(np.int64)


def window_around(joints: FloatArray, camera: Camera, settings: ObservationSettings) -> Window:
    """Return the square window around the projected joints (21, 3), mm, of a hand.

    ``window_px`` fixes its size as in the paper (128). Otherwise it spans about ``window_mm`` at the hand's
    depth, in whole pixel steps, so that sampling does not depend on camera and distance; it always includes
    all joints with a margin **[ours]**.
    """
    centre = joints.mean(axis=0)
    z = max(float(centre[2]), 1.0)
    pixels, _ = camera.pixels_from_points(np.column_stack([joints[:, :2], np.full(len(joints), z)]))
    step = max(1, round(settings.window_px / settings.tile_px)) if settings.window_px else 0
    step = step or _covering_step(pixels, camera.fx / z, settings)
    # a prediction far outside the image still gives a window, with nothing in it
    limit = 2.0 * np.array([camera.width, camera.height])
    middle = 0.5 * (pixels.min(axis=0) + pixels.max(axis=0))
    return Window.around(np.clip(middle, -limit, 2.0 * limit), settings.tile_px, step)


def _covering_step(pixels: FloatArray, px_per_mm: float, settings: ObservationSettings) -> int:
    """Return the least step of a tile that covers most of ``window_mm`` and pixels (N, 2) with a margin."""
    extent_px = float(np.ptp(pixels, axis=0).max())
    needed = max(_MIN_SHARE * settings.window_mm * px_per_mm, extent_px + 2.0 * _MARGIN_MM * px_per_mm)
    return max(1, int(np.ceil(needed / settings.tile_px)))


def everything(tile: Float32Array, window: Window) -> Observation:
    """Return the paper's observation: every reading in the window is a target."""
    return Observation(window, tile, int(np.count_nonzero(tile)))
