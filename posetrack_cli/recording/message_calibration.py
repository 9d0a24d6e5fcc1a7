"""Cameras from CameraCalibration and CameraInfo messages, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from posetrack_cli.errors import RecordingError, nearest_name
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import NotCalibratedError, no_intrinsics

MODEL_NAMES = {
    "Brown Conrady": "plumb_bob",  # as RealSense calls it
    "kannala_brandt": "equidistant",
    "fisheye": "equidistant",
    "": "plumb_bob",
    "none": "plumb_bob",
}


def camera_from_message(decoded: Any, frame_id: str, topic: str) -> Camera:
    """Return the camera of a foxglove.CameraCalibration or a ROS CameraInfo (K or k, D or d).

    Raises:
        NotCalibratedError: if it is uncalibrated, which both mark by K[0] = 0.
        PosetrackError: if its values cannot be used.
    """
    k = [float(value) for value in _field(decoded, "K")]
    d = [float(value) for value in _field(decoded, "D")]
    if len(k) != 9 or k[0] == 0.0:
        raise NotCalibratedError("camera is not calibrated", where=topic, found=f"K = {k}")
    model = str(decoded.distortion_model)
    return Camera(
        width=int(decoded.width),
        height=int(decoded.height),
        fx=k[0],
        fy=k[4],
        cx=k[2],
        cy=k[5],
        distortion=tuple(d) if any(d) else (),
        distortion_model=MODEL_NAMES.get(model, model) if any(d) else "plumb_bob",
        name=frame_id or "camera",
    )


def calibration_message(camera: Camera, stamp_ns: int, frame_id: str) -> Any:
    """Return the foxglove.CameraCalibration of a camera."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

    message = CameraCalibration(
        frame_id=frame_id,
        width=camera.width,
        height=camera.height,
        distortion_model="kannala_brandt"
        if camera.distortion_model == "equidistant"
        else camera.distortion_model,
        D=camera.distortion or (0.0,) * 5,
        K=camera.matrix.ravel().tolist(),
        R=(1, 0, 0, 0, 1, 0, 0, 0, 1),
        P=(camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0),
    )
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def choose_calibration(
    image_topic: str, frame_id: str, calibrations: Mapping[str, str], wanted: str | None = None
) -> str:
    """Return the topic of the calibration that belongs to an image topic.

    That is the one asked for; else the one with the image's frame id; else the one in the same
    namespace, nearest first; else the only one.

    Args:
        image_topic, frame_id: of the images.
        calibrations: frame id by topic.
        wanted: the --camera-topic option.

    Raises:
        RecordingError: if there is none, or several fit equally well.
    """
    if wanted is not None:
        return _asked_for(wanted, calibrations)
    if not calibrations:
        raise no_intrinsics(f"no camera calibration for {image_topic}")
    same_frame = [topic for topic, frame in calibrations.items() if frame_id and frame == frame_id]
    candidates = _nearest_namespace(image_topic, same_frame or list(calibrations))
    if len(candidates) == 1:
        return candidates[0]
    listed = ", ".join(f"{topic} (frame '{calibrations[topic]}')" for topic in sorted(candidates))
    raise RecordingError(
        "several calibrations fit", where=image_topic, found=listed, hint="choose one with --camera-topic"
    )


def _asked_for(wanted: str, calibrations: Mapping[str, str]) -> str:
    if wanted in calibrations:
        return wanted
    raise RecordingError(
        "no such calibration topic",
        where=wanted,
        found=", ".join(sorted(calibrations)) or "no calibration at all",
        hint=nearest_name(wanted, calibrations) if calibrations else "pass --camera",
    )


def _nearest_namespace(image_topic: str, topics: list[str]) -> list[str]:
    """Return the topics in the image's longest namespace that has any, else all.

    What lies directly in it comes before what lies in one within: RealSense has both, .../image/data and
    .../info/camera_info.
    """
    namespace = image_topic
    while len(topics) > 1 and "/" in namespace.strip("/"):
        namespace = namespace.rpartition("/")[0]
        inside = [topic for topic in topics if topic.startswith(f"{namespace}/")]
        directly = [topic for topic in inside if topic.rpartition("/")[0] == namespace]
        if inside:
            return directly or inside
    return topics


def _field(decoded: Any, name: str) -> Any:
    """ROS 1 and Foxglove write K and D, ROS 2 k and d."""
    value = getattr(decoded, name, None)
    return getattr(decoded, name.lower()) if value is None else value
