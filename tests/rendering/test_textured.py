"""Textured surfaces against what a pinhole camera and Lambert's law say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.gl.device import SAMPLES
from posetrack_cli.rendering.port import Lighting, RenderingDevice, Surface

CAMERA = Camera(64, 48, 100.0, 100.0, 31.5, 23.5)
SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [1.0, 1.0, 0.0]])
TOWARDS = np.broadcast_to([0.0, 0.0, -1.0], (4, 3))
CODE = 1.0 / 255.0
"""A texel's step."""
FLOAT = 1e-5
"""Some roundings of float32 at values near 1."""


@pytest.fixture(scope="module")
def device(reference_device: RenderingDevice) -> RenderingDevice:
    """All that follows holds for every implementation."""
    return reference_device


def square_surface(reflectance: float, gloss: float = 0.0) -> Surface:
    """A square of one colour, as seen by a camera before it."""
    texture = np.zeros((8, 8, 2), dtype=np.uint8)
    texture[..., 0], texture[..., 1] = round(255 * reflectance), round(255 * gloss)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    return Surface(np.array([[0, 2, 1], [1, 2, 3]]), corners, texture)


def lamp(strength: float, ambient: float, direction: tuple[float, float, float] = (0, 0, -1)) -> Lighting:
    unit = np.array([direction], dtype=float)
    return Lighting(unit / np.linalg.norm(unit), np.array([strength]), ambient, np.zeros(3))


def drawn(
    device: RenderingDevice,
    surfaces: list[Surface],
    places: list[tuple[FloatArray, FloatArray]],
    lighting: Lighting,
    camera: Camera = CAMERA,
) -> FloatArray:
    renderer = device.surface_renderer((camera.width, camera.height), surfaces, 1)
    for index, (vertices, normals) in enumerate(places):
        renderer.place(index, vertices, normals)
    image = renderer.image(camera, lighting)
    renderer.release()
    return image.astype(np.float64)


def test_a_square_covers_the_pixels_that_a_pinhole_camera_says(device: RenderingDevice) -> None:
    """30 mm wide at 250 mm: 12 px around the principal point. Edges are right to a sample."""
    vertices = 15.0 * SQUARE + [0.0, 0.0, 250.0]
    image = drawn(device, [square_surface(1.0)], [(vertices, TOWARDS)], lamp(0.0, 1.0))
    rows, columns = np.nonzero(image)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (18, 29, 26, 37)


def test_an_edge_within_a_pixel_covers_a_part_of_it(gl_device: RenderingDevice) -> None:
    vertices = 15.0 * SQUARE + [0.0, 0.0, 250.0]
    aside = vertices + np.array([1.0, 0.0, 0.0])
    moved = drawn(gl_device, [square_surface(1.0)], [(aside, TOWARDS)], lamp(0.0, 1.0))
    assert (moved[24] * np.arange(64)).sum() / moved[24].sum() == pytest.approx(31.5 + 0.4, abs=0.5 / SAMPLES)


def test_light_falls_with_the_cosine(device: RenderingDevice) -> None:
    vertices = 60.0 * SQUARE + [0.0, 0.0, 250.0]
    for angle in (0.0, 0.4, 1.0, 1.5):
        normals = np.broadcast_to([np.sin(angle), 0.0, -np.cos(angle)], (4, 3))
        image = drawn(device, [square_surface(0.6)], [(vertices, normals)], lamp(0.5, 0.25))
        assert image[24, 32] == pytest.approx(153 * CODE * (0.25 + 0.5 * np.cos(angle)), abs=10 * FLOAT)


