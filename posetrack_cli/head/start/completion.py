"""Points that were seen in one image only, given the depth that an average face has there."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.projection import in_camera_axes
from posetrack_cli.geometry.rigid_alignment import rigid_alignment
from posetrack_cli.head.detection.features import FEATURE_SD, FEATURES
from posetrack_cli.head.start.matching import View


def completed(points: FloatArray, known: BoolArray, view: View, pixels: FloatArray) -> FloatArray:
    """Return the points (K, 3), mm, with those filled in that are not known.

    Args:
        points: (K, 3) in the reference camera's axes; anything where not known.
        known: (K,) which points are measured, at least three.
        view: the camera that saw all points.
        pixels: (K, 2) where it saw them; an unknown point lies on the ray of its pixel.
    """
    if known.all():
        return points
    weights = np.where(known, FEATURE_SD**-2, 0.0)
    rotation, shift = rigid_alignment(FEATURES, points, weights)
    average = FEATURES @ rotation.T + shift
    depths = in_camera_axes(view.camera, average)[:, 2]
    return np.where(known[:, None], points, view.points_at(pixels, depths))
