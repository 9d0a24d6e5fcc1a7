"""Crops of a face: where they lie in an image, what of it they keep, and which are kept of a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from posetrack_cli.geometry.camera import Camera, pixels_from_points
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.adjustment.adjuster import PointView
from posetrack_cli.head.face.points import POINT_COUNT, HeadPose, scaled_pixels
from posetrack_cli.head.skin.matching import (
    CONTRAST,
    FINE_PX,
    GREY,
    HEIGHT,
    MIDDLE,
    PX_PER_MM,
    WIDTH,
    SkinAlbum,
    SkinView,
    cut,
    place_crop,
    to_crop,
    to_image,
)

CAMERA = Camera(640, 480, 1000.0, 1000.0, 320.0, 240.0)
BARREL = 0.25
LENS = replace(CAMERA, distortion=(-BARREL, 0.0, 0.0, 0.0))
ASIDE = 0.15
"""x / z and y / z of a head at most."""
ROUNDING = 1e-8
"""Pixels, of numbers of up to 1e5."""
BLUR_PX = int(4 * FINE_PX)
"""How far OpenCV's blur reaches."""
STILL = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
TURNED_DEG = 10.0
UNCHANGED = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
MOVED = np.array([[0.6, 0.2, 5.3], [-0.2, 0.6, 60.7]])
"""A crop that is turned and enlarged."""
CROP = np.zeros((HEIGHT, WIDTH), np.uint8)

angles = st.floats(-np.pi, np.pi)


@st.composite
def placements(draw: st.DrawFn) -> np.ndarray:
    """Turned, scaled and moved."""
    angle, scale = draw(angles), draw(st.floats(0.1, 10.0))
    cos, sin = scale * np.cos(angle), scale * np.sin(angle)
    aside, down = draw(st.floats(-1e4, 1e4)), draw(st.floats(-1e4, 1e4))
    return np.array([[cos, -sin, aside], [sin, cos, down]])


def view_at(stamp_ns: int, placement: np.ndarray = UNCHANGED) -> SkinView:
    pixels = np.random.default_rng(abs(stamp_ns)).uniform(0.0, 480.0, (POINT_COUNT, 2))
    return SkinView(
        PointView(stamp_ns, pixels, np.ones(POINT_COUNT), STILL, np.zeros(5)), CROP[None], placement[None]
    )


def rolled(angle: float, distance: float, aside: float, down: float) -> HeadPose:
    """A head that looks along the camera's axis, rolled."""
    position = distance * np.array([aside, down, 1.0])
    return HeadPose(position, head_quaternion_from_roll_pitch_yaw(np.array([angle, 0.0, 0.0])))


def pixels_at(camera: Camera, pose: HeadPose, point: np.ndarray) -> np.ndarray:
    pixels, valid = pixels_from_points(camera, pose.points(point))
    assert np.all(valid)
    return pixels


