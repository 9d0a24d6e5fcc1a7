"""Describe folders of images: depth, or grey images of one or more cameras; what is missing has a reason."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.files import placed_path
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.camera_file import load_depth_camera
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.description import described_cameras, described_stamps, opened
from posetrack_cli.recording.folder import depth_camera_path, open_depth_folder, open_grey_folder
from posetrack_cli.recording.grey import decode_as_stored, grey_like
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.image_files import (
    DEPTH_SUFFIXES,
    decode_any,
    first_decoded,
    list_images,
    read_image,
)
from posetrack_cli.recording.image_folders import CameraFolders, find_folders
from posetrack_cli.recording.stamps import STAMPS_FILE_NAME, load_stamps

ANY_RATE_HZ = 30.0
"""Which images belong together does not depend on it."""


def describe_folder(path: Path) -> dict[str, Any]:
    """Describe a folder of 16-bit depth, or images of cameras; of depth only the first image is read."""
    folders = find_folders(path)
    images = folders.by_name.get("")
    if images is not None:
        first = first_decoded(images, _as_stored)
        if (
            first.ndim == 2
            and first.dtype in (np.uint16, np.float32)
            and images[0].suffix.lower() in DEPTH_SUFFIXES
        ):
            return _describe_depth(path)
    return _describe_grey(folders)


def _describe_depth(path: Path) -> dict[str, Any]:
    """Describe a folder of depth images: number, size, stamps, camera; what is missing has a reason."""
    images = list_images(path)
    first = first_decoded(images, _as_stored)
    height, width = first.shape[:2]
    channels = 1 if first.ndim == 2 else first.shape[2]
    image = {"width": width, "height": height, "bits": 8 * first.dtype.itemsize, "channels": channels}
    stamps, no_stamps = _or_reason(lambda: _stamps(path, images))
    camera, no_camera = _or_reason(lambda: _camera(path, width, height))
    return {
        "name": shown_name(placed_path(path)),
        "kind": "folder",
        "bytes": sum(entry.stat().st_size for entry in images),
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "image": image,
        "stamps": stamps,
        "no_stamps": no_stamps,
        "cameras": [camera] if camera else [],
        "no_camera": no_camera,
        "losses": [],
    }


def _describe_grey(folders: CameraFolders) -> dict[str, Any]:
    """Describe the images of each camera, the frames that they make, and the cameras together."""
    path, by_name = folders.path, folders.by_name
    fps, no_stamps = _rate_if_unstamped(folders)
    recording, no_camera = opened(lambda: open_grey_folder(path, {"fps": fps}))
    matched = () if recording is None else recording.matched(LossLog())
    frames = [frame for frame in matched if frame is not None]
    return {
        "name": shown_name(placed_path(path)),
        "kind": "images",
        "bytes": sum(image.stat().st_size for images in by_name.values() for image in images),
        "folders": [_folder(name, images) for name, images in by_name.items()],
        "frames": len(frames),
        "incomplete_frames": sum(None in frame.images for frame in frames),
        "stamps": described_stamps(f.stamp_ns for f in frames) if not no_stamps and frames else None,
        "no_stamps": no_stamps,
        "cameras": described_cameras(recording),
        "no_camera": no_camera,
        "losses": [],
    }


def _or_reason(make: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any] | None, str | None]:
    try:
        return make(), None
    except PosetrackError as error:
        return None, str(error)


def _stamps(path: Path, images: list[Path]) -> dict[str, Any]:
    if not (path / STAMPS_FILE_NAME).exists():
        raise RecordingError(f"no {STAMPS_FILE_NAME}", hint="pass --fps")
    return described_stamps(load_stamps(path / STAMPS_FILE_NAME, [image.name for image in images]))


def _camera(path: Path, width: int, height: int) -> dict[str, Any]:
    settings = load_depth_camera(depth_camera_path(path, None, (width, height)))
    recording = open_depth_folder(path, {"fps": ANY_RATE_HZ})
    (pixels,) = recording.pixels
    unit_mm = pixels.unit_mm if isinstance(pixels, Depth) else None
    depth = {"depth_unit_mm": unit_mm, "missing": settings.missing, "mirror": settings.mirror}
    return recording.cameras[0].values() | depth


def _as_stored(image: Path) -> ImageArray:
    return decode_any(read_image(image))


def _rate_if_unstamped(folders: CameraFolders) -> tuple[float | None, str | None]:
    """Return a rate to read images without stamps at, and why they have none."""
    try:
        folders.stamped(None)
    except PosetrackError as error:
        return ANY_RATE_HZ, str(error)
    return None, None


def _folder(name: str, images: Sequence[Path]) -> dict[str, Any]:
    kind = first_decoded(images, lambda image: grey_like(decode_as_stored(read_image(image)), image))
    return {
        "name": name,
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "width": kind.width,
        "height": kind.height,
        "stored": kind.words,
    }
