"""Observations of a frame, given the predicted hand.

The cost alone cannot distinguish a hand from a wall: its pixels are cut out around the prediction, from a
wall as readily as from a body that the hand touches. But a wall has no outline, which is measured here as
well.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig, ObservationSettings
from posetrack_cli.hand.fit.skeleton import NO_INNER, NO_THUMB, THUMB
from posetrack_cli.hand.model.anatomy import HandAnatomy
from posetrack_cli.hand.model.forearm import forearm_confidence
from posetrack_cli.hand.observe.arm import is_forearm
from posetrack_cli.hand.observe.detection import Detection
from posetrack_cli.hand.observe.observation import Observation, PixelSampler, everything, window_around
from posetrack_cli.hand.observe.prediction import PredictedHand, silhouette_of
from posetrack_cli.hand.observe.region import thin_mask
from posetrack_cli.hand.observe.segmentation import Label, Segmentation
from posetrack_cli.hand.observe.segmentation import segment as segment_hand
from posetrack_cli.hand.observe.surfaces import pixel_mm, points_of, without_pinholes
from posetrack_cli.rendering.port import Window

MIN_CONTRAST, MIN_BROKEN = 0.25, 0.15
"""Thresholds for an untracked hand (contrast) and a tracked one (broken share).

Contrast is 0.0 on a bare wall, at most 0.1 on a noisy one and 0.15 at a step; on tracked hands 0.3 to 1.0,
less where the estimate is misplaced. The broken share is at most 0.05 on walls and steps.
"""
_VIEW = ObservationSettings(window_mm=300.0)
"""Window for the hand and its surroundings, independent of the likelihood's."""
_BESIDE_MM = (8.0, 20.0)
"""Distance of the surroundings from the drawn bones: beyond any skin."""
_CLEAR_STEP_MM, _BREAK_MM = 10.0, 15.0
"""Depth step that counts fully, a finger's height above its background; and the smallest one above noise."""
_FAR_MM = np.float32(1e9)
_BLOCK = np.ones((3, 3), np.uint8)


class Outline(NamedTuple):
    """Depth steps around a hand's outline **[ours]**.

    With y_out the readings next to the hand and y_in the reading of the nearest pixel well inside it; a
    missing reading counts as far away.

    Attributes:
        contrast: -1 to 1, the mean of clip((y_out - y_in) / 10 mm, -1, 1). It is antisymmetric in y_out and
            y_in, so it is 0 on any surface that looks the same on both sides: bare, tilted, noisy or with
            holes.
        broken: share of |y_out - y_in| > 15 mm. It is also high for a misplaced estimate whose fingers lie
            over gaps.
        visible: share of the hand that no other hand hides. Hidden parts count in neither figure.
    """

    contrast: float
    broken: float
    visible: float = 1.0

    def shows_hand(self, *, is_known: bool) -> bool:
        """Return whether there is the outline of a hand, regardless of the fit of its surface.

        Args:
            is_known: whether the hand was tracked before; then it is only lost if nothing is left of its
                outline.
        """
        return self.contrast >= MIN_CONTRAST or (is_known and self.broken >= MIN_BROKEN)


def outline_of(depth: ImageArray, sampler: PixelSampler, camera: Camera, hand: PredictedHand) -> Outline:
    """Measure the outline of a hand in a frame.

    Args:
        depth: (height, width) the frame, mm, 0 = no reading.
        sampler: of the camera.
        camera: its camera.
        hand: the estimated hand.

    Returns:
        The outline; fully broken if its surroundings lie outside the image, which is not evidence against a
        hand.
    """
    window = window_around(hand.joints, camera, _VIEW)
    silhouette = silhouette_of(hand.joints, hand.scale, window, camera)
    if silhouette is None:
        return Outline(0.0, 0.0)
    sampled = sampler.sample(depth, window)
    hidden = silhouette.hidden_by(sampled)
    visible = 1.0 - float(hidden[silhouette.mask].mean())
    sampled = np.abs(sampled)
    readings = np.asarray(cv2.medianBlur(np.where(sampled > 0, sampled, _FAR_MM), 3), dtype=np.float32)
    core = _core_of(silhouette.mask) & ~hidden
    if not core.any():
        return Outline(1.0, 1.0, visible)
    distance_px, inside = _nearest_inside(readings, core)
    distance_mm = distance_px * pixel_mm(float(hand.joints[:, 2].mean()), window, camera) / hand.scale
    surroundings = (distance_mm > _BESIDE_MM[0]) & (distance_mm < _BESIDE_MM[1]) & _in_image(window, camera)
    surroundings &= ~hidden
    if not surroundings.any():
        return Outline(1.0, 1.0, visible)
    steps = (readings - inside)[surroundings]
    contrast = float(np.clip(steps / _CLEAR_STEP_MM, -1.0, 1.0).mean())
    return Outline(contrast, float((np.abs(steps) > _BREAK_MM).mean()), visible)


