"""Points between camera and object coordinates, against scipy and as each other's inverse."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.rigid import in_camera, in_object

MM = 1e-9
"""Far above a few roundings of 1000 mm (1e-12), far below what matters."""


def test_points_go_where_scipy_takes_them_and_come_back() -> None:
    rng = np.random.default_rng(3)
    rotations = Rotation.random(5, random_state=4)
    position, points = rng.normal(0.0, 500.0, (5, 3)), rng.normal(0.0, 100.0, (5, 7, 3))
    q, t = rotations.as_quat()[:, None], position[:, None]
    expected = np.stack([r.apply(m) + p for r, m, p in zip(rotations, points, position, strict=True)])
    np.testing.assert_allclose(in_camera(points, t, q), expected, rtol=0.0, atol=MM)
    np.testing.assert_allclose(in_object(expected, t, q), points, rtol=0.0, atol=MM)


def test_object_a_metre_ahead_and_facing_back() -> None:
    """Half a turn about x: what is 10 mm up and 20 mm before a face is 10 mm up (-y) and 20 mm nearer."""
    position, half_a_turn = np.array([0.0, 0.0, 1000.0]), np.array([1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(
        in_camera(np.array([5.0, 10.0, 20.0]), position, half_a_turn), [5, -10, 980]
    )
    np.testing.assert_array_equal(
        in_object(np.array([5.0, -10.0, 980.0]), position, half_a_turn), [5, 10, 20]
    )
