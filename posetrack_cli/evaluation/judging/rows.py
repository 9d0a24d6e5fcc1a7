"""Many results as rows: one for each, the worst first, and one for the frames of all together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from posetrack_cli.evaluation.judging.gates import GateOutcome
from posetrack_cli.evaluation.measuring.catalogue import (
    Address,
    figure_of,
    key_figures,
    metric_of,
    split_address,
)
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.measuring.subjects import KINDS

MOST_BESIDE = 4
"""Results of more recordings get a row each: more columns do not fit beside each other."""
COUNTS = ("frames", "coverage")
WITHOUT_TRUTH = ("jitter_mm.mean", "confidence.mean")
"""What a row tells where no result has an error."""
FURTHER = ("lost", *WITHOUT_TRUTH, "ms_per_frame.median")
"""What a page tells beyond the key figures."""


class Earlier(Protocol):
    """Figures as they were in a baseline."""

    def figure(self, address: Address) -> float | None:
        """Return a figure, or None where it had none."""


@dataclass(frozen=True, eq=False)
class ResultRow:
    """A result, or all of them together.

    Attributes:
        measured: what has the figures.
        failed: gates that it failed, or that could not be judged.
        earlier: its figures in the baseline; None where that has none of it.
    """

    measured: Evaluation | Pool
    failed: int
    earlier: Earlier | None

    @property
    def name(self) -> str:
        """What it is called."""
        return self.measured.name

    def value(self, figure: str) -> float | None:
        """Return a figure by its address; None where it has none."""
        return figure_of(self.measured, figure).value

    def change(self, figure: str) -> float | None:
        """Return by how much a figure is larger than in the baseline; None where that cannot be told."""
        now = self.value(figure)
        then = None if self.earlier is None else self.earlier.figure(split_address(figure))
        return None if now is None or then is None else now - then


@dataclass(frozen=True, eq=False)
class ResultSet:
    """Results of one kind of subject and track, or of one group.

    Attributes:
        title: what tells it apart from others; empty where it is the only one.
        subject: of all of them.
        figures: addresses of the columns, of which at least one result has a value.
        further: addresses that a page tells, too.
        worst_by: the figure that the rows are in order of.
        rows: the results, the worst first: those without an estimate, those whose error is not known, the
            least covered first, and then the largest error first.
        pool: the frames of all of them.
        total: the same as a row.
        judged: whether there were gates.
        compared: whether there was a baseline.
    """

    title: str
    subject: str
    figures: tuple[str, ...]
    further: tuple[str, ...]
    worst_by: str
    rows: tuple[ResultRow, ...]
    pool: Pool
    total: ResultRow
    judged: bool = False
    compared: bool = False


@dataclass(frozen=True)
class Verdict:
    """What gates and a baseline say.

    Attributes:
        outcomes: of every gate.
        earlier: figures of the baseline by the name of a result or a pool.
        compared: whether there was a baseline.
    """

    outcomes: Sequence[GateOutcome] = ()
    earlier: Mapping[str, Earlier] = field(default_factory=dict)
    compared: bool = False


def result_sets(
    evaluations: Iterable[Evaluation], pools: Iterable[Pool], verdict: Verdict
) -> tuple[ResultSet, ...]:
    """Return a set for each pool, with its results as rows."""
    by_name = {one.name: one for one in evaluations}
    failed = Counter(outcome.result for outcome in verdict.outcomes if outcome.failed)
    return tuple(_set(pool, [by_name[name] for name in pool.results], failed, verdict) for pool in pools)


def worst_first(sets: Iterable[ResultSet]) -> tuple[Evaluation, ...]:
    """Return every result once, in the order of the rows."""
    every = (row.measured for one in sets for row in one.rows)
    return tuple({one.name: one for one in every if isinstance(one, Evaluation)}.values())


def _set(pool: Pool, members: Sequence[Evaluation], failed: Counter[str], verdict: Verdict) -> ResultSet:
    kind = KINDS[pool.subject]
    worst = next((name for name in kind.worst_by if any(name in one.metrics for one in members)), None)
    worst_by = f"{worst}.mean" if worst else "coverage"
    rows = [ResultRow(one, failed[one.name], verdict.earlier.get(one.name)) for one in members]
    return ResultSet(
        title=" ".join(pool.name.split()[1:]),
        subject=pool.subject,
        figures=_figures(rows, pool.subject),
        further=_known(rows, (*key_figures(pool.subject), *FURTHER)),
        worst_by=worst_by,
        rows=tuple(sorted(rows, key=lambda row: _badness(row, worst_by))),
        pool=pool,
        total=ResultRow(pool, failed[pool.name], verdict.earlier.get(pool.name)),
        judged=bool(verdict.outcomes),
        compared=verdict.compared,
    )


def _badness(row: ResultRow, worst_by: str) -> tuple[int, float]:
    """Sorts the worst row first."""
    coverage = row.measured.coverage
    if not coverage.frames:
        return 0, 0.0
    error = None if worst_by == "coverage" else row.value(worst_by)
    return (1, coverage.share) if error is None else (2, -error)


def _figures(rows: Sequence[ResultRow], subject: str) -> tuple[str, ...]:
    kind = KINDS[subject]
    errors = [f"{name}.{statistic}" for name in kind.lead for statistic in ("mean", "p95")]
    errors += [f"{name}.mean" for name in kind.worst_by]
    found = _known(rows, dict.fromkeys(errors))
    return (*COUNTS, *(found or _known(rows, WITHOUT_TRUTH)), *_known(rows, ("frames_wrong",)))


def _known(rows: Sequence[ResultRow], figures: Iterable[str]) -> tuple[str, ...]:
    """Those of the figures that a result has."""
    return tuple(
        figure
        for figure in dict.fromkeys(figures)
        if any(split_address(figure).base in row.measured.metrics for row in rows)
    )


def heading(figure: str) -> tuple[str, str]:
    """Return two short lines that a column of a figure is headed by, the unit in the second."""
    address = split_address(figure)
    metric = metric_of(figure)
    below = ", ".join(filter(None, (address.statistic, metric.unit)))
    if below or " " not in metric.label:
        return metric.label, below
    first, _, rest = metric.label.rpartition(" ")
    return first, rest
