"""Foxglove drawings of an estimate: mesh or lines in 3D, points and axes on camera images."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_from_points
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.fields import check_array
from posetrack_cli.units import METRES_PER_MM

LOST_ALPHA = 0.25
"""Opacity factor while the track is lost, so that the mesh is not mistaken for a detection."""

LINE_PX = 2.0
POINT_MM = 4.0
"""Diameter of the spheres drawn at points."""

# Wire format tags: field number << 3 | wire type.
_UPDATE_ENTITIES = b"\x12"  # SceneUpdate.entities = 2, length-delimited
_ENTITY_TRIANGLES = b"\x62"  # SceneEntity.triangles = 12, length-delimited
_POINT = np.dtype(
    [("header", "u1", 3), ("x", "<f8"), ("y_tag", "u1"), ("y", "<f8"), ("z_tag", "u1"), ("z", "<f8")]
)
_POINT_HEADER = (0x12, 27, 0x09)  # TriangleListPrimitive.points = 2, 27 bytes, Point3.x = 1 as fixed64
_Y_TAG, _Z_TAG = 0x11, 0x19


class SceneEncoder:
    """Encoder for the mesh of one subject.

    Points are packed into protobuf wire format with numpy; constant parts are encoded once. The entity id
    is constant, so each update replaces the previous one; its lifetime is unlimited.

    Args:
        subject: subject with triangles.
    """

    def __init__(self, subject: Subject) -> None:
        if subject.triangles is None:
            raise ValueError("subject has no triangles")
        self._subject = subject
        self._vertex_count = int(subject.triangles.max(initial=-1)) + 1
        self._pose = _pose_field()
        self._tails = {status: _colour_and_indices(subject, status) for status in Status}

    def encode(self, stamp_ns: int, status: Status, vertices: FloatArray) -> bytes:
        """Return the serialised SceneUpdate.

        Args:
            stamp_ns: time of the frame.
            status: a lost subject is drawn faintly.
            vertices: (V, 3) mm, camera axes; V covers every index of the triangles.

        Raises:
            ResultError: too few vertices, or NaN or infinity among them.
        """
        shape = (max(len(vertices), self._vertex_count), 3)
        check_array(vertices, shape, "mesh", f"{self._subject.name}, {stamp_ns} ns")
        # Protobuf fields may be concatenated in tag order: pose, points, then colour and indices.
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
    """Return the subject's lines and a sphere at every point, in the axes of the reference camera.

    The entity id is constant, so each update replaces the previous one; a lost subject is drawn faintly.
    """
    names, points = (subject.camera_frame, subject.name), (estimate.points * METRES_PER_MM).tolist()
    message = SceneUpdate()
    message.CopyFrom(_scene_of(*names, subject.lines, len(points), _faded(subject.colour, estimate)))
    (entity,) = message.entities
    entity.timestamp.FromNanoseconds(estimate.stamp_ns)
    ends = (end for line in subject.lines for end in line)
    for drawn, end in zip(entity.lines[0].points, ends, strict=True):
        drawn.x, drawn.y, drawn.z = points[end]
    for ball, (x, y, z) in zip(entity.spheres, points, strict=True):
        place = ball.pose.position
        place.x, place.y, place.z = x, y, z
    return message


_Rgba = tuple[float, float, float, float]
_Lines = tuple[tuple[int, int], ...]


@lru_cache
def _scene_of(frame: str, name: str, lines: _Lines, count: int, colour: _Rgba) -> SceneUpdate:
    """Return the constant part of a scene: everything except positions and time."""
    message = SceneUpdate()
    entity = message.entities.add(frame_id=frame, id=name)
    entity.lifetime.FromNanoseconds(0)
    drawn = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=LINE_PX, scale_invariant=True)
    drawn.pose.orientation.w = 1.0
    _colour(drawn.color, colour)
    for _ in range(2 * len(lines)):
        drawn.points.add()
    for _ in range(count):
        ball = entity.spheres.add()
        ball.pose.position.SetInParent()
        ball.pose.orientation.w = 1.0
        ball.size.x = ball.size.y = ball.size.z = POINT_MM * METRES_PER_MM
        _colour(ball.color, colour)
    return message


def point_cloud(estimate: Estimate, subject: Subject) -> PointCloud:
    """Return the points in the axes of the reference camera, for viewers without scenes, such as rerun."""
    names = ("x", "y", "z")
    message = PointCloud(frame_id=subject.camera_frame, point_stride=4 * len(names))
    message.timestamp.FromNanoseconds(estimate.stamp_ns)
    message.pose.position.SetInParent()
    message.pose.orientation.w = 1.0
    for k, name in enumerate(names):
        message.fields.add(name=name, offset=4 * k, type=PackedElementField.FLOAT32)
    message.data = (estimate.points * METRES_PER_MM).astype("<f4").tobytes()
    return message


def _faded(colour: _Rgba, estimate: Estimate) -> _Rgba:
    """Return the subject's colour, faint if it is lost."""
    red, green, blue, alpha = colour
    return red, green, blue, alpha * (LOST_ALPHA if estimate.status is Status.LOST else 1.0)


