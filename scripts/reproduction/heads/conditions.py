"""Synthetic recordings: persons who were never used for tuning, under one difficulty at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from reproduction.accuracy.measuring import number
from reproduction.heads.measuring import Measured
from reproduction.heads.options import Options, synthetic
from reproduction.heads.tables import COLUMNS, EXPLAINED, TITLES, accuracy_rows
from reproduction.heads.tasks import Task
from reproduction.running import Targets, table

CONDITIONS: dict[str, tuple[str, ...]] = {
    "slow light": (),
    "sudden light": ("--light", "sudden"),
    "occlusion": ("--occlusion",),
    "sudden turn": ("--motion", "turn"),
    "distortion": ("--lens-distortion",),
    "noise 2": ("--noise-factor", "2"),
    "speed 2": ("--speed", "2"),
    "missing images": ("--drops",),
}
"""By name the arguments of ``posetrack head synth`` beside person and length; light drifts in all of them."""
EVENTS = ("occlusion", "sudden turn")
MOST_RECOVERY_S = 0.5


class Conditions:
    """Accuracy under every condition, recovery, and frames that are wrong without saying so."""

    name = "conditions"

    def tasks(self, options: Options) -> list[Task]:
        """Every chosen condition, every person."""
        return [task for name in chosen(options) for task in tasks_of(options, name)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A table per condition, then recovery."""
        yield "## Synthetic recordings, automatic start"
        yield ""
        yield (
            f"{options.identities} persons of {options.frames} frames per condition: faces deform in the "
            "first two thirds, light drifts slowly. Means over recordings, the latest first frame, the sum "
            f"of wrong frames. {EXPLAINED}"
        )
        yield ""
        for name in chosen(options):
            yield f"### {name.capitalize()}"
            yield ""
            yield from table(("", *COLUMNS), accuracy_rows(tasks_of(options, name), measured))
        yield from _recovery(options, measured, targets)
        _judge_wrong(self.tasks(options), measured, targets)


def chosen(options: Options) -> tuple[str, ...]:
    """The conditions that are done."""
    return options.conditions or tuple(CONDITIONS)


def tasks_of(options: Options, condition: str) -> list[Task]:
    """The recordings of a condition."""
    name = condition.replace(" ", "-")
    return [
        Task(
            f"{name}-{person}-{options.frames}",
            synthetic(person, options.frames, *CONDITIONS[condition]),
        )
        for person in options.persons
    ]


def _recovery(options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
    """How long after an event the head is tracked rightly again."""
    yield "### Found again"
    yield ""
    yield (
        "Seconds from the moment when the object has left the face, or the second of two turns of 200 deg/s "
        "has ended, to the first frame from which on the head is tracked within 10 mm and 5 deg for half a "
        "second: mean, and the longest."
    )
    yield ""
    rows = []
    for condition in EVENTS:
        tasks = tasks_of(options, condition) if condition in chosen(options) else []
        for entrant, title in TITLES.items():
            found = measured.values(tasks, entrant, "recovery_s")
            if len(found):
                cells = [number(float(v), 2) for v in (found.mean(), found.max())]
                rows.append((condition, title, str(len(found)), *cells))
        found = measured.values(tasks, "deformable", "recovery_s")
        most = float(found.max()) if len(found) else np.nan
        reached = bool(most <= MOST_RECOVERY_S) if len(found) else None
        targets.add(
            f"{condition}: found again, s, longest", f"<= {MOST_RECOVERY_S:g}", f"{most:.2f}", reached
        )
    yield from table(("", "", "n", "mean, s", "longest, s"), rows)


def _judge_wrong(tasks: list[Task], measured: Measured, targets: Targets) -> None:
    for entrant in ("deformable", "deformable-2"):
        wrong, frames = (measured.values(tasks, entrant, name) for name in ("wrong", "frames"))
        shown = f"{wrong.sum():.0f} of {frames.sum():.0f}"
        what = f"{TITLES[entrant]}: wrong poses reported as tracking, all conditions"
        targets.add(what, "0", shown, bool(wrong.sum() == 0) if len(wrong) else None)
