"""Where a whole face went in an image."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import TemplateSet, take_templates
from posetrack_cli.head.initialisation.single_view import pose_near
from posetrack_cli.head.tracker.whole_face import REDUCED, SLACK, shift_of
from support.mono_scene import CAMERA, FACE
from support.textured_face import SHAPE, pose_at


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return FACE.render((CAMERA,), pose_at(0), SHAPE, noise=2.0)[0]


@pytest.fixture(scope="module")
def seen(image: np.ndarray) -> TemplateSet:
    return take_templates(RigImages((CAMERA,), (image,)), pose_at(0), SHAPE)


PIXELS = project((CAMERA,), pose_at(0).points(SHAPE)).pixels[0]


@pytest.mark.parametrize("moved", [(0, 0), (31, -18), (-60, 52)])
def test_a_shift_is_found_to_the_pixels_that_are_looked_at(image, seen, moved) -> None:
    found = shift_of(np.roll(image, moved, axis=(1, 0)), seen, PIXELS)
    np.testing.assert_allclose(found.pixels, moved, atol=REDUCED)
    assert found.likeness > 0.8


@pytest.mark.parametrize("yaw", [-0.2, 0.25])
def test_of_a_face_that_moved_and_turned_the_points_tell_how(seen, yaw) -> None:
    """Its points go different ways, by 8 px and more; read off to 2 px they tell the turn to some degrees."""
    there = pose_at(0).moved(np.array([50.0, 12.0, 0.0, 0.0, yaw, 0.0]))
    wanted = project((CAMERA,), there.points(SHAPE)).pixels[0]
    ways = wanted - PIXELS
    found = shift_of(FACE.render((CAMERA,), there, SHAPE, noise=2.0)[0], seen, PIXELS)
    assert np.ptp(ways[:, 0]) > 8.0
    assert np.median(np.abs(found.places - wanted)) < 2.0
    moved = pose_near(pose_at(0), found.places, found.likenesses, CAMERA, SHAPE)
    off = np.degrees(np.linalg.norm(there.difference(moved)[3:]))
    assert off < 5.0 < np.degrees(abs(yaw))


def test_a_point_goes_no_farther_from_the_whole_than_its_slack(image, seen) -> None:
    """One whose surroundings are seen farther away is not taken for it."""
    found = shift_of(image, seen, PIXELS + np.array([[40.0, 0.0], *[[0.0, 0.0]] * 9]))
    np.testing.assert_allclose(found.pixels, 0.0, atol=REDUCED)
    assert np.abs(found.places[0] - PIXELS[0] - [40.0, 0.0]).max() <= REDUCED * SLACK
    assert found.likenesses[0] < 0.8 < found.likenesses[1:].min()


def test_a_face_at_the_edge_is_looked_for_beyond_it(image, seen) -> None:
    edge = image[:, 250:]  # half of the face, 30 pixels farther left than before
    found = shift_of(np.roll(edge, -30, axis=1), seen, PIXELS - [250.0, 0.0])
    assert found is not None and np.isfinite(found.likeness)


def test_nothing_like_it_has_no_likeness(seen) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (480, 640)).astype(np.uint8)
    assert shift_of(noise, seen, PIXELS).likeness < 0.4


def test_what_was_not_seen_went_nowhere(image, seen) -> None:
    unseen = TemplateSet(seen.windows, seen.centres, seen.tangents, np.zeros_like(seen.seen), seen.facing)
    assert shift_of(image, unseen, PIXELS) is None
