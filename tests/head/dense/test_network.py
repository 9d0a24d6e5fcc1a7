"""Compiled networks against a brute-force version."""

from __future__ import annotations

import numpy as np

from posetrack_cli.head.dense.network import (
    EYE_NETWORK,
    GAZE_NETWORK,
    KERNELS,
    LEAST_CONTRAST,
    LEAST_SD,
    POSITION_SCALE,
    shipped_networks,
)
from posetrack_cli.head.dense.regions import RIGHT_EYE, gaze_region


def _outputs(network, crop):
    """Return the outputs, computed with shifted copies of whole images."""
    grey = crop.astype(np.float64)
    layer = ((grey - grey.mean()) / (grey.std() + LEAST_CONTRAST))[..., None]
    for size, (rows, bias) in zip(KERNELS, network.convolutions, strict=True):
        inputs, margin = layer.shape[2], size // 2
        weights = rows[:, : size * size * inputs].T.reshape(size, size, inputs, len(bias))
        padded = np.pad(layer, ((margin, margin), (margin, margin), (0, 0)))
        height, width = layer.shape[:2]
        total = np.zeros(((height + 1) // 2, (width + 1) // 2, len(bias))) + bias
        for i in range(size):
            for j in range(size):
                total += padded[i : i + height : 2, j : j + width : 2] @ weights[i, j].astype(np.float64)
        layer = np.maximum(total, 0.0)
    (first, first_bias), (last, last_bias) = network.full
    return np.maximum(layer.ravel() @ first + first_bias, 0.0) @ last + last_bias


def test_network_equals_brute_force():
    network = shipped_networks()[EYE_NETWORK]
    crop = np.random.default_rng(1).integers(0, 256, (RIGHT_EYE.height, RIGHT_EYE.width)).astype(np.uint8)

    found, expected = network.locate(crop), _outputs(network, crop)

    count = len(network.middle)
    places = expected[: 3 * count].reshape(count, 3) * POSITION_SCALE + network.middle
    # float32 sums of up to 1600 terms against float64
    np.testing.assert_allclose(found.pixels, places[:, :2], atol=2e-3)


def test_gaze_equals_brute_force():
    network, region = shipped_networks()[GAZE_NETWORK], gaze_region(np.zeros(3), mirrored=False)
    crop = np.random.default_rng(1).integers(0, 256, (region.height, region.width)).astype(np.uint8)

    side, up, log_spread = _outputs(network, crop)

    expected = [side, up, (np.exp(log_spread) + LEAST_SD) * network.spread[0]]
    np.testing.assert_allclose(network.gaze(crop), expected, atol=2e-4)


def test_equal_crops_give_equal_bits():
    network = shipped_networks()[EYE_NETWORK]
    crop = np.random.default_rng(2).integers(0, 256, (RIGHT_EYE.height, RIGHT_EYE.width)).astype(np.uint8)

    assert network.locate(crop).pixels.tobytes() == network.locate(crop.copy()).pixels.tobytes()
