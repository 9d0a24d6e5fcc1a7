"""JSON and CSV reports, and checks of report paths."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.build import version
from posetrack_cli.errors import UsageError
from posetrack_cli.evaluation.judging.comparing import Comparison
from posetrack_cli.evaluation.judging.gates import GateOutcome
from posetrack_cli.evaluation.judging.rows import ResultSet
from posetrack_cli.evaluation.measuring.catalogue import metric_of, place_of, split_address
from posetrack_cli.evaluation.measuring.evaluation import (
    STATISTIC_NAMES,
    Curve,
    Evaluation,
    Statistics,
    Value,
)
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames, reliability, roc_curve
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.reading.alignment import JointOffsets
from posetrack_cli.files import real_path, write_output
from posetrack_cli.outputs import check_free, check_place, whole_or_nothing
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.tables import csv_of
from posetrack_cli.text import printable_json


def check_reports(reports: Iterable[Path], inputs: Iterable[Path], *, overwrite: bool) -> None:
    """Check that reports can be written, before the evaluation starts.

    Args:
        reports: files to write.
        inputs: files that are read.
        overwrite: whether existing reports may be replaced.

    Raises:
        UsageError: a report is a folder, a device, an input or another report, or exists already.
        ResultError: the folder of a report does not exist.
    """
    # Compared by real path, as symbolic links can lead to an input.
    taken = {real_path(path): "an input" for path in inputs}
    for report in reports:
        check_place(report)
        if report.exists() and not report.is_file():  # writing would replace a device file
            found = "a folder" if report.is_dir() else "a device"
            hint = "use - for standard output"
            raise UsageError("report cannot be written", where=report, found=found, hint=hint)
        use = taken.get(real_path(report))
        if use:
            raise UsageError(f"report would overwrite {use}", where=report, hint="choose another name")
        if not overwrite:
            check_free(report)
        taken[real_path(report)] = "another report"


def write_report(path: Path, text: str) -> None:
    """Write a report atomically as UTF-8.

    Raises:
        ResultError: the file cannot be written.
    """
    with whole_or_nothing(path) as part:
        # Undecodable bytes in file names are written as escapes that JSON readers understand.
        write_output(part, text.encode("utf-8", "backslashreplace"))


FORMAT = "posetrack.eval/1"


def json_report(
    evaluations: Sequence[Evaluation],
    options: Mapping[str, Any],
    comparison: Comparison | None = None,
    gates: Sequence[GateOutcome] = (),
    pools: Sequence[Pool] = (),
    *,
    rows: bool = False,
) -> str:
    """Return the JSON report.

    ``results`` has name, file, track, subject, coverage, metrics by address (``unit`` and either ``value`` or
    mean, sd, median, p95, max, p5 and count), absent metrics with reasons, curve, reliability diagram and ROC
    curve, removed joint offsets, notes, losses and run record of each result. ``pooled`` has the values of
    all pools, ``comparison`` the paired differences, ``gates`` the outcomes of all gates. With the ``layout``
    ``rows``, results have no curves, and only ``OF_RECORDING`` of the run record.

    Args:
        evaluations: the results.
        options: evaluation options.
        comparison: comparison of results or groups.
        gates: outcomes of gates and baseline.
        pools: the pools.
        rows: whether the layout is ``rows``.
    """
    # No creation time, so that equal evaluations give equal files.
    report = {
        "format": FORMAT,
        "version": version(),
        "options": dict(options),
        "layout": "rows" if rows else "columns",
        "results": [_row(one) if rows else _result(one) for one in evaluations],
        "pooled": [_pool(one) for one in pools],
        "comparison": None if comparison is None else _comparison(comparison),
        "gates": [vars(outcome) for outcome in gates],
    }
    return printable_json(json.dumps(finite(report), indent=1, ensure_ascii=False, allow_nan=False)) + "\n"


def finite(value: Any) -> Any:
    """Replace NaN and infinity by None in nested lists and dictionaries, as JSON does not support them."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return value


OF_RECORDING = ("seed", "input.name", RECORDING_KEY)
"""Entries of the run record in the layout ``rows``."""


def result_values(evaluation: Evaluation) -> dict[str, Any]:
    """Return the values of a result that all reports share, without its run record."""
    return {
        "name": evaluation.name,
        "file": str(evaluation.path),
        "track": evaluation.which,
        "subject": evaluation.subject,
        **({"label": evaluation.label} if evaluation.label else {}),
        **_figures(evaluation),
        "notes": list(evaluation.notes),
        "losses": [asdict(loss) for loss in evaluation.losses],
    }


def _row(evaluation: Evaluation) -> dict[str, Any]:
    return {
        **result_values(evaluation),
        "run": {key: evaluation.run[key] for key in OF_RECORDING if key in evaluation.run},
    }


def _result(evaluation: Evaluation) -> dict[str, Any]:
    return {
        **_row(evaluation),
        "curve": None if evaluation.curve is None else _curve(evaluation.curve),
        "honesty": None if evaluation.judged is None else _honesty(evaluation.judged),
        "joint_offsets": _offsets(evaluation.joint_offsets),
        "run": dict(evaluation.run),
    }


def _pool(pool: Pool) -> dict[str, Any]:
    return {
        "name": pool.name,
        "results": list(pool.results),
        "track": pool.which,
        "subject": pool.subject,
        **_figures(pool),
        "honesty": None if pool.judged is None else _honesty(pool.judged),
    }


