"""Figure 10: the time of a frame against the number of particles, PF and RBPF."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from unit import ENTRANTS, Unit

from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.hand.synthesis.writing import write_synthetic
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results import load_arrays

PARTICLES = (64, 128, 256, 512, 1024, 2048, 4096)
RECORDING = Unit("B", 1.0, 201, 24)
"""All but the number of particles is as in 7.2.2, so motion B."""
WARM_UP = 4
ROUNDS = 2


def frame_times(context: Any, sweep: Sequence[int] = PARTICLES) -> dict[str, list[float]]:
    """Return the median milliseconds of a frame of ``pf`` and ``rbpf`` at every number of particles.

    Both take turns, in both orders, so that whatever else the machine does touches both alike.
    """
    taken: dict[str, list[float]] = {"pf": [], "rbpf": []}
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "b.mcap"
        write_synthetic(RECORDING.options(), recording)
        for particles in sweep:
            times: dict[str, list[float]] = {"pf": [], "rbpf": []}
            for turn in range(ROUNDS):
                for kind in ("pf", "rbpf") if turn % 2 == 0 else ("rbpf", "pf"):
                    times[kind] += _times(recording, kind, particles, context)
            for kind, values in times.items():
                taken[kind].append(float(np.median(values)))
    return taken


def _times(recording: Path, kind: str, particles: int, context: Any) -> list[float]:
    chosen = ENTRANTS[f"{kind}-printed"]
    changes = chosen.changes | {"filter.particles": particles, "output.mesh": "none"}
    config = load_settings(HandConfig, find_configuration(chosen.configuration), changes)
    result = recording.with_name("result.mcap")
    options = RunOptions(result, init=str(recording), overwrite=True, timings=True)
    HandRun(open_recording(recording), config, options, context).track(lambda estimate: None)
    milliseconds: list[float] = load_arrays(result)["milliseconds"][WARM_UP:].tolist()
    return milliseconds
