"""The parts of a soak, over the trackers that are asked for."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarking.machine import describe_machine
from benchmarking.rows import Row
from posetrack_cli.rendering.devices import open_fastest_device
from soaking.amounts import Amounts
from soaking.batches import soak_batches
from soaking.cases import Case, Recordings
from soaking.cold import soak_cold
from soaking.disks import soak_disk
from soaking.findings import Findings
from soaking.frames import soak_frames
from soaking.kills import soak_kills
from soaking.reference import Reference, reference_of

PARTS = ("frames", "batches", "kills", "disk", "cold")
References = Mapping[str, tuple[Case, Reference]]


def describe(amounts: Amounts, seed: int) -> dict[str, str]:
    """What figures were measured on, and how."""
    device = open_fastest_device()
    try:
        return describe_machine(device) | {"amounts": str(amounts), "seed": str(seed)}
    finally:
        device.close()


@contextmanager
def workplace(keep: Path | None) -> Iterator[Path]:
    """Yield an empty folder; deleted at the end unless it is to be kept."""
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="soak-") as name:
            yield Path(name)
        return
    keep.mkdir(parents=True)
    yield keep.resolve()


def soak(
    parts: Sequence[str],
    trackers: Sequence[str],
    amounts: Amounts,
    seed: int,
    folder: Path,
    findings: Findings,
) -> None:
    """Go through parts, each over all trackers.

    Args:
        parts: of ``PARTS``.
        trackers: of ``TRACKERS``.
        amounts: how much of everything.
        seed: of the moments of the kills.
        folder: an empty one, to work in.
        findings: where figures and troubles go.
    """
    recordings = Recordings(folder, amounts)
    if "frames" in parts:
        with _timed("frames", findings):
            for tracker in trackers:
                soak_frames(recordings.long_case(tracker), folder / f"frames-{tracker}", findings)
    if "batches" in parts:
        with _timed("batches", findings):
            soak_batches(recordings.batch_case(), amounts.kills, seed, folder / "batches", findings)
    if set(parts) <= {"frames", "batches"}:
        return
    references = _references(recordings, trackers, folder, findings)
    if "kills" in parts:
        with _timed("kills", findings):
            soak_kills(references, amounts.kills, seed, folder / "kills", findings)
    for tracker, (case, reference) in references.items():
        if "disk" in parts:
            with _timed(f"{case.name}, disk full", findings):
                soak_disk(case, reference, amounts.disks, folder / f"disk-{tracker}", findings)
        if "cold" in parts:
            soak_cold(case, reference, amounts.at_once, folder / f"cold-{tracker}", findings)


def _references(
    recordings: Recordings, trackers: Sequence[str], folder: Path, findings: Findings
) -> References:
    """The cases whose uninterrupted runs came to their end, with these."""
    found = {}
    for tracker in trackers:
        case = recordings.short_case(tracker)
        reference = reference_of(case, folder / f"reference-{tracker}", findings)
        if reference is not None:
            found[tracker] = case, reference
    return found


@contextmanager
def _timed(name: str, findings: Findings) -> Iterator[None]:
    began = time.perf_counter()
    yield
    findings.add(Row(f"{name}, taken in all", (time.perf_counter() - began) / 60.0, "min"))
