"""The figures of a result that the study tells, and figures over many results."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.comparing.paired import Paired
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.figures import figure_of
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.tracks import FILTERED
from reproduction.accuracy.tasks import Task

ASTRAY_MM = 20
"""A frame whose mean joint error is not below this does not follow the hand, whatever its status."""
ADDRESSES = {
    "error_mm": "joint_error_mm.mean",
    "p95_mm": "joint_error_mm.p95",
    "bias_mm": "joint_bias_mm",
    "inside_90": "inside_90",
    "inside_90_position": "inside_90.position",
    "inside_90_rotation": "inside_90.rotation",
    "inside_90_angles": "inside_90.angles",
    "evaluations": "evaluations.mean",
    "ms": "ms_per_frame.median",
    "ess": "ess.mean",
    "coverage": "coverage",
}
Figures = Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """A way to track, as tables show it.

    Attributes:
        entrant: whose results.
        track: of them.
        title: what tables call it.
    """

    entrant: str
    track: str = FILTERED
    title: str = ""

    @property
    def name(self) -> str:
        """What figures are kept under."""
        return self.entrant if self.track == FILTERED else f"{self.entrant} {self.track}"


class Measured:
    """Figures of the results in a folder, each measured once.

    Args:
        folder: of the results.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, str], Figures] = {}

    def figures(self, task: Task, row: Row) -> Figures | None:
        """The figures of a task's result; None where it, or the track, is missing."""
        key = (task.name, row.name)
        if key not in self._known:
            path = task.result(self.folder, row.entrant)
            if not path.exists() or row.track not in read_result(path).tracks:
                return None
            self._known[key] = figures_of(evaluate(path, EvalOptions(track=row.track)))
        return self._known[key]

    def values(self, tasks: Iterable[Task], row: Row, name: str) -> FloatArray:
        """A figure of each task that has it, (n,)."""
        found = (self.figures(task, row) for task in tasks)
        return np.array([figures[name] for figures in found if figures is not None and name in figures])

    def pairs(self, tasks: Iterable[Task], rows: tuple[Row, Row], name: str) -> FloatArray:
        """A figure of two rows for each task in which both have it, (n, 2)."""
        both = ([self.figures(task, row) or {} for row in rows] for task in tasks)
        return np.array([[f[name] for f in pair] for pair in both if all(name in f for f in pair)]).reshape(
            -1, 2
        )

    @property
    def everything(self) -> dict[str, dict[str, Figures]]:
        """All figures measured so far, by task and row, for the JSON file."""
        tasks = sorted({task for task, _ in self._known})
        return {task: {row: f for (of, row), f in self._known.items() if of == task} for task in tasks}


def figures_of(evaluation: Evaluation) -> dict[str, float]:
    """The figures of ``ADDRESSES`` that an evaluation has, and the shares of frames lost and astray."""
    found = {name: figure_of(evaluation, address).value for name, address in ADDRESSES.items()}
    figures = {name: value for name, value in found.items() if value is not None}
    if evaluation.coverage.frames:
        figures["lost"] = evaluation.coverage.lost / evaluation.coverage.frames
    within = figure_of(evaluation, f"frames_mean_within_{ASTRAY_MM}mm").value
    if within is not None:
        figures["astray"] = 1.0 - within
    return figures


def mean_of(values: FloatArray, digits: int = 2, percent: bool = False) -> str:
    """The mean as a cell shows it."""
    return number(float(values.mean()), digits, percent) if len(values) else "-"


def number(value: float, digits: int = 2, percent: bool = False) -> str:
    """A number as a cell shows it."""
    return f"{100.0 * value:.{digits}f} %" if percent else f"{value:.{digits}f}"


PAIR_COLUMNS = ("difference [95 %]", "p")


def pair_cells(said: Paired, digits: int = 2) -> list[str]:
    """The cells below ``PAIR_COLUMNS``: the mean difference with its bootstrap interval, and Wilcoxon's p."""
    interval = f" [{said.low:+.{digits}f}, {said.high:+.{digits}f}]" if said.count > 1 else ""
    return [f"{said.difference:+.{digits}f}{interval}", f"{said.p_value:.2g}"] if said.count else ["-", "-"]


def mean_and_sd(values: FloatArray, digits: int = 2) -> str:
    """Mean and standard deviation over recordings."""
    if not len(values):
        return "-"
    sd = f" ± {values.std(ddof=1):.{digits}f}" if len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{sd}"
