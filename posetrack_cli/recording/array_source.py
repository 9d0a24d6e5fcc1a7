"""Arrays in memory, or memory-mapped, as recordings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import StoredImage, UnreadableImageError
from posetrack_cli.recording.camera_of import GUESSED, Guess
from posetrack_cli.recording.depth import Depth, DepthContent, content_of, decide_unit, early
from posetrack_cli.recording.grey import grey_like, with_bits_of
from posetrack_cli.recording.pixels import Pixels
from posetrack_cli.recording.recording import CameraStream, Recording
from posetrack_cli.recording.stamps import stamps_at_rate

NAME = "arrays"
"""Stands for the path of a recording that has none."""
_PATH = Path(NAME)
_SMALLEST = 2  # pixels a side

Images = Sequence[Any]
"""Images of one camera, each (height, width[, channels]); a list, an array (N, ...) or a memory map."""


def open_depth_arrays(
    images: Images,
    camera: Camera,
    *,
    fps: float | None = None,
    stamps_ns: Sequence[int] | None = None,
    depth_unit_mm: float | None = None,
    missing: int = 0,
) -> Recording:
    """Return depth images as a recording.

    Args:
        images: N images (height, width), integers or floats; 0 and ``missing`` are no reading.
        camera: of the images.
        fps: frame rate, Hz, if there are no stamps.
        stamps_ns: (N,) stamps, ns, strictly increasing.
        depth_unit_mm: millimetres per unit; None decides by content, as for files (integers mm, floats m).

    Raises:
        UsageError: frames cannot be read twice, or neither or both of rate and stamps are given.
        RecordingError: not an image of depth, or not of the camera's size.
    """
    first = _first_of({camera.name: images}, camera)
    if first.ndim != 2 or first.dtype.kind not in "uif":
        shown = f"{first.dtype} of shape {first.shape}"
        raise RecordingError("not a depth image", where=NAME, found=shown, expected="(height, width) numbers")
    stamps = _stamps(len(images), fps, stamps_ns)
    decision = decide_unit(_early_content(images, camera, missing), depth_unit_mm)
    is_float = first.dtype.kind == "f"
    pixels = Depth(camera.width, camera.height, "32FC1", decision.unit_mm, missing, is_float=is_float)
    return _recording(
        {camera.name: images},
        [camera],
        [pixels],
        stamps,
        {"depth_unit_mm": str(decision.unit_mm), "missing": str(missing)},
        remarks=decision.remarks,
    )


def open_grey_arrays(
    images: Mapping[str, Images],
    cameras: Sequence[Camera],
    *,
    fps: float | None = None,
    stamps_ns: Sequence[int] | None = None,
    guess: Guess | None = None,
) -> Recording:
    """Return grey or colour images of one or more cameras, taken at the same instants, as a recording.

    Args:
        images: N images by camera name, (height, width), or (height, width, 3) in blue, green, red.
        cameras: of the images, the reference first; empty with ``guess`` for one uncalibrated camera.
        fps, stamps_ns: see ``open_depth_arrays``.
        guess: intrinsics of one camera that is not calibrated.

    Raises:
        UsageError: see ``open_depth_arrays``, or cameras and images differ in name.
        RecordingError: not an image, or not of the camera's size.
    """
    is_guessed = not cameras
    if is_guessed:
        if guess is None or len(images) != 1:
            raise UsageError("cameras are missing", found=", ".join(images), expected="a Camera for each")
        (name,) = images
        height, width = _first_of(images).shape[:2]
        cameras = [guess.stored_camera(width, height, name)]
    if [camera.name for camera in cameras] != list(images):
        names = ", ".join(camera.name for camera in cameras)
        raise UsageError("images and cameras differ", found=", ".join(images), expected=names)
    counts = {name: len(of) for name, of in images.items()}
    if len(set(counts.values())) > 1:
        found = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise UsageError("cameras have different numbers of images", found=found, hint="drop unpaired images")
    kinds = []
    for camera in cameras:
        own = images[camera.name]
        kind = grey_like(_first_of({camera.name: own}, camera), NAME)
        kinds.append(with_bits_of(kind, (np.asarray(own[i]) for i in _spread(len(own)))))
    stamps = _stamps(len(next(iter(images.values()))), fps, stamps_ns)
    stored = ", ".join(dict.fromkeys(kind.words for kind in kinds))
    names = ",".join(images)
    return _recording(
        images,
        cameras,
        kinds,
        stamps,
        {"cameras": names, "stored": stored},
        is_guessed=is_guessed,
    )


def _first_of(images: Mapping[str, Images], camera: Camera | None = None) -> ImageArray:
    """Return the first image, of the camera's size."""
    ((name, own),) = images.items()
    if not hasattr(own, "__len__") or not hasattr(own, "__getitem__"):
        raise UsageError(
            "frames can be read only once",
            where=name,
            found=type(own).__name__,
            expected="a list, an array or a memory map: side and shape are found before the first frame",
        )
    if len(own) == 0:
        raise UsageError("no frame to track", where=name, found="0 frames")
    first = np.asarray(own[0])
    if first.ndim not in (2, 3) or min(first.shape[:2]) < _SMALLEST:
        raise RecordingError("not an image", where=name, found=f"an array of shape {first.shape}")
    if camera is not None and first.shape[:2] != (camera.height, camera.width):
        raise RecordingError(
            "images are not of the camera's size",
            where=name,
            found=f"{first.shape[1]}x{first.shape[0]}",
            expected=f"{camera.width}x{camera.height}",
        )
    return first


