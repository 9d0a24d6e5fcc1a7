"""Does the truth win where the tracker errs? Every frame's fits also begin at the true joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from posetrack_cli.hand.confidence import RIGHT_MM
from reproduction.accuracy.tasks import Task as AccuracyTask
from reproduction.running import Targets, table
from reproduction.strangers.default import NO_OFFSETS
from reproduction.strangers.honesty import cvar_tasks
from reproduction.strangers.measuring import Frames, Measured
from reproduction.strangers.options import ARM, DEFAULT, ENTRANTS, EXACT, AnyTask, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import Column, Value, judge_most, noted, people_table
from reproduction.strangers.tasks import TRUTH, Task

TOLD = "told"
OFF_MM = 10.0
"""Mean joint error of a frame of a hand of known skin that is off."""
COLUMNS = (
    Column("error_mm", "error, mm", whole="mean"),
    Column("told_error_mm", "told, mm", whole="mean"),
    Column("off", f"frames > {OFF_MM:g} mm off", whole="sum"),
    Column("mended", "of these right when told", whole="sum"),
)
MOST_MM = {"P1": 18.0, "P4": 9.0, "P7": 12.0}
"""What the errors of the head-mounted recordings should be, offsets per bone removed."""


class Told:
    """The results of exact meshes, and the head-mounted recordings, once more with true keypoints."""

    name = "told"

    def tasks(self, options: Options) -> list[AnyTask]:
        """Everybody with the arm, and the sequences that are there, each plain and told."""
        return [*(_task(person, options) for person in options.people), *_sequences(options)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person, and one per sequence."""
        yield "## Told the truth"
        yield ""
        yield (
            "Fits of every frame begin at the true joints, too (`--keypoints`), which are not believed. A "
            "frame that is off, and right when told, was a failure of the search: the truth costs less. Of "
            "one that is off both times another pose costs less than the truth. People with the exact mesh; "
            f"P1, P4, P7 by default, offsets per bone removed, off from {RIGHT_MM:g} mm on."
        )
        yield ""
        rows = {person: figures_of(person, options, measured) for person in options.people}
        noted(measured, self.name, rows)
        yield from people_table(COLUMNS, rows)
        found = {task.name: _sequence_figures(task, measured) for task in _sequences(options)}
        for name, figures in found.items():
            measured.note(self.name, name, figures)
        titles = ("", *(column.title for column in COLUMNS[:2]), "frames off", COLUMNS[3].title)
        yield from table(titles, [_cells(name, figures) for name, figures in found.items()])
        for name, most in MOST_MM.items():
            error = found.get(name, {}).get("error_mm")
            value = error if isinstance(error, float) else float("nan")
            judge_most(targets, f"{name}, offsets removed: mean joint error, mm", most, value)


def _task(person: Person, options: Options) -> Task:
    task = options.task(person, ARM, EXACT)
    return replace(task, entrants={**task.entrants, TOLD: (*ENTRANTS[EXACT], "--keypoints", TRUTH)})


def _sequences(options: Options) -> list[AccuracyTask]:
    return [
        replace(
            task,
            entrants={
                **task.entrants,
                TOLD: (*ENTRANTS[DEFAULT], "--keypoints", str(options.output / f"{task.name}.csv")),
            },
        )
        for task in cvar_tasks(options)
    ]


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by the columns' names; none without both results."""
    task = _task(person, options)
    return _compared(measured.frames(task, EXACT), measured.frames(task, TOLD), OFF_MM)


def _sequence_figures(task: AccuracyTask, measured: Measured) -> dict[str, Value]:
    plain, told = (measured.frames(task, entrant, options=NO_OFFSETS) for entrant in (DEFAULT, TOLD))
    return _compared(plain, told, RIGHT_MM)


def _compared(plain: Frames | None, told: Frames | None, off_mm: float) -> dict[str, Value]:
    if plain is None or told is None:
        return {}
    off = plain.error > off_mm
    return {
        "error_mm": float(plain.error.mean()),
        "told_error_mm": float(told.error.mean()),
        "off": int(off.sum()),
        "mended": int((told.error[off] <= off_mm).sum()),
    }


def _cells(name: str, figures: Mapping[str, Value]) -> list[str]:
    return [name, *(column.shown(figures.get(column.name)) for column in COLUMNS)]
