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
from posetrack_cli.recording.grey import decode_shown, grey_like
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.image_files import (
    DEPTH_SUFFIXES,
    ImageFile,
    decode_any,
    files_of,
    first_decoded,
    read_image,
)
from posetrack_cli.recording.image_folders import CameraFolders, Timing, depth_below, find_depth, find_folders
from posetrack_cli.recording.image_lists import DEPTH_WORD

ANY_RATE_HZ = 30.0
"""Which images belong together does not depend on it."""


def describe_folder(path: Path) -> dict[str, Any]:
    """Describe a folder of 16-bit depth, or images of cameras; of depth only the first image is read.

    Of a folder with depth below both this and the images of cameras are described, the latter under
    ``colour``.
    """
    if (depth := depth_below(path)) is not None:
        others = _others(path)
        return _describe_depth(depth) | ({} if others is None else {"colour": _describe_grey(others)})
    folders = find_folders(path)
    images = folders.by_name.get("")
    if images is not None:
        first = first_decoded(images, _as_stored)
        if (
            first.ndim == 2
            and first.dtype in (np.uint16, np.float32)
            and images[0].suffix.lower() in DEPTH_SUFFIXES
        ):
            return _describe_depth(find_depth(path))
    return _describe_grey(folders)


def _others(path: Path) -> CameraFolders | None:
    """Return the images of a folder that are not called depth, None if there are none."""
    try:
        found = find_folders(path).without_depth()
    except RecordingError:
        return None
    return None if all(DEPTH_WORD in name.lower() for name in found.by_name) else found


def _describe_depth(found: CameraFolders) -> dict[str, Any]:
    """Describe a folder of depth images: number, size, stamps, camera; what is missing has a reason."""
    path, (images,) = found.path, found.by_name.values()
    first = first_decoded(images, _as_stored)
    height, width = first.shape[:2]
    channels = 1 if first.ndim == 2 else first.shape[2]
    image = {"width": width, "height": height, "bits": 8 * first.dtype.itemsize, "channels": channels}
    timing, no_stamps = _timing(found)
    stamps = None if timing is None else described_stamps(stamp for stamp, _ in timing.stamped[""])
    fps = None if timing else ANY_RATE_HZ
    camera, no_camera = _or_reason(lambda: _camera(path, images[0].parent, (width, height), fps))
    return {
        "name": shown_name(placed_path(path)),
        "kind": "folder",
        "bytes": sum(file.stat().st_size for file in files_of(images)),
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "image": image,
        "stamps": stamps,
        "no_stamps": no_stamps,
        "cameras": [camera] if camera else [],
        "no_camera": no_camera,
        "remarks": _remarks(found, timing),
        "losses": [],
    }


def _describe_grey(folders: CameraFolders) -> dict[str, Any]:
    """Describe the images of each camera, the frames that they make, and the cameras together."""
    path, by_name = folders.path, folders.by_name
    timing, no_stamps = _timing(folders)
    fps = None if timing else ANY_RATE_HZ
    recording, no_camera = opened(lambda: open_grey_folder(path, {"fps": fps}))
    matched = () if recording is None else recording.matched(LossLog())
    frames = [frame for frame in matched if frame is not None]
    return {
        "name": shown_name(placed_path(path)),
        "kind": "images",
        "bytes": sum(file.stat().st_size for images in by_name.values() for file in files_of(images)),
        "folders": [_folder(name, images) for name, images in by_name.items()],
        "frames": len(frames),
        "incomplete_frames": sum(None in frame.images for frame in frames),
        "stamps": described_stamps(f.stamp_ns for f in frames) if not no_stamps and frames else None,
        "no_stamps": no_stamps,
        "cameras": described_cameras(recording),
        "no_camera": no_camera,
        "remarks": _remarks(folders, timing),
        "losses": [],
    }


def _or_reason(make: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any] | None, str | None]:
    try:
        return make(), None
    except PosetrackError as error:
        return None, str(error)


def _camera(path: Path, images: Path, size: tuple[int, int], fps: float | None) -> dict[str, Any]:
    settings = load_depth_camera(depth_camera_path(path, None, images, size))
    recording = open_depth_folder(path, {"fps": fps})
    (pixels,) = recording.pixels
    unit_mm = pixels.unit_mm if isinstance(pixels, Depth) else None
    depth = {"depth_unit_mm": unit_mm, "missing": settings.missing, "mirror": settings.mirror}
    return recording.cameras[0].values() | depth


def _as_stored(image: ImageFile) -> ImageArray:
    return decode_any(read_image(image))


def _timing(folders: CameraFolders) -> tuple[Timing | None, str | None]:
    """Return the stamps of images without a rate, or why they have none."""
    try:
        return folders.timing(None), None
    except PosetrackError as error:
        return None, str(error).removeprefix(f"{folders.path}: ")


def _remarks(folders: CameraFolders, timing: Timing | None) -> list[str]:
    return [*folders.every_remark, *(() if timing is None else timing.remarks)]


def _folder(name: str, images: Sequence[ImageFile]) -> dict[str, Any]:
    kind = first_decoded(images, lambda image: grey_like(decode_shown(read_image(image)), image))
    return {
        "name": name,
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "width": kind.width,
        "height": kind.height,
        "stored": kind.words,
    }
