"""Common part of dataset layouts: images with stamps and a known camera become a recording."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import placed_path, read_text
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import StoredImage, UnreadableImageError
from posetrack_cli.recording.camera_file import (
    Rig,
    SingleCamera,
    camera_record,
    depth_storage,
    image_camera,
    load_depth_camera,
    load_rig,
    used_window,
)
from posetrack_cli.recording.camera_of import ImageCamera, Resampling, at_size, is_same
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.description import described_stamps, described_use
from posetrack_cli.recording.grey import Grey, grey_like
from posetrack_cli.recording.identity import files_digest, identity_record, shown_name
from posetrack_cli.recording.pixels import Window
from posetrack_cli.recording.recording import CameraStream, ReadingOptions, Recording
from posetrack_cli.recording.stamps import stamp_at_rate, stamps_at_rate

KINECT_HZ = 30.0  # Kinect v1
MOST_UNREADABLE = 300  # if more initial images fail, the rest is not tried


@dataclass(frozen=True)
class DatasetImage:
    """An image of a dataset.

    Attributes:
        stamp_ns: time of capture.
        where: its name, for errors and losses.
        read: returns stored depth, (height, width) integers or floats; or (height, width) grey, or (height,
            width, 3) blue green red. Raises UnreadableImageError.
        camera: camera of this image if intrinsics change; None for the dataset's.
    """

    stamp_ns: int
    where: str
    read: Callable[[], ImageArray]
    camera: Camera | None = None


@dataclass(frozen=True)
class Dataset:
    """Images of one camera, all of one kind.

    Attributes:
        path: the recording.
        words: name of the format, as text.
        images: at least one.
        camera: camera of the images; scaled to stored images of another resolution.
        why: source of the camera, as text.
        files: (name, path) of the files that identify the recording.
        unit_mm: millimetres per stored depth unit.
        remarks: remarks on what was detected.
        fps: rate of synthetic stamps; None if stamps are stored.
    """

    path: Path
    words: str
    images: Sequence[DatasetImage]
    camera: Camera
    why: str
    files: Sequence[tuple[str, Path]]
    unit_mm: float = 1.0
    remarks: tuple[str, ...] = ()
    fps: float | None = None

    def scaled(self, camera: Camera, width: int, height: int) -> Camera:
        """Return a camera scaled to images of a size.

        Raises:
            RecordingError: the aspect ratios differ.
        """
        found = at_size(camera, width, height)
        if found is None:
            raise RecordingError(
                "images and intrinsics differ in aspect ratio",
                where=self.path,
                found=f"{width}x{height} and {camera.width}x{camera.height}",
                hint="pass --camera with the intrinsics of the images",
            )
        return found

    def image_camera(self, width: int, height: int) -> ImageCamera:
        """Return the camera of stored images of a size."""
        size = (self.camera.width, self.camera.height)
        said = (f"intrinsics for {size[0]}x{size[1]} are scaled to {width}x{height}",)
        return ImageCamera(
            self.scaled(self.camera, width, height), self.why, () if size == (width, height) else said
        )


def open_depth(dataset: Dataset, options: ReadingOptions) -> Recording:
    """Open a depth dataset with its own camera and unit unless options override them.

    Raises:
        RecordingError: no image can be decoded, or the camera does not fit.
        UsageError: an option is invalid.
    """
    first = _first(dataset)
    if first.ndim != 2:
        raise RecordingError("colour images, not depth", where=dataset.path, found=dataset.words)
    height, width = first.shape
    file = options.get("camera_file")
    settings = None if file is None else load_depth_camera(file)
    stated_mm, missing = depth_storage(settings, options)
    unit_mm = dataset.unit_mm if stated_mm is None else stated_mm
    if settings is None or file is None:
        found = dataset.image_camera(width, height)
    else:
        found = image_camera(settings, file, (width, height))
    window = used_window(None if settings is None else settings.crop, settings, options)
    is_float = first.dtype.kind == "f"
    encoding: Any = "16UC1" if unit_mm == 1.0 and not is_float else "32FC1"
    pixels = Depth(width, height, encoding, unit_mm, missing, is_float=is_float)
    stream = _stream(dataset, pixels, found.camera, window, changes=file is None)
    record = {"depth_unit_mm": f"{unit_mm:g}", "missing": str(missing)}
    return _recording(dataset, stream, window, found.why, found.remarks, file, record)


def open_grey(dataset: Dataset, options: ReadingOptions) -> Recording:
    """Open a grey or colour dataset with its own camera unless options override it.

    Raises:
        RecordingError: no image can be decoded, or the camera does not fit.
        UsageError: an option is invalid.
    """
    first = _first(dataset)
    pixels = replace(grey_like(first, dataset.path), keeps_colour=bool(options.get("in_colour")))
    size = (pixels.width, pixels.height)
    file, names = options.get("camera_file"), options.get("cameras")
    own = dataset.image_camera(*size)
    rig = known_rig(dataset.path, own.camera) if file is None else load_rig(file)
    rig = rig if names is None else rig.subset(names)
    if len(rig.cameras) != 1:
        found = ", ".join(rig.cameras)
        raise UsageError(
            f"several cameras for one {dataset.words}",
            where=rig.path,
            found=found,
            hint="choose one with --cameras",
        )
    (name,) = rig.cameras
    (camera,) = rig.stored_cameras({name: size})
    window = rig.window(name, options.get("mirror"))
    stream = _stream(dataset, pixels, camera, window, changes=file is None)
    why = own.why if file is None else file.name
    remarks = own.remarks if file is None else rig.remarks({name: size})
    record = {"cameras": stream.camera.name, "stored": pixels.words}
    return _recording(dataset, stream, window, why, remarks, file, record)


def known_rig(path: Path, camera: Camera) -> Rig:
    """Return a recording's own camera as a rig, like one from a camera file."""
    values = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    lens = {"distortion": camera.distortion, "distortion_model": camera.distortion_model}
    return Rig(path, {"": SingleCamera(**values, **(lens if camera.distortion else {}))})


