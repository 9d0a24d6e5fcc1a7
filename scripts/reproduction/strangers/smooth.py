"""The smoothed track of the recordings with the person's own mesh, against the filtered one."""

from __future__ import annotations

import math
from collections.abc import Iterator

from posetrack_cli.results.tracks import SMOOTHED
from reproduction.running import Targets
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, EXACT, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import (
    Column,
    Value,
    judge_count,
    judge_most,
    max_of,
    noted,
    people_table,
    values_of,
)
from reproduction.strangers.tasks import Task

LEAST_SHARE = 0.9
"""Of how many people smoothing is to be better: of 18 of 20."""
MOST_RATIO = 1.02
COLUMNS = (
    Column("filtered_error_mm", "filtered, mm", whole="mean"),
    Column("smoothed_error_mm", "smoothed, mm", whole="mean"),
    Column("ratio", "ratio", 3, target=f"< 1 on 90 %, all <= {MOST_RATIO:g}", whole="max"),
)


class Smoothing:
    """Does it help, and does it ever harm?"""

    name = "smooth"

    def tasks(self, options: Options) -> list[Task]:
        """Everybody, with the arm; the same runs as those of the part ``mesh``."""
        return [options.task(person, ARM, EXACT) for person in options.people]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person."""
        yield "## Smoothed against filtered"
        yield ""
        yield "Mean joint errors with the exact mesh. Ratio: smoothed over filtered; of all, the worst."
        yield ""
        rows = {person: figures_of(person, options, measured) for person in options.people}
        noted(measured, self.name, rows)
        yield from people_table(COLUMNS, rows, "all: means, worst ratio")
        ratios = values_of(rows, "ratio")
        people, better = len(ratios), int((ratios < 1.0).sum())
        judge_count(targets, "smoothing: better", math.ceil(LEAST_SHARE * people), better, people)
        judge_most(targets, "smoothing: worst ratio", MOST_RATIO, max_of(ratios), 3)


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by the columns' names."""
    task = options.task(person, ARM, EXACT)
    filtered, smoothed = measured.error(task, EXACT), measured.error(task, EXACT, SMOOTHED)
    return {
        "filtered_error_mm": filtered,
        "smoothed_error_mm": smoothed,
        "ratio": smoothed / filtered,
    }
