"""Drawing of hands: shaded mesh, contours and segmentation."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.evaluation.measuring.image_consistency import MESH_LEVEL
from posetrack_cli.evaluation.viewing.drawing import Canvas, Colour, Shown, SkeletonDrawer, lit, shaded
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.skeleton import THUMB, inner_of
from posetrack_cli.hand.model.anatomy import JOINT_PARENTS, HandAnatomy
from posetrack_cli.hand.model.forearm import LEAST_CONFIDENCE, transforms_with_forearm
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.observe.observation import PixelSampler, window_around
from posetrack_cli.hand.observe.prediction import PredictedHand
from posetrack_cli.hand.observe.segmentation import Label, Segmentation, segment
from posetrack_cli.hand.start import forearm_confidence_of
from posetrack_cli.rendering.port import DepthRenderer, RenderingDevice, Window

Box: TypeAlias = tuple[slice, slice]
_RIM = np.ones((3, 3), np.uint8)


LABEL_COLOURS: dict[Label, Colour] = {
    Label.UNREAD: (90, 30, 90),
    Label.HAND: (90, 200, 90),
    Label.FOREARM: (40, 150, 255),
    Label.OTHER: (170, 120, 80),
    Label.BEYOND: (60, 110, 170),
}
_OPACITY = 0.7


_KEPT = 4
"""Number of rendered estimates to keep: one frame's panels show the same estimates and ground truths."""


@dataclass(frozen=True, eq=False)
class _Surface:
    """A rendered estimate.

    Attributes:
        box: rows and columns of the picture around the hand.
        hand: (h, w) pixels of the hand in the box.
        light: (n,) brightness of these pixels, 0 to 1.
        rim: (h, w) its contour in the box.
        arm_box, arm_rim: likewise for the forearm, except on the hand; None if it is not shown.
    """

    box: Box
    hand: BoolArray
    light: FloatArray
    rim: BoolArray
    arm_box: Box
    arm_rim: BoolArray | None


