"""Prior of the focal length, from the field of view and the size of the face **[ours]**.

With u = log (f / L), L the longer image side, and e the eye distance in pixels of a face that looks at the
camera, the face is at z = f 63 mm / e. The log-density of u is

    log p(u) = log [w N(u; u_1, s_1) + (1 - w) N(u; u_2, s_2)] + log N(log z; log z_0, s_z)

The first component describes webcams and phones, the second crops and longer lenses. Images whose size no
camera records are probably crops. A focal length in the metadata of image or video is right to ``STATED_SD``,
unless the image was cropped afterwards, with the probability ``STATED_WRONG``.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.initialisation.mono import EYE_DISTANCE_MM
from posetrack_cli.recording.camera_of import USUAL_WIDTHS

WIDEST_DEG, NARROWEST_DEG = 80.0, 8.0
"""Range of the field of view along the longer image side."""
STEP = 0.02
"""Resolution of u: two per cent."""
WHOLE, WHOLE_SD = math.log(0.92), 0.15
"""u_1 and s_1: 57 degrees, from 45 to 72 degrees within two standard deviations."""
PART, PART_SD = math.log(2.2), 0.6
"""u_2 and s_2: 26 degrees, from 8 to 75 degrees."""
WHOLE_SHARE, WHOLE_SHARE_OF_CROPS = 0.5, 0.1
"""w, for image sizes that cameras record and for others."""
DISTANCE_MM, DISTANCE_SD = 650.0, 0.5
"""z_0 and s_z: from 0.24 to 1.8 m within two standard deviations."""
ASPECTS = (4 / 3, 16 / 9, 3 / 2, 16 / 10, 5 / 4)
"""Aspect ratios of cameras."""
STATED_SD, STATED_WRONG, STATED_WRONG_OF_CROPS = 0.06, 0.02, 0.5
"""Standard deviation of the logarithm of a stated focal length, and probabilities that it is wrong."""
LENS_CENTRE_SD = 0.02
"""Standard deviation of a lens's principal point from the image's middle, over the longer side."""
CROP_CENTRE_SCALE, CROP_FREEDOM = 0.08, 2.0
"""Scale of Student's t for a crop, over the part of the original side that was cut off, and its degrees of
freedom: most faces are filmed near the middle, but not all."""
FARTHEST, PLACES = 8.0, 81
"""Range of the principal point, in scales, and number of values along each axis."""


def log_focal_lengths() -> FloatArray:
    """Return the values of u."""
    widest, narrowest = (
        -math.log(2.0 * math.tan(math.radians(degrees) / 2.0)) for degrees in (WIDEST_DEG, NARROWEST_DEG)
    )
    return np.arange(widest, narrowest, STEP)


def log_prior(
    u: FloatArray, eye_distance: float, *, is_crop: bool, stated: float | None = None
) -> FloatArray:
    """Return log p(u) up to a constant.

    Args:
        u: values.
        eye_distance: e / L; NaN if no face was found.
        is_crop: whether the image has a size that no camera records.
        stated: f / L in the metadata.
    """
    share = WHOLE_SHARE_OF_CROPS if is_crop else WHOLE_SHARE
    density = share * _normal(u, WHOLE, WHOLE_SD) + (1.0 - share) * _normal(u, PART, PART_SD)
    if stated is not None:
        believed = _normal(u, math.log(stated), STATED_SD)
        wrong = STATED_WRONG_OF_CROPS if is_crop else STATED_WRONG
        density = (1.0 - wrong) * believed + wrong * density
    total = np.log(density)
    if np.isfinite(eye_distance):
        distance = u + math.log(EYE_DISTANCE_MM / eye_distance)
        total -= 0.5 * np.square((distance - math.log(DISTANCE_MM)) / DISTANCE_SD)
    return total


def _normal(u: FloatArray, mean: float, sd: float) -> FloatArray:
    return np.exp(-0.5 * np.square((u - mean) / sd)) / sd


def is_crop(camera: Camera) -> bool:
    """Return whether no camera records images of this size."""
    longer, shorter = max(camera.width, camera.height), min(camera.width, camera.height)
    usual = any(abs(longer / shorter - aspect) < 1.0 / shorter for aspect in ASPECTS)
    return not (usual and longer in (*USUAL_WIDTHS, 3840, 4096))


def centre_prior(camera: Camera, u: float) -> tuple[FloatArray, FloatArray]:
    """Return coordinates of the principal point along x or y from the middle, pixels, and log-densities."""
    longer = max(camera.width, camera.height)
    scale = LENS_CENTRE_SD * longer
    if is_crop(camera):
        original = longer * math.exp(u - WHOLE)
        scale = math.hypot(scale, CROP_CENTRE_SCALE * max(original - longer, 0.0))
    places = np.linspace(-FARTHEST, FARTHEST, PLACES)
    if is_crop(camera):
        log_density = -0.5 * (CROP_FREEDOM + 1.0) * np.log1p(np.square(places) / CROP_FREEDOM)
    else:
        log_density = -0.5 * np.square(places)
    return scale * places, log_density
