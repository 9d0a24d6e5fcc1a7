"""What is drawn of a face: on images, against OpenCV's projection, and in space."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation

from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.results import Estimate, Status, Subject
from posetrack_cli.results.scene import AXIS_MM, LOST_ALPHA, image_annotations, line_scene
from support.results import CAMERA, make_estimate

SUBJECT = Subject(
    "head", "left", (), ("a", "b", "c", "d"), (-1,) * 4, colour=(0.5, 0.25, 0.75, 1.0), lines=((0, 1), (2, 3))
)
TURNED = cv2.Rodrigues(np.array([0.05, -0.2, 0.1]))[0]
OTHER = replace(
    CAMERA,
    name="right",
    distortion=(0.12, -0.05, 0.001, -0.002, 0.01),
    camera_T_reference=tuple(map(tuple, np.column_stack([TURNED, [-120.0, 3.0, 10.0]]))),
)
PIXEL_TOLERANCE = 1e-6  # both evaluate one closed form in double precision


def estimate(**fields: object) -> Estimate:
    made = make_estimate(0, k=0)
    points = made.points + np.array([0.0, 0.0, 800.0])
    return replace(made, **({"points": points, "status": Status.TRACKING} | fields))  # type: ignore[arg-type]


def opencv_pixels(points: np.ndarray, camera: object) -> np.ndarray:
    place = np.array(camera.camera_T_reference)  # type: ignore[attr-defined]
    turn, _ = cv2.Rodrigues(place[:, :3])
    distortion = np.array(camera.distortion)  # type: ignore[attr-defined]
    found, _ = cv2.projectPoints(points, turn, place[:, 3], camera.matrix, distortion)  # type: ignore[attr-defined]
    return found[:, 0]


def drawn_pixels(annotation: PointsAnnotation) -> np.ndarray:
    return np.array([(point.x, point.y) for point in annotation.points])


@pytest.mark.parametrize("camera", [CAMERA, OTHER], ids=["reference", "other"])
def test_points_lines_and_axes_are_where_the_camera_sees_them(camera: object) -> None:
    made = estimate()
    lines, axes, dots = image_annotations(made, SUBJECT, camera).points  # type: ignore[arg-type]
    np.testing.assert_allclose(drawn_pixels(dots), opencv_pixels(made.points, camera), atol=PIXEL_TOLERANCE)
    np.testing.assert_allclose(drawn_pixels(lines), drawn_pixels(dots), atol=0)  # 0-1 and 2-3: all in order
    ends = made.position + AXIS_MM * matrices_from_quaternions(made.quaternion).T
    expected = opencv_pixels(np.vstack([made.position, ends]), camera)
    np.testing.assert_allclose(drawn_pixels(axes)[1::2], expected[1:], atol=PIXEL_TOLERANCE)
    np.testing.assert_allclose(drawn_pixels(axes)[::2], expected[[0, 0, 0]], atol=PIXEL_TOLERANCE)
    assert (lines.type, dots.type) == (PointsAnnotation.LINE_LIST, PointsAnnotation.POINTS)
    assert [colour.r for colour in lines.outline_colors] == [0.5, 0.5]
    assert dots.timestamp.ToNanoseconds() == made.stamp_ns


def test_what_is_behind_the_camera_is_left_out() -> None:
    points = estimate().points.copy()
    points[1, 2] *= -1.0
    lines, _, dots = image_annotations(estimate(points=points), SUBJECT, CAMERA).points
    np.testing.assert_allclose(drawn_pixels(dots), opencv_pixels(points[[0, 2, 3]], CAMERA), atol=1e-6)
    assert len(lines.points) == 2  # 2-3 alone
    behind = estimate(points=points - [0.0, 0.0, 5000.0], position=np.array([0.0, 0.0, -900.0]))
    assert not image_annotations(behind, SUBJECT, CAMERA).points


def test_a_lost_face_is_faint() -> None:
    seen, lost = estimate(), estimate()
    lost = replace(lost, status=Status.LOST)
    for of, share in ((seen, 1.0), (lost, LOST_ALPHA)):
        lines, axes, dots = image_annotations(of, SUBJECT, CAMERA).points
        assert {c.a for c in (*lines.outline_colors, *axes.outline_colors, dots.outline_color)} == {share}
        (entity,) = line_scene(of, SUBJECT).entities
        assert {entity.lines[0].color.a, *(ball.color.a for ball in entity.spheres)} == {share}


def test_lines_are_thicker_in_space_than_on_images() -> None:
    lines, axes, dots = image_annotations(estimate(), SUBJECT, CAMERA).points
    (entity,) = line_scene(estimate(), SUBJECT).entities
    assert [lines.thickness, axes.thickness, dots.thickness] == [1.5, 2.5, 5.0]
    assert entity.lines[0].thickness == 2.0


def test_the_scene_holds_the_points_in_metres() -> None:
    made = estimate()
    (entity,) = line_scene(made, SUBJECT).entities
    assert (entity.frame_id, entity.id) == ("left", "head")
    balls = np.array([(b.pose.position.x, b.pose.position.y, b.pose.position.z) for b in entity.spheres])
    np.testing.assert_allclose(1e3 * balls, made.points, rtol=1e-12)
    ends = np.array([(p.x, p.y, p.z) for p in entity.lines[0].points])
    np.testing.assert_allclose(1e3 * ends, made.points, rtol=1e-12)


@pytest.mark.parametrize("line", [(0, 4), (-1, 2), (1,)])
def test_a_line_between_points_that_there_are_not_is_refused(line: tuple[int, ...]) -> None:
    from posetrack_cli.errors import ResultError

    with pytest.raises(ResultError, match="invalid line"):
        replace(SUBJECT, lines=(line,))
