"""Face landmarks from other programs: point mapping, reading, outlier rejection, faces of a frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.points import EYE_DISTANCE_MM, FacePoints
from posetrack_cli.head.face.points import (
    EYES,
    FEATURE_SD,
    FEATURES,
    POINT_COUNT,
    POINT_NAMES,
    UNSCALED,
    scaled_pixels,
)
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.single_view import pose_of
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.keypoints.formats import parse_keypoints
from posetrack_cli.recording.keypoints.layout import (
    NORMALISED,
    PIXELS,
    KeypointSets,
    PointKind,
    by_index,
    same_order,
)
from posetrack_cli.recording.keypoints.reading import (
    digest_of,
    image_unit,
    in_pixels,
    known_scores,
)

# Mapping of other programs' points to ours.
#
# Their nostrils and brows differ slightly from ours; each point's constant offset
# (``adjustment.adjuster.OFFSET_SD_MM``) absorbs that. ``docs/landmarks.md`` has the same table.

LANDMARK_INDICES = {
    "right_eye_outer": (36, 33),
    "right_eye_inner": (39, 133),
    "left_eye_inner": (42, 362),
    "left_eye_outer": (45, 263),
    "right_mouth_corner": (48, 61),
    "left_mouth_corner": (54, 291),
    "right_nostril": (32, 97),
    "left_nostril": (34, 326),
    "right_brow_inner": (21, 55),
    "left_brow_inner": (22, 285),
}
"""Index of each point in the 68-point scheme (OpenFace, dlib, iBUG) and in MediaPipe's 468 or 478 points."""
IBUG_68, MEDIAPIPE_478 = (tuple(LANDMARK_INDICES[name][k] for name in POINT_NAMES) for k in range(2))

FACE_POINTS = PointKind(
    subject="face",
    names=POINT_NAMES,
    counted={
        POINT_COUNT: same_order(POINT_COUNT),
        68: by_index(IBUG_68),
        70: by_index(IBUG_68),
        468: by_index(MEDIAPIPE_478),
        478: by_index(MEDIAPIPE_478),
    },
    several=("faces", "multi_face_landmarks", "face_landmarks", "faceLandmarks"),
    command="posetrack head mono --help",
    flat={"face_keypoints_2d": ""},
    parts={"": slice(23, 91)},
    ends=(POINT_NAMES[0], POINT_NAMES[-1]),
)


# Reading: unit, noise and outliers of a file

