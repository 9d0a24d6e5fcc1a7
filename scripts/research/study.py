"""A study: parts with jobs and report sections, and its command line.

Usage: PYTHONPATH=scripts .venv/bin/python -m research.study NAME [OPTIONS]; see scripts/reproduce.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import click
from click.core import ParameterSource

from posetrack_cli.errors import EXIT_DATA_LOST, PosetrackError
from research.report import Report
from research.runner import Files, Job, run_jobs

NAMES = ("hand", "hand-accuracy", "hand-strangers", "heads-strangers", "stereo", "mono")
FIRST_SEED = 201  # seeds from this one on were not used for tuning
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False, resolve_path=True)
HEADS = "Folder of recordings with left/, right/, calibration.json, truth.csv."


def setting(flag: str, default: Any, text: str, least: int = 1, **more: Any) -> Any:
    """Declare an option of a study as a dataclass field.

    Args:
        flag: name on the command line.
        default: default value.
        text: help text.
        least: minimum of a number.
        more: further parameters of ``click.option``.
    """
    number = {"type": click.IntRange(least), "show_default": True} if isinstance(default, int) else {}
    return field(default=default, metadata={"flag": flag, "more": {"help": text, **number, **more}})


class Part(NamedTuple):
    """One part of a study: its name for ``--part``, its jobs, and the function that reports the outcome."""

    name: str
    jobs: Callable[[Any], Iterable[Job]]
    write: Callable[[Any, Files, Report], None]


@dataclass(frozen=True)
class Study:
    """A study."""

    name: str  # of the report, and of the default output folder below ``out``
    options: type  # dataclass with ``output`` (folder) and ``setting`` fields
    parts: Sequence[Part]
    head: Callable[[Any], Iterable[str]]  # returns title and first paragraph of the report
    about: str  # first paragraph of the help
    # options set by ``--quick`` unless given; empty for no such flag
    quick: Mapping[str, Any] = field(default_factory=dict)
    more: Sequence[Callable[[Any], Any]] = ()  # further click options
    made: Callable[..., Any] | None = None  # creates the options from the command line; default ``options``

    def command(self) -> click.Command:
        """Return the command, which runs the chosen parts (default: all) and prints the report's path.

        The command exits with EXIT_DATA_LOST if recordings failed.
        """

        def run(jobs: int, chosen: Sequence[str], **values: Any) -> None:
            source = click.get_current_context().get_parameter_source
            if values.pop("quick", False):
                values |= {k: v for k, v in self.quick.items() if source(k) is ParameterSource.DEFAULT}
            try:
                failures = self._run((self.made or self.options)(**values), chosen, jobs)
            except PosetrackError as error:
                raise click.ClickException(str(error)) from error
            if failures:
                click.echo(f"{len(failures)} recordings failed, first {failures[0]}", err=True)
                sys.exit(EXIT_DATA_LOST)

        parts = click.Choice([part.name for part in self.parts])
        path = click.Path(path_type=Path)
        quick = click.option("--quick", is_flag=True, help="Smoke test with little data.")
        options = [
            click.option(
                "-o",
                "--out",
                "--output",
                "output",
                default=Path("out", self.name),
                type=path,
                show_default=True,
            ),
            *(
                click.option(one.metadata["flag"], one.name, default=one.default, **one.metadata["more"])
                for one in fields(self.options)
                if "flag" in one.metadata
            ),
            *self.more,
            *([quick] if self.quick else ()),
            click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1)),
            click.option(
                "--part", "--only", "chosen", multiple=True, type=parts, help="Only this part. Repeatable."
            ),
        ]
        for option in reversed(options):
            run = option(run)
        text = (
            f"{self.about}\n\nFinished files of the same code and arguments are reused. The report is "
            f"{self.name}.md in the output folder."
        )
        settings = {"help_option_names": ["-h", "--help"]}
        return click.command(self.name, help=text, context_settings=settings)(run)

    def _run(self, options: Any, chosen: Sequence[str], jobs: int) -> list[str]:
        options.output.mkdir(parents=True, exist_ok=True)
        parts = [part for part in self.parts if not chosen or part.name in chosen]
        files = Files(options.output, (job for part in parts for job in part.jobs(options)))
        failures = run_jobs(files, jobs, self.name)
        report = Report()
        for part in parts:
            part.write(options, files, report)
        click.echo(f"written: {report.write(options.output, self.name, self.head(options), failures)}")
        return failures


def unused_for_tuning(first_seed: int) -> str:
    """Return a note for the report if the seeds were not used for tuning."""
    return ", none of them used for tuning" if first_seed >= FIRST_SEED else ""


def study_of(name: str) -> Study:
    """Return the study of a name."""
    found: Study = import_module(f"research.{name.replace('-', '_')}").STUDY
    return found


if __name__ == "__main__":
    if sys.argv[1:2] == [] or sys.argv[1] not in NAMES:
        wanted = f"scripts/reproduce {', '.join(NAMES[:-1])} or {NAMES[-1]} [OPTIONS]"
        click.echo(f"reproduce: which study? found '{' '.join(sys.argv[1:2])}', expected: {wanted}", err=True)
        sys.exit(2)
    study_of(sys.argv[1]).command()(sys.argv[2:], prog_name=f"scripts/reproduce {sys.argv[1]}")
