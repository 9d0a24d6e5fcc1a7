"""Measure a hand result against ground truth: metrics of ``posetrack eval``, and wrist errors."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.measuring.catalogue import figure_of
from posetrack_cli.evaluation.measuring.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.hand_metrics import central_differences, joint_errors
from posetrack_cli.evaluation.measuring.measures import Matched, common_columns, rows_of
from posetrack_cli.evaluation.reading.tracks import usual_interval
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.results.reader import read_result
from posetrack_cli.results.topics import FILTERED
from posetrack_cli.units import NS_PER_S

WRIST = JOINT_NAMES[0]
RAW, WITHOUT_OFFSETS = EvalOptions(), EvalOptions(joint_offsets="bone")
OFF_MM = 60.0  # largest error of a wrist that counts as found
# Mean joint error from which the hand is not being followed, whatever the status
ASTRAY_MM = 20
# Addresses in ``posetrack eval`` by figure
ADDRESSES = {
    "error_mm": "joint_error_mm.mean",
    "tip_error_mm": "fingertip_error_mm.mean",
    "p95_mm": "joint_error_mm.p95",
    "velocity_error_mm_s": "velocity_error_mm_s.mean",
    "inside_90": "inside_90",
    "nees": "nees.mean",
    "evaluations": "evaluations.mean",
    "coverage": "coverage",
    "lost": "lost",
    "frames": "frames",
}


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames (M,) of a track that have ground truth, including lost ones, in temporal order."""

    error: FloatArray  # mean joint error, mm
    wrist: FloatArray  # wrist error, mm
    lost: BoolArray  # whether the status is lost


@cache
def evaluated(result: Path, options: EvalOptions = RAW) -> Evaluation:
    """Return the evaluation of a result (cached)."""
    return evaluate(result, options)


def frames_of(evaluation: Evaluation) -> Frames | None:
    """Return the frames of an evaluation; None if no frame has a true wrist."""
    track, truth, pairs = evaluation.track, evaluation.truth, evaluation.pairs
    joints = common_columns(track.point_names, () if truth is None else truth.point_names)
    if truth is None or pairs is None or not len(pairs.estimate) or WRIST not in joints.names:
        return None
    assert track.lost is not None
    errors = joint_errors(Matched(track, truth, pairs), joints)
    wrist = errors[:, joints.names.index(WRIST)]
    return Frames(errors.mean(axis=1), wrist, rows_of(track.lost, pairs.estimate))


def figures_of(result: Path | None, track: str = FILTERED) -> dict[str, float]:
    """Return the figures of a track; empty if the result or track is missing."""
    if result is None or track not in read_result(result).tracks:
        return {}
    raw = evaluated(result, replace(RAW, track=track))
    found = {name: figure_of(raw, address).value for name, address in ADDRESSES.items()}
    figures = {name: value for name, value in found.items() if value is not None}
    figures["lost_share"] = figures.get("lost", np.nan) / figures.get("frames", np.nan)
    within = figure_of(raw, f"frames_mean_within_{ASTRAY_MM}mm").value
    if within is not None:
        figures["astray"] = 1.0 - within
    return figures


def velocities_of(result: Path | None, track: str = FILTERED) -> dict[str, float]:
    """Return mean errors of the wrist's and the fingers' joint velocities, mm/s, and those of differencing.

    The true velocity is the central difference of the true joints. Differencing: backward difference of the
    estimated joints, over the same frames.
    """
    if result is None or track not in read_result(result).tracks:
        return {}
    raw = evaluated(result, replace(RAW, track=track))
    whole, of_wrist = (figure_of(raw, f"{VELOCITY}{part}.mean").value for part in ("", f".{WRIST}"))
    truth, pairs = raw.truth, raw.pairs
    if truth is None or pairs is None or whole is None or of_wrist is None:
        return {}
    joints = common_columns(raw.track.point_names, truth.point_names)
    true = central_differences(truth, pairs.truth, usual_interval(truth.stamp_ns))[:, joints.truth]
    points, stamps = raw.track.points, raw.track.stamp_ns
    assert points is not None
    backward = np.full(points.shape, np.nan)
    backward[1:] = np.diff(points, axis=0) / (np.diff(stamps) / NS_PER_S)[:, None, None]
    errors = np.linalg.norm(rows_of(backward, pairs.estimate)[:, joints.estimate] - true, axis=-1)
    means = errors[np.isfinite(errors).all(axis=1)].mean(axis=0)
    wrist, count = joints.names.index(WRIST), len(joints.names)
    others = (count * whole - of_wrist) / (count - 1)
    return {
        "wrist_velocity": of_wrist,
        "wrist_differences": float(means[wrist]),
        "finger_velocity": others,
        "finger_differences": float(np.delete(means, wrist).mean()),
    }


VELOCITY = "joint_velocity_error_mm_s"
VELOCITIES = {
    "wrist_velocity": "wrist velocity error, mm/s",
    "wrist_differences": "by differences",
    "finger_velocity": "finger joints, mm/s",
    "finger_differences": "by differences",
}
"""Titles of the figures of ``velocities_of``."""


def without_offsets(result: Path | None) -> dict[str, float]:
    """Return the mean joint error after one constant offset per joint, in the axes of its bone."""
    if result is None:
        return {}
    value = figure_of(evaluated(result, WITHOUT_OFFSETS), ADDRESSES["error_mm"]).value
    return {} if value is None else {"error_without_offsets_mm": value}


def found_within(frames: Frames) -> float:
    """Return the number (from 1) of the first tracked frame with the wrist found; infinity if none."""
    found = np.flatnonzero((frames.wrist <= OFF_MM) & ~frames.lost)
    return float(found[0]) + 1.0 if len(found) else np.inf


def start_of(result: Path | None) -> dict[str, float]:
    """Return when the hand is found and how long it is followed.

    ``off``: number of frames with a wrong wrist that are not lost. ``kept``: share of frames with the wrist
    found, whatever their status.
    """
    frames = None if result is None else frames_of(evaluated(result))
    if frames is None:
        return {}
    off = float(((frames.wrist > OFF_MM) & ~frames.lost).sum())
    return {"found_within": found_within(frames), "off": off, "kept": float((frames.wrist < OFF_MM).mean())}


def side_of(result: Path) -> str:
    """Return the side of the tracked hand from the run record."""
    return str(json.loads(evaluated(result).run["configuration"])["hand"]["side"])
