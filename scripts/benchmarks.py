"""Speed and memory of posetrack on this machine: a table on standard output, and JSON.

Times are medians over repeats in this one run. Ratios are of pairs measured in turn, so that a drifting
clock rate touches both sides alike. Quote ratios rather than milliseconds from a shared machine.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

from long_result import write_long_result
from posetrack_cli import __version__
from posetrack_cli.configuration import load_settings
from posetrack_cli.hand.anatomy import make_anatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.hand.start import scattered_poses
from posetrack_cli.hand.synthesis.frames import synthesise
from posetrack_cli.hand.synthesis.options import SynthOptions
from posetrack_cli.hand.synthesis.sensor import CAMERA
from posetrack_cli.recording.mcap_calibration import calibration_message
from posetrack_cli.recording.mcap_sink import McapSink
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.benchmark import scoring_milliseconds
from posetrack_cli.rendering.context import describe, open_context
from stepping import FRAME_NS, Walker, in_turn

PARTICLES = 512
SWEEP = (64, 128, 256, 512, 1024, 2048, 4096, 8192)


@dataclass(frozen=True)
class Row:
    """One measured figure, its unit, and what it should be at most (None: no target)."""

    name: str
    value: float
    unit: str
    target: float | None = None

    @property
    def verdict(self) -> str:
        """Whether the target is met."""
        return "" if self.target is None else ("ok" if self.value <= self.target else "MISSED")


@click.command()
@click.option("--json", "json_path", type=click.Path(path_type=Path), default=Path("out/bench.json"))
@click.option("--device", type=int, help="EGL device index.")
@click.option("--frames", default=150, show_default=True, help="Frames for the times per frame.")
@click.option(
    "--memory-frames", default=5000, show_default=True, help="Frames of the long run; 0 leaves it out."
)
@click.option(
    "--eval-frames", default=100_000, show_default=True, help="Frames of the long result; 0 leaves it out."
)
@click.option("--repeats", default=31, show_default=True, help="Repeats of each timing of the renderer.")
def main(
    json_path: Path, device: int | None, frames: int, memory_frames: int, eval_frames: int, repeats: int
) -> None:
    """Measure posetrack on this machine."""
    context = open_context(device)
    machine = describe_machine(context)
    for key, value in machine.items():
        print(f"{key}: {value}")
    rows: list[Row] = []
    recorded = [
        frame.depth.astype(np.float32) for frame in synthesise(SynthOptions(frames=frames), context=context)
    ]
    parts: tuple[Callable[[], Iterator[Row]], ...] = (
        lambda: scoring(context, repeats),
        lambda: rest_of_a_frame(context, recorded),
        lambda: velocity_ratio(context, recorded),
        lambda: against_particles(context, recorded[:1], repeats),
        start_up,
        lambda: memory(recorded[:50], memory_frames) if memory_frames else iter(()),
        lambda: evaluation(eval_frames) if eval_frames else iter(()),
    )
    for part in parts:
        for row in part():
            print(f"{row.name:58} {row.value:10.3f} {row.unit:6} {_target(row)}", flush=True)
            rows.append(row)
    json_path.parent.mkdir(parents=True, exist_ok=True)
    table = [asdict(row) | {"verdict": row.verdict} for row in rows]
    json_path.write_text(json.dumps({"machine": machine, "rows": table}, indent=1) + "\n")
    print(f"written: {json_path}")


def _target(row: Row) -> str:
    return "" if row.target is None else f"target {row.target:g}  {row.verdict}"


def describe_machine(context: Any) -> dict[str, str]:
    """Processor, cores, load, Python, renderer."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "posetrack": __version__,
        "processor": models[0] if models else platform.processor(),
        "cores": str(os.cpu_count()),
        "load": f"{os.getloadavg()[0]:.2f}",
        "system": platform.platform(),
        "python": platform.python_version(),
        "renderer": str(describe(context)),
    }


