"""Evaluations as CSV: one figure a line, and the field's curve."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict

import numpy as np

from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.comparing.comparison import Comparison
from posetrack_cli.evaluation.evaluation import Evaluation, Value
from posetrack_cli.evaluation.metrics.catalogue import metric_of, split_address
from posetrack_cli.evaluation.statistics import Statistics

HEADER = ("result", "metric", "part", "statistic", "value", "unit")
Line = tuple[str, str, str, str, float, str]


KINDS = ("largest", "mean")
"""Of a frame's joint errors."""


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


def curve_report(evaluations: Sequence[Evaluation]) -> str:
    """Return a table with the column ``d_mm``, and for each result ``NAME largest`` and ``NAME mean``.

    Shares, 0 to 1, are of the frames due: those that a result missed count as not below D.

    Raises:
        UsageError: no result has a curve: they are no hands, or there is no truth with joints.
    """
    curves = {one.name: one.curve for one in evaluations if one.curve is not None}
    if not curves:
        names = ", ".join(one.name for one in evaluations)
        raise UsageError("no curve: no result of a hand has a truth with joints", found=names)
    columns = [next(iter(curves.values())).thresholds_mm]
    columns += [shares for curve in curves.values() for shares in (curve.share, curve.mean_share)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["d_mm", *(f"{name} {kind}" for name in curves for kind in KINDS)])
    for row in np.stack(columns, axis=1).tolist():
        writer.writerow([f"{row[0]:g}", *row[1:]])
    return text.getvalue()
