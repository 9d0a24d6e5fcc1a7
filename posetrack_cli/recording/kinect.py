"""Depth of Azure Kinect recordings, and the depth unit of RealSense recordings."""

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
from posetrack_cli.recording.camera_file import (
    camera_record,
    depth_storage,
    image_camera,
    load_depth_camera,
    used_window,
)
from posetrack_cli.recording.camera_of import ImageCamera
from posetrack_cli.recording.depth import MM_PER_M, Depth
from posetrack_cli.recording.description import described_cameras, try_open
from posetrack_cli.recording.identity import file_digest, identity_record
from posetrack_cli.recording.message_topics import FileTopics, Topic
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


# Azure Kinect recordings (``.mkv`` of k4arecorder), with the calibration in an attachment


CALIBRATION = "calibration.json"
DEPTH_CAMERA = "CALIBRATION_CameraLocationD0"
BROWN_CONRADY = "CALIBRATION_LensDistortionModelBrownConrady"
# Like Brown-Conrady except for half the tangential terms.
RATIONAL = "CALIBRATION_LensDistortionModelRational6KT"
PARAMETERS = 14
SENSOR_PX = 1024
# Depth modes by image size: sensor pixels per image pixel, and the offset of the image within them.
MODES = {(320, 288): (2, 96, 90), (640, 576): (1, 192, 180), (512, 512): (2, 0, 0), (1024, 1024): (1, 0, 0)}


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
    """Open the depth of an Azure Kinect recording, with its own camera unless a file is given.

    Raises:
        RecordingError: the file is not such a recording, or its calibration is invalid.
    """
    if not is_video(path):
        raise RecordingError(
            "not a recording",
            where=path,
            found="an empty file" if path.stat().st_size == 0 else "an unknown file type",
            expected="a folder of 16-bit images, an MCAP file or a ROS bag",
        )
    file = options.get("camera_file")
    settings = None if file is None else load_depth_camera(file)
    stated_mm, missing = depth_storage(settings, options)
    unit_mm = 1.0 if stated_mm is None else stated_mm
    video = VideoImages(path, None, opened_depth, _codes, lambda first: _depth(first, unit_mm, missing))
    width, height = video.pixels.width, video.pixels.height
    if settings is None or file is None:
        found = ImageCamera(_own_camera(path, width, height), f"attachment {CALIBRATION}")
    else:
        found = image_camera(settings, file, (width, height))
    window = used_window(None if settings is None else settings.crop, settings, options)
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
    """Describe a video, including depth if it is an Azure Kinect recording.

    Raises:
        RecordingError: the file is not a video, or has depth only.
    """
    described = describe_video(path)
    if not _holds_depth(path):
        return described
    recording, no_camera = try_open(lambda: open_kinect(path, {}))
    return described | {"depth": {"cameras": described_cameras(recording), "no_camera": no_camera}}


def _holds_depth(path: Path) -> bool:
    with opened_container(path) as container:
        return depth_stream(container) is not None


def camera_of_calibration(data: bytes, width: int, height: int, where: object) -> Camera:
    """Return the depth camera of a calibration for images of a mode's size.

    The file gives parameters for the whole sensor, as fractions of its size from the image corner. A mode
    crops the sensor or bins it 2x2; here pixel centres are at integers, as in the sensor's SDK.

    Raises:
        RecordingError: there is no such camera, or its lens model is not supported.
    """
    try:
        cameras = _Calibration.model_validate_json(data).CalibrationInformation.Cameras
    except ValidationError as error:
        what, found, hint = "invalid calibration", error.errors()[0]["msg"], "pass --camera"
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
            "unsupported lens model", where=where, found=model, expected=BROWN_CONRADY, hint="pass --camera"
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
        raise UnreadableImageError(f"pixel format is {frame.format.name}, not {SENSOR_FORMAT}")
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


# Depth unit of RealSense recordings


_SENSOR = re.compile(r"/device_\d+/sensor_\d+(?=/)")
# Suffix of a sensor's topic with metres per depth code, as number or text.
UNIT = "/option/Depth_Units/value"
# Plausible units; sensors range from 0.025 mm (close range) to 1 mm.
SHORTEST_MM, LONGEST_MM = 1e-3, 100.0


def depth_unit_mm(topics: FileTopics, images: Topic) -> float | None:
    """Return the millimetres per integer depth code, None if the sensor does not state it.

    Raises:
        RecordingError: the stated value is not a plausible unit.
    """
    sensor = _SENSOR.match(images.name)
    name = "" if sensor is None else sensor.group() + UNIT
    if name not in topics.by_name or topics.by_name[name].type_name not in VALUE_TYPES:
        return None
    for item in topics.file.messages([name]):
        try:
            # Stored as float32, so round 0.001 back to 6 digits
            unit = float(f"{float(MessageDecoder().decode(*item).data) * MM_PER_M:.6g}")
        except (UndecodableMessageError, ValueError):
            unit = math.nan
        if SHORTEST_MM <= unit <= LONGEST_MM:
            return unit
        raise RecordingError(
            "implausible depth unit",
            where=f"{topics.path}, {name}",
            found=f"{unit:g} mm",
            expected=f"{SHORTEST_MM:g} to {LONGEST_MM:g} mm",
        )
    return None
