"""Draws hands: the fine mesh in an estimate's pose, by the renderer that the likelihood uses."""

from __future__ import annotations

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, ImageArray
from posetrack_cli.evaluation.metrics.image_consistency import MESH_LEVEL
from posetrack_cli.evaluation.viewing.colours import Colour, lit, shaded
from posetrack_cli.evaluation.viewing.drawing import Shown, SkeletonDrawer
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import JOINT_PARENTS
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.model import HandModel
from posetrack_cli.rendering.port import DepthRenderer, RenderingDevice
from posetrack_cli.rendering.window import Window

_RIM = np.ones((3, 3), np.uint8)


class HandDrawer:
    """Draws a hand's skin; where only joints are known, its skeleton.

    Args:
        device: draws the skin.
        hand: bones and skin.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel) -> None:
        self._device, self._anatomy = device, hand.anatomy
        self._mesh = hand.skin(MESH_LEVEL)
        self._renderer: DepthRenderer | None = None
        self._skeleton = SkeletonDrawer(JOINT_PARENTS, axes=False)

    def depth(self, camera: Camera, shown: Shown) -> Float32Array | None:
        """Depth (h, w), mm, 0 where the hand is not; None where its pose is not known."""
        if shown.position is None or shown.quaternion is None or shown.shape is None:
            return None
        pose = np.concatenate([shown.position, shown.quaternion, shown.shape])
        renderer = self._renderer_of((camera.width, camera.height))
        depth: Float32Array = renderer.depth(
            skinning_transforms(self._anatomy, pose[None]), camera, Window.whole(camera)
        )[0]
        return depth

    def draw(self, picture: ImageArray, camera: Camera, shown: Shown, colour: Colour) -> None:
        """Paint the shaded hand; see ``Drawer``."""
        depth = self.depth(camera, shown)
        if depth is None:
            self._skeleton.draw(picture, camera, shown, colour)
            return
        hand = depth > 0
        if hand.any():
            mm_per_pixel = float(depth[hand].mean()) / camera.fx
            picture[hand] = shaded(np.array(colour), lit(depth, mm_per_pixel))[hand]
            picture[_rim(hand)] = 255

    def outline(self, picture: ImageArray, camera: Camera, shown: Shown, colour: Colour) -> None:
        """Paint the hand's contour."""
        depth = self.depth(camera, shown)
        if depth is None:
            self._skeleton.outline(picture, camera, shown, colour)
        else:
            picture[_rim(depth > 0)] = colour

    def _renderer_of(self, size: tuple[int, int]) -> DepthRenderer:
        """A renderer for pictures of this size; those of one view are all alike."""
        if self._renderer is None or self._renderer.tile != size:
            self._renderer = self._device.depth_renderer(self._mesh, size, 1)
        return self._renderer


def _rim(mask: BoolArray) -> BoolArray:
    """The pixels of a region that touch what is outside."""
    eroded = cv2.erode(mask.astype(np.uint8), _RIM, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return np.asarray(mask & (eroded == 0), dtype=np.bool_)
