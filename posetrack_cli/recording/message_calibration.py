"""Cameras from CameraCalibration and CameraInfo messages, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from posetrack_cli.errors import RecordingError, nearest_name
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.base import NotCalibratedError, no_intrinsics
from posetrack_cli.recording.camera_of import calibration_of, is_same_frame, namespace_of, reprojected_to

MESSAGE_NAMES = {"equidistant": "kannala_brandt", "inverse_brown_conrady": "Inverse Brown Conrady"}
"""How messages name models that are not named as OpenCV does."""


def camera_from_message(decoded: Any, name: str, topic: str) -> Camera:
    """Return the camera of the raw image of a foxglove.CameraCalibration or a ROS CameraInfo.

    Raises:
        NotCalibratedError: if it is uncalibrated, which both mark by K[0] = 0.
        RecordingError: if its values cannot be used.
    """
    raw = calibration_of(decoded, topic).raw
    if raw is None:
        raise NotCalibratedError("camera is not calibrated", where=topic, found="K of zeros")
    return replace(raw, name=name or "camera")


def calibration_message(camera: Camera, stamp_ns: int, frame_id: str) -> Any:
    """Return the foxglove.CameraCalibration of a camera."""
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

    message = CameraCalibration(
        frame_id=frame_id,
        width=camera.width,
        height=camera.height,
        distortion_model=MESSAGE_NAMES.get(camera.distortion_model, camera.distortion_model),
        D=camera.distortion or (0.0,) * 5,
        K=camera.matrix.ravel().tolist(),
        R=(1, 0, 0, 0, 1, 0, 0, 0, 1),
        P=(camera.fx, 0, camera.cx, 0, 0, camera.fy, camera.cy, 0, 0, 0, 1, 0),
    )
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def choose_calibration(
    image_topic: str,
    frame_id: str,
    calibrations: Mapping[str, str],
    wanted: str | None = None,
    otherwise: str = "",
) -> str:
    """Return the topic of the calibration that belongs to an image topic.

    That is the one asked for; else the one with the image's frame id; else the one in the same
    namespace, nearest first. Depth that was reprojected to another camera has that camera's calibration.

    Args:
        image_topic, frame_id: of the images.
        calibrations: frame id by topic.
        wanted: the --camera-topic option.
        otherwise: what else to do where there is none, for the error.

    Raises:
        RecordingError: if there is none, several fit equally well, or the only one is of another frame and
            namespace.
    """
    if wanted is not None:
        return _asked_for(wanted, calibrations)
    if not calibrations:
        raise no_intrinsics(f"no camera calibration for {image_topic}", otherwise)
    candidates = _nearest_namespace(image_topic, _of_same_camera(image_topic, frame_id, calibrations))
    if len(candidates) > 1:
        listed = ", ".join(f"{topic} (frame '{calibrations[topic]}')" for topic in sorted(candidates))
        raise RecordingError(
            "several calibrations fit", where=image_topic, found=listed, hint="choose one with --camera-topic"
        )
    (topic,) = candidates
    if _is_elsewhere(image_topic, frame_id, topic, calibrations[topic]):
        raise RecordingError(
            "the only calibration is of another camera",
            where=image_topic,
            found=f"{topic} of frame '{calibrations[topic]}'",
            expected=f"frame '{frame_id}' or namespace {namespace_of(image_topic) or '/'}",
            hint=f"--camera-topic {topic} uses it all the same; or pass --camera",
        )
    return topic


def _of_same_camera(image_topic: str, frame_id: str, calibrations: Mapping[str, str]) -> list[str]:
    """Return the calibrations of the camera whose pixels the images have, as far as names tell."""
    words = reprojected_to(image_topic)
    if not words:
        same_frame = [topic for topic, frame in calibrations.items() if is_same_frame(frame, frame_id)]
        return same_frame or list(calibrations)
    own = [topic for topic in calibrations if namespace_of(topic) == namespace_of(image_topic)]
    named = [t for t, frame in calibrations.items() if any(word in f"{t} {frame}".lower() for word in words)]
    if own or named:
        return own or named
    raise RecordingError(
        "no calibration of the camera that depth was reprojected to",
        where=image_topic,
        found=", ".join(sorted(calibrations)),
        expected=f"one named {' or '.join(words)}",
        hint="pass --camera-topic or --camera",
    )


def _is_elsewhere(image_topic: str, frame_id: str, calibration: str, frame: str) -> bool:
    """Whether a calibration shares neither frame id nor namespace with the images, and has both."""
    differs = bool(frame_id and frame) and not is_same_frame(frame, frame_id)
    return (
        differs
        and not reprojected_to(image_topic)
        and not calibration.startswith(namespace_of(image_topic) + "/")
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