def _figures(measured: Evaluation | Pool) -> dict[str, Any]:

    return {
        "coverage": {**asdict(measured.coverage), "share": measured.coverage.share},
        "metrics": {base: _metric(base, value) for base, value in measured.metrics.items()},
        "absent": dict(measured.absent),
    }


def _honesty(judged: JudgedFrames) -> dict[str, Any]:
    """Return the reliability diagram and the ROC curve."""
    curve = roc_curve(*judged.scored)
    return {
        "right_if": judged.right_if,
        "far_if": judged.far_if,
        "reliability": [asdict(one) for one in reliability(*judged.scored)],
        "roc": None if curve is None else {name: values.tolist() for name, values in vars(curve).items()},
    }


def _metric(base: str, value: Value) -> dict[str, Any]:
    figures = asdict(value) if isinstance(value, Statistics) else {"value": value}
    return {"unit": metric_of(base).unit, **figures}


def _curve(curve: Curve) -> dict[str, list[float]]:
    return {
        "thresholds_mm": curve.thresholds_mm.tolist(),
        "share": curve.share.tolist(),
        "mean_share": curve.mean_share.tolist(),
    }


def _offsets(removed: JointOffsets | None) -> dict[str, Any] | None:
    if removed is None:
        return None
    joints = dict(zip(removed.names, removed.offsets.tolist(), strict=True))
    return {"axes": removed.frame, "mm": joints}


def _comparison(comparison: Comparison) -> dict[str, Any]:
    return {
        "unit": comparison.unit,
        "groups": {
            group: {figure: asdict(of) for figure, of in summary.items()}
            for group, summary in comparison.groups.items()
        },
        "differences": [_flat(asdict(one)) for one in comparison.differences],
        "notes": list(comparison.notes),
    }


def _flat(difference: dict[str, Any]) -> dict[str, Any]:
    """Return a difference with the fields of ``paired`` on the same level, except its note."""
    paired = difference.pop("paired")
    return {**{key: value for key, value in paired.items() if key != "note"}, **difference}


HEADER = ("result", "metric", "part", "statistic", "value", "unit")
Line = tuple[str, str, str, str, float, str]


KINDS = ("largest", "mean")
"""Columns per result of a curve report, by joint errors of a frame."""


def csv_report(
    evaluations: Sequence[Evaluation], comparison: Comparison | None = None, pools: Sequence[Pool] = ()
) -> str:
    """Return the CSV report with the columns ``result,metric,part,statistic,value,unit``.

    ``part`` is empty for a whole metric, ``statistic`` for scalar metrics. In comparisons, ``result`` is
    ``second - first`` and ``statistic`` ends with ``difference``, ``low``, ``high``, ``p_value`` or
    ``pairs``. For pools, ``result`` is the name of the pool. Values have full precision; they can be ``nan``
    or ``inf``.
    """
    every: list[Evaluation | Pool] = [*evaluations, *(pool for pool in pools if pool.has_pooled_values)]
    lines = [
        line for one in every for base, value in one.metrics.items() for line in _lines(one.name, base, value)
    ]
    return csv_of([HEADER, *lines, *(() if comparison is None else _differences(comparison))])


def csv_rows(sets: Sequence[ResultSet]) -> str:
    """Return the CSV report with a line per result, worst first, followed by the line of the pool.

    The columns are ``result``, ``subject``, ``track``, ``gates_failed`` and one per address; missing values
    are empty.
    """
    rows = [row for one in sets for row in (*one.rows, one.total)]
    bases = sorted(dict.fromkeys(base for row in rows for base in row.measured.metrics), key=place_of)
    figures = [f"{base}{ending}" for base in bases for ending in _endings(base)]
    lines: list[list[float | str]] = [["result", "subject", "track", "gates_failed", *figures]]
    for row in rows:
        one = row.measured
        values = [figure for base in bases for figure in _values(base, one.metrics.get(base))]
        lines.append([one.name, one.subject, one.which, row.failed, *values])
    return csv_of(lines)


def _endings(base: str) -> Sequence[str]:
    return [""] if metric_of(base).scalar else [f".{name}" for name in STATISTIC_NAMES]


def _values(base: str, value: Value | None) -> Sequence[float | str]:
    if isinstance(value, Statistics):
        return [getattr(value, name) for name in STATISTIC_NAMES]
    return [""] * len(_endings(base)) if value is None else [value]


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
    """Return the error curves as CSV with the columns ``d_mm``, ``NAME largest`` and ``NAME mean``.

    Values are shares, 0 to 1, of the expected frames; missed frames count as above D.

    Raises:
        UsageError: no result has a curve: none is of a hand with true joints.
    """
    curves = {one.name: one.curve for one in evaluations if one.curve is not None}
    if not curves:
        names = ", ".join(one.name for one in evaluations)
        raise UsageError("no curve: requires a hand result and ground truth with joints", found=names)
    columns = [next(iter(curves.values())).thresholds_mm]
    columns += [shares for curve in curves.values() for shares in (curve.share, curve.mean_share)]
    header = ["d_mm", *(f"{name} {kind}" for name in curves for kind in KINDS)]
    return csv_of([header, *([f"{row[0]:g}", *row[1:]] for row in np.stack(columns, axis=1).tolist())])
