"""What is measured of two tracks, for tests of the metrics."""

from __future__ import annotations

import numpy as np
from hypothesis import settings

from posetrack_cli.evaluation.measuring.evaluation import Curve, Statistics
from posetrack_cli.evaluation.measuring.hand_metrics import hand_metrics
from posetrack_cli.evaluation.measuring.head_metrics import head_metrics
from posetrack_cli.evaluation.measuring.measures import Matched, Measures
from posetrack_cli.evaluation.reading.tracks import Pairs, Track

NOTHING = "nothing to compare"
relaxed = settings(deadline=None)
SINGLE_MM = 1e-4
"""Errors of points read from results: single precision is 3e-5 mm below 512 mm, 6e-5 mm below 1024 mm."""


def all_pairs(frames: int) -> Pairs:
    rows = np.arange(frames, dtype=np.int64)
    return Pairs(rows, rows)


def measure(
    estimate: Track, truth: Track, pairs: Pairs | None = None, missed: int = 0
) -> tuple[Measures, Curve | None]:
    """All metrics of the subject over these pairs, by default of rows of the same number."""
    measures = Measures(NOTHING)
    matched = Matched(estimate, truth, all_pairs(len(estimate)) if pairs is None else pairs)
    if estimate.subject == "head":
        head_metrics(measures, matched)
        return measures, None
    return measures, hand_metrics(measures, matched, missed)


def figures(measures: Measures, address: str) -> Statistics:
    value = measures.metrics[address]
    assert isinstance(value, Statistics), address
    return value


def number(measures: Measures, address: str) -> float:
    value = measures.metrics[address]
    assert isinstance(value, float), address
    return value
