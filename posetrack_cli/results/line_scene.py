"""Points and lines of an estimate in space, as a Foxglove SceneUpdate."""

from __future__ import annotations

from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.scene import LOST_ALPHA, METRES_PER_MM

LINE_PX = 2.0
POINT_MM = 4.0
"""Diameter of the balls that points are drawn as."""


def line_scene(estimate: Estimate, subject: Subject) -> SceneUpdate:
    """Return the subject's lines and a ball at every point, in the axes of the camera of the estimates.

    The entity's id is constant, so each update replaces the one before; a lost subject is drawn faintly.
    """
    message = SceneUpdate()
    entity = message.entities.add(frame_id=subject.camera_frame, id=subject.name)
    entity.timestamp.FromNanoseconds(estimate.stamp_ns)
    entity.lifetime.FromNanoseconds(0)
    red, green, blue, alpha = subject.colour
    colour = {"r": red, "g": green, "b": blue, "a": alpha * _share(estimate)}
    points = (estimate.points * METRES_PER_MM).tolist()
    lines = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=LINE_PX, scale_invariant=True)
    lines.pose.orientation.w = 1.0
    _set(lines.color, colour)
    for end in (end for line in subject.lines for end in line):
        _set(lines.points.add(), dict(zip("xyz", points[end], strict=True)))
    for point in points:
        ball = entity.spheres.add()
        _set(ball.pose.position, dict(zip("xyz", point, strict=True)))
        ball.pose.orientation.w = 1.0
        _set(ball.size, dict.fromkeys("xyz", POINT_MM * METRES_PER_MM))
        _set(ball.color, colour)
    return message


def _share(estimate: Estimate) -> float:
    return LOST_ALPHA if estimate.status is Status.LOST else 1.0


def _set(target: object, values: dict[str, float]) -> None:
    for name, value in values.items():
        setattr(target, name, value)
