"""Annotated face landmarks as ground truth: a folder with one ``.pts`` file per frame, as in 300-VW.

The iBUG format has ``version: 1``, ``n_points: 68``, and a line ``x y`` per point in braces. Pixels count
from 1, as in MATLAB, so 1 is subtracted, like in Menpo's importer.
"""

from __future__ import annotations

import re
from itertools import islice
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import TruthError, UsageError
from posetrack_cli.evaluation.reading.tracks import Track, check_stamps
from posetrack_cli.files import read_text
from posetrack_cli.head.landmarks.faces import FACE_POINTS
from posetrack_cli.head.subject import HEAD, OUTER_EYES
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.recording.stamps import DIGITS, number
from posetrack_cli.results.reader import Result
from posetrack_cli.tables import number_of
from posetrack_cli.units import NS_PER_S

SUFFIX, FOLDER = ".pts", "annot"
EXPECTED = "a folder of 000001.pts, 000002.pts, ... as in 300-VW"
FIRST_PIXEL = 1.0
"""Coordinate of the centre of the first pixel in ``.pts`` files."""
_COUNT = re.compile(r"n_points:\s*0*([0-9]+)")


def load_image_points(folder: Path, result: Result) -> Track:
    """Read the annotated landmarks of a face; the last number in a file name is the frame number.

    Frame numbers start at 0 if a file has number 0, else at 1. Frames that the result does not have get
    interpolated or extrapolated stamps at its frame rate.

    Args:
        folder: folder of the files, or of a 300-VW video with the subfolder ``annot``.
        result: result of a head for the annotated frames.

    Returns:
        A track with ``pixels`` and ``frame_index``, without 3D points.

    Raises:
        TruthError: a file cannot be used, or the points do not fit the image size of the result.
        UsageError: the run mirrored its images.
        ResultError: the interpolated stamps do not increase.
    """
    if result.run.get("input.mirror") == "true":
        raise UsageError("image points cannot be used with --mirror", where=folder, found="a mirrored run")
    files = _numbered_files(folder)
    numbers = np.array(sorted(files), dtype=np.int64)
    pixels = np.array([_read_points(files[n]) for n in numbers.tolist()])
    _check_inside(folder, pixels, result)
    # Numbering starts at 0 or 1; annotations need not start with the first frame.
    frames = numbers - min(1, int(numbers[0]))
    first = files[int(numbers[0])]
    return Track(
        f"{first.parent.name} ({first.name} is frame {frames[0]})",
        HEAD,
        shape_names=(),
        point_names=FACE_POINTS.names,
        point_parents=(),
        stamp_ns=stamps_of_frames(folder, frames, result),
        frame_index=frames,
        pixels=pixels,
    )


def _numbered_files(folder: Path) -> dict[int, Path]:
    """Return the files by frame number."""
    try:
        files = _files(folder) or _files(folder / FOLDER)
    except OSError as error:
        raise TruthError("cannot be read", where=folder, found=error.strerror or error) from error
    if not files or len(files) > limits.KEYPOINT_SETS:
        found = f"more than {limits.KEYPOINT_SETS} files" if files else f"no file *{SUFFIX}"
        raise TruthError("not a folder of image points", where=folder, found=found, expected=EXPECTED)
    numbered: dict[int, Path] = {}
    for path in files:
        digits = DIGITS.findall(path.stem)
        frame = number(digits[-1]) if digits else -1
        if not 0 <= frame <= limits.MESSAGES:
            raise TruthError("no frame number in file name", where=path, expected=EXPECTED)
        if frame in numbered:
            raise TruthError("two files have the same frame number", where=path, found=numbered[frame].name)
        numbered[frame] = path
    return numbered


def _files(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    named = (e for e in folder.iterdir() if e.suffix.lower() == SUFFIX and not e.name.startswith("."))
    return sorted(islice(named, limits.KEYPOINT_SETS + 1))


def _read_points(path: Path) -> FloatArray:
    """Return the face points (P, 2) of a file, px."""
    try:
        text = read_text(path, limits.TEXT_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        found = error.strerror or error if isinstance(error, OSError) else "a file that is not UTF-8"
        raise TruthError("cannot be read", where=path, found=found) from error
    head, _, rest = text.partition("{")
    body, closed, _ = rest.partition("}")
    if not closed:
        raise TruthError("incomplete .pts file", where=path, expected="points between { and }")
    rows = [line.split() for line in body.splitlines() if line.strip()]
    stated, places = _COUNT.search(head), FACE_POINTS.places(len(rows))
    if places is None or (stated is not None and stated[1] != str(len(rows))):
        expected = FACE_POINTS.counts if stated is None or places is None else stated[1][:20]
        raise TruthError("wrong number of points", where=path, found=len(rows), expected=expected)
    points = np.empty((FACE_POINTS.size, 2))
    for row, cells in enumerate(rows):
        if len(cells) != points.shape[1]:
            raise TruthError("not a point", where=f"{path}, point {row + 1}", expected="x y")
        values = [number_of(cell, f"{path}, point {row + 1}", TruthError) for cell in cells]
        if row in places:
            points[places[row]] = values
    right, left = (points[FACE_POINTS.names.index(name)] for name in OUTER_EYES)
    # The normalised error is divided by the distance of the outer eye corners.
    if (right == left).all():
        raise TruthError("outer eye corners coincide", where=path)
    return points - FIRST_PIXEL


def _check_inside(folder: Path, pixels: FloatArray, result: Result) -> None:
    """Raise an error if most points are outside the images of the result."""
    camera = result.camera()
    # Integer coordinates are pixel centres, so the image extends from -0.5 to size - 0.5.
    inside = ((pixels >= -0.5) & (pixels < [camera.width - 0.5, camera.height - 0.5])).all(axis=2)
    if 2 * inside.sum() < inside.size:
        x, y = np.ceil(pixels.max(axis=(0, 1))).astype(int) + 1
        raise TruthError(
            "most points are outside the tracked images",
            where=folder,
            found=f"points up to {x}, {y}",
            expected=f"{camera.width}x{camera.height}",
        )


def stamps_of_frames(folder: Path, frames: IntArray, result: Result) -> IntArray:
    """Return the stamps of frames, interpolated or extrapolated for those that the result does not have."""
    own = result.columns(fields=("stamp_ns", "frame_index"))
    known, stamp_ns = own["frame_index"], own["stamp_ns"]
    if not len(known):
        known = stamp_ns = np.zeros(1, dtype=np.int64)
    if (np.diff(known) <= 0).any():
        raise TruthError("frame numbers of the result do not increase", where=folder)
    # Relative to the first stamp, as float64 cannot represent current stamps in ns exactly.
    since = (stamp_ns - stamp_ns[0]).astype(float)
    interval = since[-1] / float(known[-1] - known[0]) if len(known) > 1 else float(NS_PER_S)
    beyond = np.minimum(frames - known[0], 0) + np.maximum(frames - known[-1], 0)
    placed = np.rint(np.interp(frames, known, since) + interval * beyond)
    if (np.abs(placed + float(stamp_ns[0])) > LATEST_NS / 2).any():
        raise TruthError("frame number too large for 64-bit stamps", where=folder, found=int(frames[-1]))
    stamps: IntArray = stamp_ns[0] + placed.astype(np.int64)
    check_stamps(stamps, folder.name)
    return stamps
