"""Draws what a hand's segmentation tells apart: hand, forearm, other surfaces, missing readings."""

from __future__ import annotations

import json
from collections.abc import Mapping

import cv2
import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.configuration import validated
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.viewing.colours import Colour
from posetrack_cli.evaluation.viewing.drawing import Shown
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.observation import PixelSampler, window_around
from posetrack_cli.hand.segmentation import Label, PredictedHand, Segmentation, segment

LABEL_COLOURS: dict[Label, Colour] = {
    Label.UNREAD: (90, 30, 90),
    Label.HAND: (90, 200, 90),
    Label.FOREARM: (40, 150, 255),
    Label.OTHER: (170, 120, 80),
}
_OPACITY = 0.7


class HandSegments:
    """Segments images around estimates as a run with this configuration does around its predictions.

    Args:
        anatomy: of the hand.
        config: of the run: window and segmentation.
        camera: of the images.
    """

    def __init__(self, anatomy: HandAnatomy, config: HandConfig, camera: Camera) -> None:
        self._anatomy, self._config, self._camera = anatomy, config, camera
        self._sampler = PixelSampler(camera)

    def segmentation(self, depth: ImageArray, shown: Shown) -> Segmentation | None:
        """The labels around an estimate in a depth image, mm; None where its pose is not known."""
        if shown.position is None or shown.quaternion is None or shown.shape is None:
            return None
        pose = np.concatenate([shown.position, shown.quaternion, shown.shape])
        hand = PredictedHand.of(self._anatomy, pose)
        window = window_around(hand.joints, self._camera, self._config.observation)
        return segment(depth, self._sampler, window, self._camera, hand, self._config.segmentation)

    def paint(self, straight: ImageArray, depth: ImageArray, shown: Shown) -> None:
        """Paint the labels over a picture (h, w, 3) of the whole image without lens distortion, in place."""
        told = self.segmentation(depth, shown)
        if told is None:
            return
        colours = np.array([LABEL_COLOURS[label] for label in sorted(Label)], dtype=np.uint8)
        step = told.window.step
        tile = np.repeat(np.repeat(colours[told.labels], step, axis=0), step, axis=1)
        # a label is told at a pixel: it stands for the block around it
        left, top = told.window.left - step // 2, told.window.top - step // 2
        _blend(straight, tile, left, top)


def _blend(picture: ImageArray, tile: ImageArray, left: int, top: int) -> None:
    """Blend a tile into a picture, as far as it reaches over it."""
    height, width = picture.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + tile.shape[1], width), min(top + tile.shape[0], height)
    if x0 >= x1 or y0 >= y1:
        return
    ground, over = picture[y0:y1, x0:x1], tile[y0 - top : y1 - top, x0 - left : x1 - left]
    picture[y0:y1, x0:x1] = cv2.addWeighted(
        np.ascontiguousarray(over), _OPACITY, np.ascontiguousarray(ground), 1.0 - _OPACITY, 0.0
    )


def configuration_of(run: Mapping[str, str]) -> HandConfig:
    """The configuration of a hand run, from its record.

    Raises:
        ResultError: the record holds none.
    """
    try:
        return validated(HandConfig, json.loads(run["configuration"]), "run record")
    except (KeyError, TypeError, ValueError, UsageError) as error:
        what = "run record holds no hand's configuration"
        raise ResultError(what, found=error, expected="the record of a hand run") from error
