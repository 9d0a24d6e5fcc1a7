"""Does the tracker know when it is wrong? Confidence, status and stated intervals against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict

import numpy as np

from posetrack_cli.arrays import FloatArray
from reproduction import cvar
from reproduction.accuracy.measuring import number
from reproduction.accuracy.tasks import Task as AccuracyTask
from reproduction.running import Targets, table
from reproduction.strangers.default import Defaults
from reproduction.strangers.figures import brier_score, reliability, roc_area
from reproduction.strangers.intervals import person_inside
from reproduction.strangers.measuring import NAN, Frames, Measured
from reproduction.strangers.mesh import OwnMesh
from reproduction.strangers.options import DEFAULT, ENTRANTS, AnyTask, Options
from reproduction.strangers.tables import NOTHING

WRONG_MM, FAR_MM = 20.0, 40.0
LEAST_AREA, MOST_FAR = 0.9, 0.01
INTERVALS = (0.80, 0.97)
SEQUENCES = ("P1", "P4", "P7")
ALONE = ("P1", "P7")
"""Whose area under the curve is told of each alone: hard enough for errors of both kinds."""
POOLED = "all pooled"


class Honesty:
    """Over all results of the parts ``mesh`` and ``default``, and the head-mounted recordings."""

    name = "honesty"

    def tasks(self, options: Options) -> list[AnyTask]:
        """Those of both parts, and the sequences that are there."""
        return [*OwnMesh().tasks(options), *Defaults().tasks(options), *cvar_tasks(options)]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """Tables of confidence and of its reliability; intervals."""
        yield "## Honesty"
        yield ""
        yield (
            f"Wrong is a frame whose mean joint error is above {WRONG_MM:g} mm, raw, also where joints are "
            "marked by another convention (P1, P4, P7; Oberweger et al. 2016). Area: under the ROC curve of "
            f"confidence against wrong. Far: frames more than {FAR_MM:g} mm off that say `tracking`. All "
            "frames with a truth count, lost ones, too."
        )
        yield ""
        groups = _groups(self.tasks(options), measured)
        told = {name: confidence_figures(frames) for name, frames in groups.items()}
        for name, figures in told.items():
            measured.note(self.name, name, figures)
        yield from table(
            ("", "frames", "wrong", "area", "far, tracking", "Brier score"),
            [_cells(name, figures) for name, figures in told.items()],
        )
        _judge(told, targets)
        if POOLED in groups:
            yield from _reliability(groups[POOLED], measured)
        yield from _intervals(options, measured, targets)


def cvar_tasks(options: Options) -> list[AccuracyTask]:
    """The head-mounted recordings that are there, with the defaults."""
    if options.cvar is None:
        return []
    return [
        AccuracyTask(name, cvar.conversion(options.cvar / name, options.output), {DEFAULT: ENTRANTS[DEFAULT]})
        for name in SEQUENCES
        if (options.cvar / name).is_dir()
    ]


def _groups(tasks: Iterable[AnyTask], measured: Measured) -> dict[str, list[Frames]]:
    """The frames of all results together and, where there are some, of those that stand alone."""
    found = {
        (task.name, entrant): frames
        for task in tasks
        for entrant in task.entrants
        if (frames := measured.frames(task, entrant)) is not None
    }
    alone = {name: [found[name, DEFAULT]] for name in ALONE if (name, DEFAULT) in found}
    return ({POOLED: list(found.values())} if found else {}) | alone


def confidence_figures(frames: Sequence[Frames]) -> dict[str, float]:
    """What confidence and status say of frames: see ``Honesty``; shares from 0 to 1."""
    error, confidence = joined(frames, "error"), joined(frames, "confidence")
    wrong, far = error > WRONG_MM, (error > FAR_MM) & (joined(frames, "tracking") > 0)
    return {
        "frames": len(error),
        "wrong": float(wrong.mean()),
        "roc_area": roc_area(confidence, ~wrong),
        "far_tracking": float(far.mean()),
        "brier_score": brier_score(confidence, ~wrong),
    }


def joined(frames: Sequence[Frames], name: str) -> FloatArray:
    """An array of all frames, as numbers."""
    return np.concatenate([getattr(one, name) for one in frames]).astype(np.float64)


def _cells(name: str, figures: dict[str, float]) -> list[str]:
    area = figures["roc_area"]
    return [
        name,
        f"{figures['frames']:.0f}",
        number(figures["wrong"], 2, percent=True),
        number(area, 3) if area == area else NOTHING,
        number(figures["far_tracking"], 2, percent=True),
        number(figures["brier_score"], 3),
    ]


def _judge(told: dict[str, dict[str, float]], targets: Targets) -> None:
    for name in (POOLED, *ALONE):
        area = told.get(name, {}).get("roc_area", NAN)
        reached = area >= LEAST_AREA if area == area else None
        shown = number(area, 3) if area == area else NOTHING
        targets.add(f"confidence, {name}: area under the ROC curve", f">= {LEAST_AREA:g}", shown, reached)
    far = told.get(POOLED, {}).get("far_tracking", NAN)
    shown = number(far, 2, percent=True) if far == far else NOTHING
    what = f"frames > {FAR_MM:g} mm off that say tracking"
    targets.add(what, "<= 1 %", shown, far <= MOST_FAR if far == far else None)


def _reliability(frames: Sequence[Frames], measured: Measured) -> Iterator[str]:
    """Whether so many frames of a confidence are right as it says."""
    bins = list(reliability(joined(frames, "confidence"), joined(frames, "error") <= WRONG_MM))
    measured.note("honesty", "reliability", {f"{one.low:.1f}": asdict(one) for one in bins})
    rows = [
        (
            f"{one.low:.1f} to {one.high:.1f}",
            str(one.count),
            number(one.confidence, 3) if one.count else NOTHING,
            number(one.right, 3) if one.count else NOTHING,
        )
        for one in bins
    ]
    yield from table(("confidence", "frames", "mean confidence", "share right"), rows)


def _intervals(options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
    """The share of true joint coordinates within the stated 90 % intervals."""
    every = (person_inside(person, options, measured) for person in options.people)
    found = [inside for inside in every if inside is not None]
    share = wrist = NAN
    if found:
        inside = np.concatenate(found)
        share, wrist = float(inside.mean()), float(inside[:, 0].mean())
        measured.note("honesty", "inside_90", {"joints": share, "wrist": wrist})
        yield (
            "With the exact mesh, true joint coordinates within the 90 % intervals that follow from the "
            "stated variances of the pose, to first order, as if errors of its entries were independent: "
            f"{number(share, 1, percent=True)}; of the wrist, whose variances are stated: "
            f"{number(wrist, 1, percent=True)}."
        )
        yield ""
    for what, value in (("joints", share), ("the wrist", wrist)):
        known, (low, high) = value == value, INTERVALS
        shown = number(value, 1, percent=True) if known else NOTHING
        title = f"exact mesh: truth within 90 % intervals, {what}"
        targets.add(title, "80 to 97 %", shown, low <= value <= high if known else None)
