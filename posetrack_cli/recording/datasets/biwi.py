"""Biwi Kinect head pose sequences: Kinect v1 colour and depth with two calibrations.

A folder has frame_NNNNN_rgb.png, frame_NNNNN_depth.bin (16-bit mm, runs without and with readings), rgb.cal
and depth.cal. A calibration has K, four distortion coefficients, R and t in mm from the depth camera to
this one, width and height.
"""

from __future__ import annotations

import re
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.datasets.layout import (
    Dataset,
    DatasetImage,
    camera_of,
    describe_dataset,
    nominal_stamps,
    numbered,
    numbers_of,
    open_depth,
    open_grey,
)
from posetrack_cli.recording.grey import decode_as_stored
from posetrack_cli.recording.image_files import ImageFile, read_image
from posetrack_cli.recording.recording import ReadingOptions, Recording

WORDS = "Biwi Kinect head pose sequence"
COLOUR_CALIBRATION, DEPTH_CALIBRATION = "rgb.cal", "depth.cal"
COLOUR_IMAGE = re.compile(r"frame_([0-9]{1,9})_rgb\.png")
DEPTH_IMAGE = re.compile(r"frame_([0-9]{1,9})_depth\.bin")
SIZE = struct.Struct("<ii")  # width and height
RUN = struct.Struct("<ii")  # pixels without and with a reading; the 16-bit readings follow
# Count of numbers in K; in R, t, width and height; and in the distortion between them
MATRIX, EXTRINSICS_AND_SIZE, DISTORTIONS = 9, 14, (0, 4, 5)
SENSOR = "a Kinect"


def is_biwi(path: Path) -> bool:
    """Return whether a path is a sequence folder: a calibration and images with its names."""
    calibrations = ((COLOUR_CALIBRATION, COLOUR_IMAGE), (DEPTH_CALIBRATION, DEPTH_IMAGE))
    if not path.is_dir() or not any((path / name).is_file() for name, _ in calibrations):
        return False
    try:
        return any(name.fullmatch(file.name) for file in path.iterdir() for _, name in calibrations)
    except OSError:
        return False


def open_biwi_depth(path: Path, options: ReadingOptions) -> Recording:
    """Open the depth of a sequence.

    Raises:
        RecordingError: the calibration or the images are missing or damaged.
    """
    return open_depth(_dataset(path, options, DEPTH_IMAGE, DEPTH_CALIBRATION), options)


def open_biwi_colour(path: Path, options: ReadingOptions) -> Recording:
    """Open the colour images of a sequence.

    Raises:
        RecordingError: the calibration or the images are missing or damaged.
    """
    return open_grey(_dataset(path, options, COLOUR_IMAGE, COLOUR_CALIBRATION), options)


def describe_biwi(path: Path) -> dict[str, Any]:
    """Describe a sequence."""
    return describe_dataset(path, WORDS, {"hand run": open_biwi_depth, "head mono": open_biwi_colour})


def load_calibration(path: Path) -> Camera:
    """Return the camera of a calibration, without its extrinsics.

    Raises:
        RecordingError: the file cannot be read, or is not a calibration.
    """
    values = numbers_of(path)
    lens = len(values) - MATRIX - EXTRINSICS_AND_SIZE
    if lens not in DISTORTIONS:
        expected = "K, distortion, R, t, width and height"
        raise RecordingError(
            "invalid calibration", where=path, found=f"{len(values)} numbers", expected=expected
        )
    distortion = tuple(values[MATRIX : MATRIX + lens])
    width, height = values[-2:]
    if not (width.is_integer() and height.is_integer()):
        raise RecordingError("invalid calibration", where=path, found=f"size {width:g} x {height:g}")
    return camera_of(
        round(width),
        round(height),
        values[0],
        values[4],
        values[2],
        values[5],
        path,
        distortion=distortion if any(distortion) else (),
    )


def decode_depth(data: bytes) -> ImageArray:
    """Return (height, width) uint16 depth, mm, from a file of runs.

    Raises:
        UnreadableImageError: the file is truncated, damaged, or exceeds ``limits``.
    """
    if len(data) < SIZE.size:
        raise UnreadableImageError("image is incomplete")
    width, height = SIZE.unpack_from(data)
    if min(width, height) < 1:
        raise UnreadableImageError("image is damaged")
    if width * height > limits.IMAGE_PIXELS:
        raise UnreadableImageError(f"image has more than {limits.IMAGE_PIXELS} pixels")
    depth = np.zeros(width * height, np.int16)
    pixel, at = 0, SIZE.size
    while pixel < len(depth):
        if at + RUN.size > len(data):
            raise UnreadableImageError("image is incomplete")
        empty, count = RUN.unpack_from(data, at)
        at += RUN.size
        end = pixel + empty + count
        if min(empty, count) < 0 or not empty + count or end > len(depth):
            raise UnreadableImageError("image is damaged")
        if at + 2 * count > len(data):
            raise UnreadableImageError("image is incomplete")
        depth[pixel + empty : end] = np.frombuffer(data, "<i2", count, at)
        pixel, at = end, at + 2 * count
    return np.maximum(depth, 0).astype(np.uint16).reshape(height, width)


def _dataset(path: Path, options: ReadingOptions, name: re.Pattern[str], calibration: str) -> Dataset:
    images = numbered(path, name)
    if not images:
        expected = "frame_00000_rgb.png, ..." if name is COLOUR_IMAGE else "frame_00000_depth.bin, ..."
        raise RecordingError("no images", where=path, expected=expected)
    stamps, fps, said = nominal_stamps(images, options.get("fps"), SENSOR)
    read = _colour if name is COLOUR_IMAGE else _depth
    stored = [
        DatasetImage(stamp, file.name, partial(read, file))
        for stamp, file in zip(stamps, images.values(), strict=True)
    ]
    files = [(file.name, file) for file in (*images.values(), path / calibration)]
    camera = load_calibration(path / calibration)
    return Dataset(path, WORDS, stored, camera, calibration, files, remarks=said, fps=fps)


def _depth(file: Path) -> ImageArray:
    return decode_depth(read_image(ImageFile(file)))


def _colour(file: Path) -> ImageArray:
    return decode_as_stored(read_image(ImageFile(file)))
