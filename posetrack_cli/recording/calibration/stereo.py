"""Calibration of several cameras from folders of board images, and how good it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.files import placed_path
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.epipolar import CameraPair
from posetrack_cli.geometry.triangulation import triangulate
from posetrack_cli.recording.calibration.boards import Board
from posetrack_cli.recording.calibration.joint import adjust
from posetrack_cli.recording.calibration.solve import CameraFit, fit_camera, place_cameras, shared_views
from posetrack_cli.recording.calibration.views import CameraViews
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.identity import shown_name

DOUBTFUL_PX = 1.0
"""Errors above are no calibration to rely on."""
MISFIT = 3.0
"""Cameras do not fit together if one's error is this many times that of its views alone, and doubtful."""
DOUBTFUL_FOCAL = 0.02
"""Standard deviation of a focal length, as a fraction, that comes of views that are all alike."""


@dataclass(frozen=True)
class PairError:
    """How well two cameras fit together.

    Attributes:
        first, second: names.
        views: instants at which both saw the board.
        epipolar_rms_px, epipolar_p95_px: Sampson distance of corners, root mean square and 95th percentile.
        square_mm: mean side of a square, triangulated.
        baseline_mm: distance of the cameras.
    """

    first: str
    second: str
    views: int
    epipolar_rms_px: float
    epipolar_p95_px: float
    square_mm: float
    baseline_mm: float


@dataclass(frozen=True)
class StereoCalibration:
    """Cameras and their errors.

    Attributes:
        board: that was seen.
        cameras: the reference first.
        fits: of each camera.
        pairs: of every two cameras that saw the board at once.
        fits_together: whether one place of the cameras explains their views. If not, intrinsics are those of
            each camera's own views.
    """

    board: Board
    cameras: tuple[Camera, ...]
    fits: tuple[CameraFit, ...]
    pairs: tuple[PairError, ...]
    fits_together: bool = True

    def lines(self) -> list[str]:
        """Return what was measured and how well, for people and as comments of the camera file."""
        return [*map(_camera_line, self.fits), *(_pair_line(pair, self.board) for pair in self.pairs)]

    @property
    def is_inaccurate(self) -> bool:
        """Whether an error of a camera or of two together is large."""
        errors = [*(fit.rms_px for fit in self.fits), *(pair.epipolar_rms_px for pair in self.pairs)]
        return max(errors) > DOUBTFUL_PX

    def doubts(self) -> list[str]:
        """Return what speaks against using it; nothing if nothing does."""
        found = []
        for fit in self.fits:
            if fit.rms_px > DOUBTFUL_PX:
                found.append(
                    f"camera '{fit.camera.name}': reprojection error of {fit.rms_px:.2f} px is large"
                )
            if fit.focal_sd_px > DOUBTFUL_FOCAL * fit.camera.fx:
                found.append(
                    f"camera '{fit.camera.name}': focal length is uncertain by {fit.focal_sd_px:.0f} px; "
                    "show the board tilted, and in every part of the image"
                )
        for pair in self.pairs:
            if pair.epipolar_rms_px > DOUBTFUL_PX:
                found.append(
                    f"'{pair.first}' and '{pair.second}': epipolar error of {pair.epipolar_rms_px:.2f} px is "
                    "large; were the images taken at the same instants, and the board still?"
                )
        return found

    def file_text(self, source: Path) -> str:
        """Return the camera file, with the errors as comments."""
        title = (
            f"measured by posetrack calibrate stereo on {shown_name(placed_path(source))}, {self.board.words}"
        )
        return camera_file_text(self.cameras, [title, *self.lines()])


def calibrate_stereo(views: Sequence[CameraViews], distortion: str = "four") -> StereoCalibration:
    """Calibrate the cameras that saw a board.

    Every camera's intrinsics come from all its views, the places then from the views that two cameras share;
    with these to start from everything is adjusted together. Views that were not taken at once fit no place:
    then intrinsics stay as they are.

    Args:
        views: of each camera (``find_views``), the reference first.
        distortion: ``none``, ``four`` (k1 k2 p1 p2), ``five`` (and k3) or ``eight`` (rational) coefficients.

    Raises:
        RecordingError: there are too few views of the board.
    """
    fitted = [fit_camera(own, distortion) for own in views]
    fits, used = [fit for fit, _ in fitted], [own for _, own in fitted]
    start = place_cameras([fit.camera for fit in fits], used)
    joint = adjust(start, used)
    fits_together = all(
        rms <= max(MISFIT * fit.rms_px, DOUBTFUL_PX) for fit, rms in zip(fits, joint.rms_px, strict=True)
    )
    cameras = joint.cameras if fits_together else tuple(start)
    if fits_together:
        fits = [
            replace(fit, camera=camera, rms_px=float(rms), focal_sd_px=float(sd))
            for fit, camera, rms, sd in zip(fits, cameras, joint.rms_px, joint.focal_sd_px, strict=True)
        ]
    pairs = [
        error
        for i, j in combinations(range(len(cameras)), 2)
        if (error := _pair_error(cameras[i], cameras[j], used[i], used[j]))
    ]
    return StereoCalibration(views[0].board, cameras, tuple(fits), tuple(pairs), fits_together)


def _pair_error(first: Camera, second: Camera, views: CameraViews, others: CameraViews) -> PairError | None:
    shared = shared_views(views, others)
    if not shared:
        return None
    errors = np.concatenate([CameraPair(first, second).epipolar_errors(one, two) for one, two, _ in shared])
    sides = np.concatenate(
        [
            _sides(triangulate([first, second], np.stack([one, two]))[0], ids, views.board)
            for one, two, ids in shared
        ]
    )
    return PairError(
        first.name,
        second.name,
        len(shared),
        float(np.sqrt(np.mean(errors**2))),
        float(np.percentile(errors, 95)),
        float(np.mean(sides)),
        float(np.linalg.norm(CameraPair(first, second).transform[1])),
    )


def _sides(points: FloatArray, ids: FloatArray, board: Board) -> FloatArray:
    """Return the distances, mm, of corners that are neighbours in a row."""
    neighbours = (np.diff(ids) == 1) & (ids[1:] % board.across != 0)
    sides: FloatArray = np.linalg.norm(np.diff(points, axis=0), axis=-1)[neighbours]
    return sides


def _camera_line(fit: CameraFit) -> str:
    camera = fit.camera
    return (
        f"camera {camera.name}: reprojection error {fit.rms_px:.3f} px (rms) in {fit.used} views; board "
        f"found in {fit.found} of {fit.images} images; fx {camera.fx:.1f} fy {camera.fy:.1f} "
        f"+- {fit.focal_sd_px:.1f} px"
    )


def _pair_line(pair: PairError, board: Board) -> str:
    return (
        f"{pair.first} - {pair.second}: epipolar error {pair.epipolar_rms_px:.3f} px (rms), "
        f"{pair.epipolar_p95_px:.3f} px (95 %) in {pair.views} views; baseline {pair.baseline_mm:.2f} mm; "
        f"a square of {board.square_mm:g} mm measures {pair.square_mm:.3f} mm"
    )
