"""What a segmentation says of every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.hand.observation import Observation
from posetrack_cli.rendering.window import Window


class Label(IntEnum):
    """What a pixel shows: no reading, the hand, its forearm beyond the wrist, or another surface."""

    UNREAD = 0
    HAND = 1
    FOREARM = 2
    OTHER = 3


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The pixels of a window, told apart.

    Attributes:
        window: which pixels.
        depth: (h, w) readings, mm, 0 = none.
        labels: (h, w) uint8, of ``Label``.
        wrist: (3,) where the forearm begins, on its axis, camera axes, mm.
        arm: (3,) unit vector from the elbow to the wrist, camera axes; None where no forearm is seen.
    """

    window: Window
    depth: Float32Array
    labels: ImageArray
    wrist: FloatArray
    arm: FloatArray | None

    def is_labelled(self, label: Label) -> BoolArray:
        """(h, w) which pixels carry a label."""
        mask: BoolArray = self.labels == label
        return mask

    @property
    def observation(self) -> Observation:
        """The window as the likelihood reads it: the hand's depths, minus the others', 0 for the rest."""
        hand = self.is_labelled(Label.HAND)
        image = np.where(hand, self.depth, -self.depth)
        image[self.labels == Label.FOREARM] = 0.0
        return Observation(self.window, image, int(np.count_nonzero(hand)))
