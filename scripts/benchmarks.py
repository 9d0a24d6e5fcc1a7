"""Speed and memory of posetrack on this machine: a table on standard output, and JSON.

Times are medians over repeats in this one run. Ratios are of pairs measured in turn, so that a drifting
clock rate touches both sides alike. Quote ratios rather than milliseconds from a shared machine.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarking.batches import batches
from benchmarking.commands import start_up
from benchmarking.hands import hands
from benchmarking.heads import heads
from benchmarking.lengths import FULL, QUICK, Lengths
from benchmarking.machine import describe_machine
from benchmarking.rendering import scoring
from benchmarking.results import evaluation
from benchmarking.rows import Row
from posetrack_cli.cli.options import DrawingDevice
from posetrack_cli.rendering.devices import open_fastest_device
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions

Part = Callable[[Any, Lengths], Iterator[Row]]


def _depths(device: RenderingDevice, frames: int) -> list[Any]:
    options = SynthOptions(frames=frames)
    return [frame.depth.astype(np.float32) for frame in synthesise(options, device=device)]


PARTS: Mapping[str, Part] = {
    "commands": lambda device, lengths: start_up(),
    "rendering": lambda device, lengths: scoring(device, lengths.repeats),
    "hand": lambda device, lengths: hands(device, _depths(device, lengths.hand_frames), lengths),
    "head": lambda device, lengths: heads(lengths),
    "eval": lambda device, lengths: evaluation(lengths.eval_frames),
    "batch": lambda device, lengths: batches(lengths),
}


@click.command()
@click.option(
    "--json", "json_path", type=click.Path(path_type=Path), default=Path("out/bench.json"), show_default=True
)
@click.option(
    "--device",
    type=DrawingDevice(),
    help="Index of an EGL device, or cpu.  [default: as posetrack hand run]",
)
@click.option("--quick", is_flag=True, help="See that everything works; its figures are not to be quoted.")
@click.option("--part", "parts", type=click.Choice(list(PARTS)), multiple=True, help="Only this; repeatable.")
def main(json_path: Path, device: int | str | None, quick: bool, parts: Sequence[str]) -> None:
    """Measure posetrack on this machine."""
    drawing, lengths = open_fastest_device(device), QUICK if quick else FULL
    machine = describe_machine(drawing) | {"length": "quick" if quick else "full"}
    for key, value in machine.items():
        print(f"{key}: {value}")
    rows = list(_printed(PARTS[part](drawing, lengths) for part in PARTS if part in (parts or PARTS)))
    json_path.parent.mkdir(parents=True, exist_ok=True)
    table = [asdict(row) | {"verdict": row.verdict} for row in rows]
    json_path.write_text(json.dumps({"machine": machine, "rows": table}, indent=1) + "\n")
    print(f"written: {json_path}")


def _printed(parts: Iterable[Iterator[Row]]) -> Iterator[Row]:
    for part in parts:
        for row in part:
            print(row.line, flush=True)
            yield row


if __name__ == "__main__":
    main()
