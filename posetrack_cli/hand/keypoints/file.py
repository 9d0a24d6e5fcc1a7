"""Reads a file of keypoints: which layout it has, in what unit it is, whose sides it tells."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import open_input
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.keypoints.json_text import read_json, read_json_lines
from posetrack_cli.hand.keypoints.layout import (
    HANDEDNESS,
    METRES,
    MILLIMETRES,
    MIRRORED,
    NORMALISED,
    PIXELS,
    UNITS,
    Parsed,
)
from posetrack_cli.hand.keypoints.sets import KeypointSets
from posetrack_cli.hand.keypoints.tables import KIND, read_csv
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.units import METRES_PER_MM

UNSURE = "unsure"
"""How sides are taken that may be the wrong way round."""
_MOST_OF = 90.0
"""Percent of the points that have to lie where a unit would have them."""
_NEAREST_M, _FARTHEST_M = 0.1, 10.0
_OUTSIDE = 0.5
"""Of the image's size beside it: landmarks that are cut off."""
_OF_WORLD = 20.0
"""Percent of normalised coordinates below 0, from which on their origin is taken to be in the hand."""


@dataclass(frozen=True, eq=False)
class KeypointFile:
    """Keypoints as a run uses them.

    Attributes:
        name, digest: of the file: its last part, and the SHA-256 of its bytes.
        sets: pixels, or mm in camera axes; scores are all known; sides are the hand's own.
        in_pixels: which of the two.
        unit: of the file, as it was told or determined.
        sides: how its sides are taken: ``none``, ``as told``, ``exchanged``, or ``UNSURE``: as told, by
            labels that some versions of MediaPipe mean otherwise.
    """

    name: str
    digest: str
    sets: KeypointSets
    in_pixels: bool
    unit: str
    sides: str

    def record(self) -> dict[str, str]:
        """Return what a result states of the file: all that its bytes depend on."""
        return {
            "keypoints": self.name,
            "keypoints.sha256": self.digest,
            "keypoints.unit": self.unit,
            "keypoints.sides": self.sides,
        }

    @property
    def line(self) -> str:
        """What was found, for people."""
        sets = self.sets
        by = "stamp" if sets.by_stamp else "number"
        labels = {
            "none": "no sides",
            "as told": "sides as told",
            "exchanged": "right and left exchanged",
            UNSURE: "handedness as told (MediaPipe before 0.10.15 exchanges it: --keypoints-swap-sides)",
        }
        return f"{len(sets)} hands of 21 points by frame {by}, in {self.unit}, {labels[self.sides]}"


