"""What the study says: figures per recording, paired over recordings, over all conditions at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import SIGNIFICANCE, Paired, paired
from posetrack_cli.evaluation.evaluate import evaluate
from posetrack_cli.evaluation.evaluation import Statistics
from reproduction.study import CONDITIONS, Condition
from reproduction.unit import Unit

METRICS = ("joint_error_mm", "velocity_error_mm_s")
"""What entrants are compared by."""
RELIABILITY = ("coverage", "nees", "inside_90")
"""What is told of every entrant besides."""
Figures = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two entrants over the recordings of one condition.

    Attributes:
        condition: kind of recording.
        first, second: entrants; differences are second minus first.
        values: (n, 2) their means over each recording.
        summary: what the pairs say.
    """

    condition: Condition
    first: str
    second: str
    values: FloatArray
    summary: Paired

    @property
    def differences(self) -> FloatArray:
        """(n,) second minus first."""
        return np.diff(self.values, axis=1)[:, 0]


def measure(units: Sequence[Unit], entrants: Sequence[str], folder: Path) -> dict[tuple[str, str], Figures]:
    """Return by unit and entrant the mean over the recording of every metric that it has."""
    return {
        (unit.name, entrant): _means(path)
        for unit in units
        for entrant in entrants
        if (path := unit.result(folder, entrant)).exists()
    }


def _means(path: Path) -> Figures:
    metrics = evaluate(path).metrics
    values = {name: metrics[name] for name in (*METRICS, *RELIABILITY) if name in metrics}
    return {name: value.mean if isinstance(value, Statistics) else value for name, value in values.items()}


def compare(
    measured: Mapping[tuple[str, str], Figures],
    units: Mapping[Condition, Sequence[Unit]],
    pair: tuple[str, str],
    metric: str,
) -> list[Comparison]:
    """Compare two entrants under every condition in which both have the metric."""
    compared = []
    for condition in CONDITIONS:
        figures = [[measured.get((unit.name, name), {}) for name in pair] for unit in units[condition]]
        rows = [[both[metric] for both in row] for row in figures if all(metric in both for both in row)]
        if rows:
            values = np.array(rows)
            compared.append(Comparison(condition, *pair, values, paired(values[:, 0], values[:, 1])))
    return compared


def adjusted(comparisons: Sequence[Comparison]) -> FloatArray:
    """P values (n,) adjusted for their number (Benjamini and Hochberg 1995)."""
    from scipy.stats import false_discovery_control

    p_values = np.array([comparison.summary.p_value for comparison in comparisons])
    return np.asarray(false_discovery_control(p_values), dtype=np.float64) if len(p_values) else p_values


def verdict(comparison: Comparison, p_value: float) -> str:
    """In words: which entrant has the smaller error, if the pairs tell."""
    if not p_value < SIGNIFICANCE:
        return "no difference found"
    better = comparison.second if comparison.summary.difference < 0 else comparison.first
    return f"{better} is better"
