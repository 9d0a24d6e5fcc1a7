"""Opens files of keypoints, whatever their layout, and makes pixels of points in images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import open_input
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.identity import file_digest, files_digest
from posetrack_cli.recording.keypoints.json_text import frame_files, read_folder, read_json, read_json_lines
from posetrack_cli.recording.keypoints.kind import PointKind
from posetrack_cli.recording.keypoints.layout import NORMALISED, PIXELS, Parsed
from posetrack_cli.recording.keypoints.sets import KeypointSets
from posetrack_cli.recording.keypoints.tables import KIND, read_csv

MOST_OF = 90.0
"""Percent of the points that have to lie where a unit would have them."""
_OUTSIDE = 0.5
"""Of the image's size beside it: landmarks that are cut off."""


def parse_keypoints(path: Path, kind: PointKind) -> Parsed:
    """Read keypoints that another program found, in the file's unit.

    Args:
        path: CSV; JSON, one value (``.json``) or one per line (``.jsonl``, ``.ndjson``); or a folder of JSON
            files, one a frame.
        kind: whose points they are.

    Raises:
        UsageError: no such file; or names file, line and field of what cannot be used.
    """
    if path.is_dir():
        return read_folder(path, kind)
    _check_size(path)
    suffix = path.suffix.lower()
    if suffix in (".jsonl", ".ndjson"):
        return read_json_lines(path, kind)
    return read_json(path, kind) if suffix == ".json" else read_csv(path, kind)


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
