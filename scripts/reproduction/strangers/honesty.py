"""Does the tracker know when it is wrong? Confidence, status and stated intervals against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any

from posetrack_cli.evaluation.figures import figure_of
from posetrack_cli.evaluation.honesty import JudgedFrames, pooled_frames, reliability
from posetrack_cli.evaluation.metrics.honesty_metrics import (
    BRIER,
    CALIBRATION,
    FAR_TRACKED,
    ROC_AREA,
    WRONG,
    honesty_metrics,
)
from posetrack_cli.evaluation.metrics.measures import Measures
from posetrack_cli.evaluation.pooling import pool
from posetrack_cli.evaluation.subjects.hand import FAR_MM
from posetrack_cli.hand.confidence import RIGHT_MM
from reproduction import cvar
from reproduction.accuracy.measuring import number
from reproduction.accuracy.tasks import Task as AccuracyTask
from reproduction.running import Targets, table
from reproduction.strangers.default import Defaults
from reproduction.strangers.intervals import evaluation_with_bones
from reproduction.strangers.measuring import WRIST, Measured
from reproduction.strangers.mesh import OwnMesh
from reproduction.strangers.options import DEFAULT, ENTRANTS, AnyTask, Options
from reproduction.strangers.tables import NOTHING, judge_intervals

INSIDE = "joint_inside_90"
LEAST_AREA, MOST_FAR = 0.9, 0.01
SEQUENCES = ("P1", "P4", "P7")
ALONE = {"P1": 0.75, "P7": 0.75}
"""Whose area under the curve is told of each alone, and what it should be: they have errors of both kinds."""
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
            f"Wrong is a frame whose mean joint error is above {RIGHT_MM:g} mm, raw, also where joints are "
            "marked by another convention (P1, P4, P7; Oberweger et al. 2016). Area: under the ROC curve of "
            f"confidence. Far: frames more than {FAR_MM:g} mm off that are not lost. All frames with a truth "
            "count, lost ones, too. The figures are those of `posetrack eval`."
        )
        yield ""
        groups = _groups(self.tasks(options), measured)
        told = {name: confidence_figures(frames) for name, frames in groups.items()}
        for name, figures in told.items():
            measured.note(self.name, name, figures)
        yield from table(
            ("", "frames", "wrong", "area", "far, not lost", "Brier score", "calibration error"),
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


def _groups(tasks: Iterable[AnyTask], measured: Measured) -> dict[str, JudgedFrames]:
    """The frames of all results together and, where there are some, of those that stand alone."""
    found = {
        (task.name, entrant): frames
        for task in tasks
        for entrant in task.entrants
        if (frames := measured.judged(task, entrant)) is not None
    }
    alone = {name: found[name, DEFAULT] for name in ALONE if (name, DEFAULT) in found}
    return ({POOLED: pooled_frames(list(found.values()))} if found else {}) | alone


def confidence_figures(judged: JudgedFrames) -> dict[str, Any]:
    """What ``posetrack eval`` measures of confidence and status, by address; without what has no value."""
    measures = Measures("no frame has a truth")
    honesty_metrics(measures, judged)
    return {"frames": len(judged.right), **measures.metrics}


def _cells(name: str, figures: dict[str, Any]) -> list[str]:
    return [
        name,
        str(figures["frames"]),
        _shown(figures.get(WRONG), 2, percent=True),
        _shown(figures.get(ROC_AREA), 3),
        _shown(figures.get(FAR_TRACKED), 2, percent=True),
        _shown(figures.get(BRIER), 3),
        _shown(figures.get(CALIBRATION), 3),
    ]


def _shown(value: float | None, digits: int, percent: bool = False) -> str:
    return NOTHING if value is None else number(value, digits, percent)


def _judge(told: dict[str, dict[str, Any]], targets: Targets) -> None:
    for name, least in {POOLED: LEAST_AREA, **ALONE}.items():
        area = told.get(name, {}).get(ROC_AREA)
        title = f"confidence, {name}: area under the ROC curve"
        reached = None if area is None else area >= least
        targets.add(title, f">= {least:g}", _shown(area, 3), reached)
    far = told.get(POOLED, {}).get(FAR_TRACKED)
    what = f"frames > {FAR_MM:g} mm off that are not lost"
    shown = _shown(far, 2, percent=True)
    targets.add(what, f"<= {100 * MOST_FAR:g} %", shown, None if far is None else far <= MOST_FAR)


def _reliability(judged: JudgedFrames, measured: Measured) -> Iterator[str]:
    """Whether so many frames of a confidence are right as it says."""
    bins = reliability(*judged.scored)
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
    every = (evaluation_with_bones(person, options, measured) for person in options.people)
    found = [one for one in every if one is not None]
    together = pool("exact mesh", found) if found else None
    joints, wrist = (
        None if together is None else figure_of(together, address).value
        for address in (INSIDE, f"{INSIDE}.{WRIST}")
    )
    if joints is not None:
        measured.note("honesty", INSIDE, {"joints": joints, "wrist": wrist})
        yield (
            "With the exact mesh, true joint coordinates within the 90 % intervals that follow from the "
            "stated variances of the pose, to first order, as if errors of its entries were independent: "
            f"{_shown(joints, 1, percent=True)}; of the wrist, whose variances are stated: "
            f"{_shown(wrist, 1, percent=True)}."
        )
        yield ""
    for what, value in (("joints", joints), ("the wrist", wrist)):
        judge_intervals(targets, f"exact mesh: truth within 90 % intervals, {what}", value)
