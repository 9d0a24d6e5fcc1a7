"""Reads a file of landmarks: in what unit it is, how noisy it is, and which of its points are wild."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import EYES, POINT_COUNT
from posetrack_cli.head.landmarks.points import FACE_POINTS
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.keypoints.layout import NORMALISED, PIXELS
from posetrack_cli.recording.keypoints.reading import (
    digest_of,
    image_unit,
    in_pixels,
    known_scores,
    parse_keypoints,
)
from posetrack_cli.recording.keypoints.sets import KeypointSets

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
