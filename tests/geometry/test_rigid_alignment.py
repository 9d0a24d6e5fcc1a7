from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.rigid import rigid_alignment

ROUNDING = 1e-9


@given(st.integers(0, 2**32 - 1))
def test_a_rigid_motion_is_found_again(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, weights = rng.normal(scale=50.0, size=(6, 3)), rng.uniform(0.1, 1.0, 6)
    R, t = Rotation.random(rng=rng).as_matrix(), rng.normal(scale=100.0, size=3)
    found_R, found_t = rigid_alignment(points, points @ R.T + t, weights)
    np.testing.assert_allclose(found_R, R, atol=ROUNDING)
    np.testing.assert_allclose(found_t, t, atol=100.0 * ROUNDING)


@pytest.mark.parametrize("seed", range(5))
def test_noisy_points_give_what_scipy_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, weights = rng.normal(size=(10, 3)), rng.uniform(size=10)
    target = source + rng.normal(scale=0.5, size=(10, 3))
    R, t = rigid_alignment(source, target, weights)
    share = weights / weights.sum()
    expected, _ = Rotation.align_vectors(target - share @ target, source - share @ source, weights)
    np.testing.assert_allclose(R, expected.as_matrix(), atol=ROUNDING)
    np.testing.assert_allclose(t, share @ target - R @ (share @ source), atol=ROUNDING)


def test_a_mirror_image_is_not_rigid() -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    R, _ = rigid_alignment(points, points * [-1.0, 1.0, 1.0], np.ones(5))
    assert np.linalg.det(R) == pytest.approx(1.0)
