"""One unit of the study: a synthetic recording, tracked by every entrant. Run as a process of its own.

Usage: PYTHONPATH=scripts .venv/bin/python -m reproduction.unit --motion C --speed 1 --seed 101 \\
    --frames 150 --entrants pf-union,rbpf-union --out DIR

A result that is there already is left alone if it is of this version and configuration, so a study that was
stopped goes on where it was. The recording
itself is deleted in the end: the same options make the same one again.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from posetrack_cli.build import source_digest
from posetrack_cli.configuration import find_configuration, load_settings
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.rendering.devices import open_fastest_device
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import read_result
from posetrack_cli.synthesis.hand.options import Switches, SynthOptions
from posetrack_cli.synthesis.hand.writing import write_synthetic


@dataclass(frozen=True)
class Entrant:
    """A way to track: a shipped configuration and what differs from it."""

    configuration: str
    changes: dict[str, Any]


PLAIN = {"filter.proposal": "marginal", "observation.sigma_mm": 4.0}
"""The paper's question is about sampling from the motion alone; such particles need a wide sigma."""
ENTRANTS = {
    f"{kind}-{cost}": Entrant("hand", {"filter.kind": kind, "observation.cost": cost} | PLAIN)
    for kind in ("pf", "rbpf")
    for cost in ("paper", "union")
} | {
    f"{kind}-{name}": Entrant(configuration, {"filter.kind": kind})
    for kind in ("pf", "rbpf")
    for name, configuration in (("printed", "hand-paper"), ("default", "hand"))
}
"""Filter and cost, particles drawn from the motion, all else as in hand.toml; ``printed``: hand-paper, the
paper as printed; ``default``: hand.toml itself."""


@dataclass(frozen=True)
class Unit:
    """Which recording: motion A, B or C, at a speed, from a seed."""

    motion: str
    speed: float
    seed: int
    frames: int

    @property
    def name(self) -> str:
        """What its files are called by, such as ``C-2x-101-150``."""
        return f"{self.motion}-{self.speed:g}x-{self.seed:03d}-{self.frames}"

    def result(self, folder: Path, entrant: str) -> Path:
        """Where an entrant's result lies."""
        return folder / f"{self.name}-{entrant}.mcap"

    def options(self) -> SynthOptions:
        """How the recording is made: A and B bare, as in the paper; C with all that a Kinect sees."""
        switches = Switches.usual(self.motion)
        return SynthOptions(self.motion, self.frames, self.seed, self.speed, switches=switches)


@click.command()
@click.option("--motion", type=click.Choice(["A", "B", "C"]), required=True)
@click.option("--speed", type=float, required=True)
@click.option("--seed", type=int, required=True)
@click.option("--frames", type=int, required=True)
@click.option("--entrants", required=True, help="Names, comma-separated.")
@click.option("--out", type=click.Path(path_type=Path), required=True)
def main(motion: str, speed: float, seed: int, frames: int, entrants: str, out: Path) -> None:
    """Make the recording, track it by every entrant, delete it."""
    run_unit(Unit(motion, speed, seed, frames), entrants.split(","), out)


def run_unit(unit: Unit, entrants: list[str], out: Path) -> None:
    """Track a unit by the entrants whose results are not there yet."""
    missing = [entrant for entrant in entrants if not is_current(unit.result(out, entrant), entrant)]
    if not missing:
        return
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / f"{unit.name}.mcap"
        write_synthetic(unit.options(), recording)
        device = open_fastest_device()
        for entrant in missing:
            track(recording, unit, entrant, unit.result(out, entrant), device)


def configuration(entrant: str) -> HandConfig:
    """An entrant's resolved configuration; nobody looks at the mesh, so none is written."""
    chosen = ENTRANTS[entrant]
    changes = chosen.changes | {"output.mesh": "none"}
    return load_settings(HandConfig, find_configuration(chosen.configuration), changes)


def is_current(result: Path, entrant: str) -> bool:
    """Whether a finished result of this posetrack and of the entrant's configuration is there."""
    if not result.exists():
        return False
    run = read_result(result).run
    stated = json.dumps(configuration(entrant).model_dump(mode="json"))
    return (run.get("sources"), run["configuration"]) == (source_digest(), stated)


def track(recording: Path, unit: Unit, entrant: str, result: Path, device: RenderingDevice) -> None:
    """Track a recording; C starts as ``--init center``, A and B from the true pose, which is anywhere.

    The tracker's seed is the unit's: entrants over the same recording are pairs.
    """
    config = configuration(entrant)
    init = "center" if unit.motion == "C" else str(recording)
    options = RunOptions(result, seed=unit.seed, init=init, overwrite=True)
    HandRun(open_recording(recording), config, options, device).track(lambda estimate: None)


if __name__ == "__main__":
    main()