def _core_of(mask: BoolArray) -> BoolArray:
    """Return the pixels well inside a mask (h, w); all of a thin one."""
    core: BoolArray = cv2.erode(mask.astype(np.uint8), _BLOCK) > 0
    return core if core.any() else mask


def _nearest_inside(readings: Float32Array, core: BoolArray) -> tuple[Float32Array, Float32Array]:
    """Return distance (h, w), pixels, to the nearest pixel of a mask (h, w), and its reading, mm."""
    distance, nearest = cv2.distanceTransformWithLabels(
        (~core).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(int(nearest.max()) + 1, dtype=np.float32)
    of_label[nearest[core]] = readings[core]
    return distance.astype(np.float32, copy=False), of_label[nearest]


def _in_image(window: Window, camera: Camera) -> ImageArray:
    """Return the mask (h, w) of a window's pixels inside the image."""
    rows, columns = window.rows(), window.columns()
    return np.outer((rows >= 0) & (rows < camera.height), (columns >= 0) & (columns < camera.width))


class ThinPart(NamedTuple):
    """The parts of an observed hand that are as thin as fingers.

    Attributes:
        points: (h, w, 3) of all pixels, camera axes, mm.
        apart: distance of neighbouring pixels at the hand's depth, mm.
        hand: (h, w) target pixels in front of the forearm; all of them without one.
        thin: (h, w) the thin ones among them.
    """

    points: FloatArray
    apart: float
    hand: BoolArray
    thin: BoolArray


def thin_part(observation: Observation, camera: Camera, scale: float = 1.0) -> ThinPart:
    """Return the parts that no disc thicker than a finger covers (``region.thin_mask``).

    Args:
        observation: with at least one target pixel.
        camera: of the depth image.
        scale: of the hand.
    """
    image, window = observation.image, observation.window
    target = image > 0
    apart = float(pixel_mm(float(np.median(image[target])), window, camera))
    points = points_of(image, window, camera).astype(np.float64)
    hand = target & ((points - observation.wrist) @ observation.inner[:3] <= 0.0)
    return ThinPart(points, apart, hand, thin_mask(target, apart / scale) & hand)


_FOREARM_MM = 160.0
"""Length of a detected arm behind the wrist that is ignored."""
_STEP_MM = 25.0
"""Depth difference to the detection's coarse mask from which a reading is on another surface."""


class Observer:
    """Cuts windows out of depth images and segments them.

    Args:
        config: window and segmentation.
        anatomy: the hand.
        camera: of the depth images.
        segment: separate the hand from its surroundings; else all readings are targets.
        with_arm: include the forearm in the targets, for a likelihood that models it; else it is cut off.
        follows: whether predictions are of a tracked hand, not hypotheses.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        camera: Camera,
        *,
        segment: bool,
        with_arm: bool = False,
        follows: bool = False,
    ) -> None:
        self._config, self.anatomy, self._camera = config, anatomy, camera
        self._segment, self._with_arm, self._follows = segment, with_arm, follows
        self.sampler = PixelSampler(camera)

    def observe(
        self, depth: ImageArray, predicted: FloatArray, expected: FloatArray = NO_INNER
    ) -> Observation:
        """Cut the window around a predicted pose (22,) and find its target pixels.

        Args:
            depth: (height, width) the frame, mm.
            predicted: (22,).
            expected: (6,) predicted inner numbers; the forearm's direction is not used.
        """
        hand = PredictedHand.of(self.anatomy, predicted, expected[THUMB])
        window = window_around(hand.joints, self._camera, self._config.observation)
        if not self._segment:
            return everything(self.sampler.sample(depth, window), window)
        found = segment_hand(depth, self.sampler, window, self._camera, hand, is_followed=self._follows)
        return self._observation(found, expected)

    def _observation(self, found: Segmentation, expected: FloatArray) -> Observation:
        return found.observation_with_inner(expected) if self._with_arm else found.observation

    def fingers_mm2(self, observation: Observation) -> float:
        """Return the finger-thin area of the hand without forearm, mm^2 (``Detection.fingers_mm2``)."""
        if not observation.target_pixels:
            return 0.0
        thin = thin_part(observation, self._camera).thin
        apart = pixel_mm(observation.image[thin], observation.window, self._camera)
        return float(np.square(apart).sum())

    def outline(self, depth: ImageArray, pose: FloatArray, thumb: FloatArray = NO_THUMB) -> Outline:
        """Measure the outline of a hand in a pose (22,) in a frame (height, width), mm.

        Args:
            depth: the frame.
            pose: of the hand.
            thumb: (2,) its inner angles.
        """
        return outline_of(depth, self.sampler, self._camera, PredictedHand.of(self.anatomy, pose, thumb))

    def forearm_confidence(self, depth: ImageArray, window: Window, drawn: Float32Array) -> float:
        """Return how well a frame (height, width), mm, supports a forearm rendered (h, w) in a window."""
        camera, step = self._camera, window.step
        return forearm_confidence(
            drawn,
            np.abs(self.sampler.sample(depth, window)),
            _in_image(window, camera),
            drawn * (step / np.sqrt(camera.fx * camera.fy) / self.anatomy.scale),
            self._config.observation.unread_weight,
        )

    def observe_detection(self, depth: ImageArray, detection: Detection) -> Observation:
        """Cut the window around a detected hand; pixels beyond its wrist are forearm."""
        corners = _corners_of(detection, self._camera)
        window = window_around(corners, self._camera, self._config.observation)
        tile = self.sampler.sample(depth, window)
        labels = np.where(tile != 0, np.uint8(Label.OTHER), np.uint8(Label.UNREAD))
        coarse = np.maximum(self.sampler.sample(depth, detection.window), np.float32(0.0))
        read = without_pinholes(coarse, _STEP_MM)
        surface = _nearest_in(np.where(detection.mask, read, 0.0), detection.window, window)
        labels[(surface > 0) & (tile > 0) & (np.abs(tile - surface) < _STEP_MM)] = Label.HAND
        if detection.wrist is not None and detection.arm is not None:
            offset = points_of(tile, window, self._camera) - detection.wrist
            beyond = (offset @ detection.arm < 0.0) & (np.linalg.norm(offset, axis=2) < _FOREARM_MM)
            beyond &= labels == Label.OTHER
            near = is_forearm(offset[beyond], -detection.arm, self.anatomy.scale)
            labels[beyond] = np.where(near, Label.FOREARM, Label.BEYOND)
        wrist = detection.palm if detection.wrist is None else detection.wrist
        found = Segmentation(window, np.abs(tile), labels, wrist, detection.arm)
        return self._observation(found, NO_INNER)


def _corners_of(detection: Detection, camera: Camera) -> FloatArray:
    """Return opposite corners (2, 3) of a detection's mask, at the palm's depth, mm."""
    rows, columns = np.nonzero(detection.mask)
    us, vs = detection.window.columns()[columns], detection.window.rows()[rows]
    pixels = np.array([[us.min(), vs.min()], [us.max(), vs.max()]], dtype=np.float64)
    return camera.points_from_pixels(pixels, np.full(2, detection.palm[2]))


def _nearest_in(image: ImageArray, coarse: Window, window: Window) -> ImageArray:
    """Resample an image from one window to another by nearest pixel; 0 outside."""
    rows = np.rint((window.rows() - coarse.top) / coarse.step).astype(np.int64)
    columns = np.rint((window.columns() - coarse.left) / coarse.step).astype(np.int64)
    inside = np.ix_((rows >= 0) & (rows < coarse.height), (columns >= 0) & (columns < coarse.width))
    clipped = np.ix_(np.clip(rows, 0, coarse.height - 1), np.clip(columns, 0, coarse.width - 1))
    out = np.zeros((window.height, window.width), dtype=image.dtype)
    out[inside] = image[clipped][inside]
    return out
