"""Export of a track as an MCAP file of ROS 2 messages, for RViz, ``ros2 bag`` and rosbag tools.

A result itself has Foxglove messages and JSON, and rosbag2 plays only files in which all messages are CDR,
so this is a separate file. It has the contents of the Foxglove messages, in metres; ``/tf`` also has the
poses of further cameras with each frame.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from posetrack_cli.errors import ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.ros2_messages import CDR, ros2_encoder, ros2_schema
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.message_cameras import calibration_message, camera_transforms
from posetrack_cli.recording.topics import camera_topic
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Subject, kind_of
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.scene import line_scene
from posetrack_cli.results.topics import TRANSFORMS_TOPIC
from posetrack_cli.units import METRES_PER_MM, NS_PER_S

CAMERA_INFO = "camera_info"
LINE_MM = 3.0
"""Width of drawn lines; RViz has no pixel units."""
LINE_LIST, SPHERE_LIST = 5, 7
"""Types of ``visualization_msgs/Marker``."""
FLOAT32 = 7
"""Datatype of ``sensor_msgs/PointField``."""

Values = Mapping[str, Any]


def write_ros2(source: ExportSource, path: Path) -> None:
    """Write a track's estimates.

    Raises:
        ResultError: it cannot be read or written, or a stamp does not fit into a ROS message.
    """
    cameras = source.result.cameras()
    with McapSink(path, profile="ros2") as sink:
        topics = _Topics(sink, source, cameras)
        for estimate in source.estimates():
            topics.write(estimate)
        sink.finish()


class _Topics:
    """Topics of a track, named like the result's: ``/hand/odometry`` and so on."""

    def __init__(self, sink: McapSink, source: ExportSource, cameras: tuple[Camera, ...]) -> None:
        prefix = source.topic.rpartition("/")[0]
        self._sink, self._cameras = sink, cameras
        self._where = source.where
        self._subject = _drawable(replace(source.result.subject, name=_name(prefix).replace("/", "_")))
        self._transforms = self._topic(TRANSFORMS_TOPIC, "tf2_msgs/TFMessage")
        self._infos = [
            self._topic(camera_topic(camera, CAMERA_INFO, len(cameras)), "sensor_msgs/CameraInfo")
            for camera in cameras
        ]
        self._odometry = self._topic(f"{prefix}/odometry", "nav_msgs/Odometry")
        self._joints = None
        if source.result.subject.shape_names and kind_of(source.result.subject.name).shape_unit:
            self._joints = self._topic(f"{prefix}/joint_states", "sensor_msgs/JointState")
        self._points = self._topic(f"{prefix}/points", "sensor_msgs/PointCloud2")
        self._markers = self._topic(f"{prefix}/markers", "visualization_msgs/MarkerArray")
        self._confidence = self._topic(f"{prefix}/confidence", "std_msgs/Float64")
        self._status = self._topic(f"{prefix}/status", "std_msgs/String")

    def write(self, estimate: Estimate) -> None:
        """Write one estimate on every topic."""
        stamp_ns, subject = estimate.stamp_ns, self._subject
        transforms = [messages.frame_transforms(estimate, subject)]
        if len(self._cameras) > 1:
            transforms.append(camera_transforms(self._cameras, subject.camera_frame, stamp_ns))
        try:
            self._transforms(stamp_ns, _transforms(transforms))
            for info, camera in zip(self._infos, self._cameras, strict=True):
                frame = subject.camera_frame if camera is self._cameras[0] else camera.name
                info(stamp_ns, _camera_info(camera, stamp_ns, frame))
            self._odometry(stamp_ns, _odometry(estimate, subject))
            if self._joints is not None:
                self._joints(stamp_ns, _joint_states(estimate, subject))
            self._points(stamp_ns, _point_cloud(estimate, subject))
            self._markers(stamp_ns, {"markers": list(_markers(estimate, subject))})
        except struct.error as error:
            what, expected = "stamp does not fit into a ROS message", "stamps before 2038"
            raise ResultError(what, where=self._where, found=f"{stamp_ns} ns", expected=expected) from error
        self._confidence(stamp_ns, {"data": estimate.confidence})
        self._status(stamp_ns, {"data": estimate.status.value})

    def _topic(self, topic: str, kind: str) -> Callable[[int, Values], None]:
        """Register a topic, and return a function that writes messages to it."""
        channel_id = self._sink.raw_channel(f"/{_name(topic)}", ros2_schema(kind), CDR)
        encode = ros2_encoder(kind)

        def write(stamp_ns: int, values: Values) -> None:
            self._sink.write(channel_id, stamp_ns, encode(values))

        return write


