"""What a frame of a hand costs: with each configuration from file to file and in the tracker alone."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarking.commands import peak_memory
from benchmarking.lengths import Lengths
from benchmarking.recordings import write_hand_recording
from benchmarking.rows import Row, median_ms, median_of_pairs
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.port import RenderingDevice
from stepping import Walker, in_turn

TARGETS_MS = {"hand": 50.0, "hand-fast": 25.0, "hand-pso": None}
"""20 and 40 frames/s."""
WARM_UP = 5


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
    """The same frames through the trackers of all configurations in turn."""
    walkers = {name: Walker(device, config, depths[0]) for name, config in configs.items()}
    times = in_turn(walkers, depths, WARM_UP)
    for name in walkers:
        yield Row(f"{name}, tracking alone", median_ms(times[name]), "ms")
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
            options = RunOptions(Path(folder, f"{name}.mcap"))
            outcome = HandRun(open_recording(path), config, options, device).track(lambda estimate: None)
            total = 1e3 * outcome.seconds / outcome.tracked
            yield Row(f"{name}, file to file", total, "ms", TARGETS_MS[name])


def velocity_ratio(device: RenderingDevice, depths: Sequence[Any]) -> Iterator[Row]:
    """Frame time of the RBPF over that of the plain filter, which step through the same frames in turn."""
    configs = {kind: load_settings(HandConfig, None, {"filter.kind": kind}) for kind in ("rbpf", "pf")}
    walkers = {kind: Walker(device, config, depths[0]) for kind, config in configs.items()}
    times = in_turn(walkers, depths, WARM_UP)
    yield Row("RBPF / PF frame time, median of pairs", median_of_pairs(times["rbpf"], times["pf"]), "", 1.03)
