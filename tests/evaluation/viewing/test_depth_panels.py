"""Panels of a frame: what is over what, marks of lost frames, lens distortion, captions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.viewing import panels
from posetrack_cli.evaluation.viewing.drawing import LOST, SECOND, SKIN, TRUTH, DepthRange, Shown
from posetrack_cli.evaluation.viewing.hand_drawing import HandDrawer
from posetrack_cli.evaluation.viewing.layers import Drawing, DrawnTrack, point_errors
from posetrack_cli.evaluation.viewing.panels import DEPTH_LAYOUTS, DepthPanels, DepthScene
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from support.tracks import FRAME_NS, hand_track
from support.viewing import KINECT

FRAMES = 4
LENS = replace(KINECT, distortion=(0.25, -0.1, 0.002, -0.003, 0.0))
CAPTION_PX = 18


@pytest.fixture(scope="module")
def drawer(device: RenderingDevice) -> Iterator[HandDrawer]:
    yield HandDrawer(device, average_hand())


@pytest.fixture(scope="module")
def track() -> Track:
    return hand_track("mine", FRAMES, 0.0)


def frame_of(drawer: HandDrawer, track: Track, row: int = 1, camera: Camera = KINECT) -> Frame:
    """What a sensor behind a pinhole sees of the track's own hand, before a wall."""
    depth = drawer.depth(camera, Shown.of_row(track, row))
    assert depth is not None
    return Frame(row, int(track.stamp_ns[row]), (np.where(depth > 0, depth, 2000.0).astype(np.float32),))


def picture_of(frame: Frame, *tracks: DrawnTrack, layout: str) -> np.ndarray:
    drawing = Drawing(tracks, (), scale=1.0)
    panels = DepthPanels(KINECT, drawing, DepthRange(500.0, 1000.0), layout)
    return panels.picture(drawing.at(frame, frame.stamp_ns))


def scene_of(
    frame: Frame, *tracks: DrawnTrack, camera: Camera = KINECT, truth: DrawnTrack | None = None
) -> DepthScene:
    drawing = Drawing(tracks, () if truth is None else (truth,), scale=1.0)
    panels = DepthPanels(camera, drawing, DepthRange(500.0, 1000.0))
    return panels.scene(drawing.at(frame, frame.stamp_ns))


