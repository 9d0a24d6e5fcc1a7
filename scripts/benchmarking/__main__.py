"""Speed and memory of posetrack on this machine: a table on standard output, and JSON.

Times are medians over repeats in this one run. Ratios are of pairs measured in turn, so that a drifting
clock rate touches both sides alike. Quote ratios rather than milliseconds from a shared machine.
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
    """How long each part measures."""

    repeats: int  # of each timing of the renderer
    hand_frames: int  # of the synthetic hand, for times per frame
    head_frames: int  # of the synthetic head, seen to and fro
    head_steps: int  # tracked of it
    hand_memory: int  # frames of a long run; the short one has a tenth
    head_memory: int
    eval_frames: int  # of a long result
    batch_frames: int  # of each of the recordings of a batch
    batch_jobs: int  # very short ones


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
    help="Index of an EGL device, or cpu.  [default: as posetrack hand run]",
)
@click.option("--quick", is_flag=True, help="See that everything works; its figures are not to be quoted.")
@click.option("--part", "parts", type=click.Choice(list(PARTS)), multiple=True, help="Only this; repeatable.")
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
