"""Recordings of Stray Scanner, an app for iPhones and iPads with LiDAR.

A folder has depth/NNNNNN.png (16-bit mm), confidence/NNNNNN.png (0, 1 or 2), rgb.mp4, camera_matrix.csv
(3x3, of the video) and odometry.csv, whose lines have time in seconds and image number; newer versions add
the intrinsics of each image. All images are in sensor orientation: landscape.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.camera_of import is_off_centre, principal_point_fault
from posetrack_cli.recording.datasets.layout import (
    Dataset,
    DatasetImage,
    camera_of,
    describe_dataset,
    known_rig,
    numbered,
    numbers_of,
    open_depth,
)
from posetrack_cli.recording.image_files import ImageFile, decode_any, decode_codes, read_image
from posetrack_cli.recording.recording import ReadingOptions, Recording
from posetrack_cli.recording.video import open_video
from posetrack_cli.recording.video_file import opened_video
from posetrack_cli.tables import TextFile, number_of, whole_of
from posetrack_cli.units import NS_PER_S

WORDS = "Stray Scanner recording"
MATRIX, ODOMETRY, VIDEO = "camera_matrix.csv", "odometry.csv", "rgb.mp4"
DEPTH, CONFIDENCE = "depth", "confidence"
LIKELY_SIZE = (1920, 1440)  # video size if there is no video
# ARKit's lowest confidence: edges, dark and shiny surfaces.
UNTRUSTED = 0
TIME, NUMBER, INTRINSICS = "timestamp", "frame", ("fx", "fy", "cx", "cy")
IMAGE = re.compile(r"([0-9]{1,18})\.png")
EXPECTED = "odometry must be a CSV file in UTF-8"


def is_stray_scanner(path: Path) -> bool:
    """Return whether a path is a Stray Scanner folder."""
    return path.is_dir() and (path / MATRIX).is_file() and (path / ODOMETRY).is_file()


def open_stray_depth(path: Path, options: ReadingOptions) -> Recording:
    """Open the depth of a Stray Scanner folder.

    Raises:
        RecordingError: a file is missing or damaged.
    """
    rows = _rows(path / ODOMETRY)
    images = numbered(path / DEPTH, IMAGE)
    levels = numbered(path / CONFIDENCE, IMAGE) if (path / CONFIDENCE).is_dir() else {}
    if not images:
        raise RecordingError(
            "no depth images",
            where=path / DEPTH,
            expected="16-bit images 000000.png and so on",
            hint="NPY files of Stray Scanner 2021 are not supported: record with a newer version",
        )
    whole, of = _video_camera(path)
    read = [(row, images[row.number], levels.get(row.number)) for row in rows if row.number in images]
    if not read:
        found = f"numbers {rows[0].number} to {rows[-1].number}" if rows else "no lines"
        raise RecordingError("no depth image has a stamp", where=path / ODOMETRY, found=found)
    cameras = [row.camera(whole, path / ODOMETRY) for row, _, _ in read]
    stored = [
        DatasetImage(row.stamp_ns, f"{DEPTH}/{file.name}", partial(_depth, file, level), camera)
        for (row, file, level), camera in zip(read, cameras, strict=True)
    ]
    remarks = [f"images are landscape (sensor orientation); intrinsics are those of {of}"]
    if levels:
        remarks.append(f"depth with confidence {UNTRUSTED} is ignored")
    if len(set(cameras)) > 1:
        remarks.append("intrinsics change during the recording: applied image by image")
    if len(images) > len(read):
        remarks.append(f"skipped {len(images) - len(read)} depth images without a stamp in {ODOMETRY}")
    files = [(f"{DEPTH}/{file.name}", file) for _, file, _ in read]
    files += [(f"{CONFIDENCE}/{level.name}", level) for _, _, level in read if level is not None]
    files += [(name, path / name) for name in (MATRIX, ODOMETRY)]
    dataset = Dataset(path, WORDS, stored, cameras[0], MATRIX, files, remarks=tuple(remarks))
    return open_depth(dataset, options)


def open_stray_video(path: Path, options: ReadingOptions) -> Recording:
    """Open the video of a Stray Scanner folder with its camera.

    Raises:
        RecordingError: a file is missing or damaged.
    """
    if options.get("camera_file") is not None:
        return open_video(path / VIDEO, options)
    camera, _ = _video_camera(path)
    return open_video(path / VIDEO, options, known_rig(path / MATRIX, camera))


def describe_stray(path: Path) -> dict[str, Any]:
    """Describe a Stray Scanner folder."""
    return describe_dataset(path, WORDS, {"hand run": open_stray_depth, "head mono": open_stray_video})


@dataclass(frozen=True)
class _Row:
    """A line of the odometry.

    Attributes:
        stamp_ns: time of capture.
        number: number of the image.
        intrinsics: fx, fy, cx, cy of the video image; None if not stated.
    """

    stamp_ns: int
    number: int
    intrinsics: tuple[float, float, float, float] | None

    def camera(self, whole: Camera, where: Path) -> Camera:
        """Return the camera of this image, given the recording's."""
        if self.intrinsics is None:
            return whole
        return camera_of(whole.width, whole.height, *self.intrinsics, where)


