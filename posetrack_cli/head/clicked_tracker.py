"""A stereo tracker that begins with points that a person clicked in the first frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.following import Images
from posetrack_cli.head.start.clicked import read_clicked
from posetrack_cli.head.start.from_clicked import start_from_clicked
from posetrack_cli.head.start.start import NoStart, Start, find_start
from posetrack_cli.head.stereo_state import StereoState
from posetrack_cli.head.stereo_tracker import StereoTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.tracking.two_pass import NothingFoundError


class ClickedTracker(StereoTracker):
    """A ``StereoTracker`` whose first frame starts from clicked points; after a loss it finds faces itself.

    Args:
        config: parameters.
        cameras: of the recording, the reference first.
        clicked: table of points, see ``read_clicked``.
        known: what another tracker has ``learned``.

    Raises:
        UsageError: no such table, or a face detector without its model.
        PosetrackError: points that cannot be used. From ``step``, NothingFoundError: they are no face's.
    """

    def __init__(
        self,
        config: HeadStereoConfig,
        cameras: Sequence[Camera],
        clicked: Path,
        known: Mapping[str, np.ndarray[Any, Any]] | None = None,
    ) -> None:
        self._path, self._clicked = clicked, read_clicked(clicked, cameras)
        self._detector = FaceDetector(config.start.detection)
        self._first: Images | None = None
        super().__init__(config, cameras, self._find, known)

    def start(self, frame: Frame, rng: np.random.Generator) -> StereoState:
        """Return the state before the first frame, in which the points were clicked."""
        self._first = frame.images
        return super().start(frame, rng)

    def _find(self, images: Images) -> Start | NoStart:
        settings = self._config.start
        if images is not self._first:
            return find_start(images, self._cameras, self._detector, settings)
        found = start_from_clicked(images, self._cameras, self._clicked, settings)
        if isinstance(found, Start):
            return found
        raise NothingFoundError(
            "clicked points begin no head",
            where=self._path,
            found=found.reason,
            hint="were they clicked in the first frame that is tracked? right is the subject's right",
        )
