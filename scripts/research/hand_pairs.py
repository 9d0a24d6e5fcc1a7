"""Accuracy of the hand tracker on recordings of both hands of a stranger."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.measuring.catalogue import figure_of
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames, pooled_frames, roc_area
from posetrack_cli.evaluation.measuring.subjects.hand import FAR_MM
from posetrack_cli.evaluation.reading.tracks import associate, track_of_result
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.hand.config import SIDES
from posetrack_cli.results.reader import Result, read_result
from research import hands
from research.hand_accuracy import NO_MESH
from research.report import Column, Report, over, values_of
from research.runner import FILE, TOOL, Files, Job, Step

APART_MM = (260, 120)
"""Distance between the places of the hands: side by side, and crossing each other."""
FRAMES = 200
COLUMNS = (
    Column("sides", "hands with the right side", 0, whole="sum"),
    Column("found_within", "found within, frames", 0, whole="max"),
    Column("error_without_offsets_mm", "offsets removed, mm"),
    Column("tip_error_mm", "tips, mm"),
    Column("lost", "lost", 0, whole="sum"),
    Column("far", f"> {FAR_MM:g} mm off, not lost", 2, percent=True),
    Column("swapped", "frames with the other hand", 0, whole="sum"),
    Column("joint_inside_90", "offsets removed: in 90 % intervals", 1, percent=True),
    Column("right_alone", "right alone: frames on it", 1, percent=True),
)
MOST = {260: (2.6, 4.8), 120: (5.0, 9.0)}


def name_of(person: int, apart: int) -> str:
    """Return the name of a recording."""
    return f"{person}-both-{apart}"


def jobs(people: tuple[int, ...], tool: Path) -> Iterator[Job]:
    """Yield the jobs that render and track both hands, and the right one alone."""
    for person in people:
        for apart in APART_MM:
            name = name_of(person, apart)
            drawn, recording = f"drawn/{name}", f"recordings/{name}.mcap"
            seeds = ("--person", str(person), "--motion", str(person), "--frames", str(FRAMES))
            truths = (("--truth", f"{side}={FILE}{drawn}/truth-{side}.csv") for side in SIDES)
            run = ("hand", "run", FILE + recording, *NO_MESH)
            one = ("--hands", "1", "--hand-side", "right", "--shape", f"{FILE}runs/{name}.mcap")
            steps = (
                Step(drawn, (TOOL, str(tool), *seeds, "--both", "--apart", str(apart)), scratch=True),
                Step(recording, ("convert", f"{FILE}{drawn}/depth", *sum(truths, ())), scratch=True),
                Step(f"runs/{name}.mcap", run),
                Step(f"runs/{name}-right.mcap", (*run, *one)),
            )
            yield Job(name, steps)


def report(people: tuple[int, ...], files: Files, report: Report) -> None:
    """Report both hands, and the right one alone."""
    report.text(
        "## Two hands",
        f"Defaults, {FRAMES} frames; per recording the mean of both hands. Frames with the other hand: not "
        "lost, and nearer to the other hand's truth. Right alone: `--hands 1 --hand-side right`.",
    )
    judged: list[JudgedFrames] = []
    for apart in APART_MM:
        rows = {}
        for person in people:
            result, alone = (files.made(f"runs/{name_of(person, apart)}{end}.mcap") for end in ("", "-right"))
            row = {} if result is None else _figures(result)
            judged += [] if result is None else _judged(result)
            if alone is not None:
                errors = _errors(read_result(alone), "right")
                row["right_alone"] = float(np.mean(errors < hands.OFF_MM))
            rows[str(person)] = row
        report.figures(f"both, {apart} mm apart", COLUMNS, rows)
        error, tips = MOST[apart]
        figures = list(rows.values())
        what = f"two hands, {apart} mm apart"
        for title, column, most in (
            ("offsets removed: mean joint error, mm", "error_without_offsets_mm", error),
            ("fingertips, mm", "tip_error_mm", tips),
        ):
            report.judge(f"{what}, {title}", over(figures, column), most=most)
        report.judge(f"{what}: frames far off, not lost", over(figures, "far"), most=0.01, percent=True)
        inside = over(figures, "joint_inside_90")
        report.judge(f"{what}: in 90 % intervals", inside, least=0.75, most=0.97, digits=1, percent=True)
        for title, column, least in (("sides right", "sides", 2.0), ("no swap", "swapped", 0.0)):
            right = values_of(figures, column) == least
            count = float(right.sum()) if len(right) else None
            report.judge(f"{what}: {title}, of {len(right)}", count, least=len(right), digits=0)
    pooled = pooled_frames(judged) if judged else None
    area = None if pooled is None else roc_area(pooled.confidence, pooled.right)
    report.judge("confidence, all hands pooled: area under the ROC curve", area, least=0.9, digits=3)


def _judged(path: Path) -> list[JudgedFrames]:
    """Return the frames of all hands of a result, judged right or wrong."""
    options = (replace(hands.RAW, label=label) for label in read_result(path).labels)
    every = (hands.evaluated(path, one).judged for one in options)
    return [one for one in every if one is not None]


def _figures(path: Path) -> dict[str, float]:
    """Return the figures of a result: means, sums or the worst of both hands."""
    result = read_result(path)
    if result.labels != SIDES:
        return {"sides": 0.0}
    first, second = (_of_hand(result, side, SIDES[1 - k]) for k, side in enumerate(SIDES))
    both = {name: np.array([first[name], second[name]]) for name in first}
    figures = {name: float(values.mean()) for name, values in both.items()}
    figures |= {name: float(both[name].sum()) for name in ("sides", "lost", "swapped")}
    return figures | {"found_within": float(both["found_within"].max())}


def _of_hand(result: Result, side: str, other: str) -> dict[str, float]:
    """Return the figures of one hand."""
    options = replace(hands.RAW, label=side)
    evaluation = hands.evaluated(result.path, options)
    found = {name: figure_of(evaluation, address).value for name, address in hands.ADDRESSES.items()}
    without = hands.evaluated(result.path, replace(hands.WITHOUT_OFFSETS, label=side))
    found["error_without_offsets_mm"] = figure_of(without, hands.ADDRESSES["error_mm"]).value
    found["joint_inside_90"] = figure_of(without, "joint_inside_90").value
    frames = hands.frames_of(evaluation)
    assert frames is not None
    others = _errors(result.of(side), other)
    return {name: np.nan if value is None else value for name, value in found.items()} | {
        "found_within": hands.found_within(frames),
        "far": float(np.mean((frames.error > FAR_MM) & ~frames.lost)),
        "swapped": float(np.sum((others < frames.error) & ~frames.lost)),
        "sides": float(np.median(frames.error) < np.median(others)),
    }


def _errors(result: Result, side: str) -> FloatArray:
    """Return the mean distance (M,) of a hand's joints from the ground truth of a side, mm."""
    track, truth = track_of_result(result, side), load_truth(result, label=side)
    assert truth is not None and truth.points is not None and track.points is not None
    pairs = associate(track.stamp_ns, truth.stamp_ns, hands.RAW.tolerance_ns)
    apart = track.points[pairs.estimate] - truth.points[pairs.truth]
    distances: FloatArray = np.linalg.norm(apart, axis=2).mean(axis=1)
    return distances