def scoring(context: Any, repeats: int) -> Iterator[Row]:
    """Draw and reduce N poses: the paper's 128 x 128 window, and the same window sampled at 64 x 64."""
    anatomy = make_anatomy()
    poses = scattered_poses(anatomy, PARTICLES, np.random.default_rng(0))
    transforms, mesh = skinning_transforms(anatomy, poses), hand_mesh(anatomy)
    for tile, target in ((128, 80.0), (64, 33.0)):
        value = scoring_milliseconds(context, mesh, transforms, tile, 128 // tile, repeats)
        yield Row(f"draw and reduce, N = {PARTICLES}, {tile} x {tile} tiles", value, "ms", target)


def rest_of_a_frame(context: Any, recorded: list[Any]) -> Iterator[Row]:
    """A whole run from file to file, less the time the likelihood takes."""
    config = HandConfig()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "in.mcap")
        write_recording(path, recorded, len(recorded))
        run = HandRun(open_recording(path), config, RunOptions(Path(folder, "out.mcap")), context)
        watches = watched(run.tracker, "costs", "log_likelihood")
        outcome = run.track(lambda estimate: None)
    per_frame = 1e3 * outcome.seconds / outcome.tracked
    scored = 1e3 * sum(watch.seconds for watch in watches) / outcome.tracked
    yield Row("frame in all, file to file, hand.toml", per_frame, "ms")
    yield Row("  of it the likelihood (kinematics, draw, reduce)", scored, "ms")
    yield Row("  of it everything else", per_frame - scored, "ms", 8.0)


def watched(tracker: Any, *names: str) -> list[Stopwatch]:
    """Put a stopwatch on methods of a filter's scorer that do not call each other."""
    watches = [Stopwatch(getattr(tracker.scorer, name)) for name in names]
    for name, watch in zip(names, watches, strict=True):
        setattr(tracker.scorer, name, watch)
    return watches


