"""Redo experiments A, B and C of Sugano's thesis, and measure the one-camera head tracker on other faces.

Usage: scripts/reproduce mono [-o out/mono] [--heads FOLDER] [--clips FOLDER] [--people 6] [--quick]
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import click

from reproduction.one_camera.clips import Clips
from reproduction.one_camera.comparing import Population
from reproduction.one_camera.experiments import Experiments
from reproduction.one_camera.measuring import Measured
from reproduction.one_camera.options import (
    FRAMES,
    LEAST_MOTION_FRAMES,
    MODEL_PEOPLE,
    MOTION_FRAMES,
    PEOPLE,
    Options,
    Part,
)
from reproduction.one_camera.people import People
from reproduction.running import FOLDER, Study, thesis_head
from reproduction.steps import run_chains

PARTS: tuple[Part, ...] = (People(), Clips(), Experiments(), Population())
QUICK_PEOPLE, QUICK_MODEL_PEOPLE, QUICK_FRAMES = 1, 6, 180
"""A model of ten identity dimensions needs five persons, and experiment B one more."""


def _make(parts: Sequence[Part], options: Options, jobs: int) -> list[str]:
    return run_chains((chain for part in parts for chain in part.chains(options)), options.output, jobs)


def _head(options: Options) -> Iterable[str]:
    return thesis_head("Head pose and face deformation from one camera", 4, "head-mono", options.modelled)


STUDY = Study("mono", "mono.json", PARTS, _make, lambda options: Measured(options.output), _head)


@STUDY.command
@click.option(
    "--heads",
    type=FOLDER,
    help="Folder of recordings with left/, right/, calibration.json and truth.csv each.",
)
@click.option("--clips", type=FOLDER, help="Folder of videos of faces.")
@click.option(
    "--people",
    default=PEOPLE,
    show_default=True,
    type=click.IntRange(1),
    help="Test persons, the first of those that the model is built from.",
)
@click.option(
    "--model-people",
    default=MODEL_PEOPLE,
    show_default=True,
    type=click.IntRange(6),
    help="Persons that the model is built from.",
)
@click.option(
    "--frames",
    default=FRAMES,
    show_default=True,
    type=click.IntRange(60),
    help="Frames per test recording.",
)
@click.option(
    "--motion-frames",
    default=MOTION_FRAMES,
    show_default=True,
    type=click.IntRange(LEAST_MOTION_FRAMES),
    help="Frames per recording of the two motions that the model is built from.",
)
@STUDY.running_options(
    "--first-identity",
    f"a person of {QUICK_FRAMES} frames, a model of {QUICK_MODEL_PEOPLE} persons of "
    f"{LEAST_MOTION_FRAMES} frames",
)
def main(jobs: int, chosen: tuple[str, ...], quick: bool, **values: Any) -> None:
    """Redo experiments A, B, C and measure accuracy; everything goes to the output folder, report.md tells.

    Recordings and tracks that the same code made with the same arguments are kept: an interrupted study goes
    on where it stopped.
    """
    if quick:
        values |= {"people": QUICK_PEOPLE, "model_people": QUICK_MODEL_PEOPLE}
        values |= {"frames": QUICK_FRAMES, "motion_frames": LEAST_MOTION_FRAMES}
    options = Options(**values)
    if options.people > options.model_people:
        modelled = f"only {options.model_people} are in the model (--model-people)"
        raise click.UsageError(f"--people {options.people}: {modelled}")
    STUDY.run(options, chosen, jobs)


if __name__ == "__main__":
    main()
