"""Tables with one row per result, worst first, and a row for the pool."""

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
"""Maximum number of recordings with a column per result; more columns do not fit on a terminal."""
COUNTS = ("frames", "coverage")
WITHOUT_TRUTH = ("jitter_mm.mean", "confidence.mean")
"""Columns if no result has an error."""
FURTHER = ("lost", *WITHOUT_TRUTH, "ms_per_frame.median")
"""Columns of the HTML page in addition to the key figures."""


class Baseline(Protocol):
    """Metric values of a result or pool in a baseline."""

    def figure(self, address: Address) -> float | None:
        """Return a value; None if it is missing."""


@dataclass(frozen=True, eq=False)
class ResultRow:
    """Table row of a result or a pool.

    Attributes:
        measured: the result or pool.
        failed: number of gates that it failed.
        baseline: its values in the baseline; None if the baseline does not have it.
    """

    measured: Evaluation | Pool
    failed: int
    baseline: Baseline | None

    @property
    def name(self) -> str:
        """Name of the result or pool."""
        return self.measured.name

    def value(self, figure: str) -> float | None:
        """Return the value at an address; None if it is missing."""
        return figure_of(self.measured, figure).value

    def change(self, figure: str) -> float | None:
        """Return the difference to the baseline; None if one of the values is missing."""
        now = self.value(figure)
        then = None if self.baseline is None else self.baseline.figure(split_address(figure))
        return None if now is None or then is None else now - then


@dataclass(frozen=True, eq=False)
class ResultSet:
    """Results with the same subject and track, or of one group, as a table.

    Attributes:
        title: distinguishes the set from others; empty if it is the only one.
        subject: kind of subject.
        figures: addresses of the columns; at least one result has a value.
        further: addresses of further columns of the HTML page.
        worst_by: address that ranks the rows.
        rows: results, worst first: those without estimates, then those without a known error by increasing
            coverage, then by decreasing error.
        pool: pool of the results.
        total: row of the pool.
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
class GateReport:
    """Outcomes of the gates and values of the baseline.

    Attributes:
        outcomes: outcomes of all gates.
        baseline: baseline values by name of the result or pool.
        compared: whether there was a baseline.
    """

    outcomes: Sequence[GateOutcome] = ()
    baseline: Mapping[str, Baseline] = field(default_factory=dict)
    compared: bool = False


def result_sets(
    evaluations: Iterable[Evaluation], pools: Iterable[Pool], gates: GateReport
) -> tuple[ResultSet, ...]:
    """Return a set with the results of each pool."""
    by_name = {one.name: one for one in evaluations}
    failed = Counter(outcome.result for outcome in gates.outcomes if outcome.failed)
    return tuple(_set(pool, [by_name[name] for name in pool.results], failed, gates) for pool in pools)


def worst_first(sets: Iterable[ResultSet]) -> tuple[Evaluation, ...]:
    """Return all results in row order, without duplicates."""
    every = (row.measured for one in sets for row in one.rows)
    return tuple({one.name: one for one in every if isinstance(one, Evaluation)}.values())


def _set(pool: Pool, members: Sequence[Evaluation], failed: Counter[str], gates: GateReport) -> ResultSet:
    kind = KINDS[pool.subject]
    # One ranking for the whole table: the first metric that at least one result has.
    worst = next((name for name in kind.worst_by if any(name in one.metrics for one in members)), None)
    worst_by = f"{worst}.mean" if worst else "coverage"
    rows = [ResultRow(one, failed[one.name], gates.baseline.get(one.name)) for one in members]
    return ResultSet(
        title=" ".join(pool.name.split()[1:]),
        subject=pool.subject,
        figures=_figures(rows, pool.subject),
        further=_known(rows, (*key_figures(pool.subject), *FURTHER)),
        worst_by=worst_by,
        rows=tuple(sorted(rows, key=lambda row: _badness(row, worst_by))),
        pool=pool,
        total=ResultRow(pool, failed[pool.name], gates.baseline.get(pool.name)),
        judged=bool(gates.outcomes),
        compared=gates.compared,
    )


def _badness(row: ResultRow, worst_by: str) -> tuple[int, float]:
    """Return a sort key; the worst row sorts first."""
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
    """Return the addresses that at least one result has a value for."""
    return tuple(
        figure
        for figure in dict.fromkeys(figures)
        if any(split_address(figure).base in row.measured.metrics for row in rows)
    )


def heading(figure: str) -> tuple[str, str]:
    """Return the two lines of a column heading, with the unit in the second."""
    address = split_address(figure)
    metric = metric_of(figure)
    below = ", ".join(filter(None, (address.statistic, metric.unit)))
    if below or " " not in metric.label:
        return metric.label, below
    # Without statistic and unit, the last word moves to the second line to keep columns narrow.
    first, _, rest = metric.label.rpartition(" ")
    return first, rest
