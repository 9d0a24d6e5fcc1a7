"""Tables of accuracy: a row for each way to track."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from reproduction.accuracy.measuring import mean_of, number
from reproduction.heads.measuring import Measured
from reproduction.heads.tasks import Task

TITLES = {
    "deformable": "deformable (default)",
    "deformable-2": "deformable, two passes",
    "rigid": "rigid",
    "rigid-2": "rigid, two passes",
    "paper": "`head-stereo-paper`, deformable",
    "paper-rigid": "`head-stereo-paper`, rigid",
}
"""What tables call the entrants."""
COLUMNS = (
    "x, mm",
    "y",
    "z",
    "roll, deg",
    "pitch",
    "yaw",
    "mouth, mm",
    "tracked",
    "first frame",
    "wrong",
)
EXPLAINED = (
    "Mean absolute errors over the frames that are reported as tracked, after one constant rigid offset of "
    "the head's frame (`eval --align rigid`). Mouth: corners of the mouth while they are more than 3 mm from "
    "their neutral place, in head coordinates, after each point's constant offset. Tracked: share of all "
    "frames. First frame: the number, from 0, of the first one tracked. Wrong: frames reported as tracked "
    "whose pose is off by more than 10 mm or 5 deg."
)


def accuracy_cells(tasks: Sequence[Task], measured: Measured, entrant: str) -> list[str]:
    """Means over recordings; the latest start and the sum of wrong frames."""

    def mean(name: str, digits: int = 2, percent: bool = False) -> str:
        return mean_of(measured.values(tasks, entrant, name), digits, percent)

    first, wrong = (measured.values(tasks, entrant, name) for name in ("first", "wrong"))
    return [
        *(mean(name) for name in HEAD_POSE),
        mean("mouth_mm"),
        mean("tracked", 1, percent=True),
        number(float(first.max()), 0) if len(first) else "-",
        number(float(wrong.sum()), 0) if len(wrong) else "-",
    ]


def accuracy_rows(tasks: Sequence[Task], measured: Measured) -> Iterator[list[str]]:
    """A row for each entrant that has a result of any of the recordings."""
    for entrant, title in TITLES.items():
        if len(measured.values(tasks, entrant, "frames")):
            yield [title, *accuracy_cells(tasks, measured, entrant)]


def at_most(value: float, limit: float) -> bool | None:
    """Whether a target is reached; None where nothing was measured."""
    return bool(value <= limit) if np.isfinite(value) else None
