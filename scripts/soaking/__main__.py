"""Long runs, 100 kills, full disks and cold kernel caches: nothing may grow, and nothing may be lost.

Every run is a process of its own, started as a user starts it. Prints a table, and one line for whatever is
not as it must be; the exit code is 1 if there is any.
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
@click.option("--only", type=click.Choice(PARTS), multiple=True, help="Only this; repeatable.")
@click.option("--tracker", type=click.Choice(TRACKERS), multiple=True, help="Only this; repeatable.")
@click.option("--frames", type=click.IntRange(min=60), help="Of each long run.  [default: 20000]")
@click.option("--kills", type=click.IntRange(min=1), help="Of runs, and of batches.  [default: 100]")
@click.option("--disks", type=click.IntRange(min=1), help="Sizes for each tracker.  [default: 10]")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the moments of the kills.")
@click.option("--json", "as_json", type=click.Path(path_type=Path), help="Write the figures here.")
@click.option("--markdown", "as_markdown", type=click.Path(path_type=Path), help="Write them as tables.")
@click.option("--keep", type=click.Path(path_type=Path), help="Work in this new folder and leave it.")
@click.option("--quick", is_flag=True, help="See that everything works; its figures are not to be quoted.")
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
    """Let trackers run long, kill them, fill their disk, start them cold; exit code 1 if any suffers."""
    signal.signal(signal.SIGTERM, _leave)  # what is mounted is unmounted
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
    print(f"not as it must be: {len(findings.troubles)}")
    sys.exit(1 if findings.troubles else 0)


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(128 + number)


def describe(amounts: Amounts, seed: int) -> dict[str, str]:
    """Return what figures were measured on, and how."""
    device = open_fastest_device()
    try:
        return describe_machine(device) | {"amounts": str(amounts), "seed": str(seed)}
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
    """Go through parts, each over all trackers, in an empty folder; ``seed`` is of the kills' moments."""
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
