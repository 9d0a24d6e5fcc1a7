"""Keypoint files opened, their units, and which of their frames are whose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from statistics import median

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.identity import file_digest, files_digest
from posetrack_cli.recording.keypoints.formats import frame_files
from posetrack_cli.recording.keypoints.layout import (
    NORMALISED,
    NS_TOLERANCE,
    PIXELS,
    KeypointSets,
)
from posetrack_cli.recording.recording import Recording
from posetrack_cli.units import NS_PER_S

# Which frames of a recording the keypoints of a file are of, and for how many of a run there were any


COMPARED = 100
"""Early frames whose stamps are compared with those of a file."""


def fitted_to(sets: KeypointSets, recording: Recording) -> tuple[KeypointSets, str]:
    """Return the sets of a file as they belong to a recording's frames, and what was decided, for people.

    Where a file states frame numbers and stamps, the stamps count if they are the recording's, else the
    numbers: stamps that were computed from an average rate are not. Numbers count from 1 if the last one is
    the number of frames.

    Args:
        sets: as they were read.
        recording: whose early frames' stamps are compared.
    """
    if not sets.by_stamp:
        return _numbered(sets, recording)
    stamps = _early_stamps(recording)
    intervals = [b - a for a, b in pairwise(stamps.values()) if b > a] or [2 * NS_TOLERANCE]
    near = replace(sets, tolerance_ns=min(NS_TOLERANCE, min(intervals) // 2))
    if sets.numbers is None or (sets.numbers < 0).any():
        return near, ""
    numbered, words = _numbered(_by_number(sets), recording)
    order = np.argsort(sets.numbers, kind="stable")
    told = dict(zip(numbered.keys.tolist(), sets.keys[order].tolist(), strict=True))
    apart = [abs(told[number] - stamp) for number, stamp in stamps.items() if number in told]
    if not apart or 2 * sum(gap <= near.tolerance_ns for gap in apart) >= len(apart):
        return near, ""
    worst, usual = max(apart), median(intervals)
    off = f"its stamps are up to {worst / NS_PER_S:.2g} s ({worst / usual:.0f} frames) off the recording's"
    return numbered, f"{off}: frame numbers are used{words and f', {words}'}"


def _numbered(sets: KeypointSets, recording: Recording) -> tuple[KeypointSets, str]:
    """Return sets by numbers from 0."""
    count = recording.frame_count
    if count is None or not len(sets) or sets.keys[0] < 1 or sets.keys[-1] != count:
        return sets, ""
    return replace(sets, keys=sets.keys - 1), f"numbers count from 1: the last is {count} of {count} frames"


def _by_number(sets: KeypointSets) -> KeypointSets:
    """Return the sets of a file in order of its frame numbers."""
    numbers = sets.keys if sets.numbers is None else sets.numbers
    order = np.argsort(numbers, kind="stable")
    return replace(
        sets,
        keys=numbers[order],
        by_stamp=False,
        points=sets.points[order],
        scores=sets.scores[order],
        right=sets.right[order],
        numbers=None,
    )


def _early_stamps(recording: Recording) -> dict[int, int]:
    """Return the stamps, ns, of some early frames by their numbers."""
    frames = recording.stored_frames(LossLog())
    return {number: frame.stamp_ns for number, frame in islice(frames, COMPARED)}


class KeypointUse:
    """Counts for which frames of a run there are keypoints.

    Args:
        name: of the file.
        sets: what it holds.
        what: they are called.
    """

    def __init__(self, name: str, sets: KeypointSets, what: str = "keypoints") -> None:
        self._name, self._sets, self._what = name, sets, what
        self._frames, self._told = 0, 0

    def see(self, index: int, stamp_ns: int) -> None:
        """Count a frame."""
        rows = self._sets.of(index, stamp_ns)
        self._frames += 1
        self._told += int(rows.stop > rows.start)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to say at the end, in one line: most frames have none, so perhaps they are matched wrongly."""
        if 2 * self._told >= self._frames:
            return ()
        by = "by stamps, to 10 ms" if self._sets.by_stamp else "by number, counted from 0"
        return (f"{self._name} has {self._what} for {self._told} of {self._frames} frames, matched {by}",)


# Makes pixels of points in images


MOST_OF = 90.0
"""Percent of the points that have to lie where a unit would have them."""
_OUTSIDE = 0.5
"""Of the image's size beside it: landmarks that are cut off."""


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file of keypoints; UsageError if it cannot be read."""
    try:
        if path.is_dir():
            return files_digest((file.name, file) for file in frame_files(path))[1]
        return file_digest(path)[1]
    except RecordingError as error:
        raise UsageError(str(error)) from error


def image_unit(points: FloatArray, camera: Camera, path: Path, units: Sequence[str], hint: str) -> str:
    """Return the unit that most of some points (N, 2 or 3) in images look like: normalised or pixels.

    Args:
        points: as read.
        camera: of the images that they were found in.
        path: the file's, for the error.
        units: that may be told, for the error.
        hint: how.

    Raises:
        UsageError: they look like neither.
    """
    if _lie_within(points, 1.0, 1.0):
        return NORMALISED
    if _lie_within(points, camera.width, camera.height):
        return PIXELS
    (x0, y0), (x1, y1) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    raise UsageError(
        "unit cannot be told",
        where=path,
        found=f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} beside an image of {camera.width} x {camera.height}",
        expected=f"one of {', '.join(units)}",
        hint=hint,
    )


def _lie_within(points: FloatArray, width: float, height: float) -> bool:
    """Whether most points lie in an image of a size, or not far beside it."""
    size = np.array([width, height])
    inside = ((points[:, :2] >= -_OUTSIDE * size) & (points[:, :2] <= (1.0 + _OUTSIDE) * size)).all(axis=1)
    return bool(100.0 * inside.mean() >= MOST_OF)


def in_pixels(sets: KeypointSets, unit: str, camera: Camera) -> KeypointSets:
    """Return sets of points in images in pixels.

    Normalised coordinates count from the image's corner, pixels from the first one's centre.
    """
    is_normalised = unit == NORMALISED
    scale, shift = ((camera.width, camera.height), 0.5) if is_normalised else ((1.0, 1.0), 0.0)
    pixels = sets.points[..., :2] * scale - shift
    unknown = np.full_like(sets.points[..., 2:], np.nan)
    return replace(sets, points=np.concatenate([pixels, unknown], axis=-1))


def known_scores(scores: FloatArray) -> FloatArray:
    """Return scores, those not stated 1; where all are 0 a program wrote the field without filling it."""
    stated = np.isfinite(scores)
    if not scores[stated].any():
        return np.ones_like(scores)
    return np.where(stated, scores, 1.0)
