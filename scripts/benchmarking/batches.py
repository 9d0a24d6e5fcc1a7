"""Batches: parallel against sequential recordings, and the overhead of many short jobs."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from resource import RUSAGE_SELF, getrusage

from benchmarking.processes import POSETRACK, Cluster, usage_of
from benchmarking.rows import Row
from posetrack_cli.batch.jobs import Job, Limits, Outcome, State
from posetrack_cli.batch.scheduling import run_batch

RECORDINGS = 8
PLACES = 2
FASTER = 1.6
OVERHEAD_S = 1.0
STAND_IN_S = 0.02
WORKERS = 16
CHUNK = 250  # jobs before the first look at the client's memory, which excludes one-time allocations


def batches(frames: int, jobs: int) -> Iterator[Row]:
    """Yield throughput, overhead per recording and scheduling overhead."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, least, more in (("hand", 0, ["--motion", "C"]), ("head", 30, [])):
            made = [folder / f"{kind}{seed}.mcap" for seed in range(RECORDINGS)]
            for seed, path in enumerate(made, 31):
                line = [*POSETRACK, kind, "synth", *more, "--frames", str(max(frames, least))]
                usage_of([*line, "--seed", str(seed), "-o", str(path)])
            command, options = (
                (("hand", "run"), ()) if kind == "hand" else (("head", "mono"), ("--cameras=left",))
            )
            yield from throughput(folder, command, made, *options)
        yield from scheduling(folder, jobs)


def throughput(
    folder: Path, command: tuple[str, ...], recordings: Sequence[Path], *options: str
) -> Iterator[Row]:
    """Yield wall-clock and CPU time of a batch against those of its recordings run one after the other."""
    name = " ".join(command)

    def alone() -> float:
        used = 0.0
        for number, recording in enumerate(recordings):
            output = ["-o", str(folder / f"{name}-{number}.mcap"), "--overwrite"]
            used += usage_of([*POSETRACK, *command, str(recording), *output, *options])[0]
        return used

    def together() -> float:
        own = ["-o", str(folder / name), "--redo", "--no-reports", "--jobs", str(PLACES)]
        manifest = folder / "batch.toml"
        tables = (
            f"[[recordings]]\nname = {str(number)!r}\npath = {str(recording)!r}\n"
            for number, recording in enumerate(recordings)
        )
        manifest.write_text("".join(tables))
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
    """Stand in for a very short job."""
    time.sleep(STAND_IN_S)
    return Outcome(job.name, State.DONE)


def scheduling(folder: Path, count: int) -> Iterator[Row]:
    """Yield the scheduling overhead for very short jobs on many local workers."""
    from posetrack_cli.batch.engine import EngineOptions, open_engine  # Dask takes half a second

    scripts = Path(__file__).parents[1]  # workers must be able to import this module
    paths = [str(scripts), str(scripts.parent), os.environ.get("PYTHONPATH", "")]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
    none = (folder / "none.mcap", (), folder / "none", folder / "none.json", folder)
    jobs = [Job(str(number), ("hand", "run"), *none) for number in range(count)]
    peaks: list[int] = []
    done = 0

    def report(outcome: Outcome) -> None:
        nonlocal done
        done += 1
        if done % CHUNK == 0:
            peaks.append(getrusage(RUSAGE_SELF).ru_maxrss)

    with (
        Cluster(folder, WORKERS, environment) as cluster,
        open_engine(EngineOptions(scheduler_file=cluster.file), stand_in) as engine,
    ):
        while engine.capacity() < WORKERS:
            time.sleep(0.5)
        began = time.perf_counter()
        run_batch(engine, jobs, Limits(), report=report)
        taken = time.perf_counter() - began
    each_ms = 1e3 * (taken - count * STAND_IN_S / WORKERS) / count
    yield Row(f"batch of {count} jobs of {1e3 * STAND_IN_S:g} ms on {WORKERS} workers, time", taken, "s")
    yield Row("the same, scheduling a job", each_ms, "ms", 10.0)
    yield Row("the same, the client's peak memory over that of the first jobs", peaks[-1] / peaks[0], "", 1.1)
