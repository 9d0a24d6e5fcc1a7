"""Told nothing: the side, the start, and errors of an average hand on a stranger's."""

from __future__ import annotations

from collections.abc import Iterator

from posetrack_cli.evaluation.evaluate import EvalOptions
from reproduction.running import Targets
from reproduction.strangers.figures import OFF_MM, found_within, off_unsaid
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, DEFAULT, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import NEVER, Column, Value, judge_count, noted, people_table, values_of
from reproduction.strangers.tasks import Task

FOUND_FRAMES = 5
NO_OFFSETS = EvalOptions(joint_offsets="bone")
COLUMNS = (
    Column("tracked_side", "side"),
    Column("side_right", "side right", target="all", whole="sum"),
    Column("off_unsaid", f"wrist > {OFF_MM:g} mm off, not lost", target="0", whole="sum"),
    Column("found_within", "found within, frames", target=f"<= {FOUND_FRAMES}", whole="max"),
    Column("error_mm", "error, mm", whole="mean"),
    Column("tip_error_mm", "tips, mm", whole="mean"),
    Column("error_without_offsets_mm", "offsets removed, mm", whole="mean"),
    Column("lost", "lost frames", whole="sum"),
)


class Defaults:
    """What anybody gets who gives a recording and nothing else."""

    name = "default"

    def tasks(self, options: Options) -> list[Task]:
        """Everybody, with the arm."""
        return [options.task(person, ARM, DEFAULT) for person in options.people]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person."""
        yield "## Defaults"
        yield ""
        yield (
            "The same recordings, with the average hand. Side: as the result's record says; right if it is "
            f"the person's. Found within: the first frame, from 1, within {OFF_MM:g} mm of the true wrist "
            "that does not say that it is lost. Offsets removed: one constant offset per joint, in the axes "
            "of its bone."
        )
        yield ""
        rows = {person: figures_of(person, options, measured) for person in options.people}
        noted(measured, self.name, rows)
        yield from people_table(COLUMNS, rows)
        sides, unsaid = values_of(rows, "side_right"), values_of(rows, "off_unsaid")
        found, people = values_of(rows, "found_within"), len(unsaid)
        judge_count(targets, "defaults: side right", people, int(sides.sum()), people)
        total = f"{int(unsaid.sum())} in {people} recordings" if people else "-"
        what = f"defaults: frames with the wrist > {OFF_MM:g} mm off and not lost"
        targets.add(what, "none", total, not unsaid.any() if people else None)
        quick, title = int((found <= FOUND_FRAMES).sum()), f"defaults: found within {FOUND_FRAMES} frames"
        judge_count(targets, title, people, quick, people)


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by the columns' names; none without a result."""
    task = options.task(person, ARM, DEFAULT)
    frames = measured.frames(task, DEFAULT)
    if frames is None:
        return {}
    side = measured.side(task, DEFAULT)
    return {
        "tracked_side": side,
        "side_right": int(side == person.side),
        "off_unsaid": off_unsaid(frames.wrist, frames.lost),
        "found_within": found_within(frames.wrist, frames.lost) or NEVER,
        "error_mm": float(frames.error.mean()),
        "tip_error_mm": measured.figure(task, DEFAULT, "fingertip_error_mm.mean"),
        "error_without_offsets_mm": measured.figure(task, DEFAULT, "joint_error_mm.mean", NO_OFFSETS),
        "lost": int(frames.lost.sum()),
    }
