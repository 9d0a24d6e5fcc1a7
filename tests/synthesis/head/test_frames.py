"""The pictures: detectors find the face, cameras agree with the truth, what is asked for is to be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import islice

import cv2
import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.head.frames import (
    EXPOSURE,
    READ_SD,
    SHOT,
    Sensor,
    SyntheticHeadFrame,
    make_cameras,
    make_plan,
    render_plan,
    synthesise,
)
from posetrack_cli.synthesis.head.options import HeadSynthOptions

SHORT = HeadSynthOptions(frames=3, identity=1, seed=1)
BRIEF = replace(SHORT, frames=2, width=320, height=240)


def pixels(camera: Camera, frame: SyntheticHeadFrame) -> FloatArray:
    """Where OpenCV projects the ten points (K, 2), with the lens's distortion."""
    transform = np.array(camera.camera_T_reference)
    rotation, _ = cv2.Rodrigues(transform[:, :3])
    points = frame.pose.points(frame.shape)
    distortion = np.array(camera.distortion) if camera.distortion else None
    projected, _ = cv2.projectPoints(points, rotation, transform[:, 3], camera.matrix, distortion)
    return projected[:, 0].astype(np.float64)


@lru_cache
def brief(device: RenderingDevice) -> Sequence[SyntheticHeadFrame]:
    return list(synthesise(BRIEF, device=device))


@lru_cache
def first(options: HeadSynthOptions, device: RenderingDevice) -> SyntheticHeadFrame:
    return next(iter(synthesise(options, device=device)))


def faces(image: ImageArray) -> FloatArray:
    cascade = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_alt2.xml")
    return np.array(cascade.detectMultiScale(image, 1.1, 3, minSize=(100, 100)), dtype=float).reshape(-1, 4)


@pytest.mark.parametrize("identity", [1, 4])
def test_haar_finds_one_face_around_the_eyes(identity: int, device: RenderingDevice) -> None:
    """In photographs eyes lie at (.317, .403) and (.687, .401) of the box, sd .02; here within .06."""
    options = replace(SHORT, identity=identity, cameras=1, frames=1)
    frame = first(options, device)
    found = faces(frame.images[0])
    assert len(found) == 1
    ten = pixels(make_cameras(options)[0], frame)
    centres = (np.array([ten[0:2].mean(axis=0), ten[2:4].mean(axis=0)]) - found[0, :2]) / found[0, 2:]
    np.testing.assert_allclose(centres, [[0.317, 0.403], [0.687, 0.401]], atol=0.06)


def nearest_corner(image: ImageArray, place: FloatArray) -> float:
    """Distance, px, from a place to the nearest peak of corner strength, at least 5 % of the highest."""
    strength = cv2.cornerMinEigenVal(cv2.GaussianBlur(image, (0, 0), 1.0), 5)
    peaks = (strength == cv2.dilate(strength, np.ones((5, 5)))) & (strength > 0.05 * strength.max())
    rows, columns = np.nonzero(peaks)
    return float(np.hypot(columns - place[0], rows - place[1]).min())


def test_corners_of_eyes_and_mouth_are_corners_where_the_truth_says(device: RenderingDevice) -> None:
    options = replace(SHORT, cameras=1, frames=1)
    frame = first(options, device)
    ten = pixels(make_cameras(options)[0], frame)
    off = [nearest_corner(frame.images[0], place) for place in ten[:6]]
    assert max(off) < 2.5 and np.mean(off) < 1.5  # px of 0.7 mm


def test_nostrils_are_dark_and_the_pupils_too(device: RenderingDevice) -> None:
    frame = first(replace(SHORT, cameras=1, frames=1), device)
    image = cv2.GaussianBlur(frame.images[0], (0, 0), 1.0)
    ten = np.rint(pixels(make_cameras(replace(SHORT, cameras=1))[0], frame)).astype(int)
    cheek = image[ten[6, 1], ten[0, 0]]
    assert image[ten[6:8, 1], ten[6:8, 0]].max() < 0.4 * cheek


def test_all_cameras_see_the_same_head(device: RenderingDevice) -> None:
    """The left patch around a point is found in the other images where the truth says, to a pixel."""
    options = replace(SHORT, noise=0.5, cameras=4)
    frame = first(options, device)
    left, *others = make_cameras(options)
    at_left = pixels(left, frame)
    for other, image in zip(others, frame.images[1:], strict=True):
        at_other = pixels(other, frame)
        for k in (0, 1, 2, 3, 4, 5, 8, 9):
            (u, v), (x, y) = np.rint(at_left[k]).astype(int), np.rint(at_other[k]).astype(int)
            patch = frame.images[0][v - 10 : v + 11, u - 10 : u + 11]
            scores = cv2.matchTemplate(image[y - 25 : y + 26, x - 25 : x + 26], patch, cv2.TM_CCOEFF_NORMED)
            _, best, _, where = cv2.minMaxLoc(scores)
            found = np.array([x, y]) - 15 + where + (at_left[k] - [u, v])
            assert best > 0.7
            np.testing.assert_allclose(found, at_other[k], atol=1.5)


