"""What the head trackers do on people that nothing was tuned on: with one camera, and with two.

Usage: scripts/reproduce heads-strangers --heads FOLDER [--tuned FOLDER] [--part mono] [--jobs N]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from posetrack_cli.build import version
from posetrack_cli.errors import PosetrackError
from reproduction.head_strangers.adjusting import Adjusting
from reproduction.head_strangers.measuring import Measured
from reproduction.head_strangers.mono import Mono
from reproduction.head_strangers.options import Options, Part
from reproduction.head_strangers.size import Told
from reproduction.head_strangers.stereo import Stereo
from reproduction.running import FOLDER, Study
from reproduction.steps import run_chains

NAME = "heads-strangers"
PARTS: tuple[Part, ...] = (Mono(), Told(), Adjusting(), Stereo())


def _make(parts: Sequence[Part], options: Options, jobs: int) -> list[str]:
    return run_chains((chain for part in parts for chain in part.chains(options)), options.output, jobs)


def _head(options: Options) -> Iterable[str]:
    yield "# What the head trackers do on strangers"
    yield ""
    names = ", ".join(folder.name for folder in options.strangers)
    told = "what is shipped" if options.left_out is None else "what was learned from the others"
    yield (
        f"posetrack {version()}; strangers: {names}, with one camera tracked with {told}; "
        f"{os.cpu_count()} cores."
    )
    yield ""


STUDY = Study(
    NAME, f"{NAME}.json", PARTS, _make, lambda options: Measured(options.output), _head, report=f"{NAME}.md"
)


@STUDY.command
@click.option(
    "--heads",
    type=FOLDER,
    required=True,
    help="Folder of strangers' recordings: left/, right/, calibration.json and truth.csv in each.",
)
@click.option("--tuned", type=FOLDER, help="Folder of recordings of the people that defaults were tuned on.")
@click.option(
    "--left-out",
    type=FOLDER,
    help="Folder of what was learned without each stranger, for one camera: NAME-features.npz of "
    "scripts/build-face-features --without NAME, NAME-model.npz of scripts/build-face-model --without NAME.  "
    "[default: what is shipped, which has learned from some]",
)
@click.option("--person", "only", multiple=True, metavar="NAME", help="Track this person alone; repeatable.")
@STUDY.choosing_options
def main(
    output: Path,
    heads: Path,
    tuned: Path | None,
    left_out: Path | None,
    only: tuple[str, ...],
    jobs: int,
    chosen: tuple[str, ...],
) -> None:
    """Measure the head trackers on people that nothing was tuned on, with defaults.

    Results that the same code made with the same arguments are kept: an interrupted study goes on where it
    stopped. Written are heads-strangers.md and heads-strangers.json.
    """
    try:
        STUDY.run(Options(output, heads, tuned, only, left_out), chosen, jobs)
    except PosetrackError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main()
