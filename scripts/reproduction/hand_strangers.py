"""What the hand tracker does on people that are not its model: accuracy, start, honesty, smoothing.

Usage: scripts/reproduce hand-strangers [--out out/hand-strangers] [--people 800-819] [--part mesh] [--jobs N]
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import click

from posetrack_cli.build import version
from posetrack_cli.errors import PosetrackError
from reproduction.processes import run_modules
from reproduction.running import FOLDER, Study
from reproduction.strangers import tool as tools
from reproduction.strangers.choices import Choices
from reproduction.strangers.default import Defaults
from reproduction.strangers.free_elbow import FreeElbow
from reproduction.strangers.honesty import Honesty
from reproduction.strangers.measuring import Measured
from reproduction.strangers.mesh import OwnMesh
from reproduction.strangers.options import AnyTask, Options, Part
from reproduction.strangers.people import people_of
from reproduction.strangers.shape import Shapes
from reproduction.strangers.sheet import Sheets
from reproduction.strangers.smooth import Smoothing
from reproduction.strangers.tasks import Task, merged
from reproduction.strangers.told import Told

NAME = "hand-strangers"
PARTS: tuple[Part, ...] = (
    OwnMesh(),
    Defaults(),
    FreeElbow(),
    Honesty(),
    Smoothing(),
    Sheets(),
    Told(),
    Choices(),
    Shapes(),
)


def _make(parts: Sequence[Part], options: Options, jobs: int) -> list[str]:
    """Track what parts need; a recording that several need is made once."""
    options.runs.mkdir(parents=True, exist_ok=True)
    wanted = [task for task in _tasks(parts, options) if not _is_made(task, options)]
    commands = {task.name: _command(task, options) for task in wanted}
    return run_modules(commands, jobs, NAME) if commands else []


def _tasks(parts: Sequence[Part], options: Options) -> list[AnyTask]:
    every = [task for part in parts for task in part.tasks(options)]
    others = merged(task for task in every if not isinstance(task, Task))
    return [*merged(task for task in every if isinstance(task, Task)), *others]


def _is_made(task: AnyTask, options: Options) -> bool:
    return all(task.is_current(options.runs, entrant) for entrant in task.entrants)


def _command(task: AnyTask, options: Options) -> list[str]:
    return [type(task).__module__, task.text, str(options.runs)]


def _head(options: Options) -> Iterable[str]:
    yield "# What the hand tracker does on strangers"
    yield ""
    people = ", ".join(str(person.number) for person in options.people)
    yield (
        f"posetrack {version()}; {len(options.people)} people ({people}), who are drawn by "
        f"`{options.tool.name}`, digest {tools.tool_digest(options.tool)[:12]}; {options.frames} frames "
        f"each; {'with' if options.cvar else 'without'} the head-mounted recordings; {os.cpu_count()} cores."
    )
    yield ""


STUDY = Study(
    NAME, f"{NAME}.json", PARTS, _make, lambda options: Measured(options.runs), _head, report=f"{NAME}.md"
)


@STUDY.command
@click.option("--people", default="800-819", show_default=True, help="Whom: numbers, ranges, commas.")
@click.option("--final", is_flag=True, help="Allow people from 900 on: final measurements, never tuning.")
@click.option(
    "--frames", default=300, show_default=True, type=click.IntRange(2), help="Frames per recording."
)
@click.option("--sheets", help="Of whom the part sheet makes pictures, as --people.  [default: of all]")
@click.option(
    "--tool",
    type=click.Path(path_type=Path),
    help="Path of foreign_hand.py.  [default: that in ../shared/tools]",
)
@click.option(
    "--cvar", type=FOLDER, help="Folder with P1, P4, P7.  [default: ../shared/data/cvar-hand, if there]"
)
@STUDY.choosing_options
def main(
    output: Path,
    people: str,
    final: bool,
    frames: int,
    sheets: str | None,
    tool: Path | None,
    cvar: Path | None,
    jobs: int,
    chosen: tuple[str, ...],
) -> None:
    """Measure the hand tracker on hands that it has no model of, made by a tool outside the project.

    Results that the same code made with the same arguments are kept: an interrupted study goes on where it
    stopped. Written are hand-strangers.md and hand-strangers.json.
    """
    try:
        options = Options(
            output,
            tools.found_tool(tool),
            people_of(people, final=final),
            people_of(sheets or people, final=final),
            frames,
            cvar or (tools.CVAR if tools.CVAR.is_dir() else None),
        )
        STUDY.run(options, chosen, jobs)
    except PosetrackError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main()
