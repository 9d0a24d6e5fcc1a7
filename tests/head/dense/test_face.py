"""The dense face in the estimates of a tracker."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera, pixels_wherever
from posetrack_cli.head.actions import ACTION_NAMES
from posetrack_cli.head.dense.face import KNOWN_FACES, DenseFaces
from posetrack_cli.head.dense.measure import (
    CONVERGENCE_RAD,
    CONVERGENCE_SD_RAD,
    average_face,
    measure,
    together,
)
from posetrack_cli.head.dense.network import shipped_networks
from posetrack_cli.head.dense.numbers import CLOSED, FACE_NUMBERS, dense_points
from posetrack_cli.head.dense.points import DENSE_COUNT, DENSE_NAMES, NUMBERS
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.subject import head_subject, with_dense_face
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Status
from posetrack_cli.results.fields import check_estimate
from support.results import make_estimate, with_fields

LEFT = Camera(640, 480, 900.0, 900.0, 319.5, 239.5, name="left")
RIGHT = replace(
    LEFT,
    name="right",
    camera_T_reference=((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
)
POSE = HeadPose(np.array([10.0, -20.0, 600.0]), np.array([1.0, 0.0, 0.0, 0.0]))
SUBJECT = head_subject("left", 0)


def drawn_face(camera: Camera) -> np.ndarray:
    """Return an image with dark lips, irises and brows at the average face."""
    image = np.full((camera.height, camera.width), 170, np.uint8)
    face = average_face(shipped_networks())
    inside = np.array(camera.camera_T_reference)
    points = POSE.points(face) @ inside[:, :3].T + inside[:, 3]
    pixels = dict(zip(NUMBERS, pixels_wherever(camera, points), strict=True))

    def polygon(numbers, colour, closed=True):
        ring = np.round(np.array([pixels[number] for number in numbers])).astype(np.int32)
        if closed:
            cv2.fillPoly(image, [ring], colour)
        else:
            cv2.polylines(image, [ring], False, colour, 5)

    polygon(range(48, 60), 100)
    for lids, brow, iris in (
        ((36, 37, 38, 39, 40, 41), range(17, 22), 68),
        ((45, 44, 43, 42, 47, 46), range(26, 21, -1), 69),
    ):
        polygon(lids, 230)
        polygon(brow, 60, closed=False)
        cv2.circle(image, tuple(int(value) for value in np.round(pixels[iris])), 6, 30, -1)
    return image


def frame(*cameras: Camera) -> Frame:
    return Frame(0, 0, tuple(drawn_face(camera) for camera in cameras))


def tracked(status: Status = Status.TRACKING, confidence: float = 0.9):
    return with_fields(
        make_estimate(0, k=0, p=len(SUBJECT.point_names)),
        status=status,
        confidence=confidence,
        position=POSE.position,
        quaternion=POSE.quaternion,
        numbers=np.arange(len(SUBJECT.number_names), dtype=float),
    )


def test_estimate_has_the_numbers_of_its_subject():
    faces = DenseFaces((LEFT,), SUBJECT.number_names)

    known, estimate = faces.add((), frame(LEFT), tracked(), 0)

    subject = with_dense_face(SUBJECT)
    check_estimate(estimate, subject)
    assert subject.number_names[-len(FACE_NUMBERS) :] == FACE_NUMBERS
    named = dict(zip(subject.number_names, estimate.numbers, strict=True))
    own = [name for name in SUBJECT.number_names if name not in ACTION_NAMES]
    assert [named[name] for name in own] == [float(SUBJECT.number_names.index(name)) for name in own]
    assert len(known) == 1


def test_points_in_the_image_are_projections():
    faces = DenseFaces((LEFT,), SUBJECT.number_names)
    _, estimate = faces.add((), frame(LEFT), tracked(), 0)

    dense = dense_points(with_dense_face(SUBJECT).number_names, estimate.numbers)

    assert dense.shape == (DENSE_COUNT, 7)
    seen = pixels_wherever(LEFT, POSE.points(dense[:, :3]))
    # coordinates are rounded to 1e-3 mm and px
    np.testing.assert_allclose(dense[:, 4:6], seen, atol=5e-3)


def test_a_second_camera_makes_points_more_certain():
    networks = shipped_networks()
    both = frame(LEFT, RIGHT).images

    one = measure(networks, RigImages((LEFT, RIGHT), (both[0], None)), POSE)
    two = measure(networks, RigImages((LEFT, RIGHT), both), POSE)

    assert (two.variances < one.variances).all()
    # two images 11 degrees apart determine the depth better than faces do
    assert np.median(two.covariances[:, 2, 2]) < np.median(one.covariances[:, 2, 2])


def test_a_lost_head_has_no_face():
    faces = DenseFaces((LEFT,), SUBJECT.number_names)

    _, estimate = faces.add((), frame(LEFT), tracked(Status.LOST, 0.0), 0)

    assert np.isnan(estimate.numbers[-len(FACE_NUMBERS) :]).all()


def test_a_face_turned_away_is_unknown():
    away = HeadPose(POSE.position, np.array([0.0, 0.0, 0.0, 1.0]))

    found = measure(shipped_networks(), RigImages((LEFT,), frame(LEFT).images), away)

    assert np.isnan(found.places).all()
    assert np.isnan(found.gazes).all()


def test_eyes_that_converge_as_usual_keep_their_gazes():
    half, sd = 0.5 * CONVERGENCE_RAD, 0.05
    gazes = np.array([[0.1 + half, -0.2, sd], [0.1 - half, -0.2, sd]])

    found = together(gazes)

    np.testing.assert_allclose(found[:, :2], gazes[:, :2])
    assert (found[:, 2] < sd).all()


def test_both_eyes_look_up_alike_and_do_not_diverge_much():
    """The more certain eye counts more; a difference as likely before as measured is halved."""
    sd = CONVERGENCE_SD_RAD / np.sqrt(2.0)
    found = together(np.array([[-0.1, 0.1, sd], [0.1, 0.3, sd]]))
    assert found[0, 1] == found[1, 1] == pytest.approx(0.2)
    assert found[:, 0].sum() == pytest.approx(0.0)
    assert found[0, 0] - found[1, 0] == pytest.approx(0.5 * (CONVERGENCE_RAD - 0.2))

    uneven = together(np.array([[0.0, 0.1, 0.02], [0.0, 0.3, 0.06]]))
    assert uneven[0, 1] == pytest.approx(0.12)


def test_one_eye_keeps_its_gaze():
    gazes = np.array([[0.1, 0.2, 0.05], [np.nan] * 3])

    np.testing.assert_array_equal(together(gazes), gazes)


def test_people_are_learned_separately():
    faces = DenseFaces((LEFT,), SUBJECT.number_names)
    known, _ = faces.add((), frame(LEFT), tracked(), 1)
    again, _ = faces.add(known, frame(LEFT), tracked(), 1)

    assert len(again) == 2
    assert again[0].lengths.histogram.sum() == 0
    assert again[1].lengths.histogram.sum() > known[1].lengths.histogram.sum()


def test_known_faces_survive_a_checkpoint():
    faces = DenseFaces((LEFT,), SUBJECT.number_names)
    known, _ = faces.add((), frame(LEFT), tracked(), 1)

    arrays = KNOWN_FACES.to_arrays(known)
    again = KNOWN_FACES.to_arrays(KNOWN_FACES.from_arrays(arrays))

    assert arrays.keys() == again.keys()
    assert all(np.array_equal(arrays[name], again[name]) for name in arrays)


@pytest.mark.parametrize("confidence", [0.3, 0.9])
def test_small_faces_have_no_gaze(confidence):
    small = replace(LEFT, fx=300.0, fy=300.0)  # 31 px between the eyes at 600 mm
    faces = DenseFaces((small,), SUBJECT.number_names)

    _, estimate = faces.add((), frame(small), tracked(confidence=confidence), 0)

    named = dict(zip(with_dense_face(SUBJECT).number_names, estimate.numbers, strict=True))
    assert np.isnan(named["right_gaze_up_rad"])
    assert not np.isnan(named[f"{DENSE_NAMES[0]}_x_mm"])
    assert CLOSED in named
