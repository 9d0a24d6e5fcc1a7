"""Redo experiment 3.4 of Sugano's thesis, and measure the stereo head tracker on faces that it never saw.

Usage: scripts/reproduce stereo [-o out/stereo] [--heads FOLDER] [--identities 3] [--quick]
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import click

from reproduction.heads.comparison import Comparison
from reproduction.heads.conditions import CONDITIONS, Conditions
from reproduction.heads.experiment import Experiment
from reproduction.heads.measuring import Measured
from reproduction.heads.options import EXPERIMENT_FRAMES, FRAMES, IDENTITIES, Options, Part
from reproduction.heads.people import People
from reproduction.processes import run_modules
from reproduction.running import FOLDER, Study, thesis_head

_PEOPLE, _CONDITIONS = People(), Conditions()
PARTS: tuple[Part, ...] = (_PEOPLE, _CONDITIONS, Comparison((_PEOPLE, _CONDITIONS)), Experiment())
QUICK_FRAMES, QUICK_EXPERIMENT_FRAMES = 150, 240
QUICK_CONDITIONS = ("slow light", "occlusion")


def _make(parts: Sequence[Part], options: Options, jobs: int) -> list[str]:
    failures = []
    for part in parts:
        out = str(options.output)
        tasks = {task.name: ["reproduction.heads.tasks", task.text, out] for task in part.tasks(options)}
        failures += run_modules(tasks, jobs, part.name) if tasks else []
    return failures


def _head(options: Options) -> Iterable[str]:
    return thesis_head("Head pose and face deformation from two cameras", 3, "head-stereo", options.persons)


STUDY = Study("stereo", "stereo.json", PARTS, _make, lambda options: Measured(options.output), _head)


@STUDY.command
@click.option(
    "--heads",
    type=FOLDER,
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
@click.option(
    "--condition",
    "conditions",
    multiple=True,
    type=click.Choice(list(CONDITIONS)),
    help="Do this one alone; repeatable.",
)
@STUDY.running_options(
    "--first-identity",
    f"one person, {len(QUICK_CONDITIONS)} conditions of {QUICK_FRAMES} frames, {QUICK_EXPERIMENT_FRAMES} "
    "frames of the experiment",
)
def main(jobs: int, chosen: tuple[str, ...], quick: bool, **values: Any) -> None:
    """Redo experiment 3.4 and measure accuracy; everything goes to the output folder, report.md tells.

    Synthetic recordings are kept there and drawn anew only when the code that draws them has changed. Tracks
    that the same code made with the same arguments are kept: an interrupted study goes on where it stopped.
    """
    if quick:
        values |= {"identities": 1, "frames": QUICK_FRAMES, "experiment_frames": QUICK_EXPERIMENT_FRAMES}
        values["conditions"] = values["conditions"] or QUICK_CONDITIONS
    STUDY.run(Options(**values), chosen, jobs)


if __name__ == "__main__":
    main()
