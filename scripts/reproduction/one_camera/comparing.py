"""Experiments A, B and C over several persons: who wins, person by person."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import SIGNIFICANCE, paired
from reproduction.accuracy.measuring import number
from reproduction.one_camera import population
from reproduction.one_camera.entrants import POPULATION
from reproduction.one_camera.measuring import Figures, Measured, Removed
from reproduction.one_camera.options import Options
from reproduction.one_camera.tables import COLUMNS, EXPLAINED, WAYS, mean_row
from reproduction.running import Targets, table
from reproduction.steps import Chain

METRICS = {
    "position_mm": "position, mm",
    "z_mm": "z, mm",
    "rotation_deg": "rotation, deg",
    "pitch_deg": "pitch, deg",
    "yaw_deg": "yaw, deg",
    "shapes_mm": "points in head, mm",
}
JUDGED = ("position_mm", "rotation_deg")
PAIRED_HEADER = ("first → second", "lower", "difference [95 % interval]", "p")
LEAST_PAIRS = 6
"""Of fewer, even if all agree, p is not below 0.05: two of 2^n equally likely sets of signs."""


@dataclass(frozen=True)
class Pair:
    """Two ways to track that are compared.

    Attributes:
        first, second: entrants; the second is expected to be better.
        title: what is compared.
        judged: whether it must be better.
    """

    first: str
    second: str
    title: str
    judged: bool = False


PAIRS = (
    Pair("C", "A", "adjusted at the start → always, one pass", judged=True),
    Pair("C-2", "A-2", "adjusted at the start → always, two passes", judged=True),
    Pair("never", "C", "never adjusted → at the start, one pass", judged=True),
    Pair("never-2", "C-2", "never adjusted → at the start, two passes", judged=True),
    Pair("A", "A-2", "one pass → two passes"),
    Pair("B", "A", "person not in the model → in the model, one pass"),
    Pair("B", "shipped", "model of 10 other persons → shipped model, one pass"),
    Pair("A-paper", "A", "as printed → default, A, one pass"),
    Pair("C-paper", "A-paper", "as printed: adjusted at the start → always"),
)


class Population:
    """Means over all test persons, and paired tests."""

    name = "population"

    def chains(self, options: Options) -> list[Chain]:
        """The same as the experiments'."""
        return population.chains(options)

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table of means for each way to measure, then the pairs."""
        yield "## Over all persons"
        yield ""
        yield (
            f"{options.people} persons of {options.frames} frames each, against the truth. Means over "
            f"recordings, the latest first frame, the sum of wrong frames. {EXPLAINED}"
        )
        yield ""
        for removed, title in WAYS.items():
            yield f"### {title.capitalize()}"
            yield ""
            rows = (
                mean_row(entrant.title, found)
                for entrant in POPULATION
                if (found := figures_of(options, entrant.name, measured, removed))
            )
            yield from table(("", *COLUMNS), rows)
        yield from _pairs(options, measured, targets)


def figures_of(options: Options, entrant: str, measured: Measured, removed: Removed) -> list[Figures]:
    """The figures of each person that has some, against the truth."""
    results = (population.mono_result(options, person, entrant) for person in options.persons)
    found = (measured.figures(result, removed=removed) for result in results)
    return [figures for figures in found if "x_mm" in figures]


def pairs_of(options: Options, pair: Pair, metric: str, measured: Measured) -> FloatArray:
    """A figure of both for each person that has both, (n, 2)."""
    rows = []
    for person in options.persons:
        results = (population.mono_result(options, person, name) for name in (pair.first, pair.second))
        both = [measured.figures(result) for result in results]
        if all(metric in figures for figures in both):
            rows.append([figures[metric] for figures in both])
    return np.array(rows).reshape(-1, 2)


def _pairs(options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
    yield "### Person by person"
    yield ""
    yield (
        "Mean error of the first → the second, of as many persons as have both; in how many the second is "
        "lower; 95 % interval of the mean difference; p of Wilcoxon's signed-rank test. As measured, "
        "against the truth."
    )
    yield ""
    yield from table(("", "", *PAIRED_HEADER), _pair_rows(options, measured))
    for pair in PAIRS:
        if pair.judged:
            for metric in JUDGED:
                _judge(options, pair, metric, measured, targets)


def _pair_rows(options: Options, measured: Measured) -> Iterator[list[str]]:
    for pair in PAIRS:
        for metric, title in METRICS.items():
            values = pairs_of(options, pair, metric, measured)
            if len(values):
                yield [pair.title, title, *paired_cells(values)]


def paired_cells(values: FloatArray) -> list[str]:
    """Return cells for ``PAIRED_HEADER`` of figures (n, 2) of two ways to track."""
    said = paired(values[:, 0], values[:, 1])
    interval = "" if said.count < 2 else f" [{said.low:+.2f}, {said.high:+.2f}]"
    return [
        f"{number(said.mean_first)} → {number(said.mean_second)}",
        _lower(values),
        f"{said.difference:+.2f}{interval}",
        f"{said.p_value:.3g}",
    ]


def _lower(values: FloatArray) -> str:
    return f"{int((values[:, 1] < values[:, 0]).sum())} of {len(values)}"


def _judge(options: Options, pair: Pair, metric: str, measured: Measured, targets: Targets) -> None:
    """The second must be lower, and the pairs must tell."""
    values = pairs_of(options, pair, metric, measured)
    what, asked = f"{pair.title}: {METRICS[metric]}", f"lower, p < {SIGNIFICANCE:g}"
    if not len(values):
        targets.add(what, asked, "-", None)
        return
    said = paired(values[:, 0], values[:, 1])
    shown = f"{number(said.mean_first)} → {number(said.mean_second)}, {_lower(values)}, p {said.p_value:.3g}"
    better = bool(said.difference < 0 and said.p_value < SIGNIFICANCE)
    targets.add(what, asked, shown, better if len(values) >= LEAST_PAIRS else None)
