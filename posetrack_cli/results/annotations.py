"""Points, lines and axes of an estimate on the images of a camera, as Foxglove ImageAnnotations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import in_camera_axes, pixels_from_points
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.results.scene import LOST_ALPHA

AXIS_MM = 60.0
"""Length of the drawn axes."""
AXIS_COLOURS = ((1.0, 0.2, 0.2, 1.0), (0.2, 0.85, 0.2, 1.0), (0.25, 0.45, 1.0, 1.0))
"""Of x, y, z: red, green, blue."""
POINT_COLOUR = (1.0, 0.9, 0.2, 1.0)
POINT_PX, LINE_PX, AXIS_PX = 5.0, 1.5, 2.5

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
    draw.lines(subject.lines, (subject.colour,) * len(subject.lines), LINE_PX)
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
