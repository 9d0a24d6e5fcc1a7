"""Evaluations as CSV in long form: one figure a line."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict

from posetrack_cli.evaluation.comparing.comparison import Comparison
from posetrack_cli.evaluation.evaluation import Evaluation, Value
from posetrack_cli.evaluation.metrics.catalogue import metric_of, split_address
from posetrack_cli.evaluation.statistics import Statistics

HEADER = ("result", "metric", "part", "statistic", "value", "unit")
Line = tuple[str, str, str, str, float, str]


def csv_report(evaluations: Sequence[Evaluation], comparison: Comparison | None = None) -> str:
    """Return lines ``result,metric,part,statistic,value,unit``, UTF-8, with a header.

    ``part`` is empty for a metric as a whole; ``statistic`` is empty for a metric that is one number. Of a
    comparison ``result`` is ``second - first`` and ``statistic`` ends in ``difference``, ``low``, ``high``,
    ``p_value`` or ``pairs``. Values have all their digits; those that are not finite are ``nan`` or ``inf``.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    for one in evaluations:
        for base, value in one.metrics.items():
            writer.writerows(_lines(one.name, base, value))
    if comparison is not None:
        writer.writerows(_differences(comparison))
    return text.getvalue()


def _lines(result: str, base: str, value: Value) -> Iterator[Line]:
    metric = metric_of(base)
    part = base.removeprefix(metric.name).removeprefix(".")
    figures = asdict(value) if isinstance(value, Statistics) else {"": value}
    for statistic, figure in figures.items():
        yield result, metric.name, part, statistic, figure, "" if statistic == "count" else metric.unit


def _differences(comparison: Comparison) -> Iterator[Line]:
    for one in comparison.differences:
        address = split_address(one.figure)
        metric, part = address.metric, address.part or ""
        unit, pair = metric.unit, one.paired
        figures = {
            "difference": (pair.difference, unit),
            "low": (pair.low, unit),
            "high": (pair.high, unit),
            "p_value": (pair.p_value, ""),
            "pairs": (pair.count, ""),
        }
        for name, (figure, its_unit) in figures.items():
            statistic = f"{address.statistic}.{name}" if address.statistic else name
            yield f"{one.second} - {one.first}", metric.name, part, statistic, figure, its_unit
