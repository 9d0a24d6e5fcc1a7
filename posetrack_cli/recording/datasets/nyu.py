"""NYU hand pose data: 16-bit Kinect depth in mm, packed in 8-bit colour PNGs.

Names are depth_C_NNNNNNN.png of camera C; rendered images are named synthdepth. Green has the upper eight
bits, blue the lower ones. J. Tompson et al., Real-Time Continuous Pose Recovery of Human Hands, 2014.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.datasets.layout import (
    Dataset,
    DatasetImage,
    describe_dataset,
    nominal_stamps,
    numbered,
    open_depth,
)
from posetrack_cli.recording.image_files import ImageFile, decode_any, read_image
from posetrack_cli.recording.recording import ReadingOptions, Recording

WORDS = "NYU hand pose images"
KINDS = ("depth", "synthdepth")
NAME = re.compile(r"((?:synth)?depth)_([0-9])_([0-9]{7})\.png")
CAMERA = Camera(640, 480, 588.036865, 587.075073, 320.0, 240.0)  # published with the data
BLUE, GREEN = 0, 1
# Median of depth; most of an image may be 32001, a Kinect's code for no reading.
PLAUSIBLE_MM = (200.0, 40_000.0)
# Share of neighbouring readings within ``STEP_MM`` in depth images; swapped bytes give few.
SMOOTH = 0.9
STEP_MM = 64
SENSOR = "a Kinect"
LOOKED_AT = 5  # images inspected


def is_nyu(path: Path) -> bool:
    """Return whether a path is a folder with such names whose first images hold packed depth."""
    return path.is_dir() and any(_is_packed(path / name) for name in islice(_names(path), LOOKED_AT))


def open_nyu_depth(path: Path, options: ReadingOptions) -> Recording:
    """Open the depth of the first camera, measured rather than rendered.

    Raises:
        RecordingError: the folder cannot be listed.
    """
    found = sorted({match.groups()[:2] for name in _names(path) if (match := NAME.fullmatch(name))})
    kind, camera = found[0]
    images = numbered(path, re.compile(rf"{kind}_{camera}_([0-9]{{7}})\.png"))
    stamps, fps, said = nominal_stamps(images, options.get("fps"), SENSOR)
    stored = [
        DatasetImage(stamp, file.name, partial(_depth, file))
        for stamp, file in zip(stamps, images.values(), strict=True)
    ]
    others = ", ".join(f"{kind} of camera {number}" for kind, number in found[1:])
    remarks = ["depth in mm is unpacked from green and blue", *said]
    if others:
        remarks.insert(0, f"reading {kind} of camera {camera}; ignoring {others}")
    files = [(file.name, file) for file in images.values()]
    why = "published with the data"
    return open_depth(
        Dataset(path, WORDS, stored, CAMERA, why, files, remarks=tuple(remarks), fps=fps), options
    )


def describe_nyu(path: Path) -> dict[str, Any]:
    """Describe an NYU folder."""
    return describe_dataset(path, WORDS, {"hand run": open_nyu_depth})


def unpacked(image: ImageArray) -> ImageArray:
    """Return (height, width) uint16 depth, mm, from an image with channels blue, green, red.

    Raises:
        UnreadableImageError: the image has another format.
    """
    if image.ndim != 3 or image.dtype != np.uint8:
        raise UnreadableImageError("image has no packed depth")
    return (image[..., GREEN].astype(np.uint16) << 8) | image[..., BLUE]


def _names(path: Path) -> Iterator[str]:
    """Yield the names of matching images; scandir keeps large unrelated folders fast."""
    with suppress(OSError), os.scandir(path) as entries:
        yield from (entry.name for entry in entries if NAME.fullmatch(entry.name))


def _is_packed(file: Path) -> bool:
    """Return whether an image holds depth: plausible, and smooth once green and blue are combined."""
    with suppress(UnreadableImageError):
        depth = _depth(file).astype(np.int64)
        readings = depth[depth > 0]
        if not readings.size or not PLAUSIBLE_MM[0] <= np.median(readings) <= PLAUSIBLE_MM[1]:
            return False
        both = (depth[:, 1:] > 0) & (depth[:, :-1] > 0)
        steps = np.abs(np.diff(depth, axis=1))[both]
        return bool(steps.size and np.mean(steps <= STEP_MM) >= SMOOTH)
    return False


def _depth(file: Path) -> ImageArray:
    return unpacked(decode_any(read_image(ImageFile(file))))
