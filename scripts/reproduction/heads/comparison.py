"""A deformable against a rigid model, and a second pass against the first, recording by recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from reproduction.accuracy.measuring import number
from reproduction.heads.measuring import RIGID_FRAMES, Measured
from reproduction.heads.options import Options, Part
from reproduction.heads.tasks import Task
from reproduction.running import Targets, table

MODELS, PASSES = ("rigid", "deformable"), ("deformable", "deformable-2")
COMPARED = {
    "deforming pitch_deg": "deforming: pitch, deg",
    "deforming moving_mm": "deforming: moving points, mm",
    "still pitch_deg": "neutral: pitch, deg",
    "still rotation_deg": "neutral: rotation, deg",
    "still position_mm": "neutral: position, mm",
}
REPEATED = {"position_mm": "position, mm", "rotation_deg": "rotation, deg", "mouth_mm": "mouth, mm"}
NO_WORSE = 0.05
"""Up to this much, of the rigid model's or the first pass's error, is no difference: another seed makes as
much."""


class Comparison:
    """Pairs over all recordings of other parts.

    Args:
        parts: whose recordings.
    """

    name = "comparison"

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = parts

    def tasks(self, options: Options) -> list[Task]:
        """None of its own."""
        return []

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table for each pair."""
        tasks = [task for part in self._parts for task in part.tasks(options)]
        yield "## Deformable against rigid model, one pass"
        yield ""
        yield (
            f"Frames after the first {RIGID_FRAMES}, before which both are rigid. Deforming: the true face "
            "is not neutral; moving points: eyes, mouth and brows while they are more than 3 mm from their "
            "neutral places. Rigid → deformable."
        )
        yield ""
        yield from _pairs_table(tasks, measured, MODELS, COMPARED)
        _judge_deforming(tasks, measured, targets)
        _judge_no_worse(tasks, measured, targets, MODELS, "still ", ("pitch_deg", "position_mm"))
        yield "## Second pass against the first, deformable"
        yield ""
        yield from _pairs_table(tasks, measured, PASSES, REPEATED)
        _judge_no_worse(tasks, measured, targets, PASSES, "", REPEATED)


def _pairs_table(
    tasks: Sequence[Task], measured: Measured, pair: Sequence[str], columns: dict[str, str]
) -> Iterator[str]:
    rows = []
    for task in tasks:
        cells = [_cell(measured.pairs([task], pair, name)) for name in columns]
        if any(cell != "-" for cell in cells):
            rows.append((task.name, *cells))
    yield from table(("recording", *columns.values()), rows)


def _cell(pairs: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    return " → ".join(number(float(value)) for value in pairs[0]) if len(pairs) else "-"


def _judge_deforming(tasks: Sequence[Task], measured: Measured, targets: Targets) -> None:
    """Lower on every recording, at least halved on the median one."""
    for name, title in list(COMPARED.items())[:2]:
        pairs = measured.pairs(tasks, MODELS, name)
        lower, known = int((pairs[:, 1] < pairs[:, 0]).sum()), len(pairs) > 0
        shown, reached = f"{lower} of {len(pairs)}", lower == len(pairs) if known else None
        targets.add(f"{title}: lower than the rigid model's, recordings", "all", shown, reached)
        ratio = float(np.median(pairs[:, 1] / pairs[:, 0])) if known else np.nan
        reached = bool(ratio <= 0.5) if known else None
        targets.add(f"{title}: of the rigid model's, median", "<= 0.5", f"{ratio:.2f}", reached)


def _judge_no_worse(
    tasks: Sequence[Task],
    measured: Measured,
    targets: Targets,
    pair: Sequence[str],
    prefix: str,
    names: Sequence[str] | dict[str, str],
) -> None:
    """The second's mean over recordings against the first's."""
    titles = COMPARED | REPEATED
    for name in names:
        pairs = measured.pairs(tasks, pair, f"{prefix}{name}")
        ratio = float(pairs[:, 1].mean() / pairs[:, 0].mean()) if len(pairs) else np.nan
        what = f"{titles[f'{prefix}{name}']}: {pair[1]} of {pair[0]}, means"
        reached = bool(ratio <= 1.0 + NO_WORSE) if len(pairs) else None
        targets.add(what, f"<= {1.0 + NO_WORSE:g}", f"{ratio:.2f}", reached)
