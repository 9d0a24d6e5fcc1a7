"""What the hand tracker reaches, per configuration, on seeds that were never used for tuning.

Usage: scripts/reproduce hand-accuracy [-o out/hand-accuracy] [--seeds 20] [--kinect FOLDER] [--cvar FOLDER]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import click

from posetrack_cli import __version__
from posetrack_cli.rendering.devices import open_device
from reproduction.accuracy.filters import Filters
from reproduction.accuracy.measuring import Measured
from reproduction.accuracy.options import FIRST_SEED, Options, Part, Targets
from reproduction.accuracy.other_hands import OtherHands
from reproduction.accuracy.own_model import OwnModel
from reproduction.accuracy.real import HeadMounted, Kinect
from reproduction.accuracy.speed import Speed
from reproduction.accuracy.tasks import Task
from reproduction.closing import close_study, write_study
from reproduction.processes import run_modules

PARTS: tuple[Part, ...] = (Speed(), OwnModel(), Filters(), OtherHands(), Kinect(), HeadMounted())
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
QUICK_SEEDS, QUICK_FRAMES = 2, 20


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "-o", "--output", default=Path("out/hand-accuracy"), type=click.Path(path_type=Path), show_default=True
)
@click.option(
    "--seeds", default=20, show_default=True, type=click.IntRange(1), help="Recordings per condition."
)
@click.option(
    "--frames", default=300, show_default=True, type=click.IntRange(2), help="Frames per recording."
)
@click.option(
    "--hand-seeds", default=3, show_default=True, type=click.IntRange(1), help="Recordings per hand."
)
@click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1))
@click.option("--kinect", type=FOLDER, help="Folder of the real Kinect v2 recording.")
@click.option("--cvar", type=FOLDER, help="Folder with the head-mounted recordings P1 and P4.")
@click.option(
    "--hand-mesh", "mesh", type=click.Path(path_type=Path, exists=True), help="GLB of one more hand."
)
@click.option(
    "--only",
    "chosen",
    multiple=True,
    type=click.Choice([part.name for part in PARTS]),
    help="Do this part alone; repeatable.",
)
@click.option(
    "--first-seed",
    default=FIRST_SEED,
    show_default=True,
    type=click.IntRange(0),
    help="Of the recordings; smaller ones are for trying things out.",
)
@click.option(
    "--entrant",
    "entrants",
    multiple=True,
    help="Track with this one alone, such as hand or hand-pso; repeatable.",
)
@click.option("--quick", is_flag=True, help=f"Try it out: {QUICK_SEEDS} recordings of {QUICK_FRAMES} frames.")
def main(
    output: Path,
    seeds: int,
    frames: int,
    hand_seeds: int,
    jobs: int,
    kinect: Path | None,
    cvar: Path | None,
    mesh: Path | None,
    chosen: tuple[str, ...],
    first_seed: int,
    entrants: tuple[str, ...],
    quick: bool,
) -> None:
    """Measure accuracy, intervals, recovery and speed; everything goes to the output folder, report.md tells.

    Tracks that the same code made with the same arguments are kept: an interrupted study goes on where it
    stopped. Times are measured first, with one run at a time.
    """
    if quick:
        seeds, frames, hand_seeds = QUICK_SEEDS, QUICK_FRAMES, 1
    kinect, cvar, mesh = (path and path.resolve() for path in (kinect, cvar, mesh))
    options = Options(output, seeds, frames, hand_seeds, jobs, kinect, cvar, mesh, first_seed, entrants)
    options.runs.mkdir(parents=True, exist_ok=True)
    parts = [part for part in PARTS if not chosen or part.name in chosen]
    failures = [line for part in parts for line in _track(part, options)]
    _report(parts, options, failures)
    close_study(output, failures)


def _track(part: Part, options: Options) -> list[str]:
    """Track what a part needs; times are taken with nothing else running."""
    jobs = 1 if part.name == Speed.name else options.jobs
    tasks = [_of_chosen(task, options.entrants) for task in part.tasks(options)]
    commands = {task.name: _command(task, options) for task in tasks if task.entrants}
    return run_modules(commands, jobs, part.name, one_core=part.name != Speed.name) if commands else []


def _of_chosen(task: Task, entrants: Sequence[str]) -> Task:
    """The task of the chosen entrants alone, of all where none is chosen."""
    chosen = {name: arguments for name, arguments in task.entrants.items() if name in entrants}
    return replace(task, entrants=chosen) if entrants else task


def _command(task: Task, options: Options) -> list[str]:
    return ["reproduction.accuracy.tasks", task.text, str(options.runs)]


def _report(parts: Sequence[Part], options: Options, failures: Sequence[str]) -> None:
    measured, targets = Measured(options.runs), Targets()
    lines = (part.lines(options, measured, targets) for part in parts)
    figures = options.output / "accuracy.json"
    write_study(figures, _head(options), lines, targets, lambda: measured.everything, failures)


def _head(options: Options) -> Iterable[str]:
    device = open_device()
    renderer = str(device.info)
    device.close()
    yield "# What the hand tracker reaches"
    yield ""
    kept = ", none of them used for tuning" if options.first_seed >= FIRST_SEED else ""
    last = options.first_seed + options.seeds - 1
    yield (
        f"posetrack {__version__}; seeds {options.first_seed} to {last}{kept}; "
        f"{os.cpu_count()} cores; renderer: {renderer}."
    )
    yield ""


if __name__ == "__main__":
    main()