def _name(topic: str) -> str:
    """Return a valid ROS name: letters, digits and underscores between slashes, no leading digit."""
    parts = (re.sub(r"\W", "_", part, flags=re.ASCII) for part in topic.split("/") if part)
    return "/".join(f"_{part}" if part[0].isdigit() else part for part in parts)


def _drawable(subject: Subject) -> Subject:
    """Return the subject with lines, by default from each point to its parent."""
    bones = tuple((parent, k) for k, parent in enumerate(subject.point_parents) if parent >= 0)
    return replace(subject, lines=subject.lines or bones, triangles=None)


def _header(stamp_ns: int, frame: str) -> Values:
    return {"stamp": {"sec": stamp_ns // NS_PER_S, "nanosec": stamp_ns % NS_PER_S}, "frame_id": frame}


def _xyz(value: Any) -> Values:
    return {"x": value.x, "y": value.y, "z": value.z}


def _xyzw(value: Any) -> Values:
    return {**_xyz(value), "w": value.w}


def _transforms(of: Iterable[messages.FrameTransforms]) -> Values:
    return {
        "transforms": [
            {
                "header": _header(each.timestamp.ToNanoseconds(), each.parent_frame_id),
                "child_frame_id": each.child_frame_id,
                "transform": {"translation": _xyz(each.translation), "rotation": _xyzw(each.rotation)},
            }
            for message in of
            for each in message.transforms
        ]
    }


def _camera_info(camera: Camera, stamp_ns: int, frame: str) -> Values:
    message = calibration_message(camera, stamp_ns, frame)
    return {
        "header": _header(stamp_ns, frame),
        "height": message.height,
        "width": message.width,
        "distortion_model": camera.distortion_model,
        **{name: list(getattr(message, name.upper())) for name in "dkrp"},
    }


def _odometry(estimate: Estimate, subject: Subject) -> Values:
    """Return an odometry message; unknown covariances are 0, as usual in ROS."""
    message = messages.odometry(estimate, subject)
    pose = {"position": _xyz(message.pose.position), "orientation": _xyzw(message.pose.orientation)}
    twist = {"linear": _xyz(message.linear_velocity), "angular": _xyz(message.angular_velocity)}
    return {
        "header": _header(estimate.stamp_ns, message.frame_id),
        "child_frame_id": message.body_frame_id,
        "pose": {"pose": pose, "covariance": list(message.pose_covariance) or None},
        "twist": {"twist": twist, "covariance": list(message.velocity_covariance) or None},
    }


def _joint_states(estimate: Estimate, subject: Subject) -> Values:
    joints = messages.joint_states(estimate, subject).joints
    return {
        "header": _header(estimate.stamp_ns, subject.name),
        "name": [joint.name for joint in joints],
        "position": [joint.position for joint in joints],
        "velocity": [joint.velocity for joint in joints if joint.HasField("velocity")],
    }


def _point_cloud(estimate: Estimate, subject: Subject) -> Values:
    count, step = len(estimate.points), 12
    return {
        "header": _header(estimate.stamp_ns, subject.camera_frame),
        "height": 1,
        "width": count,
        "fields": [
            {"name": axis, "offset": 4 * k, "datatype": FLOAT32, "count": 1} for k, axis in enumerate("xyz")
        ],
        "point_step": step,
        "row_step": step * count,
        "data": (estimate.points * METRES_PER_MM).astype("<f4").tobytes(),
        "is_dense": True,
    }


def _markers(estimate: Estimate, subject: Subject) -> Iterable[Values]:
    """Yield markers for lines and points; faint while the track is lost."""
    (entity,) = line_scene(estimate, subject).entities
    (lines,) = entity.lines
    balls = [_xyz(ball.pose.position) for ball in entity.spheres]
    size = entity.spheres[0].size.x if balls else 0.0
    drawn = (
        (LINE_LIST, {"x": LINE_MM * METRES_PER_MM}, [_xyz(point) for point in lines.points]),
        (SPHERE_LIST, dict.fromkeys("xyz", size), balls),
    )
    colour = {name: getattr(lines.color, name) for name in "rgba"}
    for number, (kind, scale, points) in enumerate(drawn):
        yield {
            "header": _header(estimate.stamp_ns, entity.frame_id),
            "ns": entity.id,
            "id": number,
            "type": kind,
            "pose": {"orientation": {"w": 1.0}},
            "scale": scale,
            "color": colour,
            "points": points,
        }
