"""The software rasteriser against planes and spheres on paper, and against the GL renderer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.skeleton import NO_INNER, PALM, empty_posed, pose_bones, skeleton_of, skin_of
from posetrack_cli.hand.model.anatomy import BONE_COUNT
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.observe.observation import window_around
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.rendering.raster import NEAR_MM, NOTHING, Drawing, View, draw, empty_drawing
from support.fitting import HANDS, TILE_PX
from support.hand import KINECT, random_poses
from support.rendering import moved_a_subpixel

VIEW = View(90.0, 32.0, 95.0, 30.0)
STILL = np.tile(np.eye(3, 4), (BONE_COUNT, 1, 1))
EXACT_MM = 1e-9
"""1 / z is linear in the image, so a plane's depth is right to rounding."""


def solid(vertices: FloatArray, triangles: IntArray) -> SkinnedMesh:
    """A mesh in camera coordinates that the palm's bone alone holds."""
    weights = np.zeros((len(vertices), BONE_COUNT))
    weights[:, 0] = 1.0
    return SkinnedMesh(np.asarray(vertices, dtype=np.float64), weights, triangles)


def drawn(mesh: SkinnedMesh, view: View = VIEW, size: tuple[int, int] = (60, 64)) -> Drawing:
    skin = skin_of(mesh)
    out = empty_drawing(skin.mesh, *size)
    assert draw(skin.mesh, STILL, view, out)
    return out


def depth_of(drawing: Drawing) -> FloatArray:
    return np.divide(1.0, drawing.inverse, out=np.zeros_like(drawing.inverse), where=drawing.inverse > 0)


