"""A finished result, measured where it was made: its key figures and its gates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posetrack_cli.evaluation.assessment import Assessment, Request
from posetrack_cli.evaluation.evaluate import EvalOptions
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.figures import figure_of, key_figures
from posetrack_cli.evaluation.gates import parse_gate

FURTHER = ("confidence.mean", "jitter_mm.mean")
"""What is told of every result besides the key figures."""


def request_of(result: Path, judging: Mapping[str, Any]) -> Request:
    """Return what is to be found out about a result.

    Args:
        result: its path.
        judging: fields of ``jobs.Judging`` as plain values.
    """
    truth, report = judging["truth"], judging["report"]
    return Request(
        results=(result,),
        options=EvalOptions(truth=None if truth is None else Path(truth)),
        gates=tuple(parse_gate(text) for text in judging["gates"]),
        keep_tracks=report is not None,
        page=report is not None,
    )


def measured_row(found: Assessment) -> dict[str, Any]:
    """Return what a summary tells of a result, as plain values.

    Keys: ``subject``, ``frames``, ``lost``, ``figures`` by address, ``gates``: of each its condition, figure,
    whether it failed, and its line.
    """
    (one,) = found.evaluations
    gates = [
        {"gate": gate.gate, "figure": gate.figure, "failed": gate.failed, "line": gate.line}
        for gate in found.outcomes
    ]
    return {
        "subject": one.subject,
        "frames": one.coverage.frames,
        "lost": one.coverage.lost,
        "figures": _figures(one),
        "gates": gates,
    }


def unmeasured_row(reason: str, judging: Mapping[str, Any]) -> dict[str, Any]:
    """Return the row of a result that cannot be measured: its gates cannot be judged, so they failed."""
    gates = [
        {"gate": gate, "figure": None, "failed": True, "line": f"{gate}: {reason}"} for gate in judging["gates"]
    ]
    return {"figures": {}, "gates": gates, "unmeasured": reason}


def _figures(evaluation: Evaluation) -> dict[str, float]:
    """The figures that it has, by address."""
    names = dict.fromkeys((*key_figures(evaluation.subject), *FURTHER))
    values = {name: figure_of(evaluation, name).value for name in names}
    return {name: value for name, value in values.items() if value is not None}
