"""The cameras of a synthetic recording: one, or two that are toed in."""

from __future__ import annotations

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.synthesis.head.options import HeadSynthOptions

FOCAL_WIDTHS = 1000.0 / 640.0
"""Focal length in image widths: a field of view of 35.5 degrees."""
DISTORTION = (-0.14, 0.06, 0.0006, -0.0004, 0.0)
"""Of the left or only lens; the right one's first two are a tenth smaller."""
NAMES = ("left", "right")


def make_cameras(options: HeadSynthOptions) -> tuple[Camera, ...]:
    """Return the cameras, the reference camera first.

    The second one stands ``baseline_mm`` to the right and looks at the place ``distance_mm`` straight ahead
    of the first.
    """
    reference = _camera(options, NAMES[0] if options.cameras == 2 else "camera", DISTORTION)
    if options.cameras == 1:
        return (reference,)
    toe_in = float(np.arctan2(options.baseline_mm, options.distance_mm))
    c, s = np.cos(toe_in), np.sin(toe_in)
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    translation = -rotation @ [options.baseline_mm, 0.0, 0.0]
    rows = np.column_stack([rotation, translation]).tolist()
    other = tuple(0.9 * value for value in DISTORTION[:2]) + DISTORTION[2:]
    return reference, _camera(options, NAMES[1], other, tuple(tuple(row) for row in rows))


def _camera(
    options: HeadSynthOptions,
    name: str,
    distortion: tuple[float, ...],
    transform: tuple[tuple[float, ...], ...] | None = None,
) -> Camera:
    focal = FOCAL_WIDTHS * options.width
    camera = Camera(
        width=options.width,
        height=options.height,
        fx=focal,
        fy=focal,
        cx=(options.width - 1) / 2.0,
        cy=(options.height - 1) / 2.0,
        distortion=distortion if options.distortion else (),
        name=name,
    )
    if transform is None:
        return camera
    from dataclasses import replace

    return replace(camera, camera_T_reference=transform)
