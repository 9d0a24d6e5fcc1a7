"""Figure 10: the time of a frame against the number of particles, PF and RBPF."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import synthesise
from reproduction.unit import ENTRANTS, Unit
from stepping import Walker, in_turn

PARTICLES = (64, 128, 256, 512, 1024, 2048, 4096)
RECORDING = Unit("B", 1.0, 201, 34)
"""All but the number of particles is as in 7.2.2, so motion B."""
WARM_UP = 4


def frame_times(device: RenderingDevice, sweep: Sequence[int] = PARTICLES) -> dict[str, list[float]]:
    """Return the median milliseconds of a frame of ``pf`` and ``rbpf`` at every number of particles."""
    recorded = [frame.depth.astype(np.float32) for frame in synthesise(RECORDING.options(), device=device)]
    taken: dict[str, list[float]] = {"pf": [], "rbpf": []}
    for particles in sweep:
        walkers = {kind: Walker(device, _config(kind, particles), recorded[0]) for kind in taken}
        for kind, seconds in in_turn(walkers, recorded, WARM_UP).items():
            taken[kind].append(1e3 * float(np.median(seconds)))
    return taken


def _config(kind: str, particles: int) -> HandConfig:
    chosen = ENTRANTS[f"{kind}-printed"]
    changes = chosen.changes | {"filter.particles": particles}
    return load_settings(HandConfig, find_configuration(chosen.configuration), changes)