@given(placements(), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_to_crop_undoes_to_image(placement: np.ndarray, column: float, row: float) -> None:
    places = np.array([[column, row], [row, -column]])
    np.testing.assert_allclose(to_crop(placement, to_image(placement, places)), places, atol=ROUNDING)
    np.testing.assert_allclose(to_image(placement, to_crop(placement, places)), places, atol=ROUNDING)


@given(angles, st.floats(200.0, 3000.0), st.floats(-ASIDE, ASIDE), st.floats(-ASIDE, ASIDE))
def test_a_face_that_looks_ahead_is_cut_upright_at_one_size(
    roll: float, distance: float, aside: float, down: float
) -> None:
    """A plane across the axis is seen in proportion: a point is so many mm from the middle."""
    pose = rolled(roll, distance, aside, down)
    placement = place_crop(CAMERA, pose)
    for point in np.array([[0.0, 0.0], [30.0, 0.0], [0.0, 40.0], [-50.0, -60.0]]):
        place = to_crop(placement, pixels_at(CAMERA, pose, MIDDLE + np.append(point, 0.0)))
        wanted = np.array([WIDTH / 2, HEIGHT / 2]) + PX_PER_MM * point * [1.0, -1.0]
        np.testing.assert_allclose(place, wanted, atol=ROUNDING)


@given(angles, st.floats(200.0, 3000.0), st.floats(-ASIDE, ASIDE), st.floats(-ASIDE, ASIDE))
def test_behind_a_lens_it_is_nearly_so(roll: float, distance: float, aside: float, down: float) -> None:
    """Radii are r - k r^3: lengths shrink by k r^2 across and 3 k r^2 along them, so that a direction turns
    by half of what they differ by, k r^2. Together that is 4 k r^2 of a length."""
    pose = rolled(roll, distance, aside, down)
    placement = place_crop(LENS, pose)
    middle = to_crop(placement, pixels_at(LENS, pose, MIDDLE))
    np.testing.assert_allclose(middle, [WIDTH / 2, HEIGHT / 2], atol=ROUNDING)
    for point in np.array([[10.0, 0.0], [0.0, 10.0]]):
        there = MIDDLE + np.append(point, 0.0)
        x, y, z = pose.points(np.stack([MIDDLE, there])).T
        bent = 4 * BARREL * np.max((x**2 + y**2) / z**2)
        place = to_crop(placement, pixels_at(LENS, pose, there)) - middle
        wanted = PX_PER_MM * point * [1.0, -1.0]
        assert np.linalg.norm(place - wanted) <= bent * np.linalg.norm(wanted) + ROUNDING


@given(angles, st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.sampled_from([CAMERA, LENS]))
def test_a_turned_face_is_cut_with_its_eyes_level(
    roll: float, pitch: float, yaw: float, camera: Camera
) -> None:
    """The head's x axis leads to the right, and only there: its first millimetre gives the angle."""
    quaternion = head_quaternion_from_roll_pitch_yaw(np.array([roll, pitch, yaw]))
    pose = HeadPose(np.array([20.0, -30.0, 600.0]), quaternion)
    places = to_crop(
        place_crop(camera, pose), pixels_at(camera, pose, MIDDLE + np.eye(3)[:1] * [[0.0], [1.0]])
    )
    np.testing.assert_allclose(places[0], [WIDTH / 2, HEIGHT / 2], atol=ROUNDING)
    assert places[1, 0] > places[0, 0] and abs(places[1, 1] - places[0, 1]) < ROUNDING


def test_what_is_cut_lies_where_the_placement_says() -> None:
    """A bright spot, smooth enough that the middle of what is brighter than grey is its own."""
    spot = np.array([70.0, 110.0])
    column, row = to_image(MOVED, spot)
    u, v = np.meshgrid(np.arange(200.0), np.arange(240.0))
    image = (50.0 + 150.0 * np.exp(-((u - column) ** 2 + (v - row) ** 2) / (2 * 1.5**2))).astype(np.uint8)
    bright = np.maximum(cut(image, MOVED).astype(float) - GREY, 0.0)
    rows, columns = np.indices(bright.shape)
    middle = [np.average(columns, weights=bright), np.average(rows, weights=bright)]
    np.testing.assert_allclose(middle, spot, atol=0.1)  # grey levels are whole, and so are pixels


def test_a_light_from_aside_changes_no_crop() -> None:
    """A ramp is its own blur. What is left is rounding, to half a grey level each: of the lit image, and of
    either crop before it is blurred; as much of its blur; times the contrast; and once more of the result."""
    rng = np.random.default_rng(2)
    even = rng.integers(70, 110, (240, 200)).astype(np.float64)
    ramp = 0.45 * np.arange(200.0) + 0.2 * np.arange(240.0)[:, None]
    crops = [cut(np.rint(image).astype(np.uint8), MOVED) for image in (even, even + ramp)]
    inside = np.s_[BLUR_PX : HEIGHT - BLUR_PX, BLUR_PX : WIDTH - BLUR_PX]
    apart = np.abs(crops[1][inside].astype(float) - crops[0][inside])
    assert apart.max() <= CONTRAST * 2 * 1.5 + 1.0
    assert np.std(crops[0][inside]) > 3 * np.std(apart), "there is something to be seen"


@pytest.mark.parametrize("length", [8.0, 16.0, 32.0, 64.0])
def test_waves_are_kept_the_more_the_finer_they_are(length: float) -> None:
    """Of a wave a Gaussian blur leaves exp(-2 pi^2 s^2 / l^2)."""
    columns = 2 * np.pi * np.arange(WIDTH) / length
    image = np.rint(100.0 + 40.0 * np.cos(columns)[None] * np.ones((HEIGHT, 1))).astype(np.uint8)
    whole = np.arange(BLUR_PX, BLUR_PX + 2 * 64)  # columns of whole waves that no border reaches
    seen = cut(image, UNCHANGED)[HEIGHT // 2, whole].astype(float) - GREY
    amplitude = 2 * np.mean(seen * np.cos(columns[whole]))
    wanted = CONTRAST * 40.0 * (1.0 - np.exp(-2 * (np.pi * FINE_PX / length) ** 2))
    assert amplitude == pytest.approx(wanted, abs=1.0)  # of whole grey levels, cut off


@given(placements(), st.floats(0.2, 5.0), st.floats(-200.0, 400.0), st.floats(-200.0, 400.0))
def test_a_frame_seen_larger_has_its_crop_where_the_image_is_larger(
    placement: np.ndarray, ratio: float, column: float, row: float
) -> None:
    view, place = view_at(5, placement), np.array([column, row])
    larger = view.rescaled(ratio)
    wanted = scaled_pixels(to_image(placement, place), ratio)
    np.testing.assert_allclose(to_image(larger.placements[0], place), wanted, atol=ROUNDING)
    np.testing.assert_array_equal(larger.view.pixels, scaled_pixels(view.view.pixels, ratio))
    assert larger.crops is view.crops and larger.view.pose is view.view.pose
    back = larger.rescaled(1.0 / ratio)
    np.testing.assert_allclose(back.placements[0], placement, atol=ROUNDING)


def test_an_album_is_seen_larger_frame_by_frame() -> None:
    album = SkinAlbum((view_at(0, MOVED), view_at(9, MOVED)), 7).rescaled(2.0)
    assert album.every_ns == 7 and [one.view.stamp_ns for one in album.views] == [0, 9]
    np.testing.assert_array_equal(album.views[1].placements[0], view_at(9, MOVED).rescaled(2.0).placements[0])


def kept(stamps: list[int], every_ns: int, most: int) -> list[SkinAlbum]:
    """The albums after each of the frames, as a tracker keeps them."""
    albums = [SkinAlbum(every_ns=every_ns)]
    for stamp_ns in stamps:
        album = albums[-1]
        wanted = album.wants(stamp_ns, STILL, TURNED_DEG)
        albums.append(album.with_view(view_at(stamp_ns), most) if wanted else album)
    return albums[1:]


def stamps_of(album: SkinAlbum) -> np.ndarray:
    return np.array([one.view.stamp_ns for one in album.views])


@given(st.lists(st.integers(1, 60), max_size=300), st.integers(1, 40), st.integers(4, 15))
def test_of_a_recording_of_any_length_no_more_frames_are_kept_and_none_nearer(
    gaps: list[int], every_ns: int, most: int
) -> None:
    stamps = (1000 + np.cumsum(gaps)).astype(int).tolist()
    for album in kept(stamps, every_ns, most):
        here = stamps_of(album)
        assert 1 <= len(here) <= most and here[0] == stamps[0]
        assert np.all(np.diff(here) >= album.every_ns)
        doublings = np.log2(album.every_ns / every_ns)
        assert doublings == int(doublings) and (doublings == 0 or len(here) > most // 2)


def test_frames_are_kept_evenly() -> None:
    """30 a second: each comes as soon as it may, and doubling the time doubles by how much that is late."""
    frame_ns, every_ns, most = 33, 250, 10
    for album in kept([frame_ns * index for index in range(600)], every_ns, most)[1:]:
        gaps = np.diff(stamps_of(album))
        assert np.all(gaps < album.every_ns * (1.0 + frame_ns / every_ns))


def test_of_too_many_frames_every_second_goes_and_the_time_doubles() -> None:
    albums = kept([10 * index for index in range(12)], 10, 4)
    assert [stamps_of(album).tolist() for album in albums[:6]] == [
        [0],
        [0, 10],
        [0, 10, 20],
        [0, 10, 20, 30],
        [0, 20, 40],
        [0, 20, 40],
    ]
    assert [album.every_ns for album in albums[3:6]] == [10, 20, 20]
    assert stamps_of(albums[-1]).tolist() == [0, 40, 80] and albums[-1].every_ns == 40


def test_a_first_frame_is_wanted_and_a_clock_that_goes_back_is_waited_for() -> None:
    album = SkinAlbum(every_ns=10)
    assert album.wants(-5, STILL, TURNED_DEG)
    album = album.with_view(view_at(100), 4)
    wanted = [album.wants(stamp_ns, STILL, TURNED_DEG) for stamp_ns in (109, 110, 50)]
    assert wanted == [False, True, False]


@given(st.floats(-40.0, 40.0), st.integers(-10, 50))
def test_while_a_head_turns_frames_are_wanted_four_times_as_often(yaw_deg: float, after_ns: int) -> None:
    assume(abs(abs(yaw_deg) - TURNED_DEG) > 1e-6)  # rounding
    turned = STILL.moved(np.array([0.0, 0.0, 0.0, 0.0, np.radians(yaw_deg), 0.0]))
    album = SkinAlbum((view_at(100),), 40)
    assert album.wants(100 + after_ns, turned, TURNED_DEG) == (
        after_ns >= (10 if abs(yaw_deg) > TURNED_DEG else 40)
    )
