"""Redo experiment 3.4 of Sugano's thesis, and measure the stereo head tracker on faces that it never saw.

Usage: scripts/reproduce stereo [-o out/stereo] [--heads FOLDER] [--identities 3] [--quick]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from posetrack_cli import __version__
from reproduction.accuracy.options import FIRST_SEED, Targets
from reproduction.closing import close_study, write_study
from reproduction.heads.comparison import Comparison
from reproduction.heads.conditions import CONDITIONS, Conditions
from reproduction.heads.experiment import Experiment
from reproduction.heads.measuring import Measured
from reproduction.heads.options import EXPERIMENT_FRAMES, FRAMES, IDENTITIES, Options, Part
from reproduction.heads.people import People
from reproduction.processes import run_modules

_PEOPLE, _CONDITIONS = People(), Conditions()
PARTS: tuple[Part, ...] = (_PEOPLE, _CONDITIONS, Comparison((_PEOPLE, _CONDITIONS)), Experiment())
QUICK_FRAMES, QUICK_EXPERIMENT_FRAMES = 150, 240
QUICK_CONDITIONS = ("slow light", "occlusion")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "-o", "--output", default=Path("out/stereo"), type=click.Path(path_type=Path), show_default=True
)
@click.option(
    "--heads",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder of recordings with left/, right/, calibration.json and truth.csv each.",
)
@click.option(
    "--identities",
    default=IDENTITIES,
    show_default=True,
    type=click.IntRange(1),
    help="Persons per condition.",
)
@click.option(
    "--frames",
    default=FRAMES,
    show_default=True,
    type=click.IntRange(60),
    help="Frames per recording of the conditions.",
)
@click.option(
    "--experiment-frames",
    default=EXPERIMENT_FRAMES,
    show_default=True,
    type=click.IntRange(240),
    help="Frames of experiment 3.4.",
)
@click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1))
@click.option(
    "--condition",
    "conditions",
    multiple=True,
    type=click.Choice(list(CONDITIONS)),
    help="Do this one alone; repeatable.",
)
@click.option(
    "--only",
    "chosen",
    multiple=True,
    type=click.Choice([part.name for part in PARTS]),
    help="Do this part alone; repeatable.",
)
@click.option(
    "--first-identity",
    default=FIRST_SEED,
    show_default=True,
    type=click.IntRange(0),
    help="Of the synthetic persons; smaller ones are for trying things out.",
)
@click.option(
    "--quick",
    is_flag=True,
    help=f"Try it out: one person, {len(QUICK_CONDITIONS)} conditions of {QUICK_FRAMES} frames, "
    f"{QUICK_EXPERIMENT_FRAMES} frames of the experiment.",
)
def main(
    output: Path,
    heads: Path | None,
    identities: int,
    frames: int,
    experiment_frames: int,
    jobs: int,
    conditions: tuple[str, ...],
    chosen: tuple[str, ...],
    first_identity: int,
    quick: bool,
) -> None:
    """Redo experiment 3.4 and measure accuracy; everything goes to the output folder, report.md tells.

    Synthetic recordings are kept there and drawn anew only when the code that draws them has changed. Tracks
    that the same code made with the same arguments are kept: an interrupted study goes on where it stopped.
    """
    if quick:
        identities, frames, experiment_frames = 1, QUICK_FRAMES, QUICK_EXPERIMENT_FRAMES
        conditions = conditions or QUICK_CONDITIONS
    heads = heads and heads.resolve()
    options = Options(output, heads, experiment_frames, frames, identities, first_identity, conditions)
    output.mkdir(parents=True, exist_ok=True)
    parts = [part for part in PARTS if not chosen or part.name in chosen]
    failures = [line for part in parts for line in _track(part, options, jobs)]
    _report(parts, options, failures)
    close_study(output, failures)


def _track(part: Part, options: Options, jobs: int) -> list[str]:
    """Make and track what a part needs; return what went wrong, a line for each recording."""
    tasks = part.tasks(options)
    commands = {task.name: ["reproduction.heads.tasks", task.text, str(options.output)] for task in tasks}
    return run_modules(commands, jobs, part.name) if commands else []


def _report(parts: Sequence[Part], options: Options, failures: Sequence[str]) -> None:
    measured, targets = Measured(options.output), Targets()
    lines = (part.lines(options, measured, targets) for part in parts)
    figures = options.output / "stereo.json"
    write_study(figures, _head(options), lines, targets, lambda: measured.everything, failures)


def _head(options: Options) -> Iterable[str]:
    yield "# Head pose and face deformation from two cameras"
    yield ""
    kept = ", none of them used for tuning" if options.first_identity >= FIRST_SEED else ""
    yield (
        "Sugano, *User-independent techniques for real-time estimation of non-rigid 3D head motion* (2007), "
        f"chapter 3, by posetrack {__version__}. Synthetic persons {options.persons[0]} to "
        f"{options.persons[-1]}{kept}; {os.cpu_count()} cores."
    )
    yield ""
    yield (
        "`head-stereo` is our default; `head-stereo-paper` is the thesis's method as printed, as far as "
        "there are switches (`configs/head-stereo-paper.toml` says what is ours all the same)."
    )
    yield ""


if __name__ == "__main__":
    main()
