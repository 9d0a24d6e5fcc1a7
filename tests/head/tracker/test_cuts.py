"""Cuts are told by how the whole image changes, not by its brightness."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.tracker.mono_state import is_cut, thumbnail

ROUNDING = 0.02
"""Of a correlation: grey levels in 8 bits, of contrasts down to some 20."""


def scene(seed: int) -> np.ndarray:
    """A picture with something large in it."""
    noise = np.random.default_rng(seed).normal(size=(60, 80))
    smooth = cv2.resize(cv2.GaussianBlur(noise, (0, 0), 7.5), (640, 480), interpolation=cv2.INTER_CUBIC)
    return (128.0 + 40.0 * smooth / smooth.std()).clip(0, 255).astype(np.uint8)


@given(st.integers(0, 1000), st.floats(0.4, 1.0), st.floats(0.0, 60.0))
def test_a_light_that_changes_is_no_cut(seed: int, gain: float, offset: float) -> None:
    image = scene(seed)
    lit = np.clip(gain * image + offset, 0, 255).astype(np.uint8)
    now, then = thumbnail(lit), thumbnail(image)
    clipped = float(np.mean(lit == 255))
    assert now @ then > 1.0 - ROUNDING - 2.0 * clipped
    assert clipped > 0.01 or not is_cut(then, now)


@pytest.mark.parametrize("seed", range(20))
def test_another_scene_is_a_cut(seed: int) -> None:
    assert is_cut(thumbnail(scene(seed)), thumbnail(scene(seed + 1000)))


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_a_small_movement_are_none(seed: int) -> None:
    image, rng = scene(seed), np.random.default_rng(seed)
    moved = np.roll(image, (5, 8), axis=(0, 1)) + rng.normal(0.0, 4.0, image.shape)
    assert not is_cut(thumbnail(image), thumbnail(moved.clip(0, 255).astype(np.uint8)))


def test_an_image_that_becomes_even_is_a_cut() -> None:
    """And nothing is divided by its contrast."""
    even = thumbnail(np.full((480, 640), 90, np.uint8))
    np.testing.assert_array_equal(even, 0.0)
    assert is_cut(thumbnail(scene(0)), even)


def test_a_thumbnail_has_zero_mean_and_unit_norm() -> None:
    small = thumbnail(scene(3))
    assert abs(small.mean()) < 1e-12 and np.linalg.norm(small) == pytest.approx(1.0)
