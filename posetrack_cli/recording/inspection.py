"""Describe any recording or result, as far as it can be read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.losses import Loss
from posetrack_cli.recording.camera_file import load_camera_file
from posetrack_cli.recording.folder import camera_path
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.image_files import (
    DEPTH_SUFFIXES,
    decode_any,
    first_decoded,
    list_images,
    read_image,
)
from posetrack_cli.recording.opening import is_mcap
from posetrack_cli.recording.stamps import STAMPS_FILE_NAME, load_stamps
from posetrack_cli.recording.timeline import Timeline


def describe(path: Path) -> dict[str, Any]:
    """Describe folders of images, a video or an MCAP file, recording or result, in plain values.

    Reads every message of an MCAP file, of a folder only the first image. Keys: ``name``, ``kind``
    (``folder`` of depth, ``images`` of one or more cameras, ``video`` or ``mcap``), ``bytes``, ``losses``
    (what could not be read) and what the kind has.

    Raises:
        RecordingError: if there is nothing that could be described.
    """
    if not path.exists():
        raise RecordingError("no such file or folder", where=path)
    if path.is_dir():
        return _describe_any_folder(path)
    if is_mcap(path):
        from posetrack_cli.recording.mcap_inspection import describe_mcap

        return describe_mcap(path)
    from posetrack_cli.recording.images_video import is_video
    from posetrack_cli.recording.inspection_images import describe_video

    if not is_video(path):
        raise RecordingError(
            "is not a recording or result",
            where=path,
            expected="a folder of images, an MCAP file or a video",
        )
    return describe_video(path)


def _describe_any_folder(path: Path) -> dict[str, Any]:
    """Tell a folder of 16-bit depth from folders of images of cameras."""
    from posetrack_cli.recording.image_folders import find_folders
    from posetrack_cli.recording.inspection_images import describe_image_folders

    folders = find_folders(path)
    if "" in folders:
        first = first_decoded(folders[""], _as_stored)
        if first.ndim == 2 and first.dtype == np.uint16 and folders[""][0].suffix.lower() in DEPTH_SUFFIXES:
            return describe_folder(path)
    return describe_image_folders(path, folders)


def describe_folder(path: Path) -> dict[str, Any]:
    """Describe a folder of depth images: number, size, stamps, camera; what is missing has a reason."""
    images = list_images(path)
    first = first_decoded(images, _as_stored)
    height, width = first.shape[:2]
    channels = 1 if first.ndim == 2 else first.shape[2]
    image = {"width": width, "height": height, "bits": 8 * first.dtype.itemsize, "channels": channels}
    stamps, no_stamps = _or_reason(lambda: _stamps(path, images))
    camera, no_camera = _or_reason(lambda: _camera(path, width, height))
    return {
        "name": shown_name(path.resolve()),
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


def loss_values(losses: tuple[Loss, ...]) -> list[dict[str, Any]]:
    """Return losses as plain values."""
    return [{"what": loss.what, "count": loss.count, "first": loss.first} for loss in losses]


def _or_reason(make: Callable[[], dict[str, Any]]) -> tuple[dict[str, Any] | None, str | None]:
    try:
        return make(), None
    except PosetrackError as error:
        return None, str(error)


def _stamps(path: Path, images: list[Path]) -> dict[str, Any]:
    if not (path / STAMPS_FILE_NAME).exists():
        raise RecordingError(f"no {STAMPS_FILE_NAME}", hint="pass --fps")
    timeline = Timeline()
    for stamp in load_stamps(path / STAMPS_FILE_NAME, [image.name for image in images]):
        timeline.add(stamp)
    return dict(timeline.summary()) | {"remarks": list(timeline.remarks)}


def _camera(path: Path, width: int, height: int) -> dict[str, Any]:
    settings = load_camera_file(camera_path(path, None))
    camera = settings.window.camera(settings.stored_camera(width, height))
    depth = {"depth_unit_mm": settings.depth_unit_mm, "missing": settings.missing, "mirror": settings.mirror}
    return camera.values() | depth


def _as_stored(image: Path) -> ImageArray:
    return decode_any(read_image(image))
