"""Told nothing: the side, the start, and errors with the shape that a run finds, at two speeds."""

from __future__ import annotations

from collections.abc import Iterator

from posetrack_cli.evaluation.evaluate import EvalOptions
from reproduction.running import Targets
from reproduction.strangers.figures import OFF_MM, found_within, off_unsaid
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, DEFAULT, DOUBLE_SPEED, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import (
    NEVER,
    Column,
    Value,
    judge_count,
    judge_most,
    max_of,
    mean_of,
    noted,
    people_table,
    values_of,
)
from reproduction.strangers.tasks import Task

KINDS = (ARM, DOUBLE_SPEED)
FOUND_FRAMES = 5
MOST_MM, MOST_OF_ONE_MM, MOST_TIPS_MM = 3.0, 4.5, 5.0
MOST_FAST_MM, MOST_FAST_TIPS_MM = 4.5, 8.0
NO_OFFSETS = EvalOptions(joint_offsets="bone")
COLUMNS = (
    Column("tracked_side", "side"),
    Column("side_right", "side right", target="all", whole="sum"),
    Column("off_unsaid", f"wrist > {OFF_MM:g} mm off, not lost", target="0", whole="sum"),
    Column("found_within", "found within, frames", target=f"<= {FOUND_FRAMES}", whole="max"),
    Column("error_mm", "error, mm", whole="mean"),
    Column("tip_error_mm", "tips, mm", target=f"<= {MOST_TIPS_MM:g}", whole="mean"),
    Column("error_without_offsets_mm", "offsets removed, mm", target=f"<= {MOST_MM:g}", whole="mean"),
    Column("lost", "lost frames", whole="sum"),
    Column(
        "fast_error_without_offsets_mm",
        "double speed, offsets removed, mm",
        target=f"<= {MOST_FAST_MM:g}",
        whole="mean",
    ),
    Column("fast_tip_error_mm", "tips, mm", target=f"<= {MOST_FAST_TIPS_MM:g}", whole="mean"),
    Column("fast_lost", "lost frames", whole="sum"),
)


class Defaults:
    """What anybody gets who gives a recording and nothing else."""

    name = "default"

    def tasks(self, options: Options) -> list[Task]:
        """Everybody, with the arm, at both speeds."""
        return [options.task(person, kind, DEFAULT) for person in options.people for kind in KINDS]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person."""
        yield "## Defaults"
        yield ""
        yield (
            "The same recordings, told nothing. Side: as the result's record says; right if it is "
            f"the person's. Found within: the first frame, from 1, within {OFF_MM:g} mm of the true wrist "
            "that does not say that it is lost. Offsets removed: one constant offset per joint, in the axes "
            "of its bone. What does not say double speed is of the usual one."
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
        plain = values_of(rows, "error_without_offsets_mm")
        for what, most, value in (
            ("offsets removed: mean joint error, mm", MOST_MM, mean_of(plain)),
            ("offsets removed: worst recording, mm", MOST_OF_ONE_MM, max_of(plain)),
            ("fingertips, mm", MOST_TIPS_MM, mean_of(values_of(rows, "tip_error_mm"))),
            (
                "double speed, offsets removed: mean joint error, mm",
                MOST_FAST_MM,
                mean_of(values_of(rows, "fast_error_without_offsets_mm")),
            ),
            (
                "double speed: fingertips, mm",
                MOST_FAST_TIPS_MM,
                mean_of(values_of(rows, "fast_tip_error_mm")),
            ),
        ):
            judge_most(targets, f"defaults, {what}", most, value)


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by the columns' names; none of a recording without a result."""
    usual, fast = (options.task(person, kind, DEFAULT) for kind in KINDS)
    return {**_start(person, usual, measured), **_errors(usual, measured), **_errors(fast, measured, "fast_")}


def _start(person: Person, task: Task, measured: Measured) -> dict[str, Value]:
    """Whether the side and the hand are found."""
    frames = measured.frames(task, DEFAULT)
    if frames is None:
        return {}
    side = measured.side(task, DEFAULT)
    return {
        "tracked_side": side,
        "side_right": int(side == person.side),
        "off_unsaid": off_unsaid(frames.wrist, frames.lost),
        "found_within": found_within(frames.wrist, frames.lost) or NEVER,
    }


def _errors(task: Task, measured: Measured, begin: str = "") -> dict[str, Value]:
    """Errors of a recording, by the columns' names, which begin so."""
    frames = measured.frames(task, DEFAULT)
    if frames is None:
        return {}
    found: dict[str, Value] = {
        "error_mm": float(frames.error.mean()),
        "tip_error_mm": measured.figure(task, DEFAULT, "fingertip_error_mm.mean"),
        "error_without_offsets_mm": measured.figure(task, DEFAULT, "joint_error_mm.mean", NO_OFFSETS),
        "lost": int(frames.lost.sum()),
    }
    return {f"{begin}{name}": value for name, value in found.items()}