def test_gloss_shines_where_the_light_is_mirrored(device: RenderingDevice) -> None:
    vertices = 60.0 * SQUARE + [0.0, 0.0, 250.0]
    places = [(vertices, TOWARDS)]
    shining = drawn(device, [square_surface(0.4, gloss=0.4)], places, lamp(0.5, 0.2))
    dull = drawn(device, [square_surface(0.4)], places, lamp(0.5, 0.2))
    extra = shining - dull
    assert extra.max() == pytest.approx(102 * CODE * 0.5, rel=1e-3)
    assert extra[24, 32] > extra[24, 52] > 0.0 and extra[24, 32] > extra[4, 32]


def test_another_camera_sees_it_where_its_transform_says(device: RenderingDevice) -> None:
    angle, centre = 0.2, np.array([40.0, 5.0, 0.0])
    rotation = np.array(
        [[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]]
    )
    transform = np.column_stack([rotation, -rotation @ centre])
    camera = replace(CAMERA, camera_T_reference=tuple(tuple(row) for row in transform.tolist()))
    vertices = 8.0 * SQUARE + [0.0, 0.0, 250.0]
    image = drawn(device, [square_surface(1.0)], [(vertices, TOWARDS)], lamp(0.0, 1.0), camera)
    rows, columns = np.indices(image.shape)
    found = np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()
    corners, _ = CAMERA.pixels_from_points(vertices @ rotation.T + transform[:, 3])
    np.testing.assert_allclose(found, corners.mean(axis=0), atol=0.2)  # it is 6 px wide and nearly a square


def test_the_nearer_hides_the_farther_and_the_back_is_not_drawn(device: RenderingDevice) -> None:
    surfaces = [square_surface(0.2), square_surface(0.8)]
    near, far = 20.0 * SQUARE + [0, 0, 200.0], 60.0 * SQUARE + [0, 0, 300.0]
    image = drawn(device, surfaces, [(near, TOWARDS), (far, TOWARDS)], lamp(0.0, 1.0))
    assert image[24, 32] == pytest.approx(51 * CODE, abs=FLOAT)
    assert image[24, 18] == pytest.approx(204 * CODE, abs=FLOAT)
    turned = near * [-1.0, 1.0, 1.0]
    image = drawn(device, surfaces, [(turned, TOWARDS), (far, TOWARDS)], lamp(0.0, 1.0))
    assert image[24, 32] == pytest.approx(204 * CODE, abs=FLOAT)


def test_a_texture_lies_as_its_coordinates_say(device: RenderingDevice) -> None:
    """The left half dark, the right half bright, the upper right corner brightest."""
    texture = np.zeros((8, 8, 2), dtype=np.uint8)
    texture[:, 4:, 0], texture[:2, 6:, 0] = 100, 200
    surface = replace(square_surface(0.0), texture=texture)
    vertices = 40.0 * SQUARE + [0.0, 0.0, 250.0]
    image = drawn(device, [surface], [(vertices, TOWARDS)], lamp(0.0, 1.0))
    assert image[30, 20] == 0.0
    assert image[34, 42] == pytest.approx(100 * CODE, abs=FLOAT)
    assert image[9, 46] == pytest.approx(200 * CODE, abs=FLOAT)


def test_painted_texels_replace_a_part_of_the_texture(device: RenderingDevice) -> None:
    """Also where texels are smaller than pixels, for which a coarser level of the texture is used."""
    for half_mm in (100.0, 5.0):
        vertices = half_mm * SQUARE + [0.0, 0.0, 250.0]
        renderer = device.surface_renderer((CAMERA.width, CAMERA.height), [square_surface(0.2)], 1)
        renderer.place(0, vertices, TOWARDS)
        renderer.paint(0, (0, 4), np.full((8, 4, 2), 153, dtype=np.uint8) * np.array([1, 0], dtype=np.uint8))
        image = renderer.image(CAMERA, lamp(0.0, 1.0))
        renderer.release()
        left, right = image[24, 31 - round(0.2 * half_mm)], image[24, 32 + round(0.2 * half_mm)]
        assert left == pytest.approx(51 * CODE, abs=10 * FLOAT)
        assert right == pytest.approx(153 * CODE, abs=10 * FLOAT)
