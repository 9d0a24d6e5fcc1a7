"""Hands: scoring poses, time per frame by configuration, evaluation of a long result."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarking.processes import POSETRACK, peak_memory, usage_of
from benchmarking.recordings import write_hand_recording, write_long_result
from benchmarking.rows import Row, median_ms, median_of_pairs
from benchmarking.stepping import hand_walker, in_turn
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import hand_mesh
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.devices import scoring_milliseconds
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions

PARTICLES = 512
TARGETS_MS = {"hand": 50.0, "hand-fast": 25.0, "hand-pso": None}  # 20 and 40 frames/s
WARM_UP = 5


def scoring(device: RenderingDevice, repeats: int) -> Iterator[Row]:
    """Yield times to render and score N poses: the paper's 128 x 128 window, and its 64 x 64 sampling."""
    anatomy = make_anatomy()
    poses = scattered_poses(anatomy, PARTICLES, np.random.default_rng(0))
    transforms, mesh = skinning_transforms(anatomy, poses), hand_mesh(anatomy)
    for tile, target in ((128, 80.0), (64, 33.0)):
        value = scoring_milliseconds(device, mesh, transforms, tile, 128 // tile, repeats)
        yield Row(f"draw and reduce, N = {PARTICLES}, {tile} x {tile} tiles", value, "ms", target)


def hands(device: RenderingDevice, frames: int, memory_frames: int) -> Iterator[Row]:
    """Yield times of every configuration (tracker alone, file to file), a filter comparison, peak memory.

    File to file is from PNG images in an MCAP file to a result, including detection.
    """
    synthetic = synthesise(SynthOptions(frames=frames), device=device)
    depths = [frame.depth.astype(np.float32) for frame in synthetic]
    shown = [(depth,) for depth in depths]
    configs = {name: load_settings(HandConfig, find_configuration(name), {}) for name in TARGETS_MS}
    times = in_turn({k: hand_walker(device, one, depths[0]) for k, one in configs.items()}, shown, WARM_UP)
    for name in configs:
        yield Row(f"{name}, tracking alone", median_ms(times[name]), "ms")
    for name in ("hand-fast", "hand-pso"):
        ratio = median_of_pairs(times[name], times["hand"])
        yield Row(f"{name} / hand frame time, median of pairs", ratio, "")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_hand_recording(folder / "in.mcap", depths, len(depths))
        for kind, config in configs.items():
            options = RunOptions(folder / f"{kind}.mcap")
            run = HandRun(open_recording(folder / "in.mcap"), config, options, device)
            outcome = run.track(lambda estimate: None)
            yield Row(
                f"{kind}, file to file", 1e3 * outcome.seconds / outcome.tracked, "ms", TARGETS_MS[kind]
            )
        kinds = {kind: load_settings(HandConfig, None, {"filter.kind": kind}) for kind in ("rbpf", "pf")}
        times = in_turn({k: hand_walker(device, one, depths[0]) for k, one in kinds.items()}, shown, WARM_UP)
        ratio = median_of_pairs(times["rbpf"], times["pf"])
        yield Row("RBPF / PF frame time, median of pairs", ratio, "", 1.03)
        write_hand_recording(folder / "long.mcap", depths, memory_frames)
        command = ["hand", "run", str(folder / "long.mcap")]
        yield from peak_memory("hand run", command, memory_frames, folder, 400.0)


def evaluation(frames: int) -> Iterator[Row]:
    """Yield time and peak memory of eval for a long result, and the size of the HTML page for a tenth."""
    with tempfile.TemporaryDirectory() as folder:
        long, short, page = (Path(folder, name) for name in ("long.mcap", "short.mcap", "page.html"))
        write_long_result(long, frames)
        write_long_result(short, frames // 10)
        began = time.perf_counter()
        seconds, mebibytes = usage_of([*POSETRACK, "eval", str(long)])
        yield Row(f"eval, {frames} frames with truth", time.perf_counter() - began, "s", 20.0)
        yield Row("  of it CPU time", seconds, "s")
        yield Row("  peak memory", mebibytes, "MiB", 476.8)  # 500 MB
        usage_of([*POSETRACK, "eval", str(short), "--html", str(page)])
        yield Row(f"HTML page, {frames // 10} frames", page.stat().st_size * 1e-6, "MB", 10.0)