def describe_dataset(
    path: Path, words: str, openers: Mapping[str, Callable[[Path, ReadingOptions], Recording]]
) -> dict[str, Any]:
    """Return format, images, stamps, and the cameras that commands would use.

    Args:
        path: the recording.
        words: name of the format.
        openers: openers by command.
    """
    used = [described_use(partial(open_, path, {}), command) for command, open_ in openers.items()]
    recordings = [opened for opened in map(partial(_opened, path), openers.values()) if opened is not None]
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    stored = recordings[0] if recordings else None
    stamps = () if stored is None else (f.stamp_ns for f in stored.matched(LossLog()) if f is not None)
    return {
        "name": shown_name(placed_path(path)),
        "kind": "dataset",
        "format": words,
        "bytes": sum(file.stat().st_size for file in files),
        "frames": None if stored is None else stored.frame_count,
        "stamps": None if stored is None else described_stamps(stamps),
        "used": used,
        "losses": [],
    }


def camera_of(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, where: object, **lens: Any
) -> Camera:
    """Return a camera from a dataset's intrinsics.

    Raises:
        RecordingError: the intrinsics are invalid.
    """
    is_finite = all(np.isfinite(value) and abs(value) <= limits.NUMBER for value in (fx, fy, cx, cy))
    if not is_finite or min(width, height) < 1 or min(fx, fy) <= 0:
        found = f"fx {fx:g} fy {fy:g} cx {cx:g} cy {cy:g}, {width}x{height}"
        raise RecordingError("invalid intrinsics", where=where, found=found, hint="pass --camera")
    return Camera(width, height, fx, fy, cx, cy, **lens)


