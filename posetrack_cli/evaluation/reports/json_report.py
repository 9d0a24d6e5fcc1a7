"""Evaluations as JSON: everything a later run, a CI job or a script may ask for.

``format`` names this layout, ``posetrack.eval/1``; keys may be added under the same name. Numbers that are
not finite are null. Nothing depends on the clock: the same results give the same bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from posetrack_cli import __version__
from posetrack_cli.evaluation.comparing.comparison import Comparison
from posetrack_cli.evaluation.evaluation import Curve, Evaluation, Value
from posetrack_cli.evaluation.gates import GateOutcome
from posetrack_cli.evaluation.joint_offsets import JointOffsets
from posetrack_cli.evaluation.metrics.catalogue import metric_of
from posetrack_cli.evaluation.statistics import Statistics
from posetrack_cli.text import printable_json

FORMAT = "posetrack.eval/1"


def json_report(
    evaluations: Sequence[Evaluation],
    options: Mapping[str, Any],
    comparison: Comparison | None = None,
    gates: Sequence[GateOutcome] = (),
) -> str:
    """Return the report as JSON text.

    ``results`` has for each result its name, file, track, subject, coverage, metrics by address (``unit``
    with either ``value`` or mean, sd, median, p95, max and count), absent metrics with reasons, curve,
    joint offsets that were removed, notes, losses and run record; ``comparison`` the paired differences,
    ``gates`` the outcome of every gate.

    Args:
        evaluations: the results.
        options: what they were evaluated with.
        comparison: of the results or groups.
        gates: of ``--fail-if``, files of gates and a baseline.
    """
    report = {
        "format": FORMAT,
        "version": __version__,
        "options": dict(options),
        "results": [_result(one) for one in evaluations],
        "comparison": None if comparison is None else _comparison(comparison),
        "gates": [asdict(outcome) for outcome in gates],
    }
    return printable_json(json.dumps(finite(report), indent=1, ensure_ascii=False, allow_nan=False)) + "\n"


def finite(value: Any) -> Any:
    """Replace numbers that JSON cannot hold by None, in nested lists and dictionaries."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    return value


def _result(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "name": evaluation.name,
        "file": str(evaluation.path),
        "track": evaluation.which,
        "subject": evaluation.subject,
        "coverage": {**asdict(evaluation.coverage), "share": evaluation.coverage.share},
        "metrics": {base: _metric(base, value) for base, value in evaluation.metrics.items()},
        "absent": dict(evaluation.absent),
        "curve": None if evaluation.curve is None else _curve(evaluation.curve),
        "joint_offsets": _offsets(evaluation.joint_offsets),
        "notes": list(evaluation.notes),
        "losses": [asdict(loss) for loss in evaluation.losses],
        "run": dict(evaluation.run),
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
    """The paired figures beside the names; one note."""
    paired = difference.pop("paired")
    return {**{key: value for key, value in paired.items() if key != "note"}, **difference}
