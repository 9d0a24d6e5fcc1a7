"""Whether detected points lie as symmetrically as a face's (thesis, 4.4.1)."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import undistorted_pixels
from posetrack_cli.head.face import MIRRORED

RIGHT = tuple(k for k, other in enumerate(MIRRORED) if k < other)
LEFT = tuple(MIRRORED[k] for k in RIGHT)


def slope_deviation(pixels: FloatArray, camera: Camera) -> float:
    """Return the standard deviation, rad, of the slopes of the K/2 segments from right to left points.

    The segments of a symmetric face are parallel in space, and so, but for perspective, in the image: a turn
    of the head does not matter. Slopes are angles to their mean direction **[ours]**, so that roll does not
    either, and are weighted by the squares of the segments' lengths **[ours]**: an error of a pixel turns
    the nostrils' segment five times as far as that of the eyes' outer corners.

    Args:
        pixels: (K, 2) as recorded.
        camera: that saw them; its lens bends the segments.
    """
    flat = undistorted_pixels(camera, pixels)
    segments = flat[list(LEFT)] - flat[list(RIGHT)]
    lengths = np.linalg.norm(segments, axis=1)
    along = segments.sum(axis=0) / max(float(np.linalg.norm(segments.sum(axis=0))), 1e-12)
    across = segments @ along
    angles = np.arctan2(segments[:, 1] * along[0] - segments[:, 0] * along[1], across)
    weights = lengths**2 / np.sum(lengths**2)
    return float(np.sqrt(weights @ (angles - weights @ angles) ** 2))