def numbers_of(path: Path) -> list[float]:
    """Return the numbers in a small text file, separated by spaces, commas or lines.

    Raises:
        RecordingError: the file cannot be read, or has other content.
    """
    try:
        return [float(word) for word in read_text(path, limits.TEXT_BYTES).replace(",", " ").split()]
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    except ValueError as error:
        raise RecordingError("not a file of numbers", where=path, found=error) from error


def numbered(path: Path, name: re.Pattern[str]) -> dict[int, Path]:
    """Return the files of a folder that match, sorted by the number in the pattern's last group.

    Raises:
        RecordingError: the folder cannot be listed.
    """
    try:
        found = [(name.fullmatch(file.name), file) for file in path.iterdir()]
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    by_number = {int(match.group(match.lastindex or 0)): file for match, file in found if match}
    return dict(sorted(by_number.items()))


def nominal_stamps(
    numbers: Iterable[int], fps: float | None, of: str
) -> tuple[list[int], float, tuple[str, ...]]:
    """Return stamps of numbered Kinect v1 images at its rate; missing numbers are lost frames.

    Args:
        numbers: ascending.
        fps: frame rate, Hz; replaces the sensor's.
        of: name of the sensor, as text.

    Returns:
        Stamps, ns, the rate, and a remark on it.

    Raises:
        UsageError: the rate is out of range.
    """
    numbers = list(numbers)
    rate = KINECT_HZ if fps is None else fps
    stamps_at_rate(0, rate)  # validates the rate
    said = (
        (f"no stamps: assuming {rate:g} frames/s, the rate of {of}; override with --fps",)
        if fps is None
        else ()
    )
    return [stamp_at_rate(number - numbers[0], rate) for number in numbers], rate, said


def _opened(path: Path, open_: Callable[[Path, ReadingOptions], Recording]) -> Recording | None:
    try:
        return open_(path, {})
    except (RecordingError, UsageError):
        return None


def _first(dataset: Dataset) -> ImageArray:
    """Return the first decodable image."""
    reason = ""
    for image in islice(dataset.images, MOST_UNREADABLE):
        try:
            return image.read()
        except UnreadableImageError as error:
            reason = reason or str(error)
    found = f"{len(dataset.images)} images (first one: {reason})"
    raise RecordingError("no image can be decoded", where=dataset.path, found=found)


def _stream(
    dataset: Dataset, pixels: Depth | Grey, camera: Camera, window: Window, *, changes: bool
) -> CameraStream:
    def decoded(image: DatasetImage) -> ImageArray:
        values = pixels.from_stored(image.read())
        if changes and image.camera is not None:
            source = dataset.scaled(image.camera, pixels.width, pixels.height)
            if not is_same(camera, source):
                values = Resampling(camera, source).apply(values)
        return window.apply(values)

    def images(losses: LossLog) -> Iterator[StoredImage]:
        for image in dataset.images:
            yield StoredImage(image.stamp_ns, image.where, partial(decoded, image))

    return CameraStream(window.camera(camera), pixels, images)


def _recording(
    dataset: Dataset,
    stream: CameraStream,
    window: Window,
    why: str,
    remarks: Iterable[str],
    file: Path | None,
    record: Mapping[str, str],
) -> Recording:
    def identity() -> Mapping[str, str]:
        digest = files_digest(dataset.files)
        return {
            **identity_record(dataset.path, "folder" if dataset.path.is_dir() else "file", digest),
            "frames": str(len(dataset.images)),
            **record,
            "mirror": str(window.mirror).lower(),
            **({} if dataset.fps is None else {"fps": f"{dataset.fps:g}"}),
            **camera_record(file),
        }

    recognised = (f"{dataset.words}: {len(dataset.images)} images", *dataset.remarks, *remarks)
    return Recording(
        dataset.path,
        [stream],
        identity=identity,
        frame_count=len(dataset.images),
        why=[why],
        remarks=recognised,
    )
