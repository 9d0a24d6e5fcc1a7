"""Meshes with fewer triangles: still closed, near to the whole surface, bending where it bends."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.rendering.decimation import decimated, decimation
from posetrack_cli.rendering.mesh import SkinnedMesh, closest_points, is_closed
from support.rendering import plane, rigid, sphere

EXACT = 1e-6


def volume(mesh: SkinnedMesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)


def grid(columns: int, rows: int) -> SkinnedMesh:
    """A flat rectangle of unit squares with a rim, seen from -z."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    at = np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = at[:-1, :-1].ravel(), at[:-1, 1:].ravel(), at[1:, 1:].ravel(), at[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])
    return rigid(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), triangles)


def tube(rings: int, sides: int = 8) -> SkinnedMesh:
    """A closed tube of radius 1 and length 10 along y, on two bones that meet at y = 5."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    y = np.linspace(0.0, 10.0, rings)
    vertices = [[np.cos(t), h, np.sin(t)] for h in y for t in angle]
    vertices += [[0.0, 0.0, 0.0], [0.0, 10.0, 0.0]]
    triangles = []
    for r in range(rings - 1):
        for k in range(sides):
            a, b = r * sides + k, r * sides + (k + 1) % sides
            triangles += [(a, a + sides, b), (b, a + sides, b + sides)]
    for k in range(sides):
        m, top = (k + 1) % sides, (rings - 1) * sides
        triangles += [(k, m, rings * sides), (top + m, top + k, rings * sides + 1)]
    upper = np.clip((np.array(vertices)[:, 1] - 4.0) / 2.0, 0.0, 1.0)
    return SkinnedMesh(np.array(vertices), np.stack([1.0 - upper, upper], axis=1), np.array(triangles))


def bent(angle: float) -> FloatArray:
    """Transforms (1, 2, 3, 4): the second bone turned about the x axis through (0, 5, 0)."""
    transforms = np.tile(np.eye(3, 4), (1, 2, 1, 1))
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    transforms[0, 1, :, :3], transforms[0, 1, :, 3] = turn, [0.0, 5.0, 0.0] - turn @ [0.0, 5.0, 0.0]
    return transforms


def distances(mesh: SkinnedMesh, coarse: SkinnedMesh, transforms: FloatArray) -> FloatArray:
    """Of the posed vertices of a mesh from the posed surface of another."""
    corners = coarse.posed(transforms)[0][coarse.triangles]
    points = mesh.posed(transforms)[0]
    triangle, shares = closest_points(points, corners)
    return np.linalg.norm(np.einsum("pc,pcx->px", shares, corners[triangle]) - points, axis=1)


@pytest.mark.parametrize("wanted", [300, 100, 40])
def test_a_sphere_keeps_its_volume_and_stays_closed(wanted: int) -> None:
    ball = sphere(50.0, 3)
    few = decimated(ball, wanted)
    assert wanted - 2 < len(few.triangles) <= wanted
    assert is_closed(few.triangles)
    # chords of N triangles cut off some 2 pi / (sqrt(3) N) of the radius; the volume thrice that
    assert volume(few) == pytest.approx(volume(ball), rel=2.0 / wanted)
    radii = np.linalg.norm(few.vertices, axis=1)
    assert abs(radii - 50.0).max() < 50.0 * 8.0 / wanted


def test_a_plane_keeps_its_rim_exactly() -> None:
    sheet = grid(8, 5)
    few = decimated(sheet, 2)
    assert len(few.triangles) <= 8
    np.testing.assert_allclose(few.vertices[:, 2], 0.0, atol=EXACT)
    corners = np.array([(0, 0, 0), (8, 0, 0), (8, 5, 0), (0, 5, 0)], dtype=float)
    gaps = np.linalg.norm(few.vertices[None] - corners[:, None], axis=2).min(axis=1)
    assert gaps.max() < 0.35  # of a square; the fit is to the area, not to corners


def test_a_mesh_that_has_few_enough_triangles_keeps_them() -> None:
    square = plane(500.0, 0.0, 0.0, 10.0)
    same = decimated(square, 10)
    np.testing.assert_array_equal(same.triangles, square.triangles)
    np.testing.assert_allclose(same.vertices, square.vertices, atol=1e-9)


def test_rings_stay_where_the_tube_bends() -> None:
    whole, pose = tube(21), bent(1.4)
    aware, unaware = decimated(whole, 96, pose), decimated(whole, 96)
    assert len(aware.triangles) == len(unaware.triangles) == 96
    np.testing.assert_allclose(aware.weights.sum(axis=1), 1.0)
    assert aware.weights.min() >= 0.0
    straight = np.tile(np.eye(3, 4), (1, 2, 1, 1))
    assert distances(whole, unaware, straight).mean() < 0.05  # both are good at rest
    assert distances(whole, aware, pose).mean() < 0.5 * distances(whole, unaware, pose).mean()


def test_another_shape_of_the_same_mesh_follows_linearly() -> None:
    ball = sphere(50.0, 2)
    few = decimation(ball, 60)
    wide = ball.vertices * [1.2, 0.9, 1.0] + [3.0, 0.0, -2.0]
    expected = few.of(ball.vertices).vertices * [1.2, 0.9, 1.0] + [3.0, 0.0, -2.0]
    np.testing.assert_allclose(few.of(wide).vertices, expected, atol=EXACT)


def test_the_same_mesh_gives_the_same_bytes() -> None:
    first, second = (decimated(tube(9), 60, bent(1.0)) for _ in range(2))
    np.testing.assert_array_equal(first.triangles, second.triangles)
    np.testing.assert_array_equal(first.vertices, second.vertices)
