"""Match keypoint sets to a recording's frames, and determine their unit."""

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

# Matching sets to frames

COMPARED = 100  # early frames whose stamps are compared with the file's


def fitted_to(sets: KeypointSets, recording: Recording) -> tuple[KeypointSets, str]:
    """Return the sets with keys that match a recording's frames, and a remark on what was decided.

    If a file has frame numbers and stamps, stamps are used if they match the recording's; stamps computed
    from an average rate do not. Numbers count from 1 if the last one is the number of frames.

    Args:
        sets: sets as read.
        recording: recording whose early stamps are compared.
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
    stated_ns = dict(zip(numbered.keys.tolist(), sets.keys[order].tolist(), strict=True))
    apart = [abs(stated_ns[number] - stamp) for number, stamp in stamps.items() if number in stated_ns]
    if not apart or 2 * sum(gap <= near.tolerance_ns for gap in apart) >= len(apart):
        return near, ""
    worst, usual = max(apart), median(intervals)
    off = f"stamps differ from the recording's by up to {worst / NS_PER_S:.2g} s ({worst / usual:.0f} frames)"
    return numbered, f"{off}: using frame numbers{words and f', {words}'}"


def _numbered(sets: KeypointSets, recording: Recording) -> tuple[KeypointSets, str]:
    """Return sets numbered from 0."""
    count = recording.frame_count
    if count is None or not len(sets) or sets.keys[0] < 1 or sets.keys[-1] != count:
        return sets, ""
    return replace(sets, keys=sets.keys - 1), f"frame numbers count from 1: the last is {count} of {count}"


def _by_number(sets: KeypointSets) -> KeypointSets:
    """Return the sets sorted and keyed by frame number."""
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
    """Return the stamps, ns, of early frames by frame number."""
    frames = recording.stored_frames(LossLog())
    return {number: frame.stamp_ns for number, frame in islice(frames, COMPARED)}


class KeypointUse:
    """Counts the frames of a run that have keypoints.

    Args:
        name: name of the file.
        sets: its sets.
        what: name of the points, for the remark.
    """

    def __init__(self, name: str, sets: KeypointSets, what: str = "keypoints") -> None:
        self._name, self._sets, self._what = name, sets, what
        self._frames, self._matched = 0, 0

    def see(self, index: int, stamp_ns: int) -> None:
        """Count a frame."""
        rows = self._sets.of(index, stamp_ns)
        self._frames += 1
        self._matched += int(rows.stop > rows.start)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A remark if most frames have no keypoints, which may mean a matching problem."""
        if 2 * self._matched >= self._frames:
            return ()
        by = "by stamp within 10 ms" if self._sets.by_stamp else "by frame number from 0"
        return (f"{self._name} has {self._what} for {self._matched} of {self._frames} frames, matched {by}",)


# Units of image points

MOST_OF = 90.0  # percent of points that must lie in the image for a unit to be accepted
_OUTSIDE = 0.5  # margin around the image, over its size, for truncated subjects


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a keypoint file or folder; raises UsageError if it cannot be read."""
    try:
        if path.is_dir():
            return files_digest((file.name, file) for file in frame_files(path))[1]
        return file_digest(path)[1]
    except RecordingError as error:
        raise UsageError(str(error)) from error


def image_unit(points: FloatArray, camera: Camera, path: Path, units: Sequence[str], hint: str) -> str:
    """Return the unit of image points (N, 2 or 3), normalised or pixels, judged by their range.

    Args:
        points: points as read.
        camera: camera of the images.
        path: path of the file, for the error.
        units: units that the user may choose, for the error.
        hint: how to choose one, for the error.

    Raises:
        UsageError: neither unit fits.
    """
    if _lie_within(points, 1.0, 1.0):
        return NORMALISED
    if _lie_within(points, camera.width, camera.height):
        return PIXELS
    (x0, y0), (x1, y1) = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    raise UsageError(
        "unknown unit",
        where=path,
        found=f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} for {camera.width}x{camera.height} images",
        expected=f"one of {', '.join(units)}",
        hint=hint,
    )


def _lie_within(points: FloatArray, width: float, height: float) -> bool:
    """Return whether most points lie in an image of this size or its margin."""
    size = np.array([width, height])
    inside = ((points[:, :2] >= -_OUTSIDE * size) & (points[:, :2] <= (1.0 + _OUTSIDE) * size)).all(axis=1)
    return bool(100.0 * inside.mean() >= MOST_OF)


def in_pixels(sets: KeypointSets, unit: str, camera: Camera) -> KeypointSets:
    """Return sets of image points converted to pixels.

    Normalised coordinates count from the image's corner, pixels from the first one's centre.
    """
    is_normalised = unit == NORMALISED
    scale, shift = ((camera.width, camera.height), 0.5) if is_normalised else ((1.0, 1.0), 0.0)
    pixels = sets.points[..., :2] * scale - shift
    unknown = np.full_like(sets.points[..., 2:], np.nan)
    return replace(sets, points=np.concatenate([pixels, unknown], axis=-1))


def known_scores(scores: FloatArray) -> FloatArray:
    """Return scores with 1 where not stated; if all are 0 the field was written but not filled."""
    stated = np.isfinite(scores)
    if not scores[stated].any():
        return np.ones_like(scores)
    return np.where(stated, scores, 1.0)
