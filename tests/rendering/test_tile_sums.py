"""The compiled sums over a tile: densities as the model states them, and products that stay in range."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.rendering import cpu
from posetrack_cli.rendering.pixel_model import PixelMixture, misfits_in_numpy, outline_distances
from posetrack_cli.rendering.port import Comparison
from posetrack_cli.rendering.raster import Drawing

EXACT = 1e-9
"""Of a misfit: exp by a polynomial is exact to 2e-11, and sums of some thousand terms to 1e-12."""
OF_REFERENCE = 1e-7
"""The reference multiplies distances from the outline in float32."""
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
    return Drawing(corners, corners, inverse, nothing, corners, np.zeros(2, np.bool_))


def summed(depth: np.ndarray, image: np.ndarray, model: PixelMixture | None) -> np.ndarray:
    comparison = Comparison(image.astype(np.float32), 40.0, model)
    off = outline_distances(comparison.observed).astype(np.float64)
    reading, row = cpu.reading_of(comparison, off, SLOPE), np.zeros(cpu.ROW)
    room = cpu.empty_depths(*depth.shape)
    cpu.add_sums(drawing_of(depth), room, reading, cpu.mixture_of(model), row)
    return row


@each_model
@given(st.floats(200.0, 3000.0), st.floats(-300.0, 300.0), st.floats(0.0, 8.0))
def test_densities_are_the_model_s(model: PixelMixture, depth: float, error: float, off: float) -> None:
    reading, mixture = depth + error, cpu.mixture_of(model)
    before = float(np.exp(-model.uniforms["occluder_rate"] * reading))
    best, found = cpu._densities(depth, reading, before, off, mixture)
    expected = float(model.misfit(np.array(depth), np.array(reading), off))
    assert np.log(best / found) == pytest.approx(expected, rel=EXACT, abs=EXACT)


@each_model
@given(st.floats(200.0, 3000.0), st.floats(-300.0, 300.0), st.floats(0.0, 8.0))
def test_readings_of_other_things_cost_what_the_model_says(
    model: PixelMixture, depth: float, error: float, off: float
) -> None:
    mixture, d, o = cpu.mixture_of(model), np.array(depth), np.array(off)
    expected = float(model.misfit_of_other(d, np.array(depth + error), o))
    assert cpu._misfit_of_other(depth, -depth - error, off, mixture) == pytest.approx(
        expected, rel=EXACT, abs=EXACT
    )
    unread = float(model.misfit_of_unread(d, o))
    assert cpu._misfit_of_other(depth, 0.0, off, mixture) == pytest.approx(unread, rel=EXACT, abs=EXACT)


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
    np.testing.assert_array_equal(without_model[:4], row[:4])
    assert not without_model[[4, 7]].any()


def test_depths_of_the_tile_before_do_not_count() -> None:
    image = np.zeros((12, 12))
    image[6, 6] = 600.0
    comparison = Comparison(image.astype(np.float32), 40.0, MODELS[0])
    reading = cpu.reading_of(comparison, np.zeros(image.shape), SLOPE)
    room, model = cpu.empty_depths(*image.shape), cpu.mixture_of(MODELS[0])
    rows = np.zeros((2, cpu.ROW))
    cpu.add_sums(drawing_of(np.full(image.shape, 600.0)), room, reading, model, rows[0])
    cpu.add_sums(drawing_of(np.zeros(image.shape)), room, reading, model, rows[1])
    assert rows[0, 1] == 1
    assert not rows[1].any()
