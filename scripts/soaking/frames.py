"""Long runs: check that memory and time per frame do not grow after the first thousand frames."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarking.rows import Row
from posetrack_cli.arrays import FloatArray
from posetrack_cli.cli.terminal import bar
from posetrack_cli.results import load_arrays
from soaking.runs import DONE, Case, Findings, Looker, run_to_end, started

GROWTH_MIB = 16.0  # allowed growth of memory after the first thousand frames
# Allowed ratio of CPU times, last over first thousand frames. CPU time includes reading, writing and
# checkpoints, and does not depend on the load of the machine.
SLOWER = 1.10
WARM_UP = 60  # frames of the preceding run, enough to compile every kernel
MARKS = (1_000, 5_000, 10_000, 20_000)
FIRST = 1_000
SAMPLE_S = 0.25


class Sample(NamedTuple):
    """State of a process: frames done, resident and peak memory (MiB), CPU time (s)."""

    frames: int
    resident: float
    peak: float
    cpu: float


def soak_frames(case: Case, folder: Path, findings: Findings) -> None:
    """Run a case to its end and record memory and time per frame; a short run compiles the kernels first."""
    folder.mkdir()
    output, warm = folder / "long.mcap", folder / "warm.mcap"
    ended = run_to_end(case.command(warm, "--end", str(WARM_UP)), folder / "warm.txt")
    if not findings.troubles_of(f"{case.name}, {WARM_UP} frames", ended.troubles((DONE,))):
        return
    samples = []
    with (
        started(case.command(output), folder / "long.txt") as run,
        bar(case.name, "frame", case.frames) as shown,
    ):
        for sample in watch(case, output, run.process.pid):
            samples.append(sample)
            shown.advance(sample.frames - shown.done)
        ended = run.end()
    if not findings.troubles_of(f"{case.name}, {case.frames} frames", ended.troubles((DONE,))):
        return
    milliseconds = load_arrays(output)["milliseconds"]
    if len(milliseconds) != case.frames:
        findings.trouble(f"{case.name}: {len(milliseconds)} frames in the result, expected {case.frames}")
        return
    for row in (
        *memory_rows(case.name, samples, case.frames),
        *time_rows(case.name, milliseconds),
        *cpu_rows(case.name, samples, case.frames),
    ):
        findings.add(row)
    findings.add(Row(f"{case.name}, size of the result", 1e-6 * output.stat().st_size, "MB"))


def watch(case: Case, output: Path, process: int) -> Iterator[Sample]:
    """Yield a sample after each progress of a process, until it ends."""
    last, looker = 0, Looker(case, output)
    while (memory := memory_of(process)) is not None:
        if (steps := looker.steps) > last:
            last = steps
            yield Sample(last, *memory)
        time.sleep(SAMPLE_S)


def memory_of(process: int) -> tuple[float, float, float] | None:
    """Return resident and peak memory of a process, MiB, and its CPU time, s; None once it has ended."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return None
    values = dict(line.split(":", 1) for line in status.splitlines())
    if "VmRSS" not in values:  # a zombie
        return None
    resident, peak = (float(values[name].split()[0]) / 1024 for name in ("VmRSS", "VmHWM"))
    return resident, peak, (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_rows(name: str, samples: Sequence[Sample], frames: int) -> Iterator[Row]:
    """Yield memory after each mark (a third and all of a short run), and its growth after the first."""
    if not samples:
        return
    marks = [frames // 3, frames]
    if frames > FIRST:
        marks = [*(mark for mark in MARKS if mark < frames), frames]
    values = [memory_after(samples, mark) for mark in marks]
    for mark, value in zip(marks, values, strict=True):
        yield Row(f"{name}, memory after {mark} frames", value, "MiB")
    yield Row(f"{name}, memory at its peak", max(sample.peak for sample in samples), "MiB")
    growth = max(values[1:]) - values[0]
    yield Row(f"{name}, growth of memory after {marks[0]} frames", growth, "MiB", GROWTH_MIB)


def memory_after(samples: Sequence[Sample], frames: int) -> float:
    """Return the median memory (MiB) over the last tenth before a frame, which averages out garbage."""
    seen = [sample.resident for sample in samples if 0.9 * frames <= sample.frames <= frames]
    nearest = min(samples, key=lambda sample: abs(sample.frames - frames))
    return float(np.median(seen or [nearest.resident]))


def time_rows(name: str, milliseconds: FloatArray) -> Iterator[Row]:
    """Yield the median time per frame of the first and last thousand frames, and their ratio."""
    count = window_of(len(milliseconds))
    first, last = (float(np.median(part)) for part in (milliseconds[:count], milliseconds[-count:]))
    yield Row(f"{name}, time per frame, first {count}, median", first, "ms")
    yield Row(f"{name}, time per frame, last {count}, median", last, "ms")
    yield Row(f"{name}, time per frame, last over first", last / first, "")


def cpu_rows(name: str, samples: Sequence[Sample], frames: int) -> Iterator[Row]:
    """Yield the ratio of CPU times, last over first thousand frames; nothing with too few samples."""
    count = window_of(frames)
    done, cpu = [sample.frames for sample in samples], [sample.cpu for sample in samples]
    if not samples or done[-1] - done[0] < count:
        return
    marks = np.interp([done[0], done[0] + count, done[-1] - count, done[-1]], done, cpu)
    if marks[1] > marks[0]:
        ratio = float((marks[3] - marks[2]) / (marks[1] - marks[0]))
        yield Row(f"{name}, CPU time per frame, last {count} over first", ratio, "", SLOWER)


def window_of(frames: int) -> int:
    """Return the number of frames compared at either end: a thousand, or a third of a short run."""
    return min(FIRST, frames // 3)
