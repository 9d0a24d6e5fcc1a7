"""How a study of a tracker ends: report.md, its figures as JSON, and what failed."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import click

from posetrack_cli.errors import EXIT_DATA_LOST
from posetrack_cli.evaluation.reports.json_report import finite
from reproduction.accuracy.measuring import table
from reproduction.accuracy.options import Targets


def write_study(
    path: Path,
    head: Iterable[str],
    parts: Iterable[Iterable[str]],
    targets: Targets,
    figures: Callable[[], object],
    failures: Sequence[str],
) -> None:
    """Write report.md, and beside it the figures.

    Args:
        path: JSON file of the figures; the report lies beside it.
        head: of the report, before what was asked for.
        parts: lines of each; all are read before anything is written, for they fill the targets.
        targets: what was asked for and reached.
        figures: everything measured, once the parts have been read.
        failures: what went wrong, a line each.
    """
    body = [line for part in parts for line in part]
    lines = [*head, *_summary(targets), *body, *_failed(failures)]
    (path.parent / "report.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = {"targets": targets.rows, "figures": figures(), "failures": list(failures)}
    text = json.dumps(finite(found), indent=1, ensure_ascii=False) + "\n"
    path.write_text(text, encoding="utf-8")


def close_study(output: Path, failures: Sequence[str]) -> None:
    """Say where the report is, and end with the exit code of data lost where recordings failed."""
    click.echo(f"written: {output / 'report.md'}")
    if failures:
        click.echo(f"{len(failures)} recordings failed, first {failures[0]}", err=True)
        sys.exit(EXIT_DATA_LOST)


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
