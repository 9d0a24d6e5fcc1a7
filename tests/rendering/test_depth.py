"""Drawn depth against scenes whose depth is known: a sphere, a tilted plane, rays cut with triangles."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.rendering.cpu import CpuDevice
from posetrack_cli.rendering.gl.device import NEAR_MM
from posetrack_cli.rendering.mesh import SkinnedMesh, joined
from posetrack_cli.rendering.pixel_model import PixelMixture
from posetrack_cli.rendering.port import Comparison, RenderingDevice, Window
from support.rendering import (
    CAMERA,
    SUBPIXEL_PX,
    cast,
    moved,
    octahedron,
    plane,
    rays,
    rigid,
    sagitta,
    sphere,
)

DEPTH_MM = 0.1
"""The bound asked for. What a 24-bit depth of near / z can do: z^2 / near 2^-24 = 0.001 mm at 1 m."""

WHOLE = Window.whole(CAMERA)
RADIUS, CENTRE = 60.0, np.array([12.0, -7.0, 400.0])


@pytest.fixture(scope="module")
def device(any_device: RenderingDevice) -> RenderingDevice:
    """All that follows holds for every implementation."""
    return any_device


def draw(device: RenderingDevice, mesh: SkinnedMesh, window: Window, camera: Camera = CAMERA) -> np.ndarray:
    renderer = device.depth_renderer(mesh, (window.width, window.height), 1)
    return renderer.depth(moved((0.0, 0.0, 0.0)), camera, window)[0]


def sphere_depth(directions: np.ndarray, radius: float, grow: float = 0.0) -> np.ndarray:
    """Nearest z of a sphere about CENTRE, NaN where a ray misses it."""
    a = (directions**2).sum(axis=-1)
    b = directions @ CENTRE
    square = b**2 - a * (CENTRE @ CENTRE - (radius + grow) ** 2)
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(square)) / a


def test_a_sphere(device: RenderingDevice) -> None:
    ball = sphere(RADIUS, 5)
    inside = sagitta(ball, RADIUS)
    drawn = draw(device, rigid(ball.vertices + CENTRE, ball.triangles), WHOLE)
    directions = rays(CAMERA, WHOLE)
    # the polyhedron lies between two spheres: the true one and one smaller by the sagitta
    outer, inner = sphere_depth(directions, RADIUS), sphere_depth(directions, RADIUS, -inside)
    covered = drawn > 0
    assert (covered[~np.isnan(inner)]).all()
    assert not covered[np.isnan(outer)].any()
    sure = ~np.isnan(inner)
    assert sure.sum() > 300
    assert (drawn[sure] > outer[sure] - DEPTH_MM).all()
    assert (drawn[sure] < inner[sure] + DEPTH_MM).all()
    # front faces: the nearest pixel is the sphere's near pole, not its far one
    assert abs(drawn[covered].min() - sphere_depth(directions, RADIUS)[sure].min()) < inside + DEPTH_MM


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (1.2, 0.0), (-0.4, 0.9)])
def test_a_tilted_plane(reference_device: RenderingDevice, slopes: tuple[float, float]) -> None:
    drawn = draw(reference_device, plane(700.0, *slopes), WHOLE)
    directions = rays(CAMERA, WHOLE)
    depth = 700.0 / (1.0 - directions[..., 0] * slopes[0] - directions[..., 1] * slopes[1])
    np.testing.assert_allclose(drawn, depth, atol=DEPTH_MM)


def test_what_faces_away_is_not_drawn(device: RenderingDevice) -> None:
    facing = plane(700.0, 0.0, 0.0)
    assert not draw(device, rigid(facing.vertices, facing.triangles[:, ::-1]), WHOLE).any()


@pytest.mark.parametrize("first", [0, 1])
def test_the_nearest_surface_wins_in_either_order(device: RenderingDevice, first: int) -> None:
    planes = [plane(500.0, 0.0, 0.0, half=61.0), plane(800.0, 0.0, 0.0)]
    pair = joined([planes[first], planes[1 - first]])
    both = np.tile(np.eye(3, 4, dtype=np.float32), (1, 2, 1, 1))
    drawn = device.depth_renderer(pair, (64, 48), 1).depth(both, CAMERA, WHOLE)[0]
    directions = rays(CAMERA, WHOLE)
    near = (np.abs(500.0 * directions[..., :2]) < 61.0).all(axis=-1)
    assert near.any()
    np.testing.assert_allclose(drawn, np.where(near, 500.0, 800.0), atol=DEPTH_MM)


WINDOWS = [
    Window(0, 0, 1, 64, 48),
    Window(-20, -15, 2, 40, 56),  # coarser, and over the left and upper edge
    Window(28, 22, 3, 24, 17),  # over the right and lower edge
    Window(21, 17, 1, 30, 9),
]


@pytest.mark.parametrize("window", WINDOWS)
def test_windows_and_steps_show_the_rays_through_pixel_centres(
    device: RenderingDevice, window: Window
) -> None:
    # a lopsided octahedron: no two windows, steps or axes can be confused
    mesh = rigid(octahedron().vertices * [150, 90, 60] + [20, 10, 500], octahedron().triangles)
    drawn, expected = draw(device, mesh, window), cast(mesh.vertices, mesh.triangles, rays(CAMERA, window))
    assert (expected > 0).sum() > 20
    np.testing.assert_array_equal(drawn > 0, expected > 0)
    np.testing.assert_allclose(drawn, expected, atol=DEPTH_MM)


def test_nothing_nearer_than_the_near_plane(reference_device: RenderingDevice) -> None:
    # a floor from behind the sensor to far in front: drawn from the near plane on
    floor = rigid(
        [[-900, 20, -1000], [900, 20, -1000], [900, 20, 2000], [-900, 20, 2000]], [(0, 1, 2), (0, 2, 3)]
    )
    turned = rigid(floor.vertices, floor.triangles[:, ::-1])
    directions = rays(CAMERA, WHOLE)
    with np.errstate(divide="ignore"):
        depth = 20.0 / directions[..., 1]
    seen = (depth > NEAR_MM) & (depth < 2000.0)
    assert 0 < seen.sum() < seen.size
    drawn = np.maximum(draw(reference_device, floor, WHOLE), draw(reference_device, turned, WHOLE))
    np.testing.assert_array_equal(drawn > 0, seen)
    # a pixel up or down on the floor is depth^2 / (20 f) nearer or farther
    off_mm = DEPTH_MM + 1e-5 * depth + SUBPIXEL_PX * depth**2 / (20.0 * CAMERA.fy)
    assert (np.abs(drawn - depth) < off_mm)[seen].all()


def test_nothing_behind_the_sensor_or_too_near(device: RenderingDevice) -> None:
    behind = device.depth_renderer(sphere(30.0, 2), (64, 48), 3)
    offsets = moved((0, 0, -400), (0, 0, 0), (0, 0, NEAR_MM - 31))
    assert not behind.depth(offsets, CAMERA, WHOLE).any()


def test_the_processor_draws_nothing_of_a_mesh_that_comes_too_near() -> None:
    """Unlike OpenGL, which draws what lies beyond the near plane: no sensor sees that near."""
    drawing = CpuDevice().depth_renderer(sphere(30.0, 2), (64, 48))
    near, far = drawing.depth(moved((0, 0, NEAR_MM + 29), (0, 0, NEAR_MM + 31)), CAMERA, WHOLE)
    assert not near.any()
    assert far.any()
    sums = drawing.sums(moved((0, 0, NEAR_MM + 29)), CAMERA, WHOLE, Comparison(far, 40.0, PixelMixture()))
    assert sums.both[0] == sums.misfit[0] == sums.relief[0] == 0.0


def test_a_vertex_on_three_bones_is_skinned_as_in_numpy(device: RenderingDevice) -> None:
    rng = np.random.default_rng(4)
    mesh = sphere(80.0, 3)
    weights = np.zeros((len(mesh.vertices), 4))
    for row in weights:
        bones = rng.permutation(4)[: rng.integers(1, 4)]
        row[bones] = rng.uniform(0.2, 1.0, len(bones))
    weights /= weights.sum(axis=1, keepdims=True)
    skinned = SkinnedMesh(mesh.vertices, weights, mesh.triangles)
    transforms = np.tile(np.eye(3, 4), (1, 4, 1, 1)) + 0.1 * rng.standard_normal((1, 4, 3, 4))
    transforms[..., 3] = rng.uniform([-40, -40, 410], [40, 40, 490], (1, 4, 3))
    drawn = device.depth_renderer(skinned, (64, 48), 1).depth(transforms.astype(np.float32), CAMERA, WHOLE)[0]
    vertices = skinned.posed(transforms)[0]
    expected = cast(vertices, front_facing(vertices, mesh.triangles), rays(CAMERA, WHOLE))
    assert (expected > 0).sum() > 200
    different = (drawn > 0) != (expected > 0)
    assert different.sum() <= 2  # a ray along an edge may fall to either side
    both = (drawn > 0) & (expected > 0)
    # steep random faces: float32 vertices (450 mm eps = 3e-5) shift the silhouette of a fold by a hair
    assert (np.abs(drawn - expected)[both] > DEPTH_MM).sum() <= 2


def front_facing(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return triangles[np.einsum("ti,ti->t", normals, corners[:, 0]) < 0]
