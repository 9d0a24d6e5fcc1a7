"""The strongest place of a map near where it is expected."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, IntArray

# Beyond so many standard deviations nothing is looked for.
REACH = 2.5
# A prior draws a peak by a pixel or two; more uphill is another peak's slope.
STEPS_UPHILL = 2


def find_peak(
    response: Float32Array, expected: FloatArray, sd: tuple[float, float]
) -> tuple[FloatArray, float]:
    """Return the peak of a response that a Gaussian prior chooses, and the response there.

    The prior chooses a pixel; from there the response itself is climbed, so that the prior shifts nothing.

    Args:
        response: (height, width), not negative.
        expected: (2,) pixels, the prior's mean.
        sd: its standard deviations in x and y, pixels.

    Returns:
        (2,) pixels, refined to a fraction by a parabola through the neighbours, and the response at the
        nearest pixel; the expected place and 0 where it lies outside the map.
    """
    columns = _near(expected[0], sd[0], response.shape[1])
    rows = _near(expected[1], sd[1], response.shape[0])
    if not len(columns) or not len(rows):
        return expected.astype(float), 0.0
    prior_x = np.exp(-0.5 * ((columns - expected[0]) / sd[0]) ** 2)
    prior_y = np.exp(-0.5 * ((rows - expected[1]) / sd[1]) ** 2)
    values = response[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] * prior_x * prior_y[:, None]
    row, column = np.unravel_index(int(np.argmax(values)), values.shape)
    x, y = _climbed(response, int(columns[column]), int(rows[row]))
    shift_x = _vertex(response[y, x - 1 : x + 2])
    shift_y = _vertex(response[y - 1 : y + 2, x])
    return np.array([x + shift_x, y + shift_y]), float(response[y, x])


def _climbed(response: Float32Array, x: int, y: int) -> tuple[int, int]:
    """Return the pixel of the greatest response that a few steps uphill lead to."""
    height, width = response.shape
    for _ in range(STEPS_UPHILL):
        row, column = divmod(int(np.argmax(response[y - 1 : y + 2, x - 1 : x + 2])), 3)
        x, y = int(np.clip(x + column - 1, 1, width - 2)), int(np.clip(y + row - 1, 1, height - 2))
    return x, y


def _near(expected: float, sd: float, size: int) -> IntArray:
    first = max(int(np.ceil(expected - REACH * sd)), 1)
    last = min(int(np.floor(expected + REACH * sd)), size - 2)
    near: IntArray = np.arange(first, last + 1)
    return near


def _vertex(three: Float32Array) -> float:
    """Return where, in -0.5..0.5, the parabola through three neighbouring values is greatest."""
    before, at, after = (float(value) for value in three)
    curvature = before - 2.0 * at + after
    if curvature >= 0.0:
        return 0.0
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))