class Stopwatch:
    """Adds up the time that calls of a function take."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.seconds = function, 0.0

    def __call__(self, *arguments: Any) -> Any:
        """Call the function and add its time."""
        began = time.perf_counter()
        try:
            return self.function(*arguments)
        finally:
            self.seconds += time.perf_counter() - began


def velocity_ratio(context: Any, recorded: list[Any]) -> Iterator[Row]:
    """Frame time of the RBPF over that of the PF: both step through the same frames in turn."""
    configs = {kind: load_settings(HandConfig, None, {"filter.kind": kind}) for kind in ("rbpf", "pf")}
    walkers = {kind: Walker(context, config, recorded[0]) for kind, config in configs.items()}
    times = in_turn(walkers, recorded, warm_up=5)
    ratios = np.divide(times["rbpf"], times["pf"])
    for kind in times:
        yield Row(f"step of the {kind}", 1e3 * float(np.median(times[kind])), "ms")
    yield Row("RBPF / PF frame time, median of pairs", float(np.median(ratios)), "", 1.03)


def against_particles(context: Any, recorded: list[Any], repeats: int) -> Iterator[Row]:
    """Time of a step against N, and how far it is from a straight line (the paper's figure 10)."""
    configs = [load_settings(HandConfig, None, {"filter.particles": n}) for n in SWEEP]
    walkers = [Walker(context, config, recorded[0]) for config in configs]
    taken: list[list[float]] = [[] for _ in SWEEP]
    for repeat in range(max(5, repeats // 3) + 1):
        for walker, times in zip(walkers, taken, strict=True):
            seconds = walker.step(repeat, recorded[0])
            if repeat:
                times.append(seconds)
    medians = 1e3 * np.array([np.median(times) for times in taken])
    for n, milliseconds in zip(SWEEP, medians, strict=True):
        yield Row(f"step, N = {n}", float(milliseconds), "ms")
    particles = np.array(SWEEP, dtype=float)
    # relative residuals: every N counts alike
    design = np.stack([np.ones_like(particles), particles], axis=1) / medians[:, None]
    (offset, slope), *_ = np.linalg.lstsq(design, np.ones_like(particles), rcond=None)
    worst = np.abs((offset + slope * particles) / medians - 1.0).max()
    yield Row("  line through them: per particle", 1e3 * float(slope), "us")
    yield Row("  line through them: offset", float(offset), "ms")
    yield Row("  largest distance from the line", 100.0 * float(worst), "%", 15.0)


def start_up() -> Iterator[Row]:
    """CPU time of posetrack --help."""
    command = [sys.executable, "-m", "posetrack_cli.cli.main", "--help"]
    times = [usage_of(command)[0] for _ in range(6)]
    yield Row("posetrack --help, CPU time", float(np.median(times[1:])), "s", 0.3)


def memory(recorded: list[Any], frames: int) -> Iterator[Row]:
    """Peak memory of hand run over a tenth of a long recording and over all of it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "long.mcap")
        write_recording(path, recorded, frames)
        command = [
            sys.executable,
            "-m",
            "posetrack_cli.cli.main",
            "hand",
            "run",
            str(path),
            "--particles",
            str(PARTICLES),
        ]
        peaks = []
        for end in (frames // 10, frames):
            output = ["-o", str(Path(folder, f"{end}.mcap")), "--end", str(end)]
            peaks.append(usage_of(command + output)[1])
            yield Row(f"peak memory, {end} frames", peaks[-1], "MiB", 400.0)
        yield Row("  of the long run over the short one", peaks[1] / peaks[0], "", 1.05)


def evaluation(frames: int) -> Iterator[Row]:
    """Time and peak memory of eval over a long result, and the size of the HTML page of a tenth of it."""
    command = [sys.executable, "-m", "posetrack_cli.cli.main", "eval"]
    with tempfile.TemporaryDirectory() as folder:
        long, short, page = (Path(folder, name) for name in ("long.mcap", "short.mcap", "page.html"))
        write_long_result(long, frames)
        write_long_result(short, frames // 10)
        began = time.perf_counter()
        seconds, mebibytes = usage_of([*command, str(long)])
        yield Row(f"eval, {frames} frames with truth", time.perf_counter() - began, "s", 20.0)
        yield Row("  of it CPU time", seconds, "s")
        yield Row("  peak memory", mebibytes, "MiB", 476.8)  # 500 MB
        usage_of([*command, str(short), "--html", str(page)])
        yield Row(f"HTML page, {frames // 10} frames", page.stat().st_size * 1e-6, "MB", 10.0)


def write_recording(path: Path, depths: list[Any], frames: int) -> None:
    """A recording of these images over and over, to and fro so that motion stays continuous."""
    import cv2
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    coded = [cv2.imencode(".png", depth.astype(np.uint16))[1].tobytes() for depth in depths]
    there_and_back = [*range(len(coded)), *range(len(coded) - 2, 0, -1)]
    with McapSink(path, compression="none") as sink:
        calibration = sink.channel("/camera/depth/calibration", CameraCalibration)
        images = sink.channel("/camera/depth/image", CompressedImage)
        message = calibration_message(CAMERA, 0, "camera")
        sink.write(calibration, 0, message.SerializeToString(deterministic=True))
        for index in range(frames):
            image = CompressedImage(
                data=coded[there_and_back[index % len(there_and_back)]], format="png", frame_id="camera"
            )
            image.timestamp.FromNanoseconds((index + 1) * FRAME_NS)
            sink.write(images, (index + 1) * FRAME_NS, image.SerializeToString(deterministic=True))
            if index % 50 == 49:
                sink.flush()
        sink.finish()


# A child's ru_maxrss begins at the size of whoever forked it, so a small process has to do that.
_LAUNCHER = """
import json, os, sys
quiet = os.open(os.devnull, os.O_WRONLY)
actions = [(os.POSIX_SPAWN_DUP2, quiet, 1), (os.POSIX_SPAWN_DUP2, quiet, 2)]
pid = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=actions)
_, status, usage = os.wait4(pid, 0)
print(json.dumps([os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, usage.ru_maxrss]))
"""


def usage_of(command: list[str]) -> tuple[float, float]:
    """Run a command; return its CPU seconds and its peak memory, MiB. Raise if it fails."""
    launched = subprocess.run(
        [sys.executable, "-S", "-c", _LAUNCHER, *command], check=True, capture_output=True, text=True
    )
    code, seconds, kibibytes = json.loads(launched.stdout)
    if code:
        raise subprocess.CalledProcessError(code, command)
    return seconds, kibibytes / 1024


if __name__ == "__main__":
    main()
