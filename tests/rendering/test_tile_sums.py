"""The compiled sums over a tile: densities as the model states them, and products that stay in range."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.lanes import padded
from posetrack_cli.rendering import cpu
from posetrack_cli.rendering.pixel_model import PixelMixture, misfits_in_numpy, outline_distances
from posetrack_cli.rendering.port import Comparison
from posetrack_cli.rendering.raster import Drawing

OF_MISFIT = 1e-5
"""Of one misfit, nats: terms in float32 are exact to 1e-7 of at most 25 nats, exponentials to 2e-7."""
OF_REFERENCE = 1e-5
"""Of sums over a thousand pixels, whose errors are independent."""
SLOPE = 0.005
MODELS = [
    PixelMixture(),
    PixelMixture(near_sd_mm=3.0, sd_mm_per_m2=1.42, outlier=0.01),
    PixelMixture(outlier=1e-7, occluded=1e-7),  # densities down to 1e-10: products leave the range of floats
    PixelMixture(half_life_mm=5.0),  # what hides is near: exp(-l d) leaves where a polynomial holds
]
each_model = pytest.mark.parametrize("model", MODELS)


def drawing_of(depth: np.ndarray) -> Drawing:
    """What a rasteriser leaves of a depth image (h, w), 0 where nothing is."""
    height, width = depth.shape
    corners = np.array([[0.0, 0.0, 1.0], [width, height, 1.0]])
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    nothing = np.zeros(depth.shape, np.int64)
    return Drawing(
        corners, corners, padded(inverse), nothing, corners, np.zeros(2, np.bool_), np.zeros((1, 4, 4))
    )


def summed(depth: np.ndarray, image: np.ndarray, model: PixelMixture | None) -> np.ndarray:
    comparison = Comparison(image.astype(np.float32), 40.0, model)
    off = outline_distances(comparison.observed)
    reading, row = cpu.reading_of(comparison, off, SLOPE), np.zeros(cpu.ROW)
    pixels = cpu.empty_pixels(*depth.shape)
    cpu.add_sums(drawing_of(depth), reading, cpu.mixture_of(model), pixels, row)
    return row


@each_model
@given(st.floats(400.0, 3000.0), st.floats(-300.0, 300.0), st.integers(0, 2))
def test_misfits_are_the_model_s(model: PixelMixture, depth: float, error: float, aside: int) -> None:
    depth, reading = float(np.float32(depth)), float(np.float32(depth + error))
    image = np.full((5, 7), -1.0)  # in front of everything: costs nothing
    image[2, 2] = reading
    drawn = np.zeros(image.shape)
    drawn[2, 2 + aside] = depth
    row = summed(drawn, image, model)
    off = aside * SLOPE * reading
    beside = float(model.misfit(np.array(depth), np.array(reading), off))
    if aside == 0:
        assert row[4] == pytest.approx(beside, abs=OF_MISFIT)
    else:
        expected = max(0.0, float(model.unexplained(np.array(reading))) - beside)
        assert row[7] == pytest.approx(expected, abs=OF_MISFIT)


@each_model
@given(st.floats(400.0, 3000.0), st.floats(-300.0, 300.0), st.integers(1, 3))
def test_readings_of_other_things_cost_what_the_model_says(
    model: PixelMixture, depth: float, error: float, aside: int
) -> None:
    depth, reading = float(np.float32(depth)), float(np.float32(depth + error))
    image, drawn = np.zeros((5, 9)), np.zeros((5, 9))
    image[2, 2], drawn[2, 2 + aside] = reading, depth
    off = np.float64(outline_distances(image.astype(np.float32))[2, 2 + aside]) * SLOPE * depth
    unread = float(model.misfit_of_unread(np.array(depth), np.array(off)))
    assert summed(drawn, image, model)[4] == pytest.approx(unread, abs=OF_MISFIT)
    image[2, 2 + aside] = -reading
    other = float(model.misfit_of_other(np.array(depth), np.array(reading), np.array(off)))
    assert summed(drawn, image, model)[4] == pytest.approx(other, abs=OF_MISFIT)


@each_model
@pytest.mark.parametrize("seed", range(4))
def test_sums_are_those_of_a_reference(model: PixelMixture, seed: int) -> None:
    rng = np.random.default_rng(seed)
    depth = 600.0 + np.cumsum(rng.normal(0.0, 1.0, (60, 48)), axis=1)
    image = depth + rng.normal(0.0, [1.0, 4.0, 30.0, 300.0][seed], depth.shape)
    image = np.where(rng.random(depth.shape) < 0.1, -image, image)
    image[rng.random(depth.shape) < 0.1] = 0.0
    image = image.astype(np.float32).astype(np.float64)  # as a comparison holds it
    depth[rng.random(depth.shape) < 0.3] = 0.0
    misfit, relief = misfits_in_numpy(depth[None], image, model, SLOPE)
    row = summed(depth, image, model)
    assert row[4] == pytest.approx(misfit[0], rel=OF_REFERENCE)
    assert row[7] == pytest.approx(relief[0], rel=OF_REFERENCE)
    drawn = depth > 0
    counts = [drawn & (image > 0), drawn & (image < 0), drawn & (image == 0)]
    np.testing.assert_array_equal(row[1:4], [count.sum() for count in counts])
    without_model = summed(depth, image, None)
    np.testing.assert_array_equal(without_model[1:4], row[1:4])
    assert row[0] == pytest.approx(without_model[0], rel=OF_REFERENCE)
    assert not without_model[[4, 7]].any()


def test_depths_of_the_tile_before_do_not_count() -> None:
    image = np.zeros((12, 12))
    image[6, 6] = 600.0
    comparison = Comparison(image.astype(np.float32), 40.0, MODELS[0])
    reading = cpu.reading_of(comparison, np.zeros(image.shape, np.float32), SLOPE)
    pixels, model = cpu.empty_pixels(*image.shape), cpu.mixture_of(MODELS[0])
    rows = np.zeros((2, cpu.ROW))
    cpu.add_sums(drawing_of(np.full(image.shape, 600.0)), reading, model, pixels, rows[0])
    cpu.add_sums(drawing_of(np.zeros(image.shape)), reading, model, pixels, rows[1])
    assert rows[0, 1] == 1
    assert not rows[1].any()