LANDMARK_UNITS = (PIXELS, NORMALISED)
AROUND = 2
"""Frames before and after whose median predicts a point."""
LEAST_NOISE_PX, DEFAULT_NOISE = 0.3, 0.02
"""Minimum noise; and the default for short files, in eye distances."""
OUTLIER_NOISE, OUTLIER_EYES = 5.0, 0.08
"""A point is an outlier beyond this many standard deviations and eye distances from its prediction."""
FEWEST_TRIPLES = 20
"""Minimum number of three consecutive frames to estimate the noise."""
FEWEST_POINTS = 6
"""Minimum number of known points of a face."""
_MAD = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution."""


@dataclass(frozen=True, eq=False)
class LandmarkFile:
    """Landmarks of a run.

    Attributes:
        name, digest: last part of the file's path, and SHA-256 of its bytes.
        sets: in pixels, with all scores known and outliers removed.
        unit: of the file, given or determined.
        noise_px: (K,) standard deviation of each point's x or y.
        outliers: number of outliers.
    """

    name: str
    digest: str
    sets: KeypointSets
    unit: str
    noise_px: FloatArray
    outliers: int

    def record(self) -> dict[str, str]:
        """Return the entries of the run record that identify the file."""
        return {
            "landmarks": self.name,
            "landmarks.sha256": self.digest,
            "landmarks.unit": self.unit,
        }

    @property
    def line(self) -> str:
        """Summary for the user."""
        by = "stamp" if self.sets.by_stamp else "number"
        ignored = f", {self.outliers} outlier{'s' * (self.outliers > 1)} ignored" if self.outliers else ""
        noise = float(np.median(self.noise_px))
        return f"{len(self.sets)} faces by frame {by}, in {self.unit}, noise {noise:.1f} px{ignored}"


def read_landmarks(path: Path, camera: Camera, unit: str | None = None) -> LandmarkFile:
    """Read landmarks from another program.

    The noise of a point is estimated from second differences over three consecutive frames: white noise of sd
    s gives p- - 2 p + p+ a sd of s sqrt(6), and head acceleration adds little. A point far from the median of
    five frames is an outlier.

    Args:
        path: see ``parse_keypoints``; 10, 68, 468 or 478 points per face.
        camera: of the images with the landmarks.
        unit: ``px`` or ``normalised``; by default named by the file or inferred from its values.

    Raises:
        UsageError: no such file; otherwise names file, line and field of the invalid entry.
    """
    parsed = parse_keypoints(path, FACE_POINTS)
    sets = replace(parsed.sets, keys=parsed.sets.keys - parsed.first)
    if parsed.first and not sets.by_stamp and sets.keys[0] < 0:
        raise UsageError("invalid frame number", where=path, found="frame 0", expected="frames from 1 on")
    unit = unit or parsed.unit or _unit_by_numbers(sets, camera, path)
    if unit not in LANDMARK_UNITS:
        expected = " or ".join(LANDMARK_UNITS)
        raise UsageError("landmarks are not in image units", where=path, found=unit, expected=expected)
    sets = in_pixels(sets, unit, camera)
    sets = replace(sets, scores=known_scores(sets.scores))
    outliers = _outliers(sets, _noise_px(sets))
    points = np.where(outliers[..., None], np.nan, sets.points)
    noise = _noise_px(replace(sets, points=points))
    known = np.isfinite(points[..., 0]) & (sets.scores > 0.0)
    kept = known.sum(axis=1) >= FEWEST_POINTS
    sets = sets.rows(kept, points)
    return LandmarkFile(shown_name(path), digest_of(path), sets, unit, noise, int(outliers.sum()))


def _unit_by_numbers(sets: KeypointSets, camera: Camera, path: Path) -> str:
    points = sets.points[np.isfinite(sets.points[..., 0])]
    hint = "set --landmarks-unit; pixels refer to the recorded images"
    return image_unit(points, camera, path, LANDMARK_UNITS, hint)


def _eye_distances(sets: KeypointSets) -> FloatArray:
    """Return the eye distance, pixels, of each set (N,); NaN where an eye is unknown."""
    eyes = sets.points[:, EYES, :2]
    between = eyes[:, 2:].mean(axis=1) - eyes[:, :2].mean(axis=1)
    distances: FloatArray = np.linalg.norm(between, axis=1)
    return distances


def _noise_px(sets: KeypointSets) -> FloatArray:
    pixels, alone = sets.points[..., :2], _alone(sets)
    second = pixels[:-2] - 2.0 * pixels[1:-1] + pixels[2:]
    usable = (alone[:-2] & alone[1:-1] & alone[2:])[:, None] & np.isfinite(second[..., 0])
    eyes = _eye_distances(sets)
    usual = DEFAULT_NOISE * float(np.nanmedian(eyes)) if np.isfinite(eyes).any() else LEAST_NOISE_PX
    noise = np.full(POINT_COUNT, max(usual, LEAST_NOISE_PX))
    for k in np.flatnonzero(usable.sum(axis=0) >= FEWEST_TRIPLES):
        shaken = np.abs(second[usable[:, k], k])
        noise[k] = max(_MAD * float(np.median(shaken)) / np.sqrt(6.0), LEAST_NOISE_PX)
    return noise


def _alone(sets: KeypointSets) -> BoolArray:
    """Return whether a set is the only one of its frame; several faces are not associated over time."""
    differs = np.diff(sets.keys) != 0
    alone: BoolArray = np.append(True, differs) & np.append(differs, True)
    return alone


def _outliers(sets: KeypointSets, noise: FloatArray) -> BoolArray:
    """Return (N, K) whether a point is far from the median of neighbouring frames."""
    pixels, alone = sets.points[..., :2], _alone(sets)
    if len(pixels) < 2 * AROUND + 1:
        return np.zeros(pixels.shape[:2], dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(pixels, 2 * AROUND + 1, axis=0)
    expected = np.full_like(pixels, np.nan)
    expected[AROUND:-AROUND] = _nan_median(windows)
    expected[:AROUND], expected[-AROUND:] = expected[AROUND], expected[-AROUND - 1]
    eyes = np.nan_to_num(_eye_distances(sets), nan=np.inf)
    off = np.abs(pixels - expected).max(axis=2)
    most = np.maximum(OUTLIER_NOISE * noise, OUTLIER_EYES * eyes[:, None])
    outliers: BoolArray = (off > most) & alone[:, None]
    return outliers


def _nan_median(windows: FloatArray) -> FloatArray:
    """Return the medians along the last axis, ignoring NaN; NaN where all are NaN."""
    known: BoolArray = np.any(np.isfinite(windows), axis=-1)
    filled = np.where(np.expand_dims(known, -1), windows, 0.0)
    medians: FloatArray = np.where(known, np.nanmedian(filled, axis=-1), np.nan)
    return medians


# Faces of a frame, in the scaled images of a tracker

SLID_NOISE, SLID_EYES = 4.0, 0.08
"""A point has slid if it is this many standard deviations and eye distances from its landmark."""
FEATURE_OFFSET_EYES = 0.16
"""Maximum distance of a feature from its landmark: conventions differ, for example at the end of a brow."""
LEAST_RESPONSE = 0.5
"""Minimum response of a place that resembles its point."""
SLID_POINTS = 3
"""Minimum number of points for a track to have slid."""


@dataclass(frozen=True, eq=False)
class LandmarkFace:
    """A face from landmarks.

    Attributes:
        stamp_ns: of its frame if known, else 0.
        pixels: (K, 2); missing points are filled in from an average face.
        responses: (K,) scores, 0 to 1; 0 for missing points.
        pixels_per_mm: scale of the face in the image.
    """

    stamp_ns: int
    pixels: FloatArray
    responses: FloatArray
    pixels_per_mm: float


class Landmarks:
    """Landmarks in the scaled images of a tracker.

    Args:
        file: as read.
        camera: of the scaled images.
        scale: of these relative to the recorded ones.
    """

    def __init__(self, file: LandmarkFile, camera: Camera, scale: float = UNSCALED) -> None:
        self._file, self._camera, self._scale = file, camera, scale
        self.noise_px: FloatArray = scale * file.noise_px

    def faces(self, frame: Frame) -> tuple[LandmarkFace, ...]:
        """Return the faces of a frame, the largest first."""
        rows = self._file.sets.of(frame.index, frame.stamp_ns)
        found = (self._face(row, frame.stamp_ns) for row in range(rows.start, rows.stop))
        faces = [face for face in found if face is not None]
        return tuple(sorted(faces, key=lambda face: -face.pixels_per_mm))

    def has_slid(self, pixels: FloatArray, face: LandmarkFace) -> bool:
        """Whether tracked points (K, 2) have left the landmarks of a face."""
        return int(np.sum(self._is_off(pixels, face) & (face.responses > 0.0))) >= SLID_POINTS

    def start_pixels(self, seen: FacePoints, face: LandmarkFace) -> FloatArray:
        """Return the pixels (K, 2) to track: the detected features near a face's landmarks.

        A tracker follows image features; a landmark is off by a few pixels due to its convention and noise.
        It is used where no feature near it resembles the point.
        """
        looks_like = (seen.responses > LEAST_RESPONSE) & ~self._is_off(seen.pixels, face, FEATURE_OFFSET_EYES)
        return np.where((looks_like | (face.responses <= 0.0))[:, None], seen.pixels, face.pixels)

    def _is_off(self, pixels: FloatArray, face: LandmarkFace, least_eyes: float = SLID_EYES) -> BoolArray:
        off = np.linalg.norm(pixels - face.pixels, axis=1)
        most = np.maximum(SLID_NOISE * self.noise_px, least_eyes * EYE_DISTANCE_MM * face.pixels_per_mm)
        far: BoolArray = off > most
        return far

    def _face(self, row: int, stamp_ns: int) -> LandmarkFace | None:
        """Return the face of a row of the file; None if its points do not fit a face."""
        sets = self._file.sets
        known = np.isfinite(sets.points[row, :, 0]) & (sets.scores[row] > 0.0)
        scores = np.where(known, sets.scores[row], 0.0)
        pixels = scaled_pixels(sets.points[row, :, :2], self._scale)
        try:
            pose, _ = pose_of(pixels, scores * FEATURE_SD.min() / FEATURE_SD, self._camera, FEATURES)
        except ValueError:
            return None
        expected = project((self._camera,), pose.points(FEATURES)).pixels[0]
        filled = np.where(known[:, None], pixels, expected)
        if not np.isfinite(filled).all() or pose.position[2] <= 0.0:
            return None
        return LandmarkFace(stamp_ns, filled, scores, float(self._camera.fx / pose.position[2]))
