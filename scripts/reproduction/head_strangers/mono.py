"""One camera on strangers: errors, the first seconds, gain, points at the start, honesty."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from posetrack_cli.head.face.points import POINT_NAMES
from reproduction.accuracy.measuring import number
from reproduction.head_strangers.measuring import WRONG_DEG, Judged, Measured, area, without_others
from reproduction.head_strangers.options import Options
from reproduction.heads_data import reading_arguments
from reproduction.one_camera.population import CAMERA, TRACKED
from reproduction.running import Targets, table
from reproduction.steps import Chain, Step

FACTORS, BEYOND = (0.95, 1.05), 1
"""Depth factors that are right, and how many people's may not be."""
MEDIAN = {"x_mm": 3.0, "y_mm": 3.0, "z_mm": 6.0, "roll_deg": 0.35, "pitch_deg": 1.0, "yaw_deg": 1.0}
WORST = {"x_mm": 6.0, "y_mm": 6.0, "z_mm": 10.0, "yaw_deg": 1.8}
EARLY_RATIO = 1.3
POINTS_MEAN_PX, POINTS_P95_PX = 2.5, 7.0
INSIDE = (0.75, 0.97)
LEAST_AREA = 0.85
COLUMNS = {
    "x_mm": "x, mm",
    "y_mm": "y",
    "z_mm": "z",
    "roll_deg": "roll, deg",
    "pitch_deg": "pitch",
    "yaw_deg": "yaw",
    "rotation_p95": "rotation p95",
    "factor": "right depth factor",
    "yaw_gain": "yaw gain",
    "early_ratio": "early / late",
    "points_px": "first points, px",
    "tracked": "tracked",
    "wrong": "off",
    "position_inside": "position inside",
    "rotation_inside": "rotation inside",
    "ms": "ms",
}
"""What tables show, by the figures' names."""


class Mono:
    """The left camera alone, with the defaults."""

    name = "mono"

    def chains(self, options: Options) -> list[Chain]:
        """One for each person."""
        return [
            mono_chain(options, folder, f"{folder.name}-{self.name}", options.learned_without(folder))
            for folder in options.everybody
        ]

    def lines(self, options: Options, measured: Measured, targets: Targets) -> Iterator[str]:
        """A row per person, what was asked for, and the points of the first frame."""
        yield "## One camera"
        yield ""
        yield (
            "Means of absolute errors over all frames in which the head was followed, after one constant "
            "rigid offset of the head's frame. Right depth factor: what all lengths must be multiplied by "
            "to be nearest. Early: the first two seconds, rotation. First points: of the first tracked "
            "frame on the image, less the mean offset of the other people. Tracked: share of frames that do "
            f"not say they are lost. Off: share of frames whose rotation is off by more than {WRONG_DEG:g} "
            "deg. Inside: share of entries within the stated 90 % intervals, nothing removed."
        )
        yield ""
        strangers = judged_people(options.strangers, self.name, measured)
        familiar = judged_people(options.familiar, self.name, measured)
        yield from people_table(strangers, familiar, self.name, measured)
        judge_strangers(strangers, targets)
        judge_honesty({**strangers, **familiar}, self.name, measured, targets)
        yield from points_table(strangers)


def mono_chain(options: Options, folder: Path, name: str, arguments: Sequence[str]) -> Chain:
    """A recording whose left camera is tracked."""
    reading = reading_arguments(folder, options.output / "recordings")
    given = ("head", "mono", *reading, "--cameras", CAMERA, "--timings", *arguments)
    return Chain(name, TRACKED, (Step(f"runs/{name}.mcap", given),))


def judged_people(folders: Sequence[Path], kind: str, measured: Measured) -> dict[str, Judged]:
    """The people who have a result of a kind, by name."""
    found = {folder.name: measured.judged(f"runs/{folder.name}-{kind}.mcap", folder) for folder in folders}
    return {name: one for name, one in found.items() if one is not None}


def rows_of(people: Mapping[str, Judged]) -> dict[str, dict[str, float]]:
    """The figures of people, with those that need the others."""
    if not people:
        return {}
    left = without_others([one.first_px for one in people.values()])
    return {
        name: {
            **one.figures,
            "points_px": float(lengths.mean()),
            "wrong": float(one.wrong[one.tracked].mean()) if one.tracked.any() else float("nan"),
            "position_inside": float(one.inside[:, :3].mean()),
            "rotation_inside": float(one.inside[:, 3:].mean()),
        }
        for (name, one), lengths in zip(people.items(), left, strict=True)
    }


