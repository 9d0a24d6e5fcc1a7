"""What of a frame a tracker looks at, given where it expects the hand."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.observation import Observation, PixelSampler, everything, window_around
from posetrack_cli.hand.outline import LEAST_BROKEN, LEAST_CONTRAST, outline_of
from posetrack_cli.hand.segmentation import Detection, Label, PredictedHand, Segmentation
from posetrack_cli.hand.segmentation import segment as segment_hand
from posetrack_cli.hand.segmentation.surfaces import points_of, without_pinholes
from posetrack_cli.rendering.window import Window

_FOREARM_MM = 160.0
"""Of a detected arm so much behind the wrist is left out of account, besides what lies beyond the window."""
_STEP_MM = 25.0
"""A reading farther from the nearest pixel of a detection's coarse mask is of another surface."""


class Observer:
    """Cuts windows out of depth images and finds the target pixels in them.

    Args:
        config: window and segmentation.
        anatomy: the hand.
        camera: of the depth images.
        segment: whether the hand is told from what is around it; else all readings are targets.
    """

    def __init__(self, config: HandConfig, anatomy: HandAnatomy, camera: Camera, *, segment: bool) -> None:
        self._config, self._anatomy, self._camera, self._segment = config, anatomy, camera, segment
        self.sampler = PixelSampler(camera)

    def observe(self, depth: ImageArray, predicted: FloatArray) -> Observation:
        """Cut the window around a predicted pose (22,) and find the target pixels in it."""
        hand = PredictedHand.of(self._anatomy, predicted)
        window = window_around(hand.joints, self._camera, self._config.observation)
        if not self._segment:
            return everything(self.sampler.sample(depth, window), window)
        settings = self._config.segmentation
        return segment_hand(depth, self.sampler, window, self._camera, hand, settings).observation

    def shows_hand(self, depth: ImageArray, pose: FloatArray, *, is_known: bool) -> bool:
        """Whether a frame shows the outline of a hand in a pose (22,), however well its surface fits.

        Args:
            depth: (height, width) the frame, mm.
            pose: as estimated.
            is_known: whether frames before it did: it then shows none only if nothing is left of one.
        """
        hand = PredictedHand.of(self._anatomy, pose)
        outline = outline_of(depth, self.sampler, self._camera, hand)
        return outline.contrast >= LEAST_CONTRAST or (is_known and outline.broken >= LEAST_BROKEN)

    def observe_detection(self, depth: ImageArray, detection: Detection) -> Observation:
        """Cut the window around a detected hand; what lies beyond its wrist is forearm."""
        corners = _corners_of(detection, self._camera)
        window = window_around(corners, self._camera, self._config.observation)
        tile = self.sampler.sample(depth, window)
        labels = np.where(tile > 0, np.uint8(Label.OTHER), np.uint8(Label.UNREAD))
        read = without_pinholes(self.sampler.sample(depth, detection.window), _STEP_MM)
        surface = _nearest_in(np.where(detection.mask, read, 0.0), detection.window, window)
        labels[(surface > 0) & (tile > 0) & (np.abs(tile - surface) < _STEP_MM)] = Label.HAND
        if detection.wrist is not None and detection.arm is not None:
            offset = points_of(tile, window, self._camera) - detection.wrist
            beyond = (offset @ detection.arm < 0.0) & (np.linalg.norm(offset, axis=2) < _FOREARM_MM)
            labels[beyond & (labels == Label.OTHER)] = Label.FOREARM
        wrist = detection.palm if detection.wrist is None else detection.wrist
        return Segmentation(window, tile, labels, wrist, detection.arm).observation


def _corners_of(detection: Detection, camera: Camera) -> FloatArray:
    """Opposite corners (2, 3) of a detection's mask in the image, at the palm's depth, mm."""
    rows, columns = np.nonzero(detection.mask)
    us, vs = detection.window.columns()[columns], detection.window.rows()[rows]
    pixels = np.array([[us.min(), vs.min()], [us.max(), vs.max()]], dtype=np.float64)
    return camera.points_from_pixels(pixels, np.full(2, detection.palm[2]))


def _nearest_in(image: ImageArray, coarse: Window, window: Window) -> ImageArray:
    """Values of an image over one window at the nearest pixels of another; 0 outside."""
    rows = np.rint((window.rows() - coarse.top) / coarse.step).astype(np.int64)
    columns = np.rint((window.columns() - coarse.left) / coarse.step).astype(np.int64)
    inside = np.ix_((rows >= 0) & (rows < coarse.height), (columns >= 0) & (columns < coarse.width))
    clipped = np.ix_(np.clip(rows, 0, coarse.height - 1), np.clip(columns, 0, coarse.width - 1))
    out = np.zeros((window.height, window.width), dtype=image.dtype)
    out[inside] = image[clipped][inside]
    return out
