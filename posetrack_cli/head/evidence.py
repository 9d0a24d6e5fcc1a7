"""Diagnosis of recordings without a tracked face: image statistics and the most likely cause."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.head.config import DetectionSettings
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.camera_of import principal_point_fault
from posetrack_cli.recording.grey import PLAIN_BITS, Grey
from posetrack_cli.recording.recording import Recording

WHITE, DARK, FLAT = 250, 40, 12
"""Grey values: saturated from WHITE on, dark below DARK, and the minimum contrast range FLAT."""
_MUCH = 0.3
"""Share of saturated pixels that hides a face."""
TURNED_AWAY_DEG = 40.0
"""Yaw from which a head hides half of its points."""
_BITS = (
    "set bits in the camera file to the number of significant bits; for depth images use posetrack hand run"
)
THOROUGHLY_SEARCHED = 2
"""Number of images that are searched in all orientations."""


@dataclass(frozen=True)
class _Seen:
    """Statistics of one image.

    Attributes:
        low, middle, high: percentiles 5, 50 and 95 of brightness.
        white: share of white pixels.
        eye_distances: of the detected faces, pixels.
        turned_deg: of the detected faces, their yaw to either side.
        score: of the best face.
    """

    low: float
    middle: float
    high: float
    white: float
    eye_distances: tuple[float, ...]
    turned_deg: tuple[float, ...]
    score: float


class FaceEvidence:
    """Statistics and diagnosis of sampled frames.

    Args:
        recording: of the frames.
        settings: of the face detector.
        frames: a few frames of the recording.
    """

    def __init__(self, recording: Recording, settings: DetectionSettings, frames: Sequence[Frame]) -> None:
        self._recording, self._detector = recording, FaceDetector(settings)
        self._images = [image for frame in frames for image in frame.images if image is not None]
        self._seen = [self._look(image, index) for index, image in enumerate(self._images)]

    @property
    def line(self) -> str:
        """Statistics, followed by the most likely cause if there is one."""
        return f"{self.seen}{f'; {self.reason}' if self.reason else ''}"

    @property
    def seen(self) -> str:
        """Number of images with a face, size of the faces, brightness of the images."""
        if not self._seen:
            return "no readable image"
        low, middle, high = (
            int(np.median([getattr(one, name) for one in self._seen])) for name in ("low", "middle", "high")
        )
        sizes = [size for one in self._seen for size in one.eye_distances]
        faces = f"face in {sum(bool(one.eye_distances) for one in self._seen)}"
        if sizes:
            faces += f", eye distance {min(sizes):.0f} to {max(sizes):.0f} px"
        light = f"brightness {low} to {high}, median {middle}, {100.0 * self._white:.0f} % of pixels white"
        return f"{len(self._seen)} images checked ({self._stored}): {faces}; {light}"

    @cached_property
    def reason(self) -> str:
        """Most likely cause with a suggested fix; empty without evidence."""
        if not self._seen:
            return ""
        return self._of_camera or self._of_brightness or self._of_turn

    @property
    def _white(self) -> float:
        return float(np.median([one.white for one in self._seen]))

    @property
    def _stored(self) -> str:
        kinds = dict.fromkeys(p.words for p in self._recording.pixels if isinstance(p, Grey))
        return ", ".join(kinds) or "grey"

    @property
    def _of_camera(self) -> str:
        for camera in self._recording.cameras:
            fault = principal_point_fault(camera)
            if fault is not None:
                where = f"({camera.cx:.0f}, {camera.cy:.0f}) in {camera.width}x{camera.height}"
                return f"the principal point is {fault}, {where}: pass --camera for these images"
        return ""

    @property
    def _of_brightness(self) -> str:
        high = float(np.median([one.high for one in self._seen]))
        low = float(np.median([one.low for one in self._seen]))
        is_deep = any(isinstance(p, Grey) and p.bits > PLAIN_BITS for p in self._recording.pixels)
        bits = f": {_BITS}" if is_deep else ""
        if self._white > _MUCH:
            return f"images are mostly white{bits}"
        if high < DARK:
            return f"images are dark{bits}"
        return f"images have almost no contrast{bits}" if high - low < FLAT else ""

    @property
    def _of_turn(self) -> str:
        turned = [angle for one in self._seen for angle in one.turned_deg if angle > TURNED_AWAY_DEG]
        if not turned or len(turned) < sum(bool(one.turned_deg) for one in self._seen):
            return ""
        return (
            f"heads are turned away from the camera, by about {np.median(turned):.0f} degrees: "
            "--start N skips to a frame that shows more of the face"
        )

    def _look(self, image: ImageArray, index: int) -> _Seen:
        low, middle, high = (float(value) for value in np.percentile(image, (5.0, 50.0, 95.0)))
        # a thorough search takes a second
        thorough = index < THOROUGHLY_SEARCHED
        found = self._detector.detect(image) if thorough else self._detector.detect_quickly(image, 0)
        eyes = tuple(float(face.guess.eye_distance) for face in found.faces)
        turned = tuple(float(np.degrees(abs(face.angles[1]))) for face in found.faces)
        white = float(np.mean(image >= WHITE))
        return _Seen(low, middle, high, white, eyes, turned, found.best_score)
