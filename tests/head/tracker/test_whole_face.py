"""Where a whole face went in an image."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import TemplateSet, take_templates
from posetrack_cli.head.tracker.whole_face import REDUCED, shift_of
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
