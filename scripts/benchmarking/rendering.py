"""What drawing and scoring hands costs against their number."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarking.rows import Row
from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.rendering.devices import scoring_milliseconds
from posetrack_cli.rendering.port import RenderingDevice

PARTICLES = 512


def scoring(device: RenderingDevice, repeats: int) -> Iterator[Row]:
    """Draw and reduce N poses: the paper's 128 x 128 window, and the same window sampled at 64 x 64."""
    anatomy = make_anatomy()
    poses = scattered_poses(anatomy, PARTICLES, np.random.default_rng(0))
    transforms, mesh = skinning_transforms(anatomy, poses), hand_mesh(anatomy)
    for tile, target in ((128, 80.0), (64, 33.0)):
        value = scoring_milliseconds(device, mesh, transforms, tile, 128 // tile, repeats)
        yield Row(f"draw and reduce, N = {PARTICLES}, {tile} x {tile} tiles", value, "ms", target)


def fitted_line(particles: FloatArray, milliseconds: FloatArray) -> tuple[float, float]:
    """Offset and slope with the least squared relative residuals: every N counts alike."""
    design = np.stack([np.ones_like(particles), particles], axis=1) / milliseconds[:, None]
    (offset, slope), *_ = np.linalg.lstsq(design, np.ones_like(particles), rcond=None)
    return float(offset), float(slope)
