"""Recordings of faces that are not ours, with truth: what was asked for, person by person."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from reproduction.accuracy.measuring import number
from reproduction.heads.measuring import Measured
from reproduction.heads.options import Options
from reproduction.heads.tables import COLUMNS, EXPLAINED, accuracy_rows
from reproduction.heads.tasks import Task
from reproduction.heads_data import CALIBRATION, TRUTH
from reproduction.running import Targets, table

ONE_PASS = {
    "x_mm": 0.3,
    "y_mm": 0.3,
    "z_mm": 0.6,
    "roll_deg": 0.25,
    "pitch_deg": 0.6,
    "yaw_deg": 0.6,
    "mouth_mm": 2.5,
}
TWO_PASSES = {"x_mm": 0.2, "y_mm": 0.2, "z_mm": 0.4, "pitch_deg": 0.5, "yaw_deg": 0.5, "mouth_mm": 2.0}
LEAST_TRACKED, LATEST_FIRST = 0.995, 29


class People:
    """Accuracy on every recording of a folder."""

    name = "people"

    def tasks(self, options: Options) -> list[Task]:
        """One for each person; none without a folder."""
        return [
            Task(folder.name, folder=str(folder))
            for folder in ([] if options.heads is None else persons_in(options.heads))
        ]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table per person, then the targets."""
        yield "## Recordings of other faces, automatic start"
        yield ""
        tasks = self.tasks(options)
        if not tasks:
            yield "Not measured: no recordings were given (`--heads`)."
            yield ""
            return
        yield f"No parameter differs between them. {EXPLAINED}"
        yield ""
        for task in tasks:
            yield f"### {task.name}"
            yield ""
            yield from table(("", *COLUMNS), accuracy_rows([task], measured))
            judge(task, measured, targets)


def persons_in(folder: Path) -> Sequence[Path]:
    """The folders in a folder that hold a recording with calibration and truth."""
    return sorted(
        path.resolve()
        for path in folder.iterdir()
        if all((path / name).is_file() for name in (CALIBRATION, TRUTH))
    )


def judge(task: Task, measured: Measured, targets: Targets) -> None:
    """The default configuration against what was asked for."""
    for entrant, passes, limits in (
        ("deformable", "one pass", ONE_PASS),
        ("deformable-2", "two passes", TWO_PASSES),
    ):
        figures = measured.figures(task, entrant)
        for name, limit in limits.items():
            value = figures.get(name)
            reached = None if value is None else value <= limit
            shown = "-" if value is None else number(value, 3)
            targets.add(f"{task.name}, {passes}: {_words(name)}", f"<= {limit:g}", shown, reached)
    figures = measured.figures(task, "deformable")
    if figures:
        tracked, first = figures["tracked"], figures["first"]
        asked = f">= {LEAST_TRACKED:.1%}"
        targets.add(f"{task.name}: frames tracked", asked, f"{tracked:.2%}", tracked >= LEAST_TRACKED)
        targets.add(f"{task.name}: first frame tracked", "< 30", f"{first:.0f}", first <= LATEST_FIRST)


def _words(name: str) -> str:
    """``pitch_deg`` as ``pitch, deg``."""
    what, unit = name.rsplit("_", 1)
    return f"{'moving corners of the mouth' if what == 'mouth' else what}, {unit}"
