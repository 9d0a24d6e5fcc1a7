"""How far a depth image explains a forearm that is drawn behind a hand **[ours]**.

With E the area, mm^2 of a hand of scale 1, of the drawn forearm whose readings lie within ``NEAR_MM`` of it,
W that of all other readings there, in front or behind, and U that without a reading:

    confidence = E / (E + W + w U + E_0)

with the weight w of a missing reading in the likelihood's cost. What lies outside the image or behind the
hand counts as nothing, so a forearm of which little is seen has little to set against ``E_0``.

In 420 frames of seven people (503 to 731 of the synthetic strangers) 388 of the 392 forearms that point to
within 10 degrees of the true direction have 0.5 or more, and none of the 13 that are 15 degrees off or more.
Of four others (800 to 803) it is 164 of 165 and none of 40.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.forearm import LENGTH_MM
from posetrack_cli.rendering.window import Window

LEAST_CONFIDENCE = 0.5
"""A forearm of less is not drawn."""
NEAR_MM = 15.0
"""Distance of a reading that is the forearm's: people's forearms are not tubes."""
_ENOUGH_MM2 = 300.0
"""E_0: a strip of the forearm, 6 mm long, which tells no direction."""
_HALF_WIDTH_MM, _NEAREST_MM = 60.0, 50.0
"""Of the window around the forearm, and the depth up to which it reaches."""


def forearm_window(
    wrist: FloatArray, direction: FloatArray, scale: float, camera: Camera, tile: int
) -> Window:
    """Return the window of (tile, tile) pixels that shows the whole of a drawn forearm.

    Args:
        wrist: (3,) mm, camera axes.
        direction: (3,) unit vector from wrist to elbow.
        scale: of the hand.
        camera: of the depth image.
        tile: width and height, pixels.
    """
    ends = wrist + np.array([[0.0], [LENGTH_MM * scale]]) * direction
    ends[:, 2] = np.maximum(ends[:, 2], _NEAREST_MM)
    half = _HALF_WIDTH_MM * scale * camera.fx / ends[:, 2:]
    pixels, limit = camera.pixels_from_points(ends)[0], 2.0 * np.array([camera.width, camera.height])
    low, high = (np.clip(at, -limit, 2.0 * limit) for at in ((pixels - half).min(0), (pixels + half).max(0)))
    step = max(1, int(np.ceil((high - low).max() / tile)))
    return Window.around(0.5 * (low + high), tile, step)


def forearm_confidence(
    drawn: Float32Array,
    readings: Float32Array,
    inside: BoolArray,
    mm_per_pixel: FloatArray,
    unread_weight: float,
) -> float:
    """Return the confidence of a forearm, 0 to 1.

    Args:
        drawn: (h, w) its depth, mm, 0 where it is not seen.
        readings: (h, w) of the image, mm, 0 for none.
        inside: (h, w) which pixels lie in the image.
        mm_per_pixel: (h, w) what a pixel spans there, mm of a hand of scale 1.
        unread_weight: w.
    """
    arm, read = (drawn > 0) & inside, readings > 0
    near = np.abs(readings - drawn) <= NEAR_MM
    area = np.square(mm_per_pixel)
    explained, other, unread = (float(area[arm & part].sum()) for part in (read & near, read & ~near, ~read))
    return explained / (explained + other + unread_weight * unread + _ENOUGH_MM2)
