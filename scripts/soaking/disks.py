"""Runs that fill their disk, and simultaneous runs with an empty kernel cache."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from benchmarking.rows import Row
from posetrack_cli.outputs import state_path
from soaking.kills import unreadable
from soaking.runs import DONE, FAILED, Case, Findings, Reference, run_to_end, started

PAGE = 4096
# Share of the estimated disk space of a run. The estimate is an upper bound (it counts the last, largest
# checkpoint twice), so the share must be small enough for the run to fail.
LARGEST = 0.85


class Disk(NamedTuple):
    """A folder of limited size, and a function that lifts the limit.

    Without a mounted file system, ``file_bytes`` limits the size of a file instead; else it is None.
    """

    folder: Path
    file_bytes: int | None
    enlarge: Callable[[], None]


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Disk]:
    """Mount a file system of ``size`` bytes; unmount it at the end of the context.

    Raises:
        OSError: mounting failed, for example without root privileges.
    """
    folder.mkdir()
    try:  # includes the mounting: Ctrl-C may arrive right after it
        _mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder))
        yield Disk(folder, None, lambda: _mount("-o", f"remount,size={64 * size + (64 << 20)}", str(folder)))
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], capture_output=True)  # fails if not mounted


@contextmanager
def small_files(folder: Path, size: int) -> Iterator[Disk]:
    """Yield a folder with a limit on the file size, the closest substitute for a full disk without root."""
    folder.mkdir()
    yield Disk(folder, size, lambda: None)


def _mount(*arguments: str) -> None:
    try:
        subprocess.run(["mount", *arguments], check=True, capture_output=True, text=True)
    except subprocess.CalledProcessError as error:
        raise OSError(error.stderr.strip()) from error


def can_mount(folder: Path) -> bool:
    """Return whether this process may mount a small file system."""
    if os.getuid() != 0:
        return False
    with suppress(OSError), small_disk(folder, PAGE):
        return True
    return False


def sizes_of(count: int, needed: int) -> list[int]:
    """Return ``count`` evenly spaced disk sizes up to ``LARGEST * needed``, in whole pages."""
    return [max(PAGE, int(LARGEST * needed * (k + 1) / count) // PAGE * PAGE) for k in range(count)]


def fill(case: Case, reference: Reference, disk: Disk, folder: Path) -> Iterator[str]:
    """Run a case on a disk that is too small, enlarge it and resume; yield failed checks."""
    output = disk.folder / "result.mcap"
    ended = run_to_end(case.command(output), folder / "full.txt", file_bytes=disk.file_bytes)
    yield from ended.troubles((FAILED,))
    yield from unreadable(case, output)
    disk.enlarge()
    more = ["--resume"] if state_path(output).exists() else ["--overwrite"]
    again = list(run_to_end(case.command(output, *more), folder / "again.txt").troubles((DONE,)))
    yield from (f"with room again: {line}" for line in again)
    if not again and output.read_bytes() != reference.data:
        yield "with room again the result differs from an uninterrupted run's"


def soak_disk(case: Case, reference: Reference, count: int, folder: Path, findings: Findings) -> None:
    """Run a case on ``count`` disks that are too small."""
    folder.mkdir()
    mounts = can_mount(folder / "probe")
    make, needed = (small_disk, reference.room) if mounts else (small_files, len(reference.data))
    sizes, wrong = sizes_of(count, needed), 0
    for number, size in enumerate(sizes):
        inner = folder / f"size-{number}"
        inner.mkdir()
        with make(inner / "disk", size) as disk:
            troubles = fill(case, reference, disk, inner)
            wrong += not findings.troubles_of(f"{case.name}, disk full at {size} bytes", troubles)
    kind = "disks of" if mounts else "files of at most"
    span = f"{sizes[0] // 1024} to {sizes[-1] // 1024} KiB"
    findings.add(Row(f"{case.name}, {kind} {span}, sizes tried", len(sizes), ""))
    findings.add(Row(f"{case.name}, full disks that were not taken as they must be", wrong, "", 0.0))


def soak_cold(case: Case, reference: Reference, at_once: int, folder: Path, findings: Findings) -> None:
    """Start identical runs that compile at the same time; all must give the same result."""
    folder.mkdir()
    environment = {"NUMBA_CACHE_DIR": str(folder / "cache")}
    outputs = [folder / f"{number}.mcap" for number in range(at_once)]
    began, wrong = time.perf_counter(), 0
    with ExitStack() as stack:
        runs = [
            stack.enter_context(started(case.command(output), output.with_suffix(".txt"), environment))
            for output in outputs
        ]
        ended = [run.end() for run in runs]
    seconds = time.perf_counter() - began
    for output, end in zip(outputs, ended, strict=True):
        troubles = list(end.troubles((DONE,)))
        if not troubles and output.read_bytes() != reference.data:
            troubles = ["the result differs from that of a run with compiled kernels"]
        wrong += not findings.troubles_of(f"{case.name}, cold run {output.stem}", troubles)
    findings.add(Row(f"{case.name}, {at_once} at once on an empty kernel cache, total time", seconds, "s"))
    findings.add(Row(f"{case.name}, of them failed or with other bytes", wrong, "", 0.0))
