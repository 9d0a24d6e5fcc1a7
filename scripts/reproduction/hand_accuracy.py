"""What the hand tracker reaches, per configuration, on seeds that were never used for tuning.

Usage: scripts/reproduce hand-accuracy [-o out/hand-accuracy] [--seeds 20] [--kinect FOLDER] [--cvar FOLDER]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from posetrack_cli.build import version
from posetrack_cli.rendering.devices import open_fastest_device
from reproduction.accuracy.filters import Filters
from reproduction.accuracy.measuring import Measured
from reproduction.accuracy.options import Options, Part
from reproduction.accuracy.other_hands import OtherHands
from reproduction.accuracy.own_model import OwnModel
from reproduction.accuracy.real import HeadMounted, Kinect
from reproduction.accuracy.speed import Speed
from reproduction.accuracy.tasks import Task
from reproduction.processes import run_modules
from reproduction.running import FOLDER, Study, unused_for_tuning

PARTS: tuple[Part, ...] = (Speed(), OwnModel(), Filters(), OtherHands(), Kinect(), HeadMounted())
QUICK_SEEDS, QUICK_FRAMES = 2, 20


def _make(parts: Sequence[Part], options: Options, jobs: int) -> list[str]:
    """Track what parts need; times are taken with nothing else running."""
    options.runs.mkdir(parents=True, exist_ok=True)
    failures = []
    for part in parts:
        timed = part.name == Speed.name
        tasks = [_of_chosen(task, options.entrants) for task in part.tasks(options)]
        commands = {task.name: _command(task, options) for task in tasks if task.entrants}
        failures += (
            run_modules(commands, 1 if timed else jobs, part.name, one_core=not timed) if commands else []
        )
    return failures


def _of_chosen(task: Task, entrants: Sequence[str]) -> Task:
    """The task of the chosen entrants alone, of all where none is chosen."""
    chosen = {name: arguments for name, arguments in task.entrants.items() if name in entrants}
    return replace(task, entrants=chosen) if entrants else task


def _command(task: Task, options: Options) -> list[str]:
    return ["reproduction.accuracy.tasks", task.text, str(options.runs)]


def _head(options: Options) -> Iterable[str]:
    device = open_fastest_device()
    renderer = str(device.info)
    device.close()
    first, last = options.first_seed, options.first_seed + options.seeds - 1
    yield "# What the hand tracker reaches"
    yield ""
    yield (
        f"posetrack {version()}; seeds {first} to {last}{unused_for_tuning(first)}; "
        f"{os.cpu_count()} cores; renderer: {renderer}."
    )
    yield ""


STUDY = Study("hand-accuracy", "accuracy.json", PARTS, _make, lambda options: Measured(options.runs), _head)


@STUDY.command
@click.option(
    "--seeds", default=20, show_default=True, type=click.IntRange(1), help="Recordings per condition."
)
@click.option(
    "--frames", default=300, show_default=True, type=click.IntRange(2), help="Frames per recording."
)
@click.option(
    "--hand-seeds", default=3, show_default=True, type=click.IntRange(1), help="Recordings per hand."
)
@click.option("--kinect", type=FOLDER, help="Folder of the real Kinect v2 recording.")
@click.option("--cvar", type=FOLDER, help="Folder with the head-mounted recordings P1 and P4.")
@click.option(
    "--hand-mesh",
    "mesh",
    type=click.Path(path_type=Path, exists=True, resolve_path=True),
    help="GLB of one more hand.",
)
@click.option(
    "--entrant",
    "entrants",
    multiple=True,
    help="Track with this one alone, such as hand or hand-pso; repeatable.",
)
@STUDY.running_options("--first-seed", f"{QUICK_SEEDS} recordings of {QUICK_FRAMES} frames")
def main(jobs: int, chosen: tuple[str, ...], quick: bool, **values: Any) -> None:
    """Measure accuracy, intervals, recovery and speed; everything goes to the output folder, report.md tells.

    Tracks that the same code made with the same arguments are kept: an interrupted study goes on where it
    stopped. Times are measured first, with one run at a time.
    """
    if quick:
        values |= {"seeds": QUICK_SEEDS, "frames": QUICK_FRAMES, "hand_seeds": 1}
    STUDY.run(Options(**values), chosen, jobs)


if __name__ == "__main__":
    main()