class KeypointUse:
    """Counts for which frames of a run there are keypoints.

    Args:
        keypoints: the file.
    """

    def __init__(self, keypoints: KeypointFile) -> None:
        self._file, self._frames, self._told = keypoints, 0, 0

    def see(self, index: int, stamp_ns: int) -> None:
        """Count a frame."""
        rows = self._file.sets.of(index, stamp_ns)
        self._frames += 1
        self._told += int(rows.stop > rows.start)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to say at the end, in one line: most frames have none, so perhaps they are matched wrongly."""
        if 2 * self._told >= self._frames:
            return ()
        by = "by stamps, to 10 ms" if self._file.sets.by_stamp else "by number, counted from 0"
        return (f"{self._file.name} has keypoints for {self._told} of {self._frames} frames, matched {by}",)


def read_keypoints(
    path: Path, camera: Camera, unit: str | None = None, swap_sides: bool = False
) -> KeypointFile:
    """Read keypoints that another program found.

    Args:
        path: CSV; or JSON, one value (``.json``) or one per line (``.jsonl``, ``.ndjson``).
        camera: of the depth images, for normalised points.
        unit: one of ``UNITS``; None as the file names it, else as its numbers look.
        swap_sides: exchange right and left as they would be taken otherwise: labels of MediaPipe's solutions
            are taken as they are, others exchanged.

    Raises:
        UsageError: no such file; or names file, line and field of what cannot be used.
    """
    parsed = _parse(path)
    unit = unit or parsed.unit or _unit_by_numbers(parsed.sets, camera, path)
    exchanged = (parsed.side_field == MIRRORED) != swap_sides
    sets = _in_our_units(parsed.sets, unit, camera, path)
    sides = "exchanged" if exchanged else (UNSURE if parsed.side_field == HANDEDNESS else "as told")
    sides = "none" if np.isnan(sets.right).all() else sides
    right = 1.0 - sets.right if exchanged else sets.right
    known = replace(sets, scores=_known_scores(sets.scores), right=right)
    try:
        digest = file_digest(path)[1]
    except RecordingError as error:
        raise UsageError(str(error)) from error
    return KeypointFile(shown_name(path), digest, known, unit in (PIXELS, NORMALISED), unit, sides)


def _parse(path: Path) -> Parsed:
    _check_size(path)
    suffix = path.suffix.lower()
    if suffix in (".jsonl", ".ndjson"):
        return read_json_lines(path)
    return read_json(path) if suffix == ".json" else read_csv(path)


def _check_size(path: Path) -> None:
    """Raise where a file is missing or larger than any that is read."""
    try:
        with open_input(path) as stream:
            size = stream.seek(0, 2)
    except OSError as error:
        raise UsageError("cannot be read", where=path, found=error.strerror or error, hint=KIND) from error
    if size > limits.KEYPOINT_BYTES:
        expected = f"{limits.KEYPOINT_BYTES} at most"
        raise UsageError("is too large", where=path, found=f"{size} bytes", expected=expected)


def _unit_by_numbers(sets: KeypointSets, camera: Camera, path: Path) -> str:
    """The unit that coordinates look like.

    Raises:
        UsageError: they look like none.
    """
    points = sets.points[np.isfinite(sets.points[..., 0])]
    if np.isfinite(points[:, 2]).all():
        low, high = np.percentile(points[:, 2], [100.0 - _MOST_OF, _MOST_OF])
        if METRES_PER_MM * low >= _NEAREST_M:
            return MILLIMETRES
        if low >= _NEAREST_M and high <= _FARTHEST_M:
            return METRES
    if _lies_within(points, 1.0, 1.0):
        if np.percentile(points[:, :2].min(axis=1), _OF_WORLD) < 0.0:
            raise _no_place(path)
        return NORMALISED
    if _lies_within(points, camera.width, camera.height):
        return PIXELS
    (x0, y0), (x1, y1) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    raise UsageError(
        "unit cannot be told",
        where=path,
        found=f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} beside an image of {camera.width} x {camera.height}",
        expected=f"one of {', '.join(UNITS)}",
        hint="--keypoints-unit tells it; pixels are those of the depth images",
    )


def _lies_within(points: FloatArray, width: float, height: float) -> bool:
    """Whether most points (N, 3) lie in an image of a size, or not far beside it."""
    size = np.array([width, height])
    inside = ((points[:, :2] >= -_OUTSIDE * size) & (points[:, :2] <= (1.0 + _OUTSIDE) * size)).all(axis=1)
    return bool(100.0 * inside.mean() >= _MOST_OF)


def _no_place(path: Path) -> UsageError:
    return UsageError(
        "points have no place",
        where=path,
        found="coordinates about an origin in the hand, as MediaPipe's world landmarks have",
        expected="points in the image (px, normalised), or before the camera (mm, m; z is positive)",
        hint="take MediaPipe's image landmarks",
    )


def _in_our_units(sets: KeypointSets, unit: str, camera: Camera, path: Path) -> KeypointSets:
    """The sets in pixels, or in mm before the camera.

    Raises:
        UsageError: points in space lie behind the camera.
    """
    points = sets.points
    if unit in (PIXELS, NORMALISED):
        scale = (camera.width, camera.height) if unit == NORMALISED else (1.0, 1.0)
        # normalised coordinates count from the image's corner, pixels from the first one's centre
        shift = 0.5 if unit == NORMALISED else 0.0
        pixels = points[..., :2] * scale - shift
        return replace(sets, points=np.concatenate([pixels, np.full_like(points[..., 2:], np.nan)], axis=-1))
    points = points / (METRES_PER_MM if unit == METRES else 1.0)
    known = np.isfinite(points[..., 0])
    if not np.isfinite(points[known]).all():
        what = "points in space need a z"
        raise UsageError(what, where=path, expected="x, y, z", hint="--keypoints-unit px is for images")
    if np.percentile(points[known][:, 2], _OF_WORLD) < limits.NEAREST_MM:
        raise _no_place(path)
    points[points[..., 2] < limits.NEAREST_MM] = np.nan
    return replace(sets, points=points)


def _known_scores(scores: FloatArray) -> FloatArray:
    """Scores, those not stated 1; where all are 0 a program wrote the field without filling it."""
    stated = np.isfinite(scores)
    if not scores[stated].any():
        return np.ones_like(scores)
    return np.where(stated, scores, 1.0)