def people_table(
    strangers: Mapping[str, Judged], familiar: Mapping[str, Judged], part: str, measured: Measured
) -> Iterator[str]:
    """A row for each person, and mean, median and worst of the strangers."""
    rows, others = rows_of(strangers), rows_of(familiar)
    for name, figures in {**rows, **others}.items():
        measured.note(part, name, figures)
    cells = [[name, *_cells(figures)] for name, figures in rows.items()]
    if rows:
        for title, summary in (
            ("**mean**", np.nanmean),
            ("**median**", np.nanmedian),
            ("largest", np.nanmax),
        ):
            whole = {
                name: float(summary([one.get(name, np.nan) for one in rows.values()])) for name in COLUMNS
            }
            measured.note(part, title.strip("*"), whole)
            cells.append([title, *_cells(whole)])
    cells += [[f"{name} (tuned on)", *_cells(figures)] for name, figures in others.items()]
    yield from table(("person", *COLUMNS.values()), cells)


def points_table(people: Mapping[str, Judged]) -> Iterator[str]:
    """How far each point of the first frame is off, less what the others' are on average."""
    yield "First points, px, less the mean offset of the other people:"
    yield ""
    left = without_others([one.first_px for one in people.values()]) if people else np.empty((0, 0))
    rows = [[name, *map(_short, values)] for name, values in zip(people, left, strict=True)]
    yield from table(("person", *(name.replace("_", " ") for name in POINT_NAMES)), rows)


def judge_strangers(people: Mapping[str, Judged], targets: Targets) -> None:
    """The errors against what was asked for."""
    rows = list(rows_of(people).values())
    factors = np.array([row["factor"] for row in rows])
    outside = int(((factors < FACTORS[0]) | (factors > FACTORS[1])).sum())
    asked = f"{FACTORS[0]:g} to {FACTORS[1]:g}, but {BEYOND}"
    targets.add("depth factors", asked, f"{outside} outside", outside <= BEYOND if rows else None)
    for said, limits, summary in (("median", MEDIAN, np.nanmedian), ("worst", WORST, np.nanmax)):
        for name, limit in limits.items():
            value = _over(rows, name, summary)
            judge_most(targets, f"{name.replace('_', ', ')}, {said} person", limit, value)
    judge_most(
        targets,
        "first two seconds over the rest, median",
        EARLY_RATIO,
        _over(rows, "early_ratio", np.nanmedian),
    )
    left = without_others([one.first_px for one in people.values()]) if people else np.full((1, 1), np.nan)
    judge_most(targets, "first points, px: mean", POINTS_MEAN_PX, float(left.mean()))
    judge_most(targets, "first points, px: 95 %", POINTS_P95_PX, float(np.quantile(left, 0.95)))


def judge_honesty(
    people: Mapping[str, Judged], part: str, measured: Measured, targets: Targets, of: str = ""
) -> None:
    """Intervals and confidence of all people pooled; ``of`` stands before what is judged."""
    if not people:
        return
    inside = np.concatenate([one.inside for one in people.values()])
    for title, columns in (("positions", slice(0, 3)), ("rotations", slice(3, 6)), ("all", slice(0, 6))):
        share = float(inside[:, columns].mean())
        measured.note(part, f"inside, {title}", {"share": share})
        least, most = INSIDE
        shown = number(share, 1, percent=True)
        targets.add(
            f"{of}90 % intervals hold, {title}", f"{least:.0%} to {most:.0%}", shown, least <= share <= most
        )
    found = area(list(people.values()))
    measured.note(part, "confidence", {"roc_area": found})
    known = found == found
    shown = number(found, 3) if known else "-"
    targets.add(
        f"{of}confidence against rotation > {WRONG_DEG:g} deg, ROC area",
        f">= {LEAST_AREA:g}",
        shown,
        found >= LEAST_AREA if known else None,
    )


def judge_most(targets: Targets, what: str, most: float, value: float) -> None:
    """Judge a figure that may be so large at most; NaN was not measured."""
    known = value == value
    targets.add(what, f"<= {most:g}", number(value) if known else "-", value <= most if known else None)


def six_of(figures: Mapping[str, float]) -> list[str]:
    """The six errors as cells."""
    return [_short(figures.get(name, float("nan"))) for name in HEAD_POSE]


def _over(rows: Sequence[Mapping[str, float]], name: str, summary: object) -> float:
    values = [row[name] for row in rows if name in row]
    return float(summary(values)) if values and callable(summary) else float("nan")


def _cells(figures: Mapping[str, float]) -> list[str]:
    digits = {"factor": 3, "yaw_gain": 3, "ms": 1}
    return [_short(figures.get(name, float("nan")), digits.get(name, 2)) for name in COLUMNS]


def _short(value: float, digits: int = 2) -> str:
    return number(value, digits) if value == value else "-"
