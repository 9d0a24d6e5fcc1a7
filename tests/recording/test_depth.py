"""What of stored pixel values is depth."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.recording.depth import depth_from_codes, depth_from_floats, depth_from_inverse


def test_metres_that_no_camera_reads_are_no_reading() -> None:
    metres = np.array([[1e30, 3.4e38, np.inf, 10_001.0, 1e-30, 1e-6, 0.0, -1.0, np.nan]], dtype=np.float32)
    np.testing.assert_array_equal(depth_from_floats(metres), 0.0)
    np.testing.assert_allclose(depth_from_floats(np.array([[9_999.0, 0.001]])), [[9.999e6, 1.0]], rtol=1e-6)


@pytest.mark.parametrize(("unit_mm", "expected"), [(1e6, [0.0, 1e6, 0.0]), (1e-6, [0.0, 0.0, 0.065535])])
def test_a_unit_that_makes_everything_far_or_near_leaves_no_reading(
    unit_mm: float, expected: list[float]
) -> None:
    codes = np.array([[0, 1, 65535]], dtype=np.uint16)
    np.testing.assert_allclose(depth_from_codes(codes, unit_mm), [expected], rtol=1e-6)


@pytest.mark.parametrize("a", [0.0, -5.0, 1e-38, 3e38, np.inf, np.nan])
@pytest.mark.parametrize("b", [0.0, 7.0, -3e38, np.inf, np.nan])
def test_no_parameters_of_inverse_depth_give_anything_but_depth(a: float, b: float) -> None:
    depth = depth_from_floats(depth_from_inverse(np.array([[0, 1, 7, 65535]], dtype=np.uint16), a, b))
    assert np.isfinite(depth).all()
    assert ((depth == 0.0) | ((depth >= 0.01) & (depth <= 1e7))).all()
