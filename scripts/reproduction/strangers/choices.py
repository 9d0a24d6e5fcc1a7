"""What the tracker's choices are worth on strangers: filter, cost, shape; and the swarm beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import paired
from reproduction.accuracy.measuring import PAIR_COLUMNS, mean_and_sd, pair_cells
from reproduction.running import Targets, table
from reproduction.strangers.default import NO_OFFSETS
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import (
    ARM,
    AVERAGE_HAND,
    DEFAULT,
    PAPER_COST,
    PLAIN_FILTER,
    SWARM,
    UNION_COST,
    Options,
)
from reproduction.strangers.people import Person
from reproduction.strangers.tables import NOTHING, Column, Value, noted, numbers_of, people_table
from reproduction.strangers.tasks import Task

ENTRANTS = {
    DEFAULT: "default",
    PLAIN_FILTER: "plain filter",
    PAPER_COST: "the paper's cost",
    UNION_COST: "union cost",
    SWARM: "swarm",
    AVERAGE_HAND: "average hand",
}
"""What is compared, and what tables call it."""
COLUMNS = tuple(Column(name, f"{title}, mm", whole="mean") for name, title in ENTRANTS.items())
RAW, NO_OFFSETS_LEFT, LOST = "", "_without_offsets", "_lost"
"""Ends of the names of figures, behind the entrant's: mean errors, mm, and frames."""
KINDS = {RAW: "raw", NO_OFFSETS_LEFT: "offsets removed"}


@dataclass(frozen=True)
class Question:
    """Two entrants, of which the second is hoped to be better."""

    asked: str
    first: str
    second: str


QUESTIONS = (
    Question("Does velocity help? RBPF after plain filter", PLAIN_FILTER, DEFAULT),
    Question("Which pixels cost? Union after the paper's", PAPER_COST, UNION_COST),
    Question("A mixture per pixel? Default after union", UNION_COST, DEFAULT),
    Question("Does the shape help? Estimated after average", AVERAGE_HAND, DEFAULT),
    Question("An optimiser instead? Default after swarm", SWARM, DEFAULT),
)


class Choices:
    """Everybody's recording, tracked in ways that differ from the default in one thing each."""

    name = "choices"

    def tasks(self, options: Options) -> list[Task]:
        """The recordings with the arm, by everything that is compared."""
        return [_task(person, options) for person in options.people]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per entrant, one per question and kind of error, one per person."""
        yield "## What filter, cost and shape are worth"
        yield ""
        yield (
            "The recordings of the part `default`, tracked again with one thing changed: `--filter pf`, "
            "`--cost paper`, `--cost union`, `--filter pso` (64 particles, 25 generations), all told the "
            "side and the shape that the default found, so that nothing else differs; and `--shape average`, "
            "told nothing: a hand of 179 mm, whatever the person's size. The filters' particles are drawn by "
            "the local fits. "
            "Errors are means over the joints and all frames, lost ones included; ± is the standard "
            "deviation over people."
        )
        yield ""
        rows = {person: figures_of(person, options, measured) for person in options.people}
        noted(measured, self.name, rows)
        every = list(rows.values())
        cells = [_entrant_cells(name, every) for name in ENTRANTS]
        yield from table(("", "people", "error, mm", "offsets removed, mm", "lost frames"), cells)
        yield (
            "A pair is a person, tracked both ways. Differences are the second minus the first, mm: below 0 "
            "the second is better. Their interval is Efron's bootstrap, p that of Wilcoxon's signed-rank "
            "test, two-sided."
        )
        yield ""
        titles = ("", "errors", "pairs", "first", "second", *PAIR_COLUMNS, "second better on")
        found = {(one, kind): _pairs(one, kind, every) for one in QUESTIONS for kind in KINDS}
        yield from table(titles, [_question_cells(*asked, pairs) for asked, pairs in found.items()])
        for (one, kind), pairs in found.items():
            measured.note(f"{self.name}, paired", f"{one.second}-{one.first}{kind}", asdict(paired(*pairs.T)))
        yield from people_table(COLUMNS, rows)


def _task(person: Person, options: Options) -> Task:
    return options.task(person, ARM, *ENTRANTS)


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by entrant and kind; those of entrants without a result are missing."""
    task, figures = _task(person, options), dict[str, Value]()
    for name in ENTRANTS:
        raw, rest = measured.frames(task, name), measured.frames(task, name, options=NO_OFFSETS)
        if raw is not None and rest is not None:
            figures[name + RAW] = float(raw.error.mean())
            figures[name + NO_OFFSETS_LEFT] = float(rest.error.mean())
            figures[name + LOST] = int(raw.lost.sum())
    return figures


def _entrant_cells(name: str, rows: Sequence[Mapping[str, Value]]) -> list[str]:
    raw, rest, lost = (numbers_of([row.get(name + kind) for row in rows]) for kind in (*KINDS, LOST))
    shown = str(int(lost.sum())) if len(lost) else NOTHING
    return [ENTRANTS[name], str(len(raw)), mean_and_sd(raw), mean_and_sd(rest), shown]


def _pairs(question: Question, kind: str, rows: Sequence[Mapping[str, Value]]) -> FloatArray:
    """(n, 2) the errors of both, of the people who have them."""
    both = ([row.get(name + kind) for name in (question.first, question.second)] for row in rows)
    return np.array([pair for pair in both if None not in pair], dtype=np.float64).reshape(-1, 2)


def _question_cells(question: Question, kind: str, pairs: FloatArray) -> list[str]:
    said, better = paired(*pairs.T), int((pairs[:, 1] < pairs[:, 0]).sum())
    means = (mean_and_sd(column) for column in pairs.T)
    shown = str(better) if said.count else NOTHING
    return [question.asked, KINDS[kind], str(said.count), *means, *pair_cells(said), shown]
