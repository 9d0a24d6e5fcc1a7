"""What drawing and scoring hands costs against their number."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarking.rows import Row
from posetrack_cli.arrays import FloatArray
from posetrack_cli.configuration import load_settings
from posetrack_cli.hand.anatomy import make_anatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.rendering.devices import scoring_milliseconds
from posetrack_cli.rendering.port import RenderingDevice
from stepping import Walker

PARTICLES = 512
SWEEP = (64, 128, 256, 512, 1024, 2048, 4096, 8192)


def scoring(device: RenderingDevice, repeats: int) -> Iterator[Row]:
    """Draw and reduce N poses: the paper's 128 x 128 window, and the same window sampled at 64 x 64."""
    anatomy = make_anatomy()
    poses = scattered_poses(anatomy, PARTICLES, np.random.default_rng(0))
    transforms, mesh = skinning_transforms(anatomy, poses), hand_mesh(anatomy)
    for tile, target in ((128, 80.0), (64, 33.0)):
        value = scoring_milliseconds(device, mesh, transforms, tile, 128 // tile, repeats)
        yield Row(f"draw and reduce, N = {PARTICLES}, {tile} x {tile} tiles", value, "ms", target)


def against_particles(device: RenderingDevice, depth: Any, repeats: int) -> Iterator[Row]:
    """Time of a step against N, and how far it is from a straight line (the paper's figure 10)."""
    configs = [load_settings(HandConfig, None, {"filter.particles": n}) for n in SWEEP]
    walkers = [Walker(device, config, depth) for config in configs]
    taken: list[list[float]] = [[] for _ in SWEEP]
    for repeat in range(max(3, repeats // 3) + 1):
        for walker, times in zip(walkers, taken, strict=True):
            seconds = walker.step(repeat, depth)
            if repeat:
                times.append(seconds)
    medians = 1e3 * np.array([np.median(times) for times in taken])
    for n, milliseconds in zip(SWEEP, medians, strict=True):
        yield Row(f"hand, step with N = {n}", float(milliseconds), "ms")
    particles = np.array(SWEEP, dtype=float)
    offset, slope = fitted_line(particles, medians)
    worst = np.abs((offset + slope * particles) / medians - 1.0).max()
    yield Row("  line through them: per particle", 1e3 * slope, "us")
    yield Row("  line through them: offset", offset, "ms")
    yield Row("  largest distance from the line", 100.0 * float(worst), "%", 15.0)


def fitted_line(particles: FloatArray, milliseconds: FloatArray) -> tuple[float, float]:
    """Offset and slope with the least squared relative residuals: every N counts alike."""
    design = np.stack([np.ones_like(particles), particles], axis=1) / milliseconds[:, None]
    (offset, slope), *_ = np.linalg.lstsq(design, np.ones_like(particles), rcond=None)
    return float(offset), float(slope)