def near_colour(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    return (np.abs(picture.astype(int) - colour) <= 2).all(axis=2)


def test_over_changes_the_hand_s_pixels_and_dims_the_rest(drawer: HandDrawer, track: Track) -> None:
    frame = frame_of(drawer, track)
    hand = frame.depth < 1000.0
    scene = scene_of(frame, DrawnTrack(track, drawer))
    observed, over = scene.observed, scene.over(*scene.instant.estimates)
    np.testing.assert_allclose(over[~hand], 0.6 * observed[~hand], atol=1.0)
    changed = np.abs(over.astype(float) - 0.6 * observed).max(axis=2) > 10
    assert changed[hand].mean() > 0.99


def test_rendered_shows_the_estimate_and_nothing_else(drawer: HandDrawer, track: Track) -> None:
    frame = frame_of(drawer, track)
    scene = scene_of(frame, DrawnTrack(track, drawer))
    rendered = scene.rendered(scene.instant.estimates[0])
    np.testing.assert_array_equal(rendered.any(axis=2), frame.depth < 1000.0)


def test_the_truth_is_a_green_contour_where_the_truth_is(drawer: HandDrawer, track: Track) -> None:
    assert track.position is not None
    wrong = replace(track, position=track.position + np.array([60.0, 0.0, 0.0]))
    frame = frame_of(drawer, track)
    scene = scene_of(frame, DrawnTrack(wrong, drawer), truth=DrawnTrack(track, drawer, TRUTH))
    picture = scene.over(*scene.instant.estimates)
    hand = (frame.depth < 1000.0).astype(np.uint8)
    rim = (hand > 0) & (cv2.erode(hand, np.ones((3, 3), np.uint8)) == 0)
    np.testing.assert_array_equal(near_colour(picture, TRUTH), rim)


@pytest.mark.parametrize("status", ["tracking", "lost", "reinitialised", "no estimate"])
def test_frames_that_are_not_simply_tracked_have_a_border(
    drawer: HandDrawer, track: Track, status: str
) -> None:
    row = 1
    at_row = np.arange(FRAMES) == row
    changed = replace(
        track, lost=at_row & (status == "lost"), reinitialised=at_row & (status == "reinitialised")
    )
    frame = frame_of(drawer, track, row)
    if status == "no estimate":
        frame = replace(frame, stamp_ns=10 * FRAMES * FRAME_NS)
    scene = scene_of(frame, DrawnTrack(changed, drawer))
    (drawn,) = scene.instant.estimates
    assert drawn.status == status
    border = scene.over(drawn)[0]
    red = near_colour(border[None], LOST).all()
    assert red == (status in ("lost", "no estimate"))
    assert bool(drawn.mark) == (status != "tracking")
    words = " ".join(drawn.words)
    assert (status.upper() if red else status) in words


def test_a_distorted_image_is_straightened_to_where_the_hand_is_drawn(
    drawer: HandDrawer, track: Track
) -> None:
    """The sensor's pixels are where OpenCV's lens model puts them; drawn hand and image must still agree."""
    assert track.position is not None
    track = replace(track, position=track.position + np.array([230.0, -130.0, 0.0]))  # a lens bends corners
    straight = frame_of(drawer, track)
    v, u = np.mgrid[0 : LENS.height, 0 : LENS.width].astype(np.float64)
    through_lens = np.stack([u.ravel(), v.ravel()], axis=1)
    ideal = cv2.undistortPoints(
        through_lens[:, None], LENS.matrix, np.array(LENS.distortion), None, None, LENS.matrix
    )[:, 0]
    x, y = (ideal[:, k].reshape(u.shape).astype(np.float32) for k in (0, 1))
    seen = cv2.remap(straight.depth, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    frame = replace(straight, images=(seen,))
    assert ((seen < 1000.0) != (straight.depth < 1000.0)).sum() > 300, "the lens moves the hand"
    scene = scene_of(frame, DrawnTrack(track, drawer), camera=LENS)
    shown = scene.observed
    drawn = scene.rendered(scene.instant.estimates[0]).any(axis=2)
    wall = tuple(shown[350, 100].tolist())
    in_image = ~near_colour(shown, wall) & shown.any(axis=2)
    assert (in_image != drawn).sum() < 0.05 * drawn.sum()  # nearest pixels twice: an edge moves by one


@pytest.mark.parametrize(
    ("layout", "results", "across", "down"),
    [
        ("over", 1, 1, 1),
        ("over", 2, 1, 1),
        ("beside", 1, 3, 1),
        ("beside", 2, 5, 1),
        ("paper", 1, 1, 2),
        ("paper", 2, 1, 3),
        ("side-by-side", 2, 2, 1),
    ],
)
def test_sizes_of_layouts(
    drawer: HandDrawer, track: Track, layout: str, results: int, across: int, down: int
) -> None:
    layers = [DrawnTrack(track, drawer, tone, name) for tone, name in ((SKIN, "a"), (SECOND, "b"))]
    tracks = layers if results == 2 else [DrawnTrack(track, drawer)]
    pictures = [picture_of(frame_of(drawer, track, row), *tracks, layout=layout) for row in range(FRAMES)]
    height, width = pictures[0].shape[:2]
    assert width == KINECT.width * across
    assert (height - KINECT.height * down) in (CAPTION_PX, 2 * CAPTION_PX, 3 * CAPTION_PX)
    assert {picture.shape for picture in pictures} == {pictures[0].shape}, "a video needs one size"
    assert layout in DEPTH_LAYOUTS


def test_two_results_differ_in_colour(drawer: HandDrawer, track: Track) -> None:
    both = DrawnTrack(track, drawer, SKIN, "a"), DrawnTrack(track, drawer, SECOND, "b")
    picture = picture_of(frame_of(drawer, track), *both, layout="side-by-side")[:-CAPTION_PX]
    left, right = np.hsplit(picture.astype(int), 2)
    hand = np.abs(left - right).max(axis=2) > 10
    assert (left[hand][:, 2] > left[hand][:, 0]).mean() > 0.9, "skin is red rather than blue"
    assert (right[hand][:, 2] < right[hand][:, 0]).mean() > 0.9


def test_estimates_within_the_tolerance_of_a_stamp_are_its_own(drawer: HandDrawer, track: Track) -> None:
    layer = DrawnTrack(track, drawer)
    assert [layer.row(FRAME_NS + late) for late in (0, 4_999_999, -5_000_000)] == [1, 1, 1]
    assert layer.row(FRAME_NS + 5_000_001) is None
    assert layer.row(-FRAME_NS) is None and layer.row(FRAMES * FRAME_NS) is None
    empty = Track("t", "hand", (), (), (), stamp_ns=np.empty(0, np.int64))
    assert DrawnTrack(empty, drawer).row(0) is None


def test_words_tell_what_is_known(drawer: HandDrawer, track: Track) -> None:
    assert DrawnTrack(track, drawer).at(0).words == ["tracking", "confidence 0.80"]
    errors = np.array([np.nan, 12.345, 0.0, 0.0])
    named = DrawnTrack(replace(track, confidence=None), drawer, name="mine", error_mm=errors)
    assert named.at(FRAME_NS).words == ["mine", "tracking", "error 12.3 mm"]
    assert named.at(0).words == ["mine", "tracking"]


def test_point_errors_are_mean_distances_at_equal_stamps(track: Track) -> None:
    assert track.points is not None
    offset = np.zeros((21, 3))
    offset[0] = [3.0, 4.0, 0.0]
    late = np.array([0, 1, 0, FRAME_NS // 2])
    truth = replace(track, points=track.points + offset, stamp_ns=track.stamp_ns + late)
    errors = point_errors(track, truth)
    assert errors is not None
    np.testing.assert_allclose(errors[:3], 5.0 / 21)
    assert np.isnan(errors[3])
    assert point_errors(track, None) is None
    assert track.position is not None
    pose_alone = replace(track, points=None, position=track.position + np.array([0.0, 6.0, 8.0]))
    for other in (pose_alone, replace(pose_alone, points=track.points[:, :5])):
        found = point_errors(track, other)
        assert found is not None
        np.testing.assert_allclose(found, 10.0)
    assert point_errors(replace(track, points=None, position=None), track) is None


def test_of_several_subjects_the_nearest_is_drawn_last() -> None:
    """And so hides the others; one without points comes first."""
    far, near = (np.full((3, 3), z) for z in (900.0, 600.0))
    shown = [SimpleNamespace(shown=SimpleNamespace(points=points)) for points in (near, None, far)]
    ordered = sorted(shown, key=cast(Any, panels._nearness))
    assert [one.shown.points is near for one in ordered] == [False, False, True]
    assert ordered[0].shown.points is None
