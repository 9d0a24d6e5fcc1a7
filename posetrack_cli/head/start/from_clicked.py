"""A start from points that a person clicked in one image or more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.features import FEATURE_SD, FEATURES
from posetrack_cli.head.start.clicked import clicked_camera
from posetrack_cli.head.start.settings import StartSettings
from posetrack_cli.head.start.start import NoStart, Start, match_everywhere, start_from_pixels
from posetrack_cli.head.start.views import views_of


def start_from_clicked(
    images: Sequence[ImageArray | None],
    cameras: Sequence[Camera],
    clicked: FloatArray,
    settings: StartSettings = StartSettings(),  # noqa: B008
) -> Start | NoStart:
    """Return the head whose points were clicked.

    Where a point was clicked in several images they are believed; else it is matched as a found one would be.

    Args:
        images: (height, width) uint8, one per camera, None where a camera has none.
        cameras: C >= 2, calibrated.
        clicked: (C, K, 2) pixels as ``read_clicked`` returns them.
        settings: what is good enough.
    """
    views = views_of(images, cameras)
    camera = clicked_camera(clicked)
    if camera is None or views[camera] is None:
        return NoStart("no image of the camera whose points were clicked")
    pixels_per_mm, rotation = weak_perspective(clicked[camera])
    relief = FEATURES @ rotation[2]
    pixels, correlations = match_everywhere(views, camera, clicked[camera], pixels_per_mm, relief, settings)
    given = ~np.isnan(clicked[..., 0])
    pixels[given] = clicked[given]
    correlations[given.sum(axis=0) > 1] = 1.0
    return start_from_pixels(views, camera, pixels, correlations, settings)


def weak_perspective(pixels: FloatArray) -> tuple[float, FloatArray]:
    """Return the scale, pixels per mm, and the rotation (3, 3) that lay an average face on pixels (K, 2).

    Weighted least squares for a 2 x 3 matrix (POS, DeMenthon and Davis 1995), its rows made orthonormal.
    """
    weights = 1.0 / FEATURE_SD[:, None]
    shape = np.column_stack([FEATURES, np.ones(len(FEATURES))])
    solution, *_ = np.linalg.lstsq(weights * shape, weights * pixels, rcond=None)
    u, values, vt = np.linalg.svd(solution[:3].T, full_matrices=False)
    rows = u @ vt
    return float(values.mean()), np.vstack([rows, np.cross(rows[0], rows[1])])
