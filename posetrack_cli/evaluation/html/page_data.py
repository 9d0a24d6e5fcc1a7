"""An evaluation reduced to what the page's plots show: small enough to embed, with every peak kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from posetrack_cli.evaluation.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.honesty import JudgedFrames, reliability, roc_area, roc_curve
from posetrack_cli.evaluation.html.components import components, readable
from posetrack_cli.evaluation.html.packing import envelope_rows, packed
from posetrack_cli.evaluation.html.scene import scene
from posetrack_cli.evaluation.html.timebase import RowTable, Timebase, gap_spans, state_spans, timebases
from posetrack_cli.evaluation.metrics.catalogue import label_and_unit, place_of
from posetrack_cli.evaluation.metrics.without_truth import run_series
from posetrack_cli.evaluation.pictures import Picture
from posetrack_cli.evaluation.pooling import Pool
from posetrack_cli.evaluation.subjects import KINDS


@dataclass(frozen=True)
class Budget:
    """How much of each result a page holds, so that several results make no page too large to open.

    Attributes:
        quantity_points: points of each line of the plot over time.
        component_points: points of each component of the trajectories.
        scene_frames: frames of the 3-D view.
    """

    quantity_points: int
    component_points: int
    scene_frames: int


def budget_for(results: int) -> Budget:
    """Return the budget of each of so many results."""
    share = max(1, results)
    return Budget(max(300, 6000 // share), max(100, 2500 // share), max(100, 5000 // share))


def page_data(
    evaluations: Sequence[Evaluation], pictures: Mapping[str, Sequence[Picture]], pools: Sequence[Pool] = ()
) -> dict[str, Any]:
    """Return everything that the page's scripts need, ready for JSON (see ``packing.json_text``).

    Arrays are packed; a line or scene names its frames by places in its result's table of kept frames.
    """
    bases, shared = timebases([evaluation.track for evaluation in evaluations])
    budget = budget_for(len(evaluations))
    return {
        "sharedTime": shared,
        "tickSeconds": bases[0].tick_s if bases else 1.0,
        "results": [
            _result(evaluation, base, budget, pictures.get(evaluation.name, ()))
            for evaluation, base in zip(evaluations, bases, strict=True)
        ],
        "pools": [{"name": pool.name, "honesty": _honesty(pool.judged)} for pool in pools if pool.says_more],
    }


def _result(
    evaluation: Evaluation, base: Timebase, budget: Budget, pictures: Sequence[Picture]
) -> dict[str, Any]:
    track = evaluation.track
    table = RowTable(track, base)
    lost = np.zeros(len(track), dtype=np.bool_) if track.lost is None else track.lost
    data: dict[str, Any] = {
        "name": evaluation.name,
        "subject": evaluation.subject,
        "frames": len(track),
        "quantities": _quantities(evaluation, table, budget.quantity_points),
        "curve": _curve(evaluation),
        "honesty": _honesty(evaluation.judged),
        "components": _components(evaluation, table, budget.component_points),
        "parts": _parts(evaluation),
        "scene": scene(evaluation, table, budget.scene_frames, [one.stamp_ns for one in pictures]),
        "lost": base.seconds(state_spans(track.stamp_ns, lost)).tolist(),
        "gaps": base.seconds(gap_spans(track.stamp_ns)).tolist(),
        "pictures": base.seconds(np.array([one.stamp_ns for one in pictures], dtype=np.int64)).tolist(),
    }
    return data | {"kept": table.finish()}


def _quantities(evaluation: Evaluation, table: RowTable, limit: int) -> dict[str, Any]:
    """Per-frame values by metric, those of the series and those that the track itself tells."""
    lines = evaluation.placed_series() | run_series(evaluation.track)
    found: dict[str, Any] = {}
    for name in sorted(lines, key=place_of):
        values = lines[name]
        if np.isfinite(values).any():
            rows = envelope_rows(values[None], limit)
            label, unit = label_and_unit(name)
            found[name] = {
                "label": label,
                "unit": unit,
                "points": len(rows),
                "at": table.add(rows),
                "value": packed(values[rows], "f4"),
            }
    return found


def _components(evaluation: Evaluation, table: RowTable, limit: int) -> list[dict[str, Any]]:
    found = []
    for one in components(evaluation):
        lines = [one.estimate] if one.truth is None else [one.estimate, one.truth]
        if not any(np.isfinite(line).any() for line in lines):
            continue
        rows = envelope_rows(np.stack(lines), limit)
        found.append(
            {
                "group": one.group,
                "label": one.label,
                "unit": one.unit,
                "points": len(rows),
                "at": table.add(rows),
                "estimate": packed(one.estimate[rows], "f4"),
                "truth": None if one.truth is None else packed(one.truth[rows], "f4"),
                "halfWidth": None if one.half_width is None else packed(one.half_width[rows], "f4"),
            }
        )
    return found


def _curve(evaluation: Evaluation) -> dict[str, Any] | None:
    curve = evaluation.curve
    if curve is None:
        return None
    return {
        "thresholds": np.round(curve.thresholds_mm, 6).tolist(),
        "share": np.round(curve.share, 6).tolist(),
        "meanShare": np.round(curve.mean_share, 6).tolist(),
    }


def _honesty(judged: JudgedFrames | None) -> dict[str, Any] | None:
    """The reliability of confidence, bins without frames left out, and its ROC curve."""
    if judged is None or not len(judged.scored[0]):
        return None
    bins = [one for one in reliability(*judged.scored) if one.count]
    curve = roc_curve(*judged.scored)
    return {
        "confidence": [round(one.confidence, 6) for one in bins],
        "right": [round(one.right, 6) for one in bins],
        "count": [one.count for one in bins],
        "roc": None
        if curve is None
        else {
            "confidence": curve.confidence.tolist(),
            "rightKept": np.round(curve.right_kept, 6).tolist(),
            "wrongKept": np.round(curve.wrong_kept, 6).tolist(),
            "area": roc_area(*judged.scored),
        },
    }


def _parts(evaluation: Evaluation) -> list[dict[str, Any]]:
    """The error of each joint or point."""
    metric = KINDS[evaluation.subject].point_metric
    found = []
    for name in evaluation.track.point_names:
        value = evaluation.metrics.get(f"{metric}.{name}")
        if isinstance(value, Statistics) and value.count:
            found.append({"label": readable(name), "mean": value.mean, "p95": value.p95})
    return found
