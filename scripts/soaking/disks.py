"""Runs whose disk is full at some moment, and runs that begin together on an empty kernel cache."""

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
LARGEST = 0.85
"""Of the room that a run needs, which is known from above: a checkpoint counts twice at its later, larger
size, with all that was written since. On a disk of this size a run does not come to its end."""


class Disk(NamedTuple):
    """A place that holds so many bytes, and what gives it room for everything.

    Where there is no file system of its own, no file may exceed ``file_bytes``; None where there is.
    """

    folder: Path
    file_bytes: int | None
    enlarge: Callable[[], None]


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Disk]:
    """Mount a file system of so many bytes, unmounted at the end of the context.

    Raises:
        OSError: it cannot be mounted: not root, or not allowed to.
    """
    folder.mkdir()
    try:  # around the mounting, too: Ctrl-C may come at its end
        _mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder))
        yield Disk(folder, None, lambda: _mount("-o", f"remount,size={64 * size + (64 << 20)}", str(folder)))
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], capture_output=True)  # or was not mounted


@contextmanager
def small_files(folder: Path, size: int) -> Iterator[Disk]:
    """A folder in which no file of a process may exceed so many bytes: what comes next to a full disk."""
    folder.mkdir()
    yield Disk(folder, size, lambda: None)


def _mount(*arguments: str) -> None:
    try:
        subprocess.run(["mount", *arguments], check=True, capture_output=True, text=True)
    except subprocess.CalledProcessError as error:
        raise OSError(error.stderr.strip()) from error


def can_mount(folder: Path) -> bool:
    """Whether this process may mount a small file system."""
    if os.getuid() != 0:
        return False
    with suppress(OSError), small_disk(folder, PAGE):
        return True
    return False


def sizes_of(count: int, needed: int) -> list[int]:
    """Return so many sizes, evenly up to ``LARGEST`` of what is needed, of whole pages."""
    return [max(PAGE, int(LARGEST * needed * (k + 1) / count) // PAGE * PAGE) for k in range(count)]


def fill(case: Case, reference: Reference, disk: Disk, folder: Path) -> Iterator[str]:
    """Run a case on a disk that is too small, then enlarge it and go on; yield what is not as it must be."""
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
    """Let a case run out of disk at so many sizes."""
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
    """Start so many equal runs at once, each compiling while the others do; all must come to one result."""
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