def test_one_camera_sees_what_the_left_of_two_sees(device: RenderingDevice) -> None:
    both = brief(device)
    one = list(synthesise(replace(BRIEF, cameras=1), device=device))
    for two, alone in zip(both, one, strict=True):
        assert np.array_equal(two.images[0], alone.images[0])
        assert not np.array_equal(two.images[0], two.images[1])


def test_other_people_move_alike(device: RenderingDevice) -> None:
    """That the same options give the same images ``test_writing`` shows: they give the same bytes."""
    other = synthesise(replace(BRIEF, identity=2), device=device)
    for one, another in zip(brief(device), other, strict=True):
        np.testing.assert_array_equal(one.pose.position, another.pose.position)
        np.testing.assert_array_equal(one.strengths, another.strengths)
        assert np.abs(one.shape - another.shape).max() > 0.5
        assert not np.array_equal(one.images[0], another.images[0])


def test_an_object_hides_one_half_of_the_face_only(device: RenderingDevice) -> None:
    """Once it has come; the other half is as it would be without."""
    options = replace(BRIEF, frames=13, fps=4.0, motion="still", cameras=1, noise=0.0, light="steady")
    plan = make_plan(replace(options, occlusion=True))
    assert plan.occluder is not None
    index = round((plan.occluder.start_s + 0.5) * options.fps)
    hidden = next(islice(render_plan(plan, device=device), index, None))
    plain = next(islice(synthesise(options, device=device), index, None))
    difference = np.abs(hidden.images[0].astype(float) - plain.images[0])
    changed = cv2.blur(difference, (9, 9)) > 4.0  # the object may be as grey as a single pixel of the face
    ten = np.rint(pixels(plan.cameras[0], plain)).astype(int)
    covered = changed[ten[:, 1], ten[:, 0]]
    expected = ten[:, 0] > ten[:, 0].mean() if plan.occluder.side > 0 else ten[:, 0] < ten[:, 0].mean()
    outer = [0, 3, 4, 5]  # the points far from the middle
    np.testing.assert_array_equal(covered[outer], expected[outer])
    assert plain.images[0].std() > 20.0


def test_a_lamp_that_is_switched_changes_the_picture_at_once(device: RenderingDevice) -> None:
    options = replace(SHORT, frames=5, light="sudden", motion="still", cameras=1, noise=0.0)
    means = [np.mean(frame.images[0][150:350, 220:420]) for frame in synthesise(options, device=device)]
    steps = np.abs(np.diff(means))
    assert np.argmax(steps) == 2 and steps[2] > 5.0 * max(steps[0], steps[1])


def test_a_distorted_image_is_the_straight_one_moved_as_opencv_says() -> None:
    """A bright spot at the straight camera's pixel comes out where OpenCV distorts it, to 0.1 px."""
    camera = make_cameras(HeadSynthOptions(cameras=1, distortion=True))[0]
    sensor = Sensor(camera, 0.0)
    rows, columns = np.indices((sensor.drawn.height, sensor.drawn.width))
    for point in ([-180.0, -120.0, 700.0], [0.0, 0.0, 700.0], [170.0, 60.0, 700.0]):
        (u, v), _ = sensor.drawn.pixels_from_points(np.array(point))
        light = np.exp(-0.5 * ((columns - u) ** 2 + (rows - v) ** 2) / 2.0**2).astype(np.float32)
        image = sensor.image(light, np.random.default_rng(0)).astype(float)
        y, x = np.indices(image.shape)
        found = np.array([(image * x).sum(), (image * y).sum()]) / image.sum()
        expected, _ = cv2.projectPoints(
            np.array([point]), np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
        )
        np.testing.assert_allclose(found, expected[0, 0], atol=0.1)


def test_noise_has_the_variance_that_is_told() -> None:
    """sd of a sample variance at n pixels: variance sqrt(2 / n); rounding adds 1 / 12."""
    camera = make_cameras(HeadSynthOptions(cameras=1))[0]
    light = np.full((camera.height, camera.width), 0.5, dtype=np.float32)
    image = Sensor(camera, 2.0).image(light, np.random.default_rng(1)).astype(float)
    expected = 4.0 * (READ_SD**2 + SHOT * 0.5 * EXPOSURE) + 1.0 / 12.0
    assert image.var() == pytest.approx(expected, rel=6.0 * np.sqrt(2.0 / image.size))
    assert image.mean() == pytest.approx(0.5 * EXPOSURE, abs=6.0 * np.sqrt(expected / image.size))
    assert np.ptp(Sensor(camera, 0.0).image(light, np.random.default_rng(1))) == 0
