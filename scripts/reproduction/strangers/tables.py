"""Tables of people: a row for each, then a row of all and one of what was asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from reproduction.accuracy.measuring import number
from reproduction.running import Targets, table
from reproduction.strangers.measuring import Measured
from reproduction.strangers.people import Person

NOTHING, NEVER = "-", "never"
INTERVALS = (0.80, 0.97)
"""How often 90 % intervals should hold the truth: less is overconfident, more says too little."""
Value = float | int | str | None
"""A figure of a person; NaN, None and an empty text are none."""


@dataclass(frozen=True)
class Column:
    """A figure of every person.

    Attributes:
        name: what JSON calls it.
        title: what tables call it, with its unit.
        digits: behind the point.
        percent: whether a share is shown in percent.
        target: what was asked for, in a cell; empty for nothing.
        whole: what the row of all shows: the ``mean``, the ``max`` or the ``sum`` of people, or nothing.
    """

    name: str
    title: str
    digits: int = 2
    percent: bool = False
    target: str = ""
    whole: str = ""

    def shown(self, value: Value) -> str:
        """A cell."""
        if value is None or value == "" or value != value:
            return NOTHING
        if isinstance(value, float):
            return number(value, self.digits, self.percent)
        return str(value)

    def of_all(self, values: Sequence[Value]) -> str:
        """The cell of all people; those without a figure are left out, and never is the largest."""
        if self.whole == "max" and NEVER in values:
            return NEVER
        known = numbers_of(values)
        if not self.whole or not len(known):
            return ""
        found = float(getattr(np, self.whole)(known))
        counts = self.whole != "mean" and not any(isinstance(value, float) for value in values)
        return self.shown(int(found) if counts else found)


def people_table(
    columns: Sequence[Column], rows: Mapping[Person, Mapping[str, Value]], all_title: str = "all"
) -> Iterator[str]:
    """Yield the table of some people.

    Args:
        columns: from the second on; the first is the person.
        rows: by person the figures by the columns' names.
        all_title: what the row of all is called.
    """
    cells = [
        [person.title, *(column.shown(figures.get(column.name)) for column in columns)]
        for person, figures in rows.items()
    ]
    given = {column.name: [figures.get(column.name) for figures in rows.values()] for column in columns}
    whole = [all_title, *(column.of_all(given[column.name]) for column in columns)]
    asked = ["**asked for**", *(column.target for column in columns)]
    yield from table(("person", *(column.title for column in columns)), [*cells, whole, asked])


def values_of(rows: Mapping[Person, Mapping[str, Value]], name: str) -> FloatArray:
    """A figure of the people that have it, (n,)."""
    return numbers_of([figures.get(name) for figures in rows.values()])


def numbers_of(values: Sequence[Value]) -> FloatArray:
    """The values that are numbers, (n,)."""
    numbers = [float(value) for value in values if isinstance(value, int | float)]
    return np.array([value for value in numbers if value == value])


def noted(measured: Measured, part: str, rows: Mapping[Person, Mapping[str, Value]]) -> None:
    """Keep the figures of people for the JSON file."""
    for person, figures in rows.items():
        side = {"side": person.side, "shows_back": person.shows_back}
        measured.note(part, str(person.number), {**side, **figures})


def judge_most(targets: Targets, what: str, most: float, value: float, digits: int = 2) -> None:
    """Judge a figure that may be so large at most; NaN was not measured."""
    known = value == value
    shown = number(value, digits) if known else NOTHING
    targets.add(what, f"<= {most:g}", shown, value <= most if known else None)


def judge_count(targets: Targets, what: str, least: int, count: int, people: int) -> None:
    """Judge of how many people something is true; of nobody was not measured."""
    known = people > 0
    shown = f"{count} of {people}" if known else NOTHING
    targets.add(what, f">= {least} of {people}" if known else "all", shown, count >= least if known else None)


def judge_intervals(targets: Targets, what: str, share: float | None) -> None:
    """Judge how often the truth lies within stated 90 % intervals; None was not measured."""
    low, high = INTERVALS
    shown = NOTHING if share is None else number(share, 1, percent=True)
    reached = None if share is None else low <= share <= high
    targets.add(what, f"{100 * low:g} to {100 * high:g} %", shown, reached)


def mean_of(values: FloatArray) -> float:
    """The mean, NaN of none."""
    return float(values.mean()) if len(values) else float("nan")


def max_of(values: FloatArray) -> float:
    """The largest, NaN of none."""
    return float(values.max()) if len(values) else float("nan")
