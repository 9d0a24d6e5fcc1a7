"""Runs whose disk is full at some moment: what was flushed stays, and more room ends them well."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarking.rows import Row
from posetrack_cli.outputs import state_path
from soaking.cases import Case
from soaking.findings import Findings
from soaking.kills import unreadable
from soaking.processes import DONE, FAILED, run_to_end
from soaking.reference import Reference

PAGE = 4096
LARGEST = 0.85
"""Of the room that a run needs, which is known from above: a checkpoint counts twice at its later, larger
size, with all that was written since. On a disk of this size a run does not come to its end."""


@dataclass(frozen=True)
class Disk:
    """A place that holds so many bytes.

    Attributes:
        folder: in which it is.
        file_bytes: that no file may exceed, where there is no file system of its own; None where there is.
        enlarge: gives it room for everything.
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
