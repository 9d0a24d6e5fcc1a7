"""A study: parts with jobs to run and a report to write, and its command line."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import click

from posetrack_cli.errors import EXIT_DATA_LOST, PosetrackError
from research.report import Report
from research.runner import Files, Job, run_jobs

FIRST_SEED = 201
"""Seeds from here on were not used for tuning."""
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False, resolve_path=True)


class StudyOptions(Protocol):
    """What the options of every study have."""

    @property
    def output(self) -> Path:
        """Folder of everything."""


OptionsT = TypeVar("OptionsT", bound=StudyOptions)


@dataclass(frozen=True)
class Part(Generic[OptionsT]):
    """One part of a study.

    Attributes:
        name: for ``--part``.
        jobs: what has to be made.
        tell: writes what came out.
    """

    name: str
    jobs: Callable[[OptionsT], Iterable[Job]]
    tell: Callable[[OptionsT, Files, Report], None]


@dataclass(frozen=True)
class Study(Generic[OptionsT]):
    """A study.

    Attributes:
        name: of its report, and of the folder below ``out`` that it is written to by default.
        parts: all of them.
        head: begin of the report: its title, and a paragraph.
    """

    name: str
    parts: Sequence[Part[OptionsT]]
    head: Callable[[OptionsT], Iterable[str]]

    def command(self, *options: Callable[[Any], Any]) -> Callable[[Callable[..., Any]], click.Command]:
        """Make a command of a function that takes these options, ``output``, ``jobs`` and ``chosen``."""
        parts = click.Choice([part.name for part in self.parts])
        shared = (
            click.option(
                "-o", "--out", "--output", "output", default=Path("out", self.name),
                type=click.Path(path_type=Path), show_default=True,
            ),
            *options,
            click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1)),
            click.option(
                "--part", "--only", "chosen", multiple=True, type=parts, help="Only this part; repeatable."
            ),
        )  # fmt: skip

        def decorated(function: Callable[..., Any]) -> click.Command:
            for one in reversed(shared):
                function = one(function)
            return click.command(context_settings={"help_option_names": ["-h", "--help"]})(function)

        return decorated

    def run(self, options: OptionsT, chosen: Sequence[str], jobs: int) -> None:
        """Do the chosen parts, all if none is; write the report and print its path.

        Exits with the code of lost data if recordings failed.
        """
        try:
            failures = self._run(options, chosen, jobs)
        except PosetrackError as error:
            raise click.ClickException(str(error)) from error
        if failures:
            click.echo(f"{len(failures)} recordings failed, first {failures[0]}", err=True)
            sys.exit(EXIT_DATA_LOST)

    def _run(self, options: OptionsT, chosen: Sequence[str], jobs: int) -> list[str]:
        options.output.mkdir(parents=True, exist_ok=True)
        parts = [part for part in self.parts if not chosen or part.name in chosen]
        files = Files(options.output, (job for part in parts for job in part.jobs(options)))
        failures = run_jobs(files, jobs, self.name)
        report = Report()
        for part in parts:
            part.tell(options, files, report)
        click.echo(f"written: {report.write(options.output, self.name, self.head(options), failures)}")
        return failures


def integer(name: str, default: int, told: str, least: int = 1) -> Callable[[Any], Any]:
    """Return an option that takes a whole number."""
    return click.option(name, default=default, show_default=True, type=click.IntRange(least), help=told)


def unused_for_tuning(first_seed: int) -> str:
    """Return what a report says of seeds that nothing was tuned on; nothing of others."""
    return ", none of them used for tuning" if first_seed >= FIRST_SEED else ""
