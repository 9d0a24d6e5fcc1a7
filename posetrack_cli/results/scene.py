"""What Foxglove draws of an estimate: mesh or lines in space, points and axes on images of cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import in_camera_axes, pixels_from_points
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.fields import check_array
from posetrack_cli.units import METRES_PER_MM

LOST_ALPHA = 0.25
"""Share of the opacity that is left while the track is lost, so that nobody takes the mesh for a find."""

LINE_PX = 2.0
POINT_MM = 4.0
"""Diameter of the balls that points are drawn as."""

_UPDATE_ENTITIES = b"\x12"  # SceneUpdate.entities = 2, length-delimited
_ENTITY_TRIANGLES = b"\x62"  # SceneEntity.triangles = 12, length-delimited
_POINT = np.dtype(
    [("header", "u1", 3), ("x", "<f8"), ("y_tag", "u1"), ("y", "<f8"), ("z_tag", "u1"), ("z", "<f8")]
)
_POINT_HEADER = (0x12, 27, 0x09)  # TriangleListPrimitive.points = 2, 27 bytes, Point3.x = 1 as fixed64
_Y_TAG, _Z_TAG = 0x11, 0x19


class SceneEncoder:
    """Encodes the mesh of one subject, frame after frame.

    The entity's id is constant, so each update replaces the one before; its lifetime is unlimited.

    Args:
        subject: whose triangles are drawn; must have some.
    """

    def __init__(self, subject: Subject) -> None:
        if subject.triangles is None:
            raise ValueError("a subject without triangles has no scene")
        self._subject = subject
        self._vertex_count = int(subject.triangles.max(initial=-1)) + 1
        self._pose = _pose_field()
        self._tails = {status: _colour_and_indices(subject, status) for status in Status}

    def encode(self, stamp_ns: int, status: Status, vertices: FloatArray) -> bytes:
        """Return the serialised SceneUpdate.

        Args:
            stamp_ns: of the frame.
            status: a lost subject is drawn faintly.
            vertices: (V, 3) mm, camera axes; V covers every index of the triangles.

        Raises:
            ResultError: too few vertices, or NaN or infinity among them.
        """
        shape = (max(len(vertices), self._vertex_count), 3)
        check_array(vertices, shape, "mesh", f"{self._subject.name}, {stamp_ns} ns")
        primitive = self._pose + _points_field(vertices * METRES_PER_MM) + self._tails[status]
        entity = SceneEntity(frame_id=self._subject.camera_frame, id=self._subject.name)
        entity.timestamp.FromNanoseconds(stamp_ns)
        entity.lifetime.FromNanoseconds(0)
        body = entity.SerializeToString(deterministic=True) + _delimited(_ENTITY_TRIANGLES, primitive)
        return _delimited(_UPDATE_ENTITIES, body)


def _pose_field() -> bytes:
    """Return the wire bytes of the identity pose."""
    primitive = TriangleListPrimitive()
    primitive.pose.position.SetInParent()
    primitive.pose.orientation.w = 1.0
    return bytes(primitive.SerializeToString(deterministic=True))


def _colour_and_indices(subject: Subject, status: Status) -> bytes:
    """Return the wire bytes of colour and indices, the fields that follow the points."""
    primitive = TriangleListPrimitive()
    red, green, blue, alpha = subject.colour
    share = LOST_ALPHA if status is Status.LOST else 1.0
    primitive.color.r, primitive.color.g, primitive.color.b, primitive.color.a = (
        red,
        green,
        blue,
        alpha * share,
    )
    assert subject.triangles is not None
    primitive.indices.extend(subject.triangles.ravel().tolist())
    return bytes(primitive.SerializeToString(deterministic=True))


def _points_field(points: FloatArray) -> bytes:
    """Return the wire bytes of the repeated Point3 field of (V, 3) points."""
    wire = np.empty(len(points), dtype=_POINT)
    wire["header"] = _POINT_HEADER
    wire["y_tag"], wire["z_tag"] = _Y_TAG, _Z_TAG
    wire["x"], wire["y"], wire["z"] = points.T
    return wire.tobytes()


def _delimited(tag: bytes, body: bytes) -> bytes:
    """Return a length-delimited field: tag, length as a base-128 varint, body."""
    length = bytearray()
    rest = len(body)
    while rest > 0x7F:
        length.append(rest & 0x7F | 0x80)
        rest >>= 7
    length.append(rest)
    return tag + bytes(length) + body


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


AXIS_MM = 60.0
"""Length of the drawn axes."""
AXIS_COLOURS = ((1.0, 0.2, 0.2, 1.0), (0.2, 0.85, 0.2, 1.0), (0.25, 0.45, 1.0, 1.0))
"""Of x, y, z: red, green, blue."""
POINT_COLOUR = (1.0, 0.9, 0.2, 1.0)
POINT_PX, DRAWN_LINE_PX, AXIS_PX = 5.0, 1.5, 2.5

_Rgba = tuple[float, float, float, float]


def image_annotations(estimate: Estimate, subject: Subject, camera: Camera) -> ImageAnnotations:
    """Return what a camera sees of an estimate, in pixels of its image as it was taken, distortion included.

    The points, the subject's lines between them and the axes of the pose; what lies behind the camera is left
    out, and a lost subject is drawn faintly.
    """
    message = ImageAnnotations()
    message.timestamp.FromNanoseconds(estimate.stamp_ns)
    rotation = matrices_from_quaternions(estimate.quaternion)
    ends = estimate.position + AXIS_MM * rotation.T
    every = np.vstack([estimate.points, estimate.position[None], ends])
    pixels, seen = pixels_from_points(camera, in_camera_axes(camera, every))
    share = LOST_ALPHA if estimate.status is Status.LOST else 1.0
    draw = _Drawing(message, pixels, seen, share)
    origin = len(estimate.points)
    draw.lines(subject.lines, (subject.colour,) * len(subject.lines), DRAWN_LINE_PX)
    draw.lines([(origin, origin + 1 + axis) for axis in range(3)], AXIS_COLOURS, AXIS_PX)
    draw.dots(origin)
    return message


class _Drawing:
    """Adds to a message what is seen of some pixels (N, 2).

    Args:
        message: to add to.
        pixels: of points.
        seen: (N,) which of them the camera sees.
        share: of the opacity.
    """

    def __init__(self, message: ImageAnnotations, pixels: FloatArray, seen: BoolArray, share: float) -> None:
        self._message, self._share = message, share
        self._pixels, self._seen = pixels.tolist(), seen.tolist()

    def lines(self, pairs: Sequence[tuple[int, int]], colours: Sequence[_Rgba], px: float) -> None:
        """Add lines between two pixels each, with a colour each."""
        kept = [(pair, rgba) for pair, rgba in zip(pairs, colours, strict=True) if self._sees(pair)]
        if not kept:
            return
        drawn = self._added(PointsAnnotation.LINE_LIST, px)
        for pair, rgba in kept:
            for end in pair:
                drawn.points.add(x=self._pixels[end][0], y=self._pixels[end][1])
            self._colour(drawn.outline_colors.add(), rgba)

    def dots(self, count: int) -> None:
        """Add the first so many pixels."""
        if not any(self._seen[:count]):
            return
        drawn = self._added(PointsAnnotation.POINTS, POINT_PX)
        self._colour(drawn.outline_color, POINT_COLOUR)
        for (x, y), seen in zip(self._pixels[:count], self._seen[:count], strict=True):
            if seen:
                drawn.points.add(x=x, y=y)

    def _sees(self, pair: tuple[int, int]) -> bool:
        return all(self._seen[end] for end in pair)

    def _added(self, kind: PointsAnnotation.Type.ValueType, px: float) -> PointsAnnotation:
        drawn: PointsAnnotation = self._message.points.add(type=kind, thickness=px)
        drawn.timestamp.CopyFrom(self._message.timestamp)
        return drawn

    def _colour(self, target: object, rgba: _Rgba) -> None:
        red, green, blue, alpha = rgba
        target.r, target.g, target.b = red, green, blue  # type: ignore[attr-defined]
        target.a = alpha * self._share  # type: ignore[attr-defined]
