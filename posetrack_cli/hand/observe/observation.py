"""What of a depth image the likelihood looks at: a window around the prediction, and in it the hand."""

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

_LEAST_SHARE = 0.8
"""Of ``window_mm``: a window is at least so large."""
_MARGIN_MM = 12.0
"""Around the joints: a finger's radius and a little of its motion."""


IGNORED = -1.0
"""What an image holds where nothing counts: a reading so near that it hides whatever may be there."""


@dataclass(frozen=True, eq=False)
class Observation:
    """A window of a depth image.

    Attributes:
        window: which pixels.
        image: (tile, tile) float32: depth of target pixels, mm: the hand's, and its forearm's where one is
            explained; negative: reading of something else, ``IGNORED`` where nothing counts; 0: no reading.
        target_pixels: how many there are.
        inner: (6,) as expected of the frame, or as fits found them (``hand.fit.skeleton``); the direction
            of a forearm is 0 where none is explained.
        wrist: (3,) where hand and forearm are expected to meet, mm.
        reversed: whether the limb goes on where fingers are expected, and ends where the forearm is.
    """

    window: Window
    image: Float32Array
    target_pixels: int
    inner: FloatArray = field(default_factory=NO_INNER.copy)
    wrist: FloatArray = field(default_factory=NO_INNER[:3].copy)
    reversed: bool = False

    def every(self, step: int) -> Observation:
        """The same, of every ``step``-th pixel in both directions."""
        image = np.ascontiguousarray(self.image[::step, ::step])
        shape, window = image.shape, self.window
        coarser = Window(window.left, window.top, step * window.step, shape[1], shape[0])
        return replace(self, window=coarser, image=image, target_pixels=int(np.count_nonzero(image > 0)))


class PixelSampler:
    """Samples depth images at the undistorted pixels of a window; 0 outside the image.

    Depth is never interpolated: a value between hand and wall exists nowhere.
    """

    def __init__(self, camera: Camera) -> None:
        self._size = (camera.height, camera.width)
        self._lookup = _undistorting_lookup(camera) if camera.is_distorted else None

    def sample(self, depth: ImageArray, window: Window) -> Float32Array:
        """Return the (height, width) float32 tile of a depth image, mm."""
        rows, columns = window.rows(), window.columns()
        inside_rows, inside_columns = (
            (index >= 0) & (index < size) for index, size in zip((rows, columns), self._size, strict=True)
        )
        tile = np.zeros((window.height, window.width), dtype=np.float32)
        part = np.ix_(rows[inside_rows], columns[inside_columns])
        tile[np.ix_(inside_rows, inside_columns)] = self._at(depth, part)
        return tile

    def _at(self, depth: ImageArray, part: tuple[IntArray, ...]) -> ImageArray:
        if self._lookup is None:
            return depth[part]
        rows, columns = (axis[part] for axis in self._lookup)
        valid = (rows >= 0) & (rows < self._size[0]) & (columns >= 0) & (columns < self._size[1])
        return np.where(valid, depth[np.where(valid, rows, 0), np.where(valid, columns, 0)], 0.0)


def _undistorting_lookup(camera: Camera) -> tuple[IntArray, IntArray]:
    """For every undistorted pixel the nearest row and column in the image as the sensor gives it."""
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
    """The nearest of ``size`` pixels; -1 or ``size`` where a strong distortion leads outside, or nowhere."""
    inside = np.clip(np.nan_to_num(at, nan=-1.0), -1.0, size)
    return np.rint(inside).astype(np.int64)


def window_around(joints: FloatArray, camera: Camera, settings: ObservationSettings) -> Window:
    """The square window around the projection of a hand's joints (21, 3), mm.

    ``window_px`` fixes its size as the paper does (128); else it spans about ``window_mm`` at the hand's
    depth, in whole steps of pixels, so that every camera and distance is sampled alike, and all joints with a
    margin in any case **[ours]**.
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
    """The least whole step of a tile that spans most of ``window_mm``, and pixels (N, 2) with a margin."""
    extent_px = float(np.ptp(pixels, axis=0).max())
    needed = max(_LEAST_SHARE * settings.window_mm * px_per_mm, extent_px + 2.0 * _MARGIN_MM * px_per_mm)
    return max(1, int(np.ceil(needed / settings.tile_px)))


def everything(tile: Float32Array, window: Window) -> Observation:
    """The paper's observation: every reading in the window is a target."""
    return Observation(window, tile, int(np.count_nonzero(tile)))