def _stamps(count: int, fps: float | None, stamps_ns: Sequence[int] | None) -> list[int]:
    """Return (N,) stamps, ns."""
    if (fps is None) == (stamps_ns is None):
        found = "neither" if fps is None else "both"
        raise UsageError("times of the frames", found=found, expected="fps or stamps_ns")
    if stamps_ns is None:
        assert fps is not None
        return stamps_at_rate(count, fps)
    stamps = [int(stamp) for stamp in stamps_ns]
    if len(stamps) != count:
        raise UsageError("stamps_ns has another length than the images", found=len(stamps), expected=count)
    for index, (before, after) in enumerate(pairwise(stamps), 1):
        if after <= before:
            raise UsageError("stamps_ns do not increase", found=f"{after} after {before} at {index}")
    return stamps


def _early_content(images: Images, camera: Camera, missing: int) -> DepthContent:
    return content_of(early(np.asarray(image) for image in images), camera, missing)


def _spread(count: int, most: int = 8) -> Iterator[int]:
    """Yield a few indices from the whole recording."""
    yield from sorted({round(i) for i in np.linspace(0, count - 1, most)})


def _recording(
    images: Mapping[str, Images],
    cameras: Sequence[Camera],
    pixels: Sequence[Pixels],
    stamps: Sequence[int],
    record: Mapping[str, str],
    *,
    remarks: Sequence[str] = (),
    is_guessed: bool = False,
) -> Recording:
    streams = [
        CameraStream(camera, kind, _stored(images[camera.name], camera, kind, stamps))
        for camera, kind in zip(cameras, pixels, strict=True)
    ]

    def identity() -> Mapping[str, str]:
        digest, size = hashlib.sha256(), 0
        for own in images.values():
            for image in own:
                array = np.ascontiguousarray(image)
                digest.update(f"{array.dtype}{array.shape}".encode())
                digest.update(array.data)
                size += array.nbytes
        return {
            "name": NAME,
            "kind": NAME,
            "bytes": str(size),
            "sha256": digest.hexdigest(),
            "frames": str(len(stamps)),
            **record,
        }

    return Recording(
        _PATH,
        streams,
        identity=identity,
        frame_count=len(stamps),
        is_guessed=is_guessed,
        why=[GUESSED if is_guessed else "given"] * len(streams),
        remarks=remarks,
    )


def _stored(
    images: Images, camera: Camera, pixels: Pixels, stamps: Sequence[int]
) -> Callable[[LossLog], Iterator[StoredImage | None]]:
    """Return the stream of one camera's images."""

    def decoded(index: int) -> ImageArray:
        image = np.asarray(images[index])
        if image.shape[:2] != (camera.height, camera.width):
            found, expected = image.shape[:2], (camera.height, camera.width)
            raise UnreadableImageError(f"its shape is {found}, not {expected}")
        return pixels.from_stored(image)

    def stored(losses: LossLog) -> Iterator[StoredImage]:
        for index, stamp in enumerate(stamps):
            yield StoredImage(stamp, f"image {index} of {camera.name}", partial(decoded, index))

    return stored
