"""Recordings of Kinects and RealSense cameras."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ValidationError

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.decoding import VALUE_TYPES, MessageDecoder, UndecodableMessageError
from posetrack_cli.recording.base import UnreadableImageError, no_intrinsics
from posetrack_cli.recording.camera_file import camera_record, image_camera, load_depth_camera, stated_depth
from posetrack_cli.recording.camera_of import ImageCamera
from posetrack_cli.recording.depth import MM_PER_M, Depth
from posetrack_cli.recording.description import described_cameras, opened
from posetrack_cli.recording.identity import file_digest, identity_record
from posetrack_cli.recording.message_topics import FileTopics, Topic
from posetrack_cli.recording.pixels import Window
from posetrack_cli.recording.recording import CameraStream, ReadingOptions, Recording
from posetrack_cli.recording.video import VideoImages, describe_video
from posetrack_cli.recording.video_file import (
    SENSOR_FORMAT,
    depth_stream,
    frame_pixels,
    is_video,
    opened_container,
    opened_depth,
)

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame


# Azure Kinect recordings (``.mkv`` of k4arecorder): their depth, and the camera of their attachment


CALIBRATION = "calibration.json"
DEPTH_CAMERA = "CALIBRATION_CameraLocationD0"
BROWN_CONRADY = "CALIBRATION_LensDistortionModelBrownConrady"
RATIONAL = "CALIBRATION_LensDistortionModelRational6KT"
"""The same but for half the tangential terms."""
PARAMETERS = 14
SENSOR_PX = 1024
MODES = {(320, 288): (2, 96, 90), (640, 576): (1, 192, 180), (512, 512): (2, 0, 0), (1024, 1024): (1, 0, 0)}
"""By the size of images: pixels of the sensor to one of theirs, and where they lie among those."""


class _Intrinsics(BaseModel):
    ModelType: str
    ModelParameters: list[float]


class _Camera(BaseModel):
    Location: str
    Intrinsics: _Intrinsics
    SensorWidth: int
    SensorHeight: int


class _Information(BaseModel):
    Cameras: list[_Camera]


class _Calibration(BaseModel):
    CalibrationInformation: _Information


def open_kinect(path: Path, options: ReadingOptions) -> Recording:
    """Open the depth of an Azure Kinect recording; its camera is a camera file's, else its own.

    Raises:
        RecordingError: it is none, or its calibration cannot be used.
    """
    if not is_video(path):
        raise RecordingError(
            "is not a recording",
            where=path,
            found="an empty file" if path.stat().st_size == 0 else "a file of another kind",
            expected="a folder of 16-bit images, an MCAP file or a bag of ROS",
        )
    file = options.get("camera_file")
    settings = None if file is None else load_depth_camera(file)
    stated_mm, missing = stated_depth(settings, options)
    unit_mm = 1.0 if stated_mm is None else stated_mm
    video = VideoImages(path, None, opened_depth, _codes, lambda first: _depth(first, unit_mm, missing))
    width, height = video.pixels.width, video.pixels.height
    if settings is None or file is None:
        found = ImageCamera(_own_camera(path, width, height), f"attachment {CALIBRATION}")
    else:
        found = image_camera(settings, file, (width, height))
    mirror = options.get("mirror")
    window = Window(
        None if settings is None else settings.crop,
        bool(settings and settings.mirror) if mirror is None else mirror,
    )
    stream = CameraStream(window.camera(found.camera), video.pixels, partial(video.images, window))

    def identity() -> Mapping[str, str]:
        return {
            **identity_record(path, "video", file_digest(path)),
            "frames": "" if video.count is None else str(video.count),
            "depth_unit_mm": f"{unit_mm:g}",
            "missing": str(missing),
            "mirror": str(window.mirror).lower(),
            **camera_record(file),
        }

    return Recording(
        path,
        [stream],
        identity=identity,
        frame_count=video.count,
        why=[found.why],
        remarks=found.remarks,
    )


def describe_kinect(path: Path) -> dict[str, Any]:
    """Describe a video, and its depth if it is an Azure Kinect's recording.

    Raises:
        RecordingError: it is no video, or holds depth only.
    """
    described = describe_video(path)
    if not _holds_depth(path):
        return described
    recording, no_camera = opened(lambda: open_kinect(path, {}))
    return described | {"depth": {"cameras": described_cameras(recording), "no_camera": no_camera}}


def _holds_depth(path: Path) -> bool:
    with opened_container(path) as container:
        return depth_stream(container) is not None


def camera_of_calibration(data: bytes, width: int, height: int, where: object) -> Camera:
    """Return the depth camera of a calibration as the sensor has it, for images of a mode's size.

    The file's numbers are for the whole sensor, in parts of it from its corner on: a mode cuts out of it, or
    puts two by two pixels together, and here pixels are counted from the middle of the first (as in the
    sensor's SDK).

    Raises:
        RecordingError: it tells no such camera, or its lens is of a model that cannot be used.
    """
    try:
        cameras = _Calibration.model_validate_json(data).CalibrationInformation.Cameras
    except ValidationError as error:
        what, found, hint = "calibration cannot be read", error.errors()[0]["msg"], "pass --camera"
        raise RecordingError(what, where=where, found=found, hint=hint) from None
    camera = next((camera for camera in cameras if camera.Location == DEPTH_CAMERA), None)
    is_whole = camera is not None and (camera.SensorWidth, camera.SensorHeight) == (SENSOR_PX, SENSOR_PX)
    if camera is None or not is_whole or (width, height) not in MODES:
        raise no_intrinsics(f"{where}, {width}x{height}")
    values = camera.Intrinsics.ModelParameters
    model = camera.Intrinsics.ModelType
    is_known = len(values) == PARAMETERS and not any(values[10:12])
    if not is_known or not (model == BROWN_CONRADY or (model == RATIONAL and not any(values[12:14]))):
        raise RecordingError(
            "lens cannot be used", where=where, found=model, expected=BROWN_CONRADY, hint="pass --camera"
        )
    binned, left, top = MODES[width, height]
    size = SENSOR_PX / binned
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = values
    return Camera(
        width,
        height,
        fx * size,
        fy * size,
        cx * size - left - 0.5,
        cy * size - top - 0.5,
        distortion=(k1, k2, p1, p2, k3, k4, k5, k6),
        distortion_model="rational_polynomial",
    )


def _codes(frame: VideoFrame) -> ImageArray:
    if frame.format.name != SENSOR_FORMAT:
        raise UnreadableImageError(f"it is {frame.format.name}, not {SENSOR_FORMAT} as the others")
    return np.asarray(frame_pixels(frame), dtype=np.uint16)


def _depth(first: ImageArray, unit_mm: float, missing: int) -> Depth:
    height, width = first.shape
    return Depth(width, height, "16UC1" if unit_mm == 1.0 else "32FC1", unit_mm, missing)


def _own_camera(path: Path, width: int, height: int) -> Camera:
    with opened_container(path) as container:
        data = _attachment(container)
    if data is None or len(data) > limits.TEXT_BYTES:
        raise no_intrinsics(f"{path}, no attachment {CALIBRATION}")
    return camera_of_calibration(data, width, height, f"{path}, {CALIBRATION}")


def _attachment(container: InputContainer) -> bytes | None:
    for stream in container.streams.attachments:
        if stream.name == CALIBRATION:
            return bytes(stream.data or b"")
    return None


# What RealSense cameras say of themselves in recordings: how long a unit of depth is


_SENSOR = re.compile(r"/device_\d+/sensor_\d+(?=/)")
UNIT = "/option/Depth_Units/value"
"""Of a sensor's topics: metres per code, a number or its digits."""
SHORTEST_MM, LONGEST_MM = 1e-3, 100.0
"""Cameras have from 0.025 mm, of a close-up, to 1 mm."""


def depth_unit_mm(topics: FileTopics, images: Topic) -> float | None:
    """Return how many millimetres a code of integer depth is, None if the sensor does not state it.

    Raises:
        RecordingError: what it tells is no unit.
    """
    sensor = _SENSOR.match(images.name)
    name = "" if sensor is None else sensor.group() + UNIT
    if name not in topics.by_name or topics.by_name[name].type_name not in VALUE_TYPES:
        return None
    for item in topics.file.messages([name]):
        try:
            # Stored as float32, whose nearest value to 0.001 is not it
            unit = float(f"{float(MessageDecoder().decode(*item).data) * MM_PER_M:.6g}")
        except (UndecodableMessageError, ValueError):
            unit = math.nan
        if SHORTEST_MM <= unit <= LONGEST_MM:
            return unit
        raise RecordingError(
            "depth unit cannot be used", where=f"{topics.path}, {name}", found=f"{unit:g} mm"
        )
    return None
