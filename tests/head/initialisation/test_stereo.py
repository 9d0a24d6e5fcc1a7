"""Starts: from pixels that are known, and from images of people."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.detector import Detection, FaceDetector
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES, HeadPose
from posetrack_cli.head.face.rig_images import RigImages
from posetrack_cli.head.initialisation import stereo
from posetrack_cli.head.initialisation.search import InitFailure
from posetrack_cli.head.initialisation.single_view import weak_perspective
from posetrack_cli.head.initialisation.stereo import StereoAttempt, StereoInitialisation, pose_and_shape
from support.rig import LEFT, face_pixels, right_camera, turned_head

CAMERAS = (LEFT, right_camera(0.17))
BLANK = np.zeros((480, 640), np.uint8)
ATTEMPT = StereoAttempt(RigImages(CAMERAS, (BLANK, BLANK)))
SURE = np.ones(10)


def started(pixels: np.ndarray, correlations: np.ndarray = SURE) -> StereoInitialisation | InitFailure:
    return ATTEMPT.from_pixels(0, pixels, correlations)


def test_known_pixels_give_pose_shape_and_pixels() -> None:
    truth = turned_head()
    pixels = face_pixels(CAMERAS, truth)
    start = started(pixels, 0.8 * SURE)
    assert isinstance(start, StereoInitialisation)
    np.testing.assert_allclose(truth.difference(start.pose), 0.0, atol=1e-6)
    np.testing.assert_allclose(start.shape, FEATURES, atol=1e-6)
    np.testing.assert_allclose(start.pixels, pixels, atol=1e-6)
    assert start.score == pytest.approx(0.8)
    assert start.matched.all()


def test_points_not_matched_get_an_average_faces_depth() -> None:
    truth = turned_head()
    pixels = face_pixels(CAMERAS, truth)
    expected = pixels.copy()
    pixels[1, [0, 9]] = np.nan
    start = started(pixels)
    assert isinstance(start, StereoInitialisation)
    np.testing.assert_array_equal(np.flatnonzero(~start.matched), [0, 9])
    np.testing.assert_allclose(start.pixels, expected, atol=1e-6)


def test_too_few_matches_are_no_start() -> None:
    pixels = face_pixels(CAMERAS, turned_head())
    pixels[1, :4] = np.nan
    failure = started(pixels)
    assert isinstance(failure, InitFailure)
    assert failure.reason == "6 of 10 points matched between the images"


def test_pixels_off_the_epipolar_lines_do_not_count() -> None:
    pixels = face_pixels(CAMERAS, turned_head())
    pixels[1, :5, 1] += 10.0
    failure = started(pixels)
    assert isinstance(failure, InitFailure)
    assert failure.reason.startswith("5 of 10")


def test_of_three_cameras_one_may_be_wrong() -> None:
    """A match 10 px off in one of three images does not cost the point, which keeps its true place."""
    cameras = (LEFT, right_camera(0.17), right_camera(-0.17))
    truth = turned_head()
    pixels = face_pixels(cameras, truth)
    pixels[2, :4] += 10.0
    start = StereoAttempt(RigImages(cameras, (BLANK,) * 3)).from_pixels(0, pixels, SURE)
    assert isinstance(start, StereoInitialisation)
    assert start.matched.all()
    np.testing.assert_allclose(start.shape, FEATURES, atol=1e-6)
    assert start.reprojection_px < 1e-6


def test_a_giant_is_no_start_and_says_how_large() -> None:
    failure = started(face_pixels(CAMERAS, turned_head(distance=1400.0), 2.0 * FEATURES))
    assert isinstance(failure, InitFailure)
    assert failure.reason == "implausible size: 2.00 times an average face"


def test_a_hollow_face_is_no_start() -> None:
    hollow = FEATURES * [1.0, 1.0, -1.0]
    assert isinstance(started(face_pixels(CAMERAS, turned_head(), hollow)), InitFailure)


def test_weak_perspective_recovers_scale_and_rotation() -> None:
    rotation = (Rotation.from_euler("ZYX", [0.1, 0.3, -0.2])).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    pixels = 1.3 * (FEATURES @ rotation.T)[:, :2] + [300.0, 200.0]
    scale, found, _ = weak_perspective(FEATURES, pixels, 1.0 / FEATURE_SD)
    assert scale == pytest.approx(1.3)
    np.testing.assert_allclose(found, rotation, atol=1e-9)


def test_fewer_than_two_images_are_no_start() -> None:
    failure = StereoAttempt(RigImages(CAMERAS, (BLANK, None))).find(FaceDetector())
    assert isinstance(failure, InitFailure)
    assert failure.reason == "fewer than two cameras have an image"


def test_a_blank_image_has_no_face() -> None:
    assert ATTEMPT.find(FaceDetector()) == InitFailure("no face", 0.0)


def test_cameras_of_a_known_face_are_searched_in_turn() -> None:
    """One image per frame, and each in all ways, as if the others were not there."""
    looked_at = []

    class Noting:
        def detect_quickly(self, image: np.ndarray, index: int) -> Detection:
            looked_at.append((int(image[0, 0]), index))
            return Detection((), 0.2)

    attempt = StereoAttempt(RigImages(CAMERAS, (BLANK, BLANK + 1)))
    for index in range(4):
        assert attempt.find(Noting(), index, in_turn=True) == InitFailure("no face", 0.2)
    assert looked_at == [(0, 0), (1, 0), (0, 1), (1, 1)]


class Person:
    """A recording of data/heads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        about = json.loads((folder / "calibration.json").read_text())["cameras"]["right"]
        transform = np.column_stack([about["R_from_left"], about["t_from_left_mm"]])
        rows = tuple(tuple(float(value) for value in row) for row in transform)
        left = Camera(640, 480, 1000.0, 1000.0, 320.0, 240.0, name="left")
        self.cameras = (
            left,
            Camera(640, 480, 1000.0, 1000.0, 320.0, 240.0, name="right", camera_T_reference=rows),
        )
        self.truth = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)

    def images(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        names = [self.folder / side / f"{index:06d}.jpg" for side in ("left", "right")]
        one, other = (cv2.imread(str(name), cv2.IMREAD_GRAYSCALE) for name in names)
        assert one is not None
        assert other is not None
        return one, other


@pytest.fixture(params=["person-a", "person-b"])
def person(request: pytest.FixtureRequest, measured_data: Path) -> Person:
    return Person(measured_data / "heads" / request.param)


def test_people_are_found_where_they_are(person: Person) -> None:
    errors = []
    for index in range(0, len(person.truth), 50):
        start = StereoAttempt(RigImages(person.cameras, person.images(index))).find(FaceDetector())
        assert isinstance(start, StereoInitialisation)
        errors.append(start.pose.position - person.truth[index, 1:4])
    # The feature's mean of the eye corners is a few mm off the vertices'; single corners err by up to 20 mm.
    assert np.median(np.linalg.norm(errors, axis=1)) < 10.0
    assert np.linalg.norm(errors, axis=1).max() < 20.0


def test_exchanged_images_of_people_are_noticed(person: Person) -> None:
    failures = [
        StereoAttempt(RigImages(person.cameras, person.images(index)[::-1])).find(FaceDetector())
        for index in (0, 20, 40)
    ]
    orders = [one.order for one in failures if isinstance(one, InitFailure)]
    assert orders == [(1, 0)] * 3


def test_right_images_are_not_refused_whatever_single_faces_say(
    person: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a wide baseline, where ten points found in each image by itself fit the other order better."""
    monkeypatch.setattr(stereo, "swapped_order", lambda cameras, faces: (1, 0))
    attempts = [StereoAttempt(RigImages(person.cameras, person.images(index))) for index in (0, 40)]
    starts = [attempt.find(FaceDetector()) for attempt in attempts]
    assert all(isinstance(one, StereoInitialisation) and one.reprojection_px < 1.0 for one in starts)


def test_what_matches_more_points_and_is_more_like_a_face_is_surer() -> None:
    pose, known = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0])), np.arange(10) < 8
    face = StereoInitialisation(pose, FEATURES, np.zeros((2, 10, 2)), np.ones(10, dtype=bool), 0.9)
    hollow = replace(face, shape=FEATURES * [1.0, 1.0, -1.0], matched=known)
    assert face.is_better_than(hollow) and not hollow.is_better_than(face)
    assert not face.is_better_than(replace(hollow, matched=face.matched))
    assert not face.is_better_than(replace(face, matched=known))
    assert not replace(face, reprojection_px=1.0).is_better_than(hollow)


def test_clicked_points_start_where_found_ones_do(person: Person) -> None:
    images = person.images(0)
    (face,) = FaceDetector().detect(images[0]).faces
    clicked = np.full((2, 10, 2), np.nan)
    clicked[0] = face.pixels
    by_click = StereoAttempt(RigImages(person.cameras, images)).from_clicked(clicked)
    found = StereoAttempt(RigImages(person.cameras, images)).find(FaceDetector())
    assert isinstance(by_click, StereoInitialisation)
    assert isinstance(found, StereoInitialisation)
    assert np.linalg.norm(found.pose.position - by_click.pose.position) < 3.0


# The head's frame from its points


def test_an_average_faces_pose_is_found_exactly() -> None:
    truth = turned_head(0.3, -0.2)
    pose, shape = pose_and_shape(truth.points(FEATURES))
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=1e-9)
    np.testing.assert_allclose(shape, FEATURES, atol=1e-9)


def test_pose_and_shape_give_the_points_back() -> None:
    points = turned_head().points(FEATURES) + np.random.default_rng(3).normal(0.0, 4.0, FEATURES.shape)
    pose, shape = pose_and_shape(points)
    np.testing.assert_allclose(pose.points(shape), points, atol=1e-9)
    np.testing.assert_allclose(shape[:4].mean(axis=0), 0.0, atol=1e-9)


def test_a_larger_head_has_the_same_pose() -> None:
    truth = turned_head()
    pose, shape = pose_and_shape(truth.points(1.2 * FEATURES))
    np.testing.assert_allclose(truth.difference(pose), 0.0, atol=1e-9)
    np.testing.assert_allclose(shape, 1.2 * FEATURES, atol=1e-9)
