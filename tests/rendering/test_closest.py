"""Nearest points of triangles, against their definition."""

from __future__ import annotations

import numpy as np

from posetrack_cli.rendering.mesh import closest_points
from support.rendering import sphere

ROUNDING = 1e-9


def test_nearest_points_of_one_triangle() -> None:
    corners = np.array([[(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 4.0, 0.0)]])
    points = np.array(
        [
            (1.0, 1.0, 5.0),  # above the inside
            (-3.0, -2.0, 1.0),  # nearest to a corner
            (1.0, -2.0, 0.0),  # to the edge ab
            (5.0, 5.0, 0.0),  # to the middle of bc
            (-1.0, 3.0, 2.0),  # to ca
        ]
    )
    expected = [(0.5, 0.25, 0.25), (1, 0, 0), (0.75, 0.25, 0), (0, 0.5, 0.5), (0.25, 0, 0.75)]
    triangle, shares = closest_points(points, corners)
    np.testing.assert_array_equal(triangle, 0)
    np.testing.assert_allclose(shares, expected, atol=ROUNDING)


def test_no_point_of_a_surface_is_nearer() -> None:
    rng = np.random.default_rng(4)
    mesh = sphere(50.0, 2)
    corners = mesh.vertices[mesh.triangles]
    directions = rng.standard_normal((40, 3))
    points = directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(40.0, 60.0, (40, 1))
    triangle, shares = closest_points(points, corners)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, atol=ROUNDING)
    assert shares.min() >= -ROUNDING
    found = np.linalg.norm(np.einsum("pc,pcx->px", shares, corners[triangle]) - points, axis=1)
    anywhere = rng.dirichlet(np.ones(3), (len(corners), 200))  # points all over the surface
    samples = np.einsum("tsc,tcx->tsx", anywhere, corners).reshape(-1, 3)
    others = np.linalg.norm(samples[None] - points[:, None], axis=2).min(axis=1)
    assert (found <= others + ROUNDING).all()
    assert (others - found).max() < 3.0  # and the samples are dense enough to tell
