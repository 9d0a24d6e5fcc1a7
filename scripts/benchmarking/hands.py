"""Filters in turn, memory of long runs, evaluation of a long result."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarking.processes import POSETRACK, peak_memory, usage_of
from benchmarking.recordings import link_recording, write_hand_recording, write_long_result
from benchmarking.rows import Row, median_of_pairs
from benchmarking.stepping import hand_walker, in_turn
from posetrack_cli.configuration import load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.writing import write_synthetic

WARM_UP = 5
FPS = 30.0


def filters(device: RenderingDevice, frames: int) -> Iterator[Row]:
    """Yield the ratio of the frame times of RBPF and PF on the same frames."""
    depths = [
        frame.depth.astype(np.float32) for frame in synthesise(SynthOptions(frames=frames), device=device)
    ]
    kinds = {kind: load_settings(HandConfig, None, {"filter.kind": kind}) for kind in ("rbpf", "pf")}
    walkers = {kind: hand_walker(device, config, depths[0]) for kind, config in kinds.items()}
    times = in_turn(walkers, [(depth,) for depth in depths], WARM_UP)
    yield Row("RBPF / PF frame time, median of pairs", median_of_pairs(times["rbpf"], times["pf"]), "", 1.03)


def memory(device: RenderingDevice, frames: int, hand_frames: int, head_frames: int) -> Iterator[Row]:
    """Yield peak memory of runs over recordings of made frames, repeated forwards and backwards."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = synthesise(SynthOptions(frames=frames), device=device)
        depths = [frame.depth.astype(np.float32) for frame in made]
        write_hand_recording(folder / "long.mcap", depths, hand_frames)
        yield from peak_memory(
            "hand run", ["hand", "run", str(folder / "long.mcap")], hand_frames, folder, 400.0
        )
        write_synthetic(HeadSynthOptions(frames=frames, fps=FPS), folder / "seen")
        link_recording(folder / "long", folder / "seen", head_frames)
        for kind, more in (("stereo", ()), ("mono", ("--cameras", "left"))):
            (folder / kind).mkdir()
            command = ["head", kind, str(folder / "long"), "--fps", str(FPS), *more]
            yield from peak_memory(f"head {kind}", command, head_frames, folder / kind)


def evaluation(frames: int) -> Iterator[Row]:
    """Yield time and peak memory of eval for a long result, and the size of the HTML page for a tenth."""
    with tempfile.TemporaryDirectory() as folder:
        long, short, page = (Path(folder, name) for name in ("long.mcap", "short.mcap", "page.html"))
        write_long_result(long, frames)
        write_long_result(short, frames // 10)
        began = time.perf_counter()
        seconds, mebibytes = usage_of([*POSETRACK, "eval", str(long)])
        yield Row(f"eval, {frames} frames with truth", time.perf_counter() - began, "s", 5.0)
        yield Row("  of it CPU time", seconds, "s")
        yield Row("  peak memory", mebibytes, "MiB", 250.0)
        usage_of([*POSETRACK, "eval", str(short), "--html", str(page)])
        yield Row(f"HTML page, {frames // 10} frames", page.stat().st_size * 1e-6, "MB", 10.0)
