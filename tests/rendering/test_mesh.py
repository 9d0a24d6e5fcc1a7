"""Skinned meshes and Loop subdivision, on an octahedron and on spheres made of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.rendering.mesh import (
    SkinnedMesh,
    edges_of,
    is_closed,
    joined,
    loop_limit_matrix,
    loop_subdivided,
    smoothing,
)
from support.rendering import octahedron, rigid, sphere

ROUNDING = 1e-12
"""Unit-sized numbers after a few dozen operations and one well-conditioned solve."""


def volume(mesh: SkinnedMesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)


def two_boned() -> SkinnedMesh:
    mesh = octahedron()
    first = 0.5 * (1.0 + mesh.vertices[:, 0])
    return SkinnedMesh(mesh.vertices, np.stack([first, 1.0 - first], axis=1), mesh.triangles)


def test_posed_blends_the_bones_vertex_by_vertex() -> None:
    rng = np.random.default_rng(0)
    mesh, transforms = two_boned(), rng.standard_normal((3, 2, 3, 4))
    posed = mesh.posed(transforms)
    for n in range(3):
        for v, (rest, weights) in enumerate(zip(mesh.vertices, mesh.weights, strict=True)):
            each = [t[:, :3] @ rest + t[:, 3] for t in transforms[n]]
            np.testing.assert_allclose(posed[n, v], weights @ each, atol=ROUNDING)


def test_flipped_is_the_mirror_image_and_still_faces_outwards() -> None:
    mesh = rigid(octahedron().vertices + np.array([3.0, 0.0, 0.0]), octahedron().triangles)
    flipped = mesh.flipped(np.array([-1.0, 1.0, 1.0]))
    np.testing.assert_array_equal(flipped.vertices, mesh.vertices * [-1, 1, 1])
    assert volume(mesh) > 0
    assert np.isclose(volume(flipped), volume(mesh))


@pytest.mark.parametrize("mm", [0.0, 2.0, 5.0])
def test_a_sphere_that_is_grown_is_a_larger_one(mm: float) -> None:
    ball = sphere(10.0, 3)
    grown = ball.grown(mm)
    lengths = np.linalg.norm(grown.vertices, axis=1)
    # normals of a regular mesh's triangles are the sphere's up to the square of an edge's angle
    np.testing.assert_allclose(lengths, 10.0 + mm, rtol=0.01)
    assert grown.triangles is ball.triangles and grown.weights is ball.weights
    mirrored = ball.flipped(np.array([-1.0, 1.0, 1.0])).grown(mm)
    np.testing.assert_allclose(mirrored.vertices, grown.vertices * [-1.0, 1.0, 1.0], atol=1e-9)


def test_joined_keeps_each_mesh_on_its_own_bones() -> None:
    one, two = rigid(octahedron().vertices, octahedron().triangles), two_boned()
    both = joined([one, two])
    transforms = np.random.default_rng(1).standard_normal((1, 3, 3, 4))
    expected = np.concatenate([one.posed(transforms[:, :1]), two.posed(transforms[:, 1:])], axis=1)
    np.testing.assert_allclose(both.posed(transforms), expected, atol=ROUNDING)
    np.testing.assert_array_equal(both.triangles[8:], two.triangles + 6)
    assert is_closed(both.triangles)


def test_closed_means_every_edge_twice_in_opposite_directions() -> None:
    triangles = octahedron().triangles
    assert is_closed(triangles)
    assert not is_closed(triangles[1:])
    turned = triangles.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(turned)
    assert not is_closed(np.concatenate([triangles, triangles[:1]]))


def test_edges_lie_where_the_triangles_say() -> None:
    triangles = octahedron().triangles
    edges, of_triangle = edges_of(triangles)
    assert len(edges) == 12
    for (a, b, c), sides in zip(triangles.tolist(), of_triangle, strict=True):
        assert [tuple(edges[k]) for k in sides] == [tuple(sorted(p)) for p in ((a, b), (b, c), (c, a))]


def test_subdivision_of_a_regular_mesh_is_loop_s_stencil_by_hand() -> None:
    mesh = two_boned()
    fine = loop_subdivided(mesh)
    assert len(fine.triangles) == 4 * 8
    assert is_closed(fine.triangles)
    # valence 4: beta = (5/8 - (3/8 + cos(90 deg) / 4)^2) / 4 = 31/256; the neighbours of (1,0,0) sum to 0
    np.testing.assert_allclose(fine.vertices[0], [1.0 - 4 * 31 / 256, 0.0, 0.0], atol=ROUNDING)
    edges, _ = edges_of(mesh.triangles)
    at = 6 + int(np.flatnonzero((edges == [0, 1]).all(axis=1))[0])
    # 3/8 of the ends (1,0,0), (0,1,0); 1/8 of the opposite corners (0,0,1), (0,0,-1)
    np.testing.assert_allclose(fine.vertices[at], [0.375, 0.375, 0.0], atol=ROUNDING)
    np.testing.assert_allclose(fine.weights[at], [0.6875, 0.3125], atol=ROUNDING)  # the same stencil
    np.testing.assert_allclose(fine.weights.sum(axis=1), 1.0, atol=ROUNDING)
    assert volume(fine) > 0


def test_the_limit_does_not_depend_on_how_often_one_subdivides_first() -> None:
    mesh = two_boned()
    limit = loop_limit_matrix(mesh.triangles, 6) @ mesh.vertices
    fine = loop_subdivided(loop_subdivided(mesh))
    again = loop_limit_matrix(fine.triangles, len(fine.vertices)) @ fine.vertices
    np.testing.assert_allclose(again[:6], limit, atol=ROUNDING)


def smoothed_through(mesh: SkinnedMesh, steps: int) -> SkinnedMesh:
    smooth = smoothing(mesh.triangles, steps)
    return SkinnedMesh(smooth.through @ mesh.vertices, smooth.blend @ mesh.weights, smooth.triangles)


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_the_smooth_surface_passes_through_the_given_vertices(steps: int) -> None:
    mesh = two_boned()
    smooth = smoothed_through(mesh, steps)
    np.testing.assert_allclose(smooth.vertices[:6], mesh.vertices, atol=ROUNDING)
    assert len(smooth.triangles) == 8 * 4**steps
    assert is_closed(smooth.triangles)


def test_smoothing_commutes_with_rigid_motion_and_keeps_a_sphere_round() -> None:
    ball = sphere(1.0, 2)
    turn = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    moved = rigid(ball.vertices @ turn.T + [5.0, 0.0, 1.0], ball.triangles)
    smooth = smoothed_through(ball, 1)
    np.testing.assert_allclose(
        smoothed_through(moved, 1).vertices, smooth.vertices @ turn.T + [5, 0, 1], atol=1e-11
    )
    radii = np.linalg.norm(smooth.vertices, axis=1)
    middles = ball.vertices[edges_of(ball.triangles)[0]].mean(axis=1)
    flat = 1.0 - np.linalg.norm(middles, axis=1).min()  # how far the longest edge sags: 4 %
    assert np.abs(radii - 1.0).max() < 0.5 * flat
