"""What of a frame a tracker looks at, given where it expects the hand."""

from __future__ import annotations

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.observation import Observation, PixelSampler, everything, segmented, window_around


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
        joints = joint_positions(self._anatomy, predicted[None])[0]
        window = window_around(joints, self._camera, self._config.observation)
        tile = self._sampler.sample(depth, window)
        if not self._segment:
            return everything(tile, window)
        settings, scale = self._config.segmentation, self._anatomy.scale
        return segmented(tile, window, self._camera, predicted, joints, settings, scale)