def _colour(target: Any, rgba: _Rgba) -> None:
    target.r, target.g, target.b, target.a = rgba


AXIS_MM = 60.0
"""Length of the drawn axes."""
AXIS_COLOURS = ((1.0, 0.2, 0.2, 1.0), (0.2, 0.85, 0.2, 1.0), (0.25, 0.45, 1.0, 1.0))
"""x, y, z: red, green, blue."""
POINT_COLOUR = (1.0, 0.9, 0.2, 1.0)
POINT_PX, DRAWN_LINE_PX, AXIS_PX = 5.0, 1.5, 2.5


def image_annotations(estimate: Estimate, subject: Subject, camera: Camera) -> ImageAnnotations:
    """Return the drawing of an estimate on a camera's original image, in distorted pixels.

    Shows the points, the subject's lines and the pose axes. Parts behind the camera are omitted, and a lost
    subject is drawn faintly.
    """
    rotation = matrices_from_quaternions(estimate.quaternion)
    ends = estimate.position + AXIS_MM * rotation.T
    every = np.vstack([estimate.points, estimate.position[None], ends])
    pixels, seen = pixels_from_points(camera, in_camera_axes(camera, every))
    of_lines = (_faded(subject.colour, estimate),) * len(subject.lines)
    of_axes = tuple(_faded(colour, estimate) for colour in AXIS_COLOURS)
    colours = of_lines, of_axes, _faded(POINT_COLOUR, estimate)
    drawing = _drawing_of(subject.lines, tuple(seen.tolist()), colours)
    return drawing.at(pixels, estimate.stamp_ns)


class _Drawing(NamedTuple):
    """Template of image annotations.

    Attributes:
        skeleton: annotations without pixels and time.
        ends: for each annotation, the indices of its points.
    """

    skeleton: ImageAnnotations
    ends: tuple[tuple[int, ...], ...]

    def at(self, pixels: FloatArray, stamp_ns: int) -> ImageAnnotations:
        """Return the drawing with points at pixels (N, 2)."""
        message, places = ImageAnnotations(), pixels.tolist()
        message.CopyFrom(self.skeleton)
        message.timestamp.FromNanoseconds(stamp_ns)
        for drawn, ends in zip(message.points, self.ends, strict=True):
            drawn.timestamp.CopyFrom(message.timestamp)
            for point, end in zip(drawn.points, ends, strict=True):
                point.x, point.y = places[end]
        return message


@lru_cache
def _drawing_of(
    lines: _Lines, seen: tuple[bool, ...], colours: tuple[tuple[_Rgba, ...], tuple[_Rgba, ...], _Rgba]
) -> _Drawing:
    """Return the template; the last four points are the pose's origin and the ends of its axes.

    Args:
        lines: pairs of points.
        seen: visibility of each point.
        colours: of the lines, the axes, and the points.
    """
    message, drawn_ends = ImageAnnotations(), []
    of_lines, of_axes, of_points = colours
    origin = len(seen) - 1 - len(of_axes)
    axes = tuple((origin, origin + 1 + axis) for axis in range(len(of_axes)))
    for pairs, rgba, px in ((lines, of_lines, DRAWN_LINE_PX), (axes, of_axes, AXIS_PX)):
        kept = [
            (pair, each) for pair, each in zip(pairs, rgba, strict=True) if all(seen[end] for end in pair)
        ]
        if kept:
            drawn = message.points.add(type=PointsAnnotation.LINE_LIST, thickness=px)
            for _, each in kept:
                _colour(drawn.outline_colors.add(), each)
            drawn_ends.append(tuple(end for pair, _ in kept for end in pair))
    dots = tuple(end for end in range(origin) if seen[end])
    if dots:
        _colour(message.points.add(type=PointsAnnotation.POINTS, thickness=POINT_PX).outline_color, of_points)
        drawn_ends.append(dots)
    for drawn, ends in zip(message.points, drawn_ends, strict=True):
        for _ in ends:
            drawn.points.add()
    return _Drawing(message, tuple(drawn_ends))
