"""Templates: what is kept of a frame looks, under the warp, as the face does from elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.head.face.points import POINT_NORMALS
from posetrack_cli.head.face.rig_images import RigImages, project
from posetrack_cli.head.face.templates import (
    PATCH,
    WINDOW,
    TemplateSet,
    angle_deg,
    is_new_direction,
    nearest_templates,
    take_templates,
    tangents,
    template_images,
    unwarped,
    visibility,
    warped,
    warps_between,
)
from support.textured_face import FACING, SHAPE, stereo, textured_face

TURNED = FACING.moved(np.array([15.0, -10.0, -60.0, 0.15, -0.35, 0.2]))
"""Nearer by a tenth, 20 degrees of yaw, 11 of roll."""


@pytest.fixture(scope="module")
def cameras():
    return stereo()


@pytest.fixture(scope="module")
def templates(cameras):
    return take_templates(RigImages(cameras, textured_face().render(cameras, FACING, SHAPE)), FACING, SHAPE)


def patches_in(cameras, pose):
    """The face drawn at a pose, cut out upright where its points are."""
    images = textured_face().render(cameras, pose, SHAPE)
    taken = take_templates(RigImages(cameras, images), pose, SHAPE)
    return warped(taken, taken.tangents)


def now(cameras, pose):
    return tangents(project(cameras, pose.points(SHAPE)), pose)


def test_warped_templates_look_like_the_turned_face(cameras, templates):
    wanted, _ = patches_in(cameras, TURNED)
    found, known = warped(templates, now(cameras, TURNED))
    upright, _ = warped(templates, templates.tangents)
    correlations, without = (np.sum(one * wanted, axis=-1) for one in (found, upright))
    assert known.all()
    assert correlations.min() > 0.98  # what is left: interpolation, perspective across a patch, 8 bits
    assert without.max() < correlations.min()  # so the warp is what does it


def test_warps_do_not_depend_on_the_axes_of_the_plane(cameras, templates):
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    there = now(cameras, TURNED)
    np.testing.assert_allclose(
        warps_between(there @ turn, templates.tangents @ turn), warps_between(there, templates.tangents)
    )


def test_a_plane_seen_edge_on_has_no_warp(cameras, templates):
    flat = now(cameras, FACING)
    flat[0, 3, :, 1] = 2.0 * flat[0, 3, :, 0]
    _, known = warped(templates, flat)
    assert not known[0, 3]
    assert known.sum() == known.size - 1


def test_templates_without_image_or_near_its_edge_are_not_seen(cameras):
    images = textured_face().render(cameras, FACING, SHAPE)
    assert not take_templates(RigImages(cameras, [images[0], None]), FACING, SHAPE).seen[1].any()
    pixels = project(cameras, FACING.points(SHAPE)).pixels
    pixels[0, 2], pixels[0, 5], pixels[1, 1] = [5.0, 100.0], [-500.0, 0.0], np.nan
    templates = take_templates(RigImages(cameras, images), FACING, SHAPE, pixels)
    assert templates.seen[0].tolist() == [True] * 5 + [False] + [True] * 4
    _, known = warped(templates, templates.tangents)
    assert not known[0, 2]  # a patch about it leaves the image
    assert not known[0, 5]
    assert not known[1, 1]
    assert known.sum() == known.size - 3


def test_an_image_smaller_than_a_window_shows_nothing(cameras):
    small = [np.zeros((WINDOW - 1, 640), np.uint8)] * 2
    assert not take_templates(RigImages(cameras, small), FACING, SHAPE).seen.any()


def test_template_images_are_rows_of_the_patch(templates):
    patches, _ = warped(templates, templates.tangents)
    images = template_images(patches)
    assert images.shape == (2, 10, PATCH, PATCH)
    assert images[1, 4, 3, 7] == np.float32(patches[1, 4, 3 * PATCH + 7])


def test_unwarped_intensities_are_those_of_the_image(cameras):
    images = textured_face().render(cameras, FACING, SHAPE)
    pixels = np.full((2, 10, 2), 300.5)
    taken = unwarped(take_templates(RigImages(cameras, images), FACING, SHAPE, pixels))
    np.testing.assert_array_equal(taken[1, 6], images[1][292:310, 292:310])


def test_visibility_is_the_cosine_and_nothing_from_behind(cameras):
    frontal = visibility(project(cameras, FACING.points(SHAPE)), FACING)
    points = FACING.points(SHAPE)
    to_camera = -points[0] / np.linalg.norm(points[0])
    assert frontal[0, 0] == pytest.approx(to_camera @ FACING.rotation @ POINT_NORMALS[0])
    away = FACING.moved(np.array([0.0, 0.0, 0.0, 0.0, np.radians(-80.0), 0.0]))
    seen = visibility(project(cameras, away.points(SHAPE)), away)
    assert (seen[0, 0] == 0.0) != (seen[0, 3] == 0.0)  # one outer corner is hidden by the head, one is not


# Keyframes


ROOM = np.zeros((1, 1, 1, 1))


def facing(yaw_deg: float) -> np.ndarray:
    return np.array([np.sin(np.radians(yaw_deg)), 0.0, -np.cos(np.radians(yaw_deg))])


def kept(*yaws_deg: float) -> tuple[TemplateSet, ...]:
    empty = TemplateSet(ROOM, ROOM, ROOM, np.ones((1, 1), dtype=bool), facing(0.0))
    return tuple(replace(empty, facing=facing(yaw)) for yaw in yaws_deg)


def test_the_reference_is_always_compared_with_and_the_nearest_keyframe_beside_it() -> None:
    sets = kept(0.0, 15.0, 30.0)
    assert nearest_templates(sets, facing(5.0)) == (sets[0],)
    assert nearest_templates(sets, facing(20.0)) == (sets[0], sets[1])
    assert nearest_templates(sets, facing(40.0)) == (sets[0], sets[2])


@pytest.mark.parametrize(("yaw_deg", "new"), [(0.0, False), (9.0, False), (11.0, True), (26.0, False)])
def test_a_direction_is_new_where_none_near_it_is_kept(yaw_deg: float, new: bool) -> None:
    assert is_new_direction(kept(0.0, 25.0), facing(yaw_deg), 10.0) is new


def test_angles_of_rounded_unit_vectors_are_numbers() -> None:
    longer = facing(0.0) * (1.0 + 1e-12)
    assert angle_deg(longer, longer) == 0.0
    assert angle_deg(facing(0.0), facing(30.0)) == pytest.approx(30.0)
