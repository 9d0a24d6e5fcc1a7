"""How a study of a tracker is run: its command line, its parts, its report and its figures as JSON."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import click

from posetrack_cli.build import version
from posetrack_cli.errors import EXIT_DATA_LOST
from posetrack_cli.evaluation.reports.report_files import finite

FIRST_SEED = 201
"""Seeds from here on were not used for tuning."""
FOLDER = click.Path(path_type=Path, exists=True, file_okay=False, resolve_path=True)
Command = TypeVar("Command", bound=Callable[..., Any])


@dataclass(frozen=True)
class Targets:
    """What was reached of what was asked for, filled in by the parts of the study."""

    rows: list[tuple[str, str, str, str]] = field(default_factory=list)

    def add(self, what: str, target: str, measured: str, reached: bool | None) -> None:
        """Keep a figure: what it is, what was asked for, what came out; None where nothing was measured."""
        said = {True: "reached", False: "**missed**", None: "not measured"}[reached]
        self.rows.append((what, target, measured, said))


class StudyOptions(Protocol):
    """What the options of every study have."""

    @property
    def output(self) -> Path:
        """Folder of everything."""


class Figures(Protocol):
    """What a study measured."""

    @property
    def everything(self) -> object:
        """All figures that were read so far, as JSON has them."""


OptionsT = TypeVar("OptionsT", bound=StudyOptions)
AnyOptions = TypeVar("AnyOptions", contravariant=True)
AnyFigures = TypeVar("AnyFigures", contravariant=True)


class Part(Protocol[AnyOptions, AnyFigures]):
    """One part of a study, and what it says about the results of its recordings."""

    name: str

    def lines(self, options: AnyOptions, measured: AnyFigures, targets: Targets) -> Iterator[str]:
        """The report, in Markdown; figures go to ``options.output``."""


PartT = TypeVar("PartT", bound=Part[Any, Any])


@dataclass(frozen=True)
class Study(Generic[OptionsT, PartT]):
    """A study: parts that are made, measured and reported.

    Attributes:
        name: of the folder below ``out`` that it is written to by default.
        figures: name of the JSON file of what was measured.
        parts: all of them.
        make: makes what parts need, so many processes at a time; returns what went wrong, a line each.
        measured: opens what was made.
        head: begin of the report.
        report: name of its file.
    """

    name: str
    figures: str
    parts: tuple[PartT, ...]
    make: Callable[[Sequence[PartT], OptionsT, int], list[str]]
    measured: Callable[[OptionsT], Figures]
    head: Callable[[OptionsT], Iterable[str]]
    report: str = "report.md"

    def command(self, function: Command) -> click.Command:
        """Make a command that begins with the option of the output folder."""
        place = click.Path(path_type=Path)
        names, default = ("-o", "--out", "--output"), Path("out", self.name)
        option = click.option(*names, "output", default=default, type=place, show_default=True)
        return click.command(context_settings={"help_option_names": ["-h", "--help"]})(option(function))

    def running_options(self, first: str, quick: str) -> Callable[[Command], Command]:
        """Add what every study's command ends with.

        Args:
            first: the option of the first seed.
            quick: what ``--quick`` does less.
        """
        seed_help = "Of what is made; smaller ones than the default are for trying things out."
        seed = click.option(
            first, default=FIRST_SEED, show_default=True, type=click.IntRange(0), help=seed_help
        )
        trial = click.option("--quick", is_flag=True, help=f"Try it out: {quick}.")
        return lambda function: self.choosing_options(seed(trial(function)))

    def choosing_options(self, function: Command) -> Command:
        """Add how many processes run at a time, and which parts of the study are done."""
        parts = click.Choice([part.name for part in self.parts])
        jobs = click.option("--jobs", default=os.cpu_count() or 1, show_default=True, type=click.IntRange(1))
        told = "Do this part alone; repeatable."
        chosen = click.option("--part", "--only", "chosen", multiple=True, type=parts, help=told)
        return jobs(chosen(function))

    def run(self, options: OptionsT, chosen: Sequence[str], jobs: int) -> None:
        """Do the chosen parts, all where none is; write the report and say where it is.

        Ends the process with the exit code of data lost where recordings failed.
        """
        options.output.mkdir(parents=True, exist_ok=True)
        parts = [part for part in self.parts if not chosen or part.name in chosen]
        failures = self.make(parts, options, jobs)
        self._write(parts, options, failures)
        click.echo(f"written: {options.output / self.report}")
        if failures:
            click.echo(f"{len(failures)} recordings failed, first {failures[0]}", err=True)
            sys.exit(EXIT_DATA_LOST)

    def _write(self, parts: Sequence[PartT], options: OptionsT, failures: Sequence[str]) -> None:
        """Write the report, and beside it the figures; all parts are read first: they fill the targets."""
        measured, targets = self.measured(options), Targets()
        body = [line for part in parts for line in part.lines(options, measured, targets)]
        lines = [*self.head(options), *_summary(targets), *body, *_failed(failures)]
        (options.output / self.report).write_text("\n".join(lines) + "\n", encoding="utf-8")
        found = {"targets": targets.rows, "figures": measured.everything, "failures": list(failures)}
        text = json.dumps(finite(found), indent=1, ensure_ascii=False) + "\n"
        (options.output / self.figures).write_text(text, encoding="utf-8")


def thesis_head(title: str, chapter: int, tracker: str, persons: range) -> Iterator[str]:
    """Yield the begin of a report on a chapter of the thesis.

    Args:
        title: of the report.
        chapter: of the thesis.
        tracker: name of our configuration.
        persons: seeds of the synthetic persons.
    """
    yield f"# {title}"
    yield ""
    yield (
        "Sugano, *User-independent techniques for real-time estimation of non-rigid 3D head motion* (2007), "
        f"chapter {chapter}, by posetrack {version()}. Synthetic persons {persons[0]} to "
        f"{persons[-1]}{unused_for_tuning(persons[0])}; {os.cpu_count()} cores."
    )
    yield ""
    yield (
        f"`{tracker}` is our default; `{tracker}-paper` is the thesis's method as printed, as far as there "
        f"are keys (`docs/method.md` lists what is ours all the same)."
    )
    yield ""


def unused_for_tuning(first_seed: int) -> str:
    """Return what a report says of seeds that nothing was tuned on; nothing of others."""
    return ", none of them used for tuning" if first_seed >= FIRST_SEED else ""


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterable[str]:
    """Lines of a Markdown table and an empty one."""
    yield f"| {' | '.join(header)} |"
    yield "|---" * len(header) + "|"
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""


def _summary(targets: Targets) -> Iterable[str]:
    if targets.rows:
        yield "## Asked for and reached"
        yield ""
        yield from table(("", "asked for", "measured", ""), targets.rows)


def _failed(failures: Sequence[str]) -> Iterable[str]:
    if failures:
        yield f"{len(failures)} recordings failed and are left out:"
        yield ""
        yield from (f"- {failure}" for failure in failures)
