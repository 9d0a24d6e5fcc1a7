"""With the person's own mesh: accuracy, what the arm costs, double speed, jumps."""

from __future__ import annotations

from collections.abc import Iterator

from reproduction.running import Targets
from reproduction.strangers.figures import JUMP_MM, jumps
from reproduction.strangers.measuring import NAN, Measured
from reproduction.strangers.options import ARM, DOUBLE_SPEED, EXACT, NO_ARM, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tables import (
    Column,
    Value,
    judge_most,
    mean_of,
    noted,
    people_table,
    values_of,
)
from reproduction.strangers.tasks import Task

KINDS = (ARM, NO_ARM, DOUBLE_SPEED)
MOST_MM, MOST_RATIO, MOST_FAST_MM = 4.0, 1.25, 6.0
COLUMNS = (
    Column("error_mm", "error, mm", target=f"<= {MOST_MM:g}", whole="mean"),
    Column("no_arm_error_mm", "without arm, mm", whole="mean"),
    Column("arm_ratio", "ratio", target=f"<= {MOST_RATIO:g}", whole="mean"),
    Column("double_speed_error_mm", "double speed, mm", target=f"<= {MOST_FAST_MM:g}", whole="mean"),
    Column("jumps", "jumps", whole="sum"),
    Column("double_speed_jumps", "jumps, double speed", whole="sum"),
    Column("largest_wrist_error_mm", "largest wrist error, mm", 1, whole="max"),
    Column("lost", "lost frames", whole="sum"),
)


class OwnMesh:
    """The tracker has the right surface: what is left is tracking."""

    name = "mesh"

    def tasks(self, options: Options) -> list[Task]:
        """With arm, without, and at double speed."""
        return [options.task(person, kind, EXACT) for person in options.people for kind in KINDS]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person."""
        yield "## With the person's exact mesh"
        yield ""
        yield (
            f"{options.frames} frames per recording, automatic start, the side is not told. Errors: mean "
            "over the 21 joints and all frames, lost ones included. Ratio: with arm over without; of all, "
            f"the mean of the ratios. Jumps: frames in which the joints move more than {JUMP_MM:g} mm "
            "farther than the true ones do, mean over the joints. Lost frames and the largest wrist error "
            "are those of the first column's recording."
        )
        yield ""
        rows = {person: figures_of(person, options, measured) for person in options.people}
        noted(measured, self.name, rows)
        yield from people_table(COLUMNS, rows)
        for name, what, most in (
            ("error_mm", "exact mesh: mean joint error, mm", MOST_MM),
            ("arm_ratio", "exact mesh: error with arm over without", MOST_RATIO),
            ("double_speed_error_mm", "exact mesh, double speed: mean joint error, mm", MOST_FAST_MM),
        ):
            judge_most(targets, what, most, mean_of(values_of(rows, name)))


def figures_of(person: Person, options: Options, measured: Measured) -> dict[str, Value]:
    """The figures of a person, by the columns' names."""
    found = {kind: measured.frames(options.task(person, kind, EXACT), EXACT) for kind in KINDS}
    errors = {kind: NAN if one is None else float(one.error.mean()) for kind, one in found.items()}
    slow, fast = found[ARM], found[DOUBLE_SPEED]
    return {
        "error_mm": errors[ARM],
        "no_arm_error_mm": errors[NO_ARM],
        "arm_ratio": errors[ARM] / errors[NO_ARM],
        "double_speed_error_mm": errors[DOUBLE_SPEED],
        "jumps": None if slow is None else jumps(slow.moved, slow.truly_moved),
        "double_speed_jumps": None if fast is None else jumps(fast.moved, fast.truly_moved),
        "largest_wrist_error_mm": None if slow is None else float(slow.wrist.max()),
        "lost": None if slow is None else int(slow.lost.sum()),
    }
