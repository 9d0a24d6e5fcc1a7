"""Which face of an image a start takes, and which it refuses."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.adjustment.adjuster import Adjuster
from posetrack_cli.head.config import HeadMonoConfig
from posetrack_cli.head.detection.detector import FaceDetector
from posetrack_cli.head.face.points import EYES, FEATURES
from posetrack_cli.head.initialisation.mono import LEFT, RIGHT, MonoInitialiser, face_at, slope_deviation
from posetrack_cli.head.initialisation.search import NO_FACE, InitFailure
from posetrack_cli.head.multilinear.face_model import load_face_model
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.head.frames import make_cameras, synthesise
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from support.initialisation_scenes import BENT, BLANK, PLAIN, Says, found, head, pixels_of

CONFIG = HeadMonoConfig()
NEAR, FAR = head(x=-150.0), head(yaw=10.0, x=200.0, z=1000.0)


def initialiser(camera, detector, choice=0):
    adjuster = Adjuster(load_face_model(), camera, CONFIG.adjustment)
    return MonoInitialiser(CONFIG, adjuster, detector, choice)


def detect(faces, choice=0, near=None):
    return initialiser(PLAIN, Says(faces), choice).detect(Frame(0, 7, (BLANK,)), near)


def test_a_face_is_told_with_its_pose_and_size():
    face = detect([found(NEAR)])
    assert face.stamp_ns == 7
    assert face.score == pytest.approx(0.8)
    assert face.eye_distance == pytest.approx(63.0 * 900.0 / 700.0)
    assert face.misfit < 1e-6
    np.testing.assert_allclose(NEAR.difference(face.pose), 0.0, atol=1e-4)


def test_the_choice_is_by_the_detectors_order():
    faces = [found(NEAR), found(FAR)]
    assert detect(faces).pose.position[2] == pytest.approx(700.0)
    assert detect(faces, choice=1).pose.position[2] == pytest.approx(1000.0)
    assert detect(faces, choice=2) == InitFailure("2 faces, not 3", 0.9)
    assert detect(faces[:1], choice=1) == InitFailure("1 face, not 2", 0.9)


def test_the_face_of_the_frame_before_is_kept_when_another_becomes_larger():
    before = detect([found(NEAR), found(FAR)])
    came = head(x=140.0, z=600.0)
    face = detect([found(came), found(head(x=-145.0))], near=before.pixels)
    assert face.pose.position[0] == pytest.approx(-145.0, abs=0.1)


def test_a_face_elsewhere_is_not_the_face_of_the_frame_before():
    before = detect([found(NEAR)])
    failure = detect([found(FAR)], near=before.pixels)
    assert failure == InitFailure("no face near the last position", 0.9)


def test_without_a_face_there_is_none():
    assert detect([]) == InitFailure(NO_FACE, 0.9)
    assert detect([], near=np.zeros((10, 2))) == InitFailure(NO_FACE, 0.9)


def test_points_that_are_not_symmetric_are_refused():
    face = found(NEAR)
    face.pixels[3, 1] += 25.0
    failure = detect([face])
    assert isinstance(failure, InitFailure)
    assert "slopes between left and right points differ by" in failure.reason
    assert failure.score == pytest.approx(0.8)


def test_clicked_points_are_believed():
    face = face_at(found(NEAR).pixels, 5, PLAIN)
    assert face.score == 1.0
    np.testing.assert_allclose(NEAR.difference(face.pose), 0.0, atol=1e-4)


def test_a_drawn_head_is_found(device: RenderingDevice) -> None:
    options = HeadSynthOptions(frames=1, identity=1, seed=1, cameras=1)
    frame = next(iter(synthesise(options, device=device)))
    made = Frame(0, frame.stamp_ns, (frame.images[0],))
    face = initialiser(make_cameras(options)[0], FaceDetector()).detect(made)
    assert not isinstance(face, InitFailure)
    assert np.linalg.norm(frame.pose.position - face.pose.position) < 60.0  # a mean face's size tells depth
    pitch, yaw, roll = np.rad2deg(np.abs(frame.pose.difference(face.pose)[3:]))
    assert yaw < 10.0
    assert roll < 3.0
    assert pitch < 30.0  # brows that one person has 2 mm lower than another are 4 degrees of it


def two_people(folder: Path) -> np.ndarray:
    """Person a, and beside it person b at 0.7 of the size."""
    left, right = (
        cv2.imread(str(folder / "heads" / f"person-{name}" / "left" / "000000.jpg"), cv2.IMREAD_GRAYSCALE)
        for name in "ab"
    )
    small = cv2.resize(right, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
    beside = np.full((480, small.shape[1]), 128, np.uint8)
    beside[: small.shape[0]] = small
    return np.hstack([left, beside])


def test_of_two_people_the_nearer_or_the_other_is_found(measured_data: Path) -> None:
    image = two_people(measured_data)
    camera = Camera(image.shape[1], 480, 1000.0, 1000.0, 320.0, 240.0)
    detector, frame = FaceDetector(), Frame(0, 0, (image,))
    first, second = (
        initialiser(camera, detector, choice).detect(frame, thoroughly=True) for choice in (0, 1)
    )
    assert not isinstance(first, InitFailure)
    assert not isinstance(second, InitFailure)
    assert first.pixels[EYES, 0].max() < 640 < second.pixels[EYES, 0].min()
    again = initialiser(camera, detector).detect(frame, near=second.pixels + 3.0)
    assert not isinstance(again, InitFailure)
    # the search near it starts from another box: corners agree to a pixel or two
    np.testing.assert_allclose(again.pixels, second.pixels, atol=2.0)


# Slopes of the segments between left and right points: what changes them and what does not


turns = st.floats(-35.0, 35.0)


@given(turns, turns, turns)
def test_no_turn_of_a_symmetric_face_changes_slopes_but_by_perspective(roll, pitch, yaw):
    """From 50 m away perspective is 1 / 70 of what it is from 0.7 m."""
    pixels = 70.0 * pixels_of(head(roll, pitch, yaw, z=50_000.0))
    assert np.rad2deg(slope_deviation(pixels, PLAIN)) < 0.1


@given(turns)
def test_roll_alone_changes_nothing_at_all(roll):
    assert slope_deviation(pixels_of(head(roll)), PLAIN) < 1e-9


def test_perspective_turns_them_less_than_a_detection_may():
    """At 70 cm, 30 degrees aside and 20 down; the threshold is 4 degrees."""
    pixels = pixels_of(head(0.0, 20.0, 30.0))
    assert np.rad2deg(slope_deviation(pixels, PLAIN)) < 2.5


@given(st.sampled_from(range(10)), st.floats(-20.0, 20.0).filter(lambda shift: abs(shift) > 1.0))
def test_a_point_that_is_shifted_up_or_down_raises_it(point, shift):
    pixels = pixels_of(head())
    pixels[point, 1] += shift
    assert slope_deviation(pixels, PLAIN) > np.deg2rad(0.2)


def test_it_is_a_weighted_standard_deviation_of_slopes():
    """Small slopes by hand: dy / dx of each segment, weights their lengths squared."""
    pixels = pixels_of(head())
    rises = np.array([1.0, -0.5, 0.3, 0.2, -0.4])
    pixels[list(LEFT), 1] += rises
    runs = (pixels[list(LEFT)] - pixels[list(RIGHT)])[:, 0]
    weights = runs**2 / np.sum(runs**2)
    slopes = rises / runs
    expected = np.sqrt(np.sum(weights * (slopes - np.sum(weights * slopes)) ** 2))
    assert slope_deviation(pixels, PLAIN) == pytest.approx(expected, rel=1e-2)  # angles for tangents


def test_the_lens_that_bends_segments_is_taken_off():
    pixels = pixels_of(head(x=180.0, y=120.0), BENT)
    assert slope_deviation(pixels, BENT) < 1e-6
    assert slope_deviation(pixels, PLAIN) > np.deg2rad(0.3)


def test_every_point_is_left_or_right_of_another():
    assert sorted(LEFT + RIGHT) == list(range(10))
    assert np.all(FEATURES[list(LEFT), 0] > 0.0)  # x is to the subject's left
    np.testing.assert_allclose(FEATURES[list(RIGHT), 1:], FEATURES[list(LEFT), 1:])