class HandDrawer:
    """Draws the skin of a hand, or its skeleton if only the joints are known.

    Args:
        device: rendering device.
        hand: hand model.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel) -> None:
        self._device, self._hand = device, hand
        self._renderers: dict[bool, DepthRenderer] = {}
        self._skeleton = SkeletonDrawer(JOINT_PARENTS, axes=False)
        self._kept: deque[tuple[Shown, Camera, _Surface]] = deque(maxlen=_KEPT)

    def depth(self, camera: Camera, shown: Shown) -> Float32Array | None:
        """Return the depth (h, w) of the hand, mm, 0 for background; None if the pose is unknown."""
        if shown.position is None or shown.quaternion is None or shown.shape is None:
            return None
        bones = skinning_transforms(self._hand.anatomy, _pose_of(shown)[None], _thumb_of(shown))
        depth: Float32Array = self._renderer(camera, with_arm=False).depth(
            bones, camera, Window.whole(camera)
        )[0]
        return depth

    def draw(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw the shaded hand; see ``Drawer``."""
        surface = self._surface(canvas.camera, shown)
        if surface is None:
            self._skeleton.draw(canvas, shown, colour)
            return
        part = canvas.picture[surface.box]
        part[surface.hand] = shaded(np.array(colour), surface.light)
        part[surface.rim] = 255
        self._outline_arm(canvas, surface)

    def outline(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw the contour of the hand."""
        surface = self._surface(canvas.camera, shown)
        if surface is None:
            self._skeleton.draw(canvas, shown, colour)  # thin lines, visible on a filled hand
        else:
            canvas.picture[surface.box][surface.rim] = colour
            self._outline_arm(canvas, surface)

    def _outline_arm(self, canvas: Canvas, surface: _Surface) -> None:
        if surface.arm_rim is not None:
            canvas.picture[surface.arm_box][surface.arm_rim] = LABEL_COLOURS[Label.FOREARM]

    def _surface(self, camera: Camera, shown: Shown) -> _Surface | None:
        """Return an estimate as rendered for a picture; None if the pose is unknown."""
        for kept, its_camera, surface in self._kept:
            if kept is shown and its_camera == camera:
                return surface
        depth = self.depth(camera, shown)
        if depth is None:
            return None
        whole = depth > 0
        box, arm_rim = _box(whole), self._arm_rim(camera, shown, whole)
        hand = whole[box]
        mm_per_pixel = float(depth[box][hand].mean()) / camera.fx if hand.any() else 0.0
        light = lit(depth[box], mm_per_pixel)[hand] if hand.any() else np.empty(0)
        arm_box = box if arm_rim is None else _box(arm_rim)
        arm_part = None if arm_rim is None else arm_rim[arm_box]
        surface = _Surface(box, hand, light, _rim(hand), arm_box, arm_part)
        self._kept.append((shown, camera, surface))
        return surface

    def _arm_rim(self, camera: Camera, shown: Shown, hand: BoolArray) -> BoolArray | None:
        """Return the contour (h, w) of a confident forearm estimate, except on the pixels of the hand."""
        inner = inner_of(shown.numbers)
        if not inner[:3].any() or forearm_confidence_of(shown.numbers) < LEAST_CONFIDENCE:
            return None
        bones = transforms_with_forearm(self._hand.anatomy, _pose_of(shown)[None], inner)
        depth = self._renderer(camera, with_arm=True).depth(bones, camera, Window.whole(camera))[0]
        return _rim((depth > 0) & ~hand)

    def _renderer(self, camera: Camera, *, with_arm: bool) -> DepthRenderer:
        """Return the renderer for the picture size, which is the same for all pictures of a view."""
        size = (camera.width, camera.height)
        if with_arm not in self._renderers or self._renderers[with_arm].tile != size:
            mesh = self._hand.smooth_with_arm if with_arm else self._hand.skin(MESH_LEVEL)
            self._renderers[with_arm] = self._device.depth_renderer(mesh, size, 1)
        return self._renderers[with_arm]


def _pose_of(shown: Shown) -> FloatArray:
    """Return the pose (22,) of a complete estimate."""
    assert shown.position is not None and shown.quaternion is not None and shown.shape is not None
    return np.concatenate([shown.position, shown.quaternion, shown.shape])


def _thumb_of(shown: Shown) -> FloatArray:
    """Return the inner angles (2,) of the thumb."""
    return inner_of(shown.numbers)[THUMB]


def _box(mask: BoolArray) -> Box:
    """Return rows and columns around the pixels of a mask, with a border of one pixel inside the image."""
    left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
    return slice(max(top - 1, 0), top + height + 1), slice(max(left - 1, 0), left + width + 1)


def _rim(mask: BoolArray) -> BoolArray:
    """Return the boundary pixels of a region."""
    # A border value of 1 keeps the edge of the image from being drawn as a contour.
    eroded = cv2.erode(mask.astype(np.uint8), _RIM, borderType=cv2.BORDER_CONSTANT, borderValue=1)
    return np.asarray(mask & (eroded == 0), dtype=np.bool_)


class HandSegments:
    """Segments images around estimates with the settings of the run.

    Args:
        anatomy: anatomy of the hand.
        config: configuration of the run.
        camera: camera of the images.
    """

    def __init__(self, anatomy: HandAnatomy, config: HandConfig, camera: Camera) -> None:
        self._anatomy, self._config, self._camera = anatomy, config, camera
        self._sampler = PixelSampler(camera)

    def segmentation(self, depth: ImageArray, shown: Shown) -> Segmentation | None:
        """Return the labels around an estimate in a depth image, mm; None if the pose is unknown."""
        if shown.position is None or shown.quaternion is None or shown.shape is None:
            return None
        pose = _pose_of(shown)
        hand = PredictedHand.of(self._anatomy, pose, _thumb_of(shown))
        window = window_around(hand.joints, self._camera, self._config.observation)
        return segment(depth, self._sampler, window, self._camera, hand)

    def paint(self, straight: ImageArray, depth: ImageArray, shown: Shown) -> None:
        """Draw the labels onto a picture (h, w, 3) of the whole undistorted image, in place."""
        found = self.segmentation(depth, shown)
        if found is None:
            return
        colours = np.array([LABEL_COLOURS[label] for label in sorted(Label)], dtype=np.uint8)
        step = found.window.step
        tile = np.repeat(np.repeat(colours[found.labels], step, axis=0), step, axis=1)
        # Labels are sampled at the centres of blocks of step x step pixels.
        left, top = found.window.left - step // 2, found.window.top - step // 2
        _blend(straight, tile, left, top)


def _blend(picture: ImageArray, tile: ImageArray, left: int, top: int) -> None:
    """Blend a tile into a picture, clipped to its edges."""
    height, width = picture.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + tile.shape[1], width), min(top + tile.shape[0], height)
    if x0 >= x1 or y0 >= y1:
        return
    ground, over = picture[y0:y1, x0:x1], tile[y0 - top : y1 - top, x0 - left : x1 - left]
    picture[y0:y1, x0:x1] = cv2.addWeighted(
        np.ascontiguousarray(over), _OPACITY, np.ascontiguousarray(ground), 1.0 - _OPACITY, 0.0
    )
