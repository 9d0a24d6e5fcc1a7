"""What a frame of a hand costs: with each configuration from file to file and in the tracker alone."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarking.clocks import Clocks, clocked
from benchmarking.commands import peak_memory
from benchmarking.lengths import Lengths
from benchmarking.recordings import write_hand_recording
from benchmarking.rows import Row, median_ms, median_of_pairs
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.likelihood import RenderedCosts
from posetrack_cli.hand.local_fits import LocalFitter
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.hand.swarm import RenderedObjective
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.port import RenderingDevice
from stepping import Walker, in_turn

TARGETS_MS = {"hand": 50.0, "hand-fast": 25.0, "hand-pso": None}
"""20 and 40 frames/s."""
WARM_UP = 5
PARTS = {
    "search": ((Acquisition, ("search", "reconsider")),),
    "local fits": ((LocalFitter, ("fit",)),),
    "GL (kinematics, draw, reduce)": (
        (RenderedCosts, ("costs", "log_likelihood", "scores", "forearm")),
        (RenderedObjective, ("evaluate",)),
    ),
}
"""Of a step: looking for a hand in the whole image, the fits, drawing and reducing poses."""


class WatchedWalker(Walker):
    """A walker that also tells how long the parts of each step took.

    Args:
        device: draws the poses.
        config: of the tracker.
        first: depth image that it starts in the middle of.
        clocks: of the parts.
    """

    def __init__(self, device: RenderingDevice, config: HandConfig, first: Any, clocks: Clocks) -> None:
        super().__init__(device, config, first)
        self._clocks = clocks
        self.parts: list[dict[str, float]] = []

    def step(self, index: int, shown: Any) -> float:
        """Track one frame; return the seconds it took."""
        before = dict(self._clocks.seconds)
        taken = super().step(index, shown)
        self.parts.append({name: now - before[name] for name, now in self._clocks.seconds.items()})
        return taken


def hands(device: RenderingDevice, depths: Sequence[Any], lengths: Lengths) -> Iterator[Row]:
    """Rows of every configuration, of velocity, and of a long run."""
    configs = {name: load_settings(HandConfig, find_configuration(name), {}) for name in TARGETS_MS}
    yield from tracking_alone(device, configs, depths)
    yield from file_to_file(device, configs, depths)
    yield from velocity_ratio(device, depths)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "long.mcap")
        write_hand_recording(path, depths, lengths.hand_memory)
        command = ["hand", "run", str(path)]
        yield from peak_memory("hand run", command, lengths.hand_memory, Path(folder), 400.0)


def tracking_alone(
    device: RenderingDevice, configs: Mapping[str, HandConfig], depths: Sequence[Any]
) -> Iterator[Row]:
    """The same frames through the trackers of all configurations in turn, and where the time goes."""
    with clocked(PARTS) as clocks:
        walkers = {name: WatchedWalker(device, config, depths[0], clocks) for name, config in configs.items()}
        times = in_turn(walkers, depths, WARM_UP)
    for name, walker in walkers.items():
        yield Row(f"{name}, tracking alone", median_ms(times[name]), "ms")
        for part in ("GL (kinematics, draw, reduce)", "local fits"):
            shares = np.divide([parts[part] for parts in walker.parts[WARM_UP:]], times[name])
            yield Row(f"  of it {part}", 100.0 * float(np.median(shares)), "%")
    for name in ("hand-fast", "hand-pso"):
        ratio = median_of_pairs(times[name], times["hand"])
        yield Row(f"{name} / hand frame time, median of pairs", ratio, "")


def file_to_file(
    device: RenderingDevice, configs: Mapping[str, HandConfig], depths: Sequence[Any]
) -> Iterator[Row]:
    """Whole runs from PNGs in an MCAP file to a result, the search for the hand included."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "in.mcap")
        write_hand_recording(path, depths, len(depths))
        for name, config in configs.items():
            with clocked(PARTS) as clocks:
                options = RunOptions(Path(folder, f"{name}.mcap"))
                outcome = HandRun(open_recording(path), config, options, device).track(lambda estimate: None)
            total = 1e3 * outcome.seconds / outcome.tracked
            yield Row(f"{name}, file to file", total, "ms", TARGETS_MS[name])
            parts = {part: 1e3 * seconds / outcome.tracked for part, seconds in clocks.seconds.items()}
            for part, value in parts.items():
                yield Row(f"  of it {part}", value, "ms")
            yield Row("  of it everything else", total - sum(parts.values()), "ms", 8.0)


def velocity_ratio(device: RenderingDevice, depths: Sequence[Any]) -> Iterator[Row]:
    """Frame time of the RBPF over that of the plain filter, which step through the same frames in turn."""
    configs = {kind: load_settings(HandConfig, None, {"filter.kind": kind}) for kind in ("rbpf", "pf")}
    walkers = {kind: Walker(device, config, depths[0]) for kind, config in configs.items()}
    times = in_turn(walkers, depths, WARM_UP)
    yield Row("RBPF / PF frame time, median of pairs", median_of_pairs(times["rbpf"], times["pf"]), "", 1.03)
