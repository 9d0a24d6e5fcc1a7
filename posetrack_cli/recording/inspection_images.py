"""Describe recordings of grey images: folders of one or more cameras, videos, cameras of MCAP files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.grey import decode_as_stored, kind_of_image
from posetrack_cli.recording.identity import shown_name
from posetrack_cli.recording.image_files import first_decoded, read_image
from posetrack_cli.recording.image_folders import stamped_images
from posetrack_cli.recording.images_folder import ImagesFolderRecording
from posetrack_cli.recording.matching import StoredImages
from posetrack_cli.recording.timeline import Timeline

ANY_RATE_HZ = 30.0
"""Which images belong together does not depend on it."""


def describe_image_folders(path: Path, folders: Mapping[str, list[Path]]) -> dict[str, Any]:
    """Describe folders of images of one or more cameras: what is missing has a reason.

    Keys beside those of every description: ``folders`` (number, first and last name and kind of each camera's
    images), ``stamps`` or ``no_stamps``, ``frames``, ``cameras`` or ``no_camera``.
    """
    fps, no_stamps = _rate_if_unstamped(path, folders)
    recording, no_camera = _opened(path, fps)
    frames = list(recording.matched()) if recording is not None else []
    return {
        "name": shown_name(path.resolve()),
        "kind": "images",
        "bytes": sum(image.stat().st_size for images in folders.values() for image in images),
        "folders": [_folder(name, images) for name, images in folders.items()],
        "frames": len(frames),
        "incomplete_frames": sum(None in frame.images for frame in frames),
        "stamps": _timeline(frames) if not no_stamps and frames else None,
        "no_stamps": no_stamps,
        "cameras": camera_values(recording.cameras) if recording is not None else [],
        "no_camera": no_camera,
        "losses": [],
    }


def describe_video(path: Path) -> dict[str, Any]:
    """Describe a video: size, rate, number of frames as it tells them, and its camera if there is one."""
    import cv2

    from posetrack_cli.recording.images_video import ImagesVideoRecording, opened

    with opened(path) as video:
        image = {
            "width": int(video.get(cv2.CAP_PROP_FRAME_WIDTH)),
            "height": int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        }
        rate, frames = float(video.get(cv2.CAP_PROP_FPS)), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    try:
        cameras, no_camera = camera_values(ImagesVideoRecording(path).cameras), None
    except PosetrackError as error:
        cameras, no_camera = [], str(error)
    return {
        "name": shown_name(path.resolve()),
        "kind": "video",
        "bytes": path.stat().st_size,
        "image": image,
        "frames": frames,
        "rate_hz": rate,
        "cameras": cameras,
        "no_camera": no_camera,
        "losses": [],
    }


def describe_rig(path: Path) -> tuple[list[dict[str, Any]], str | None]:
    """Return the cameras of an MCAP file with grey images of several, or why they cannot be used together."""
    from posetrack_cli.recording.images_mcap import ImagesMcapRecording

    try:
        cameras = ImagesMcapRecording(path).cameras
    except PosetrackError as error:
        return [], str(error)
    return camera_values(cameras), None


def camera_values(cameras: Sequence[Camera]) -> list[dict[str, Any]]:
    """Return cameras as plain values, with their distance from the first, mm."""
    return [
        camera.values() | {"distance_mm": float(np.linalg.norm(np.array(camera.camera_T_reference)[:, 3]))}
        for camera in cameras
    ]


def _rate_if_unstamped(path: Path, folders: Mapping[str, list[Path]]) -> tuple[float | None, str | None]:
    """Return a rate to read images without stamps at, and why they have none."""
    try:
        stamped_images(path, folders, None)
    except PosetrackError as error:
        return ANY_RATE_HZ, str(error)
    return None, None


def _opened(path: Path, fps: float | None) -> tuple[ImagesFolderRecording | None, str | None]:
    try:
        return ImagesFolderRecording(path, fps=fps), None
    except PosetrackError as error:
        return None, str(error)


def _timeline(frames: Sequence[StoredImages]) -> dict[str, Any]:
    timeline = Timeline()
    for frame in frames:
        timeline.add(frame.stamp_ns)
    return dict(timeline.summary()) | {"remarks": list(timeline.remarks)}


def _folder(name: str, images: Sequence[Path]) -> dict[str, Any]:
    kind = first_decoded(images, lambda image: kind_of_image(decode_as_stored(read_image(image)), image))
    return {
        "name": name,
        "images": len(images),
        "first": images[0].name,
        "last": images[-1].name,
        "width": kind.width,
        "height": kind.height,
        "stored": kind.words,
    }
