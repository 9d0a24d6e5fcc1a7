"""What a batch gains and costs: recordings side by side against one after the other, and many short jobs."""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

from benchmarking.cluster import Cluster
from benchmarking.commands import POSETRACK, usage_of
from benchmarking.lengths import Lengths
from benchmarking.rows import Row
from posetrack_cli.batch.jobs import Job, Limits, Outcome, State
from posetrack_cli.batch.running import run_batch

RECORDINGS = 8
PLACES = 2
FASTER = 1.6
OVERHEAD_S = 1.0
STAND_IN_S = 0.02
WORKERS = 16
CHUNK = 250
"""Jobs after which the client's memory is looked at first: what is made once is there by then."""


def batches(lengths: Lengths) -> Iterator[Row]:
    """Rows of throughput, of what a recording costs besides its own process, and of scheduling."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        hands, heads = _hands(folder, lengths.batch_frames), _heads(folder, lengths.batch_frames)
        yield from throughput(folder, ("hand", "run"), hands)
        yield from throughput(folder, ("head", "mono"), heads, "--cameras=left")
        yield from scheduling(folder, lengths.batch_jobs)


def _hands(folder: Path, frames: int) -> Sequence[Path]:
    made = [folder / f"hand{seed}.mcap" for seed in range(RECORDINGS)]
    for seed, path in enumerate(made):
        _posetrack("hand", "synth", "--motion", "C", "--frames", frames, "--seed", 31 + seed, "-o", path)
    return made


def _heads(folder: Path, frames: int) -> Sequence[Path]:
    made = [folder / f"head{seed}.mcap" for seed in range(RECORDINGS)]
    for seed, path in enumerate(made):
        _posetrack("head", "synth", "--frames", max(frames, 30), "--seed", 31 + seed, "-o", path)
    return made


def _posetrack(*arguments: object) -> None:
    line = [*POSETRACK, *map(str, arguments)]
    subprocess.run(line, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def throughput(
    folder: Path, command: tuple[str, ...], recordings: Sequence[Path], *options: str
) -> Iterator[Row]:
    """Time of a batch over that of its recordings one after the other, and its processor time over theirs.

    Args:
        folder: for the results.
        command: that tracks.
        recordings: of one batch.
        options: of the command.
    """
    name = " ".join(command)

    def alone() -> float:
        used = 0.0
        for number, recording in enumerate(recordings):
            output = folder / f"{name}-{number}.mcap"
            line = [*POSETRACK, *command, str(recording), "-o", str(output), "--overwrite", *options]
            used += usage_of(line)[0]
        return used

    def together() -> float:
        own = ["-o", str(folder / name), "--redo", "--no-reports", "--jobs", str(PLACES)]
        manifest = folder / "batch.toml"
        manifest.write_text(
            "".join(
                f"[[recordings]]\nname = {str(number)!r}\npath = {str(recording)!r}\n"
                for number, recording in enumerate(recordings)
            )
        )
        return usage_of([*POSETRACK, "batch", *command, str(manifest), *own, *options])[0]

    (one_by_one_s, alone_cpu_s), (batch_s, batch_cpu_s) = _clocked(alone), _clocked(together)
    yield Row(f"batch {name}, {RECORDINGS} recordings, {PLACES} at a time, time", batch_s, "s")
    yield Row(f"batch {name}, the same over one after the other", batch_s / one_by_one_s, "", 1.0 / FASTER)
    more = (batch_cpu_s - alone_cpu_s) / len(recordings)
    yield Row(f"batch {name}, processor time besides, a recording", more, "s", OVERHEAD_S)


def _clocked(work: Callable[[], float]) -> tuple[float, float]:
    began = time.perf_counter()
    cpu_s = work()
    return time.perf_counter() - began, cpu_s


def stand_in(job: Job, limits: Limits, progress: object, stopped: object) -> Outcome:
    """Take the time of a very short job."""
    time.sleep(STAND_IN_S)
    return Outcome(job.name, State.DONE)


def scheduling(folder: Path, count: int) -> Iterator[Row]:
    """What scheduling costs where jobs are very short: on many workers, in processes of this machine.

    Args:
        folder: for the scheduler's file.
        count: how many jobs.
    """
    scripts = Path(__file__).parents[1]  # the workers do what this module says
    paths = [str(scripts), str(scripts.parent), os.environ.get("PYTHONPATH", "")]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    with Cluster(folder, WORKERS, environment) as cluster:
        yield from _scheduled(folder, cluster.file, count)


def _scheduled(folder: Path, file: Path, count: int) -> Iterator[Row]:
    jobs = [
        Job(
            str(number),
            ("hand", "run"),
            folder / "none.mcap",
            (),
            folder / "none",
            folder / "none.json",
            folder,
        )
        for number in range(count)
    ]
    peaks: list[int] = []
    from posetrack_cli.batch.engine import Where, open_engine  # Dask takes half a second

    with open_engine(Where(scheduler_file=file), stand_in) as engine:
        while engine.places() < WORKERS:
            time.sleep(0.5)
        began, done = time.perf_counter(), 0

        def report(outcome: Outcome) -> None:
            nonlocal done
            done += 1
            if done % CHUNK == 0:
                peaks.append(getrusage(RUSAGE_SELF).ru_maxrss)

        run_batch(engine, jobs, Limits(), report=report)
        taken = time.perf_counter() - began
    each_ms = 1e3 * (taken - count * STAND_IN_S / WORKERS) / count
    yield Row(f"batch of {count} jobs of {1e3 * STAND_IN_S:g} ms on {WORKERS} workers, time", taken, "s")
    yield Row("the same, scheduling a job", each_ms, "ms", 10.0)
    yield Row("the same, the client's peak memory over that of the first jobs", peaks[-1] / peaks[0], "", 1.1)
