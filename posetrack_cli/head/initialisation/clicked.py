"""Initialisation from clicked points: a CSV file with the columns camera, point, x, y."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import PosetrackError, UsageError, nearest_name
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import StereoInitialisationSettings
from posetrack_cli.head.face.points import POINT_COUNT, POINT_NAMES
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.initialisation.stereo import (
    StereoInitialisation,
    StereoInitialiser,
    complete_camera,
)
from posetrack_cli.head.landmarks.faces import Landmarks
from posetrack_cli.recording.base import Frame
from posetrack_cli.tables import TextFile, number_of
from posetrack_cli.tracking.two_pass import NothingFoundError

COLUMNS = ("camera", "point", "x", "y")
EXPECTED = "clicked points must be a CSV file in UTF-8"


@dataclass(frozen=True, eq=False)
class ClickedPoints:
    """Clicked points of the first frame.

    Attributes:
        path: of the table.
        pixels: (C, K, 2), NaN where no point was clicked.
    """

    path: Path
    pixels: FloatArray

    @classmethod
    def read(cls, path: Path, cameras: Sequence[Camera]) -> ClickedPoints:
        """Read a table; see ``read_clicked``."""
        return cls(path, read_clicked(path, cameras))

    def no_head_error(self, failure: InitFailure) -> NothingFoundError:
        """Return the error for points that do not form a head."""
        return NothingFoundError(
            "clicked points do not form a head",
            where=self.path,
            found=failure.reason,
            hint="click them in the first tracked frame; right means the subject's right",
        )


class ClickedInitialiser(StereoInitialiser):
    """Uses clicked points in the first frame, and detection in later ones.

    Args:
        settings: of the initialisation.
        cameras: C >= 2, calibrated.
        clicked: points.
        landmarks: for later frames.

    Raises:
        UsageError: a face detector without its model.
    """

    def __init__(
        self,
        settings: StereoInitialisationSettings,
        cameras: Sequence[Camera],
        clicked: ClickedPoints,
        landmarks: Landmarks | None = None,
    ) -> None:
        super().__init__(settings, cameras, landmarks)
        self._clicked = clicked

    def find(
        self, frame: Frame, *, is_first: bool, is_known: bool = False
    ) -> StereoInitialisation | InitFailure:
        """Return the head in a frame, or the reason why there is none.

        Raises:
            NothingFoundError: the clicked points are not those of a face.
        """
        if not is_first:
            return super().find(frame, is_first=False, is_known=is_known)
        found = self._attempt(frame).from_clicked(self._clicked.pixels)
        if isinstance(found, InitFailure):
            raise self._clicked.no_head_error(found)
        return found


def read_clicked(path: Path, cameras: Sequence[Camera]) -> FloatArray:
    """Read clicked points as pixels (C, K, 2), NaN where no point was clicked.

    The file has a header line and a line for each point: camera name, point name (``face.POINT_NAMES``) and
    pixel. At least one camera needs all ten points; those of the others are matched.

    Raises:
        UsageError: no such file, not a table, or not a number.
        PosetrackError: an unknown camera or point, a pixel outside the image, a duplicate point, or no camera
            with all ten points.
    """
    pixels = np.full((len(cameras), POINT_COUNT, 2), np.nan)
    names = [camera.name for camera in cameras]
    file = TextFile(path, UsageError, EXPECTED)
    table = file.table(COLUMNS)
    places = [table.names.index(name) for name in COLUMNS]
    for line, row in table:
        where = file.where(line)
        camera_name, point_name, x, y = (row[place].strip() for place in places)
        camera = _lookup(camera_name, names, "camera", where)
        point = _lookup(point_name, POINT_NAMES, "point", where)
        pixel = _pixel(x, y, cameras[camera], where)
        if not np.isnan(pixels[camera, point, 0]):
            raise PosetrackError("point clicked twice", where=where, found=f"{point_name} in {camera_name}")
        pixels[camera, point] = pixel
    if complete_camera(pixels) is None:
        raise PosetrackError(
            "no camera has all points",
            where=path,
            found=_missing(pixels, names),
            hint="click all ten points in one image",
        )
    return pixels


def _lookup(name: str, names: Sequence[str], kind: str, where: str) -> int:
    if name not in names:
        raise PosetrackError(f"unknown {kind}", where=where, found=name, hint=nearest_name(name, names))
    return list(names).index(name)


def _pixel(x: str, y: str, camera: Camera, where: str) -> FloatArray:
    pixel = np.array([number_of(cell, where, UsageError) for cell in (x, y)])
    # pixel centres have integer coordinates, so the image extends by half a pixel; also rejects NaN
    if not (np.all(pixel >= -0.5) and np.all(pixel < np.array([camera.width, camera.height]) - 0.5)):
        raise PosetrackError(
            "pixel outside the image",
            where=where,
            found=f"{x}, {y}",
            expected=f"0 to {camera.width - 1}, 0 to {camera.height - 1}",
        )
    return pixel


def _missing(pixels: FloatArray, names: Sequence[str]) -> str:
    """List the missing points of the most complete camera."""
    known = ~np.isnan(pixels[..., 0])
    camera = int(np.argmax(known.sum(axis=1)))
    lacking = ", ".join(POINT_NAMES[k] for k in np.flatnonzero(~known[camera]))
    return f"{names[camera]} without {lacking}"