def rays(view: View = VIEW, size: tuple[int, int] = (60, 64)) -> FloatArray:
    """(h, w, 3) through the pixels' centres, z = 1."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    return np.stack(
        [(columns + 0.5 - view.b) / view.a, (rows + 0.5 - view.d) / view.c, np.ones(size)], axis=2
    )


def quad(normal: FloatArray, through: FloatArray, reach: float) -> SkinnedMesh:
    """A square on a plane, facing the camera at the origin."""
    u = np.cross(normal, [0.3, 1.0, 0.2])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    corners = through + reach * np.array([-u - v, u - v, u + v, -u + v])
    facing = np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ through < 0
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    return solid(corners, triangles if facing else triangles[:, ::-1])


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(300.0, 3000.0))
@settings(max_examples=30)
def test_a_plane_has_its_depth_at_every_pixel(nx: float, ny: float, z: float) -> None:
    normal, through = np.array([nx, ny, -1.0]), np.array([0.0, 0.0, z])
    found = drawn(quad(normal / np.linalg.norm(normal), through, 0.15 * z))
    expected = (normal @ through) / (rays() @ normal)
    shown = found.triangle != NOTHING
    assert shown.sum() > 100
    np.testing.assert_allclose(depth_of(found)[shown], expected[shown], rtol=EXACT_MM / 300.0)
    np.testing.assert_array_equal(found.inverse[~shown], 0.0)
    np.testing.assert_allclose(found.normals[0], normal / np.linalg.norm(normal), atol=1e-12)


def test_a_pixel_is_drawn_if_its_centre_is_inside() -> None:
    """A square of tile pixels 10..20 x 5..12, edges included, drawn by hand."""
    z = 500.0
    edges = [(10.0, 5.0), (10.0, 12.0), (20.0, 12.0), (20.0, 5.0)]
    corners = np.array([[(x - VIEW.b) / VIEW.a * z, (y - VIEW.d) / VIEW.c * z, z] for x, y in edges])
    shown = drawn(solid(corners, np.array([(0, 1, 2), (0, 2, 3)]))).triangle != NOTHING
    expected = np.zeros((60, 64), dtype=bool)
    expected[5:12, 10:20] = True
    np.testing.assert_array_equal(shown, expected)
    assert not (drawn(solid(corners, np.array([(2, 1, 0), (3, 2, 0)]))).triangle != NOTHING).any()  # its back


@pytest.mark.parametrize("shift", [(-300.0, 0.0), (300.0, 0.0), (0.0, -300.0), (0.0, 300.0), (5e4, -5e4)])
def test_what_reaches_over_the_border_is_cut_off(shift: tuple[float, float]) -> None:
    """The middle of a larger image of the same scene is what the smaller one shows."""
    rng = np.random.default_rng(1)
    middles = rng.uniform([-300.0, -300.0, 500.0], [300.0, 300.0, 900.0], (60, 1, 3))
    corners = (middles + rng.uniform(-150.0, 150.0, (60, 3, 3))).reshape(-1, 3)
    corners[:, :2] += shift
    mesh = solid(corners, np.arange(180).reshape(60, 3))
    margin = 200
    wide = View(VIEW.a, VIEW.b + margin, VIEW.c, VIEW.d + margin)
    large = drawn(mesh, wide, (60 + 2 * margin, 64 + 2 * margin))
    inner = np.s_[margin : margin + 60, margin : margin + 64]
    small = drawn(mesh)
    np.testing.assert_array_equal(small.triangle, large.triangle[inner])
    np.testing.assert_allclose(small.inverse, large.inverse[inner], rtol=1e-9)


def test_the_nearest_triangle_wins_in_any_order() -> None:
    rng = np.random.default_rng(2)
    corners = rng.uniform([-200.0, -200.0, 400.0], [200.0, 200.0, 900.0], (40, 3, 3))
    alone = []
    for triangle in corners:
        inverse = drawn(solid(triangle, np.array([(0, 1, 2)]))).inverse
        alone.append(inverse)
    together = drawn(solid(corners.reshape(-1, 3), np.arange(120).reshape(40, 3)))
    np.testing.assert_array_equal(together.inverse, np.max(alone, axis=0))
    shown = together.inverse > 0
    np.testing.assert_array_equal(together.triangle[shown], np.argmax(alone, axis=0)[shown])
    order = rng.permutation(40)
    shuffled = drawn(solid(corners[order].reshape(-1, 3), np.arange(120).reshape(40, 3)))
    np.testing.assert_array_equal(shuffled.inverse, together.inverse)


def test_a_sphere_of_many_triangles() -> None:
    """Chords of an arc of angle a lie r (1 - cos(a / 2)) inside; no pixel is farther off along its ray."""
    r, middle, count = 60.0, np.array([20.0, -15.0, 600.0]), 96
    around, up = np.linspace(0, 2 * np.pi, count + 1)[:-1], np.linspace(0, np.pi, count // 2 + 1)
    grid = np.stack(
        [
            np.outer(np.sin(up), np.cos(around)),
            np.outer(np.sin(up), np.sin(around)),
            np.outer(np.cos(up), around * 0 + 1),
        ],
        axis=2,
    )
    k = np.arange(count // 2 * count).reshape(-1, count)
    a, b, c, d = k, np.roll(k, -1, axis=1), k + count, np.roll(k, -1, axis=1) + count
    triangles = np.concatenate(
        [np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)]
    )
    found = drawn(solid(middle + r * grid.reshape(-1, 3), triangles))
    direction = rays()
    along = direction @ middle / (direction**2).sum(axis=2)
    off = np.linalg.norm(middle - along[..., None] * direction, axis=2)
    well_inside = off < 0.8 * r
    length = np.linalg.norm(direction, axis=2)
    expected = along - np.sqrt(np.maximum(r**2 - off**2, 0.0)) / length
    sagitta = 2.0 * r * (1.0 - np.cos(np.pi / count))  # of both directions of the grid
    error = depth_of(found)[well_inside] - expected[well_inside]
    assert well_inside.sum() > 150
    assert error.min() > -EXACT_MM
    assert error.max() < sagitta / 0.6  # the ray meets the surface at cosines above 0.6
    assert not (found.triangle != NOTHING)[off > r].any()


@pytest.mark.parametrize("name", list(HANDS))
def test_hands_are_drawn_as_by_the_renderer(name: str, device: RenderingDevice) -> None:
    """Pixels whose centres lie on an edge to float32 may differ: less than 1 % of the drawn ones."""
    hand = HANDS[name]
    skin, skeleton, posed = skin_of(hand.smooth), skeleton_of(hand.anatomy), empty_posed()
    renderer = device.depth_renderer(hand.smooth, (TILE_PX, TILE_PX), 1)
    out = empty_drawing(skin.mesh, TILE_PX, TILE_PX)
    for pose in random_poses(12, seed=5):
        window = window_around(joint_positions(hand.anatomy, pose[None])[0], KINECT, ObservationSettings())
        expected = renderer.depth(skinning_transforms(hand.anatomy, pose[None]), KINECT, window)[0]
        pose_bones(skeleton, pose, NO_INNER, posed)
        assert draw(skin.mesh, posed.bones, View(*window.tile_projection(KINECT)), out)
        found = depth_of(out)
        both = (found > 0) & (expected > 0)
        assert np.count_nonzero((found > 0) != (expected > 0)) <= 0.01 * both.sum()
        same = (np.abs(found - expected) < 0.01 + moved_a_subpixel(found))[both]  # mm; float32 at 800 mm
        assert np.count_nonzero(~same) <= 0.02 * both.sum()  # a GPU rounds corners: .01 on an NVIDIA H100
        shown = out.triangle != NOTHING
        corners = out.vertices[skin.mesh.triangles[out.triangle[shown]]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        np.testing.assert_allclose(out.normals[out.triangle[shown]], normals, atol=1e-9)
        assert ((normals * corners[:, 0]).sum(axis=1) < 0).all()  # towards the camera
        assert out.facing[skin.mesh.triangles[out.triangle[shown]]].all()


def test_a_hand_too_near_is_not_drawn_and_leaves_nothing_behind() -> None:
    mesh = quad(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 500.0]), 100.0)
    skin = skin_of(mesh)
    out = empty_drawing(skin.mesh, 60, 64)
    assert draw(skin.mesh, STILL, VIEW, out)
    near = STILL.copy()
    near[0, 2, 3] = NEAR_MM - 500.0 - 1.0
    assert not draw(skin.mesh, near, VIEW, out)
    assert not out.inverse.any()
    assert (out.triangle == NOTHING).all()
    assert not out.facing.any()
    near[0, 2, 3] += 2.0
    assert draw(skin.mesh, near, VIEW, out)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_pose_that_is_no_number_draws_nothing(value: float) -> None:
    mesh = quad(np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 500.0]), 100.0)
    skin = skin_of(mesh)
    out, bones = empty_drawing(skin.mesh, 60, 64), STILL.copy()
    bones[:, :, 3] = value
    draw(skin.mesh, bones, VIEW, out)
    assert not out.inverse.any()


@pytest.mark.parametrize("name", list(HANDS))
def test_the_skin_knows_which_finger_moves_it(name: str) -> None:
    mesh = HANDS[name].smooth
    skin = skin_of(mesh)
    spread = np.zeros_like(mesh.weights)
    np.put_along_axis(spread, skin.mesh.bones, skin.mesh.weights, axis=1)
    np.testing.assert_array_equal(spread, mesh.weights)  # no influence is left out
    assert (np.diff(skin.mesh.weights, axis=1) <= 0).all()
    by_finger = mesh.weights[:, 1:].reshape(-1, 5, 3)
    for v in range(0, len(mesh.vertices), 7):
        whole = by_finger[v].sum(axis=1)
        assert (skin.fingers[v] == PALM) == (whole.max() == 0.0)
        if skin.fingers[v] != PALM:
            assert whole[skin.fingers[v]] == whole.max()
            beyond = by_finger[v, skin.fingers[v]]
            expected = (beyond.sum(), beyond[1:].sum(), beyond[2:].sum())
            np.testing.assert_allclose(skin.reaches[v], expected)
