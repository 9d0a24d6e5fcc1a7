"""Landmarks that another program found: their points, files, and the faces of a frame."""

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
    WHOLE,
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

# The ten points of a face in files of landmarks: which of other programs' points each is.
#
# The programs' nostrils and brows are not quite ours; each point's constant offset
# (``adjustment.adjuster.OFFSET_SD_MM``) takes that up. ``docs/landmarks.md`` shows the same table.


THEIRS = {
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
"""Of each of ours, which of 68 points (OpenFace, dlib, iBUG) and which of MediaPipe's 468 or 478 it is."""
OF_68, OF_478 = (tuple(THEIRS[name][k] for name in POINT_NAMES) for k in range(2))

FACE_POINTS = PointKind(
    subject="face",
    names=POINT_NAMES,
    counted={
        POINT_COUNT: same_order(POINT_COUNT),
        68: by_index(OF_68),
        70: by_index(OF_68),
        468: by_index(OF_478),
        478: by_index(OF_478),
    },
    several=("faces", "multi_face_landmarks", "face_landmarks", "faceLandmarks"),
    command="posetrack head mono --help",
    flat={"face_keypoints_2d": ""},
    parts={"": slice(23, 91)},
    ends=(POINT_NAMES[0], POINT_NAMES[-1]),
)


# Reads a file of landmarks: in what unit it is, how noisy it is, and which of its points are wild


LANDMARK_UNITS = (PIXELS, NORMALISED)
AROUND = 2
"""Frames before and after whose median says where a point is expected."""
LEAST_NOISE_PX, USUAL_NOISE = 0.3, 0.02
"""No program is surer than this; and what is taken of a file too short to tell, in eye distances."""
WILD_NOISE, WILD_EYES = 5.0, 0.08
"""A point is wild beyond so many standard deviations and so many eye distances from where it is expected."""
FEWEST_TRIPLES = 20
"""Of three frames in a row: from so many on their noise is estimated."""
FEWEST_POINTS = 6
"""Known points of a face that is used."""
_MAD = 1.4826
"""Standard deviations per median of absolute deviations, of a normal distribution."""


@dataclass(frozen=True, eq=False)
class LandmarkFile:
    """Landmarks as a run uses them.

    Attributes:
        name, digest: of the file: its last part, and the SHA-256 of its bytes.
        sets: pixels; scores are all known, wild points are not.
        unit: of the file, as it was told or determined.
        noise_px: (K,) standard deviation of each point, x or y.
        wild: how many points were refused as wild.
    """

    name: str
    digest: str
    sets: KeypointSets
    unit: str
    noise_px: FloatArray
    wild: int

    def record(self) -> dict[str, str]:
        """Return what a result states of the file: all that its bytes depend on."""
        return {
            "landmarks": self.name,
            "landmarks.sha256": self.digest,
            "landmarks.unit": self.unit,
        }

    @property
    def line(self) -> str:
        """What was found, for people."""
        by = "stamp" if self.sets.by_stamp else "number"
        points = f"point{'s' * (self.wild > 1)}"
        wild = f", {self.wild} wild {points} left out" if self.wild else ""
        noise = float(np.median(self.noise_px))
        return f"{len(self.sets)} faces by frame {by}, in {self.unit}, noise {noise:.1f} px{wild}"


def read_landmarks(path: Path, camera: Camera, unit: str | None = None) -> LandmarkFile:
    """Read landmarks that another program found.

    The noise of a point is that of its second differences over three frames in a row: white noise of sd s
    gives |p- - 2 p + p+| a sd of s sqrt(6), and a head that is accelerated hardly adds to it. A point is wild
    if it lies far from the median of five frames about its own.

    Args:
        path: see ``parse_keypoints``; ten, 68, 468 or 478 points a face.
        camera: of the images that the landmarks were found in.
        unit: ``px`` or ``normalised``; None as the file names it, else as its numbers look.

    Raises:
        UsageError: no such file; or names file, line and field of what cannot be used.
    """
    parsed = parse_keypoints(path, FACE_POINTS)
    sets = replace(parsed.sets, keys=parsed.sets.keys - parsed.first)
    if parsed.first and not sets.by_stamp and sets.keys[0] < 0:
        raise UsageError("frame cannot be used", where=path, found="frame 0", expected="frames from 1 on")
    unit = unit or parsed.unit or _unit_by_numbers(sets, camera, path)
    if unit not in LANDMARK_UNITS:
        expected = " or ".join(LANDMARK_UNITS)
        raise UsageError("landmarks are not those of images", where=path, found=unit, expected=expected)
    sets = in_pixels(sets, unit, camera)
    sets = replace(sets, scores=known_scores(sets.scores))
    wild = _wild(sets, _noise_px(sets))
    points = np.where(wild[..., None], np.nan, sets.points)
    noise = _noise_px(replace(sets, points=points))
    known = np.isfinite(points[..., 0]) & (sets.scores > 0.0)
    kept = known.sum(axis=1) >= FEWEST_POINTS
    sets = sets.rows(kept, points)
    return LandmarkFile(shown_name(path), digest_of(path), sets, unit, noise, int(wild.sum()))


def _unit_by_numbers(sets: KeypointSets, camera: Camera, path: Path) -> str:
    points = sets.points[np.isfinite(sets.points[..., 0])]
    hint = "--landmarks-unit tells it; pixels are those of the recorded images"
    return image_unit(points, camera, path, LANDMARK_UNITS, hint)


def _eye_distances(sets: KeypointSets) -> FloatArray:
    """Return how many pixels the eyes' centres are apart in each set (N,); NaN where an eye is not known."""
    eyes = sets.points[:, EYES, :2]
    between = eyes[:, 2:].mean(axis=1) - eyes[:, :2].mean(axis=1)
    distances: FloatArray = np.linalg.norm(between, axis=1)
    return distances


def _noise_px(sets: KeypointSets) -> FloatArray:
    pixels, alone = sets.points[..., :2], _alone(sets)
    second = pixels[:-2] - 2.0 * pixels[1:-1] + pixels[2:]
    usable = (alone[:-2] & alone[1:-1] & alone[2:])[:, None] & np.isfinite(second[..., 0])
    eyes = _eye_distances(sets)
    usual = USUAL_NOISE * float(np.nanmedian(eyes)) if np.isfinite(eyes).any() else LEAST_NOISE_PX
    noise = np.full(POINT_COUNT, max(usual, LEAST_NOISE_PX))
    for k in np.flatnonzero(usable.sum(axis=0) >= FEWEST_TRIPLES):
        shaken = np.abs(second[usable[:, k], k])
        noise[k] = max(_MAD * float(np.median(shaken)) / np.sqrt(6.0), LEAST_NOISE_PX)
    return noise


def _alone(sets: KeypointSets) -> BoolArray:
    """Whether a set is the only one of its frame; of several it is not known which is whose."""
    differs = np.diff(sets.keys) != 0
    alone: BoolArray = np.append(True, differs) & np.append(differs, True)
    return alone


def _wild(sets: KeypointSets, noise: FloatArray) -> BoolArray:
    """Return (N, K): whether a point is far from where the frames around expect it."""
    pixels, alone = sets.points[..., :2], _alone(sets)
    if len(pixels) < 2 * AROUND + 1:
        return np.zeros(pixels.shape[:2], dtype=bool)
    windows = np.lib.stride_tricks.sliding_window_view(pixels, 2 * AROUND + 1, axis=0)
    expected = np.full_like(pixels, np.nan)
    expected[AROUND:-AROUND] = _nan_median(windows)
    expected[:AROUND], expected[-AROUND:] = expected[AROUND], expected[-AROUND - 1]
    eyes = np.nan_to_num(_eye_distances(sets), nan=np.inf)
    off = np.abs(pixels - expected).max(axis=2)
    most = np.maximum(WILD_NOISE * noise, WILD_EYES * eyes[:, None])
    wild: BoolArray = (off > most) & alone[:, None]
    return wild


def _nan_median(windows: FloatArray) -> FloatArray:
    """Return the medians along the last axis without NaN; NaN where there is nothing else."""
    known: BoolArray = np.any(np.isfinite(windows), axis=-1)
    filled = np.where(np.expand_dims(known, -1), windows, 0.0)
    medians: FloatArray = np.where(known, np.nanmedian(filled, axis=-1), np.nan)
    return medians


# The faces that landmarks tell of a frame, in the images that a tracker looks at


SLID_NOISE, SLID_EYES = 4.0, 0.08
"""A tracked point has slid if it is so many standard deviations and eye distances from its landmark."""
BESIDE_EYES = 0.16
"""A feature lies no farther beside its landmark: programs do not agree where a brow ends."""
LEAST_RESPONSE = 0.5
"""From so much on a place looks like its point."""
SLID_POINTS = 3
"""So many points that have slid make a track doubtful."""


@dataclass(frozen=True, eq=False)
class ToldFace:
    """A face that landmarks tell.

    Attributes:
        stamp_ns: of its frame where it is known, else 0.
        pixels: (K, 2); a point that was not told is where an average face has it.
        responses: (K,) scores, 0 to 1; 0 of a point that was not told.
        pixels_per_mm: scale of the face in the image.
    """

    stamp_ns: int
    pixels: FloatArray
    responses: FloatArray
    pixels_per_mm: float


class Landmarks:
    """Landmarks for a tracker that looks at images of one camera.

    Args:
        file: as it was read.
        camera: of the images that are looked at.
        scale: of them beside the recorded ones.
    """

    def __init__(self, file: LandmarkFile, camera: Camera, scale: float = WHOLE) -> None:
        self._file, self._camera, self._scale = file, camera, scale
        self.noise_px: FloatArray = scale * file.noise_px

    def faces(self, frame: Frame) -> tuple[ToldFace, ...]:
        """Return the faces of a frame, the largest first."""
        rows = self._file.sets.of(frame.index, frame.stamp_ns)
        found = (self._face(row, frame.stamp_ns) for row in range(rows.start, rows.stop))
        faces = [face for face in found if face is not None]
        return tuple(sorted(faces, key=lambda face: -face.pixels_per_mm))

    def has_slid(self, pixels: FloatArray, face: ToldFace) -> bool:
        """Whether tracked points (K, 2) are elsewhere than a face's."""
        return int(np.sum(self._is_off(pixels, face) & (face.responses > 0.0))) >= SLID_POINTS

    def placed(self, seen: FacePoints, face: ToldFace) -> FloatArray:
        """Return where a track begins, (K, 2): at the features that are seen near a face's landmarks.

        What is followed is what a point looks like; a landmark lies a few pixels beside that, by another
        program's convention and by its noise. It stands where nothing near it looks like the point.
        """
        looks_like = (seen.responses > LEAST_RESPONSE) & ~self._is_off(seen.pixels, face, BESIDE_EYES)
        return np.where((looks_like | (face.responses <= 0.0))[:, None], seen.pixels, face.pixels)

    def _is_off(self, pixels: FloatArray, face: ToldFace, least_eyes: float = SLID_EYES) -> BoolArray:
        off = np.linalg.norm(pixels - face.pixels, axis=1)
        most = np.maximum(SLID_NOISE * self.noise_px, least_eyes * EYE_DISTANCE_MM * face.pixels_per_mm)
        far: BoolArray = off > most
        return far

    def _face(self, row: int, stamp_ns: int) -> ToldFace | None:
        """The face of a row of the file; None where its points are no face's before this camera."""
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
        return ToldFace(stamp_ns, filled, scores, float(self._camera.fx / pose.position[2]))
