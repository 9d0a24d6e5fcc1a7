"""Benchmark of speed and memory on this machine: prints a table and writes JSON.

The part ``files`` leads: whole commands on real data (in ``../shared``, left out if missing) and made data.
Ratios come from alternating measurements, so that a drifting clock rate affects both sides. On a shared
machine, quote ratios rather than milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click

from benchmarking.batches import batches
from benchmarking.files import files
from benchmarking.hands import evaluation, filters, memory
from benchmarking.processes import start_up
from benchmarking.rows import Row, describe_machine, rows_json
from posetrack_cli.cli.options import DeviceIndex
from posetrack_cli.rendering.devices import open_fastest_device


class Lengths(NamedTuple):
    """Extent of each part."""

    file_frames: int | None  # of each recording; None for all
    repeats: int  # runs of each command
    frames: int  # made, and repeated for long recordings
    hand_memory: int  # frames of a long run; the short one has a tenth
    head_memory: int
    eval_frames: int  # of a long result
    batch_frames: int  # of each recording of a batch
    batch_jobs: int  # very short jobs, for the scheduling overhead


FULL = Lengths(None, 2, 120, 1500, 2400, 100_000, 300, 2000)
QUICK = Lengths(10, 1, 30, 100, 300, 2_000, 8, 500)
PARTS: Mapping[str, Callable[[Any, Lengths, Path | None], Iterator[Row]]] = {
    "files": lambda device, n, previous: files(n.file_frames, n.repeats, previous),
    "commands": lambda device, n, previous: start_up(),
    "filters": lambda device, n, previous: filters(device, n.frames),
    "memory": lambda device, n, previous: memory(device, n.frames, n.hand_memory, n.head_memory),
    "eval": lambda device, n, previous: evaluation(n.eval_frames),
    "batch": lambda device, n, previous: batches(n.batch_frames, n.batch_jobs),
}


@click.command()
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), default=Path("out/bench.json"), show_default=True
)
@click.option(
    "--device",
    type=DeviceIndex(),
    help="EGL device to render with, or cpu.  [default: as for posetrack hand run]",
)
@click.option("--quick", is_flag=True, help="Short smoke test; the figures are not representative.")
@click.option(
    "--previous",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Checkout of the previous version, which the part files runs alternately with this one.",
)
@click.option("--part", "parts", type=click.Choice(list(PARTS)), multiple=True, help="Only this. Repeatable.")
def main(
    json_path: Path, device: int | str | None, quick: bool, previous: Path | None, parts: Sequence[str]
) -> None:
    """Measure posetrack on this machine."""
    drawing, lengths = open_fastest_device(device), QUICK if quick else FULL
    machine = describe_machine(drawing, "scripts/bench") | {"length": "quick" if quick else "full"}
    for key, value in machine.items():
        print(f"{key}: {value}")
    rows = []
    for part in PARTS:
        for row in PARTS[part](drawing, lengths, previous) if part in (parts or PARTS) else ():
            print(row.line, flush=True)
            rows.append(row)
    json_path.parent.mkdir(parents=True, exist_ok=True)
    json_path.write_text(rows_json(machine, rows))
    print(f"written: {json_path}")


if __name__ == "__main__":
    main(prog_name="scripts/bench")
