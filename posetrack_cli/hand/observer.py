"""What of a frame a tracker looks at, given where it expects the hand."""

from __future__ import annotations

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.observation import Observation, PixelSampler, everything, window_around
from posetrack_cli.hand.segmentation import PredictedHand
from posetrack_cli.hand.segmentation import segment as segment_hand


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
        self._sampler = PixelSampler(camera)

    def observe(self, depth: ImageArray, predicted: FloatArray) -> Observation:
        """Cut the window around a predicted pose (22,) and find the target pixels in it."""
        hand = PredictedHand.of(self._anatomy, predicted)
        window = window_around(hand.joints, self._camera, self._config.observation)
        if not self._segment:
            return everything(self._sampler.sample(depth, window), window)
        settings = self._config.segmentation
        return segment_hand(depth, self._sampler, window, self._camera, hand, settings).observation
