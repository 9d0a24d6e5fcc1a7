"""Blocks of lanes against numpy: whichever lanes are chosen, and where the last block is not full."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.compiled import borrowing
from posetrack_cli.lanes import (
    BLOCK,
    above,
    add_block,
    append,
    append_indices,
    below,
    bit_count,
    multiply_block,
    padded,
)


@borrowing
def filtered(values: Float32Array, bound: np.float32, out: Float32Array, places: ImageArray) -> int:
    """Write the values above a bound and their indices; return their number."""
    to = 0
    for n in range(0, len(values), BLOCK):
        chosen = above(values, n, len(values) - n, bound) & ~below(values, n, len(values) - n, bound)
        append(chosen, values, n, out, to)
        append_indices(chosen, n, places, to)
        to += bit_count(chosen)
    return to


@borrowing
def reduced(values: Float32Array, totals: FloatArray, products: FloatArray) -> None:
    """Reduce values to sums and products of lanes."""
    for n in range(0, len(values), BLOCK):
        add_block(values, n, len(values) - n, totals)
        multiply_block(values, n, len(values) - n, products)


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 100])
def test_blocks_list_and_reduce_like_numpy(count: int) -> None:
    values = padded(np.random.default_rng(count).uniform(0.5, 2.0, count).astype(np.float32))
    out, places = np.zeros(count + BLOCK, np.float32), np.zeros(count + BLOCK, np.int32)
    chosen = np.flatnonzero(values > 1.0)
    assert filtered(values, np.float32(1.0), out, places) == len(chosen)
    np.testing.assert_array_equal(places[: len(chosen)], chosen)
    np.testing.assert_array_equal(out[: len(chosen)], values[chosen])
    assert not out[len(chosen) :].any()  # nothing is written behind
    totals, products = np.zeros(BLOCK), np.ones(BLOCK)
    reduced(values, totals, products)
    assert totals.sum() == pytest.approx(values.sum(dtype=np.float64))
    assert products.prod() == pytest.approx(values.prod(dtype=np.float64))
