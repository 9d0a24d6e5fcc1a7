"""Redo experiments A, B and C of Sugano's thesis, and measure the one-camera head tracker on other faces.

Usage: scripts/reproduce mono [-o out/mono] [--heads FOLDER] [--clips FOLDER] [--people 6] [--quick]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from posetrack_cli import __version__
from reproduction.accuracy.options import FIRST_SEED, Targets
from reproduction.closing import close_study, write_study
from reproduction.one_camera.clips import Clips
from reproduction.one_camera.comparing import Population
from reproduction.one_camera.experiments import Experiments
from reproduction.one_camera.measuring import Measured
from reproduction.one_camera.options import (
    FRAMES,
    MODEL_PEOPLE,
    MOTION_FRAMES,
    PEOPLE,
    Options,
    Part,
)
from reproduction.one_camera.people import People
from reproduction.steps import run_chains

PARTS: tuple[Part, ...] = (People(), Clips(), Experiments(), Population())
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)
QUICK_PEOPLE, QUICK_MODEL_PEOPLE, QUICK_FRAMES, QUICK_MOTION_FRAMES = 1, 6, 180, 240
"""A model of ten identity dimensions needs five persons, and experiment B one more."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("-o", "--output", default=Path("out/mono"), type=click.Path(path_type=Path), show_default=True)
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
    type=click.IntRange(120),
    help="Frames per recording of the two motions that the model is built from.",
)
@click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1))
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
    help=f"Try it out: a person of {QUICK_FRAMES} frames, a model of {QUICK_MODEL_PEOPLE} persons of "
    f"{QUICK_MOTION_FRAMES} frames.",
)
def main(
    output: Path,
    heads: Path | None,
    clips: Path | None,
    people: int,
    model_people: int,
    frames: int,
    motion_frames: int,
    jobs: int,
    chosen: tuple[str, ...],
    first_identity: int,
    quick: bool,
) -> None:
    """Redo experiments A, B, C and measure accuracy; everything goes to the output folder, report.md tells.

    Recordings and tracks that the same code made with the same arguments are kept: an interrupted study goes
    on where it stopped.
    """
    if quick:
        people, model_people = QUICK_PEOPLE, QUICK_MODEL_PEOPLE
        frames, motion_frames = QUICK_FRAMES, QUICK_MOTION_FRAMES
    if people > model_people:
        raise click.UsageError(f"--people {people}: only {model_people} are in the model (--model-people)")
    heads, clips = (folder and folder.resolve() for folder in (heads, clips))
    options = Options(output, heads, clips, people, model_people, frames, motion_frames, first_identity)
    output.mkdir(parents=True, exist_ok=True)
    parts = [part for part in PARTS if not chosen or part.name in chosen]
    failures = run_chains((chain for part in parts for chain in part.chains(options)), output, jobs)
    _report(parts, options, failures)
    close_study(output, failures)


def _report(parts: Sequence[Part], options: Options, failures: Sequence[str]) -> None:
    measured, targets = Measured(options.output), Targets()
    lines = (part.lines(options, measured, targets) for part in parts)
    figures = options.output / "mono.json"
    write_study(figures, _head(options), lines, targets, lambda: measured.everything, failures)


def _head(options: Options) -> Iterable[str]:
    yield "# Head pose and face deformation from one camera"
    yield ""
    kept = ", none of them used for tuning" if options.first_identity >= FIRST_SEED else ""
    yield (
        "Sugano, *User-independent techniques for real-time estimation of non-rigid 3D head motion* (2007), "
        f"chapter 4, by posetrack {__version__}. Synthetic persons {options.modelled[0]} to "
        f"{options.modelled[-1]}{kept}; {os.cpu_count()} cores."
    )
    yield ""
    yield (
        "`head-mono` is our default; `head-mono-paper` is the thesis's method as printed, as far as there "
        "are switches (`configs/head-mono-paper.toml` says what is ours all the same)."
    )
    yield ""


if __name__ == "__main__":
    main()
