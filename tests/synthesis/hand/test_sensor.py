from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.synthesis.hand.frames import (
    CAMERA,
    MISSING_FRACTIONS,
    missing_beside_edges,
    missing_fraction,
    noise_sd,
    noisy,
    quantised,
)

SHAPE = (CAMERA.height, CAMERA.width)


def wall(z: float) -> np.ndarray:
    return np.full(SHAPE, z, dtype=np.float32)


def disc_before_wall(radius: float = 60.0, near: float = 650.0) -> tuple[np.ndarray, np.ndarray]:
    """A disc before a wall, and every pixel's distance from the disc's last pixels."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    r = np.hypot(u - CAMERA.cx, v - CAMERA.cy)
    return np.where(r <= radius, np.float32(near), np.float32(2500.0)), r - radius


def test_noise_is_as_measured() -> None:
    """hand.md: 1.5 mm at the centre and 3 to 4.5 mm in the corners, at 2.2 to 3 m."""
    for z in (2200.0, 2500.0, 3000.0):
        sd = noise_sd(wall(z), CAMERA)
        assert sd[212, 256] == pytest.approx(1.5, abs=0.3)
        assert 3.0 <= sd[0, 0] <= 4.5
    assert noise_sd(wall(650.0), CAMERA)[212, 256] == pytest.approx(1.0, abs=0.01)


def test_readings_of_a_flat_wall_have_that_deviation() -> None:
    rng = np.random.default_rng(0)
    stack = np.stack([noisy(wall(2500.0), CAMERA, rng) for _ in range(40)])
    unit = (stack - 2500.0) / noise_sd(wall(2500.0), CAMERA)
    tolerance = 5.0 / np.sqrt(2.0 * unit.size)
    assert abs(unit.std() - 1.0) < tolerance
    assert abs(unit.mean()) < 5.0 / np.sqrt(unit.size)


@pytest.mark.parametrize(("z", "there"), [(0.0, False), (490.0, False), (700.0, True), (4600.0, False)])
def test_readings_out_of_range_are_missing(z: float, there: bool) -> None:
    readings = noisy(wall(z), CAMERA, np.random.default_rng(0))
    assert bool((readings > 0.0).all()) is there and bool((readings > 0.0).any()) is there


def test_readings_are_whole_millimetres() -> None:
    assert quantised(np.array([[0.0, 650.4, 650.6]], dtype=np.float32)).tolist() == [[0, 650, 651]]
    assert quantised(wall(650.0)).dtype == np.uint16


def test_missing_fractions_beside_an_edge_are_as_measured() -> None:
    depth, outside = disc_before_wall()
    rng = np.random.default_rng(0)
    counts = np.mean([missing_beside_edges(depth, rng) for _ in range(120)], axis=0)
    for k, fraction in enumerate(MISSING_FRACTIONS, start=1):
        ring = (outside > k - 0.6) & (outside <= k + 0.4)
        # pixels of a ring lie up to half a pixel off its distance, where the fraction is another
        slope = abs(missing_fraction(np.array([k - 0.5]))[0] - missing_fraction(np.array([k + 0.5]))[0])
        assert abs(counts[ring].mean() - fraction) < 0.03 + 0.25 * slope


def test_nothing_is_missing_on_the_nearer_side_or_far_away() -> None:
    depth, outside = disc_before_wall()
    missing = missing_beside_edges(depth, np.random.default_rng(1))
    assert not missing[outside <= 0.0].any()
    assert not missing[outside > 14.0].any()


def test_holes_come_in_patches_and_more_in_the_shadow() -> None:
    depth, outside = disc_before_wall()
    missing = missing_beside_edges(depth, np.random.default_rng(2))
    ring = (outside > 1.5) & (outside < 8.0)
    left = np.arange(SHAPE[1]) < CAMERA.cx
    assert missing[:, left][ring[:, left]].mean() > 1.5 * missing[:, ~left][ring[:, ~left]].mean()
    pairs = ring[1:] & ring[:-1]
    share = missing[ring].mean()
    assert (missing[1:] & missing[:-1])[pairs].mean() > 1.5 * share**2


def test_the_mirrored_sensor_has_its_shadow_on_the_other_side() -> None:
    depth, outside = disc_before_wall()
    missing = missing_beside_edges(depth, np.random.default_rng(2), mirrored=True)
    ring = (outside > 1.5) & (outside < 8.0)
    left = np.arange(SHAPE[1]) < CAMERA.cx
    assert missing[:, ~left][ring[:, ~left]].mean() > 1.5 * missing[:, left][ring[:, left]].mean()


def test_a_small_step_loses_less_and_a_smooth_surface_nothing() -> None:
    rng = np.random.default_rng(3)
    small, _ = disc_before_wall(near=2440.0)
    large, _ = disc_before_wall(near=650.0)
    assert 0 < missing_beside_edges(small, rng).sum() < 0.5 * missing_beside_edges(large, rng).sum()
    slope = wall(700.0) + np.arange(SHAPE[1], dtype=np.float32)
    assert not missing_beside_edges(slope, rng).any()
    assert not missing_beside_edges(wall(0.0), rng).any()
