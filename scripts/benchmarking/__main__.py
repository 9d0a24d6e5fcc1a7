"""Benchmark of speed and memory on this machine: prints a table and writes JSON.

Times are medians over repeats. Ratios come from alternating measurements, so that a drifting clock rate
affects both sides. On a shared machine, quote ratios rather than milliseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click

from benchmarking.batches import batches
from benchmarking.hands import evaluation, hands, scoring
from benchmarking.heads import heads
from benchmarking.processes import start_up
from benchmarking.rows import Row, describe_machine, rows_json
from posetrack_cli.cli.options import DeviceIndex
from posetrack_cli.rendering.devices import open_fastest_device


class Lengths(NamedTuple):
    """Extent of each part."""

    repeats: int  # of each timing of the renderer
    hand_frames: int  # of the synthetic hand, for times per frame
    head_frames: int  # of the synthetic head, repeated forwards and backwards
    head_steps: int  # frames tracked of it
    hand_memory: int  # frames of a long run; the short one has a tenth
    head_memory: int
    eval_frames: int  # of a long result
    batch_frames: int  # of each recording of a batch
    batch_jobs: int  # very short jobs, for the scheduling overhead


FULL = Lengths(31, 120, 120, 300, 1500, 2400, 100_000, 300, 2000)
QUICK = Lengths(5, 20, 30, 60, 100, 300, 2_000, 8, 500)
PARTS: Mapping[str, Callable[[Any, Lengths], Iterator[Row]]] = {
    "commands": lambda device, n: start_up(),
    "rendering": lambda device, n: scoring(device, n.repeats),
    "hand": lambda device, n: hands(device, n.hand_frames, n.hand_memory),
    "head": lambda device, n: heads(n.head_frames, n.head_steps, n.head_memory, n.repeats),
    "eval": lambda device, n: evaluation(n.eval_frames),
    "batch": lambda device, n: batches(n.batch_frames, n.batch_jobs),
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
@click.option("--part", "parts", type=click.Choice(list(PARTS)), multiple=True, help="Only this. Repeatable.")
def main(json_path: Path, device: int | str | None, quick: bool, parts: Sequence[str]) -> None:
    """Measure posetrack on this machine."""
    drawing, lengths = open_fastest_device(device), QUICK if quick else FULL
    machine = describe_machine(drawing, "scripts/bench") | {"length": "quick" if quick else "full"}
    for key, value in machine.items():
        print(f"{key}: {value}")
    rows = []
    for part in PARTS:
        for row in PARTS[part](drawing, lengths) if part in (parts or PARTS) else ():
            print(row.line, flush=True)
            rows.append(row)
    json_path.parent.mkdir(parents=True, exist_ok=True)
    json_path.write_text(rows_json(machine, rows))
    print(f"written: {json_path}")


if __name__ == "__main__":
    main(prog_name="scripts/bench")
