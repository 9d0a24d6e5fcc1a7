"""Soak test: long runs, kills, full disks and cold kernel caches; checks memory growth and data loss.

Every run is a process, started like a user's. Prints a table of figures and one line per failed check; the
exit code is 1 if a check failed.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click

from benchmarking.rows import Row, describe_machine
from posetrack_cli.rendering.devices import open_fastest_device
from soaking.disks import soak_cold, soak_disk
from soaking.frames import soak_frames
from soaking.kills import soak_batches, soak_kills
from soaking.runs import FULL, QUICK, TRACKERS, Amounts, Findings, Recordings, reference_of

PARTS = ("frames", "batches", "kills", "disk", "cold")


@click.command()
@click.option("--only", type=click.Choice(PARTS), multiple=True, help="Run only this part. Repeatable.")
@click.option("--tracker", type=click.Choice(TRACKERS), multiple=True, help="Only this tracker. Repeatable.")
@click.option("--frames", type=click.IntRange(min=60), help="Frames per long run.  [default: 20000]")
@click.option("--kills", type=click.IntRange(min=1), help="Kills of runs and of batches.  [default: 100]")
@click.option("--disks", type=click.IntRange(min=1), help="Disk sizes per tracker.  [default: 10]")
@click.option("--seed", type=int, default=0, show_default=True, help="Random seed of the kill times.")
@click.option("--json", "as_json", type=click.Path(path_type=Path), help="Write the figures as JSON.")
@click.option("--markdown", "as_markdown", type=click.Path(path_type=Path), help="Write Markdown tables.")
@click.option("--keep", type=click.Path(path_type=Path), help="Work in this new folder and keep it.")
@click.option("--quick", is_flag=True, help="Short smoke test; the figures are not representative.")
def main(
    only: Sequence[str],
    tracker: Sequence[str],
    seed: int,
    as_json: Path | None,
    as_markdown: Path | None,
    keep: Path | None,
    quick: bool,
    **given: int | None,
) -> None:
    """Run trackers for long, kill them, fill their disks, start them cold; exit code 1 if a check fails."""
    signal.signal(signal.SIGTERM, _leave)  # exit normally, so that small disks are unmounted
    amounts = (QUICK if quick else FULL)._replace(**{name: n for name, n in given.items() if n is not None})
    machine = describe(amounts, seed)
    for key, value in machine.items():
        print(f"{key}: {value}", flush=True)
    findings = Findings()
    with tempfile.TemporaryDirectory(prefix="soak-") as temporary:
        folder = Path(temporary) if keep is None else keep.resolve()
        folder.mkdir(parents=True, exist_ok=keep is None)
        soak(only or PARTS, tracker or TRACKERS, amounts, seed, folder, findings)
    for path, text in ((as_json, findings.as_json(machine)), (as_markdown, findings.as_markdown(machine))):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            print(f"written: {path}")
    print(f"failed checks: {len(findings.troubles)}")
    sys.exit(1 if findings.troubles else 0)


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(128 + number)


def describe(amounts: Amounts, seed: int) -> dict[str, str]:
    """Return machine and settings for the report."""
    device = open_fastest_device()
    try:
        return describe_machine(device, "scripts/soak") | {"amounts": str(amounts), "seed": str(seed)}
    finally:
        device.close()


def soak(
    parts: Sequence[str],
    trackers: Sequence[str],
    amounts: Amounts,
    seed: int,
    folder: Path,
    findings: Findings,
) -> None:
    """Run the parts for all trackers in an empty folder; ``seed`` determines the kill times."""
    recordings = Recordings(folder, amounts)
    if "frames" in parts:
        with _timed("frames", findings):
            for tracker in trackers:
                soak_frames(recordings.long_case(tracker), folder / f"frames-{tracker}", findings)
    if "batches" in parts:
        with _timed("batches", findings):
            soak_batches(recordings.batch_case(), amounts.kills, seed, folder / "batches", findings)
    references = {}
    for tracker in trackers if {"kills", "disk", "cold"}.intersection(parts) else ():
        case = recordings.short_case(tracker)
        if reference := reference_of(case, folder / f"reference-{tracker}", findings):
            references[tracker] = case, reference
    if "kills" in parts:
        with _timed("kills", findings):
            soak_kills(references, amounts.kills, seed, folder / "kills", findings)
    for tracker, (case, reference) in references.items() if "disk" in parts else ():
        with _timed(f"{case.name}, disk full", findings):
            soak_disk(case, reference, amounts.disks, folder / f"disk-{tracker}", findings)
    for tracker, (case, reference) in references.items() if "cold" in parts else ():
        soak_cold(case, reference, amounts.at_once, folder / f"cold-{tracker}", findings)


@contextmanager
def _timed(name: str, findings: Findings) -> Iterator[None]:
    began = time.perf_counter()
    yield
    findings.add(Row(f"{name}, taken in all", (time.perf_counter() - began) / 60.0, "min"))


if __name__ == "__main__":
    main(prog_name="scripts/soak")