def _rows(path: Path) -> list[_Row]:
    file = TextFile(path, RecordingError, EXPECTED)
    table = file.table((TIME, NUMBER), "...")
    return [_row(dict(zip(table.names, row, strict=True)), file.where(line)) for line, row in table]


def _row(cells: dict[str, str], where: str) -> _Row:
    stamp_ns = whole_of(cells[TIME], where, RecordingError, NS_PER_S)
    number = whole_of(cells[NUMBER], where, RecordingError)
    stated = [number_of(cells[n], where, RecordingError, optional=True) for n in INTRINSICS if n in cells]
    fx, fy, cx, cy = stated if len(stated) == len(INTRINSICS) else [0.0] * len(INTRINSICS)
    return _Row(stamp_ns, number, (fx, fy, cx, cy) if fx > 0 else None)


def _video_camera(path: Path) -> tuple[Camera, str]:
    """Return the camera of the video, and the source of its image size.

    Raises:
        RecordingError: the matrix is invalid, or does not fit the image size.
    """
    matrix = numbers_of(path / MATRIX)
    if len(matrix) != 9:
        expected = "3 lines of 3 numbers"
        raise RecordingError(
            "invalid camera matrix", where=path / MATRIX, found=f"{len(matrix)} numbers", expected=expected
        )
    width, height = LIKELY_SIZE
    of = f"images of {width}x{height}"
    if (path / VIDEO).is_file():
        with opened_video(path / VIDEO) as video:
            width, height = video.stream.width, video.stream.height
        of = VIDEO
    camera = camera_of(width, height, matrix[0], matrix[4], matrix[2], matrix[5], path / MATRIX)
    if is_off_centre(camera) or principal_point_fault(camera):
        raise RecordingError(
            "camera matrix does not fit the video",
            where=path / MATRIX,
            found=f"cx {camera.cx:g} cy {camera.cy:g}",
            expected=f"near the centre of {width}x{height}",
            hint="pass --camera with the intrinsics of the images",
        )
    return camera, of


def _depth(file: Path, level: Path | None) -> ImageArray:
    """Return depth, mm, without readings of the lowest confidence.

    Raises:
        UnreadableImageError: the depth cannot be decoded.
    """
    codes = decode_codes(read_image(ImageFile(file)), str(file))
    if level is None:
        return codes
    levels = decode_any(read_image(ImageFile(level)))
    if levels.shape != codes.shape:
        raise UnreadableImageError("confidence and depth differ in size")
    return np.where(levels == UNTRUSTED, 0, codes).astype(codes.dtype)
