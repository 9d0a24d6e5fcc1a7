"""What a head's result is worth beside its truth, in the figures that were asked for.

Errors are those of ``posetrack eval --align rigid``: one constant rigid offset of the head's frame is
removed. Stated intervals are compared with errors from which nothing is removed, as ``posetrack eval`` does
by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.honesty import roc_area
from posetrack_cli.evaluation.metrics.pose_errors import inside_interval, normalised_squares, pose_difference
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.euler import head_roll_pitch_yaw
from posetrack_cli.geometry.projection import pixels_from_points
from reproduction.heads_data import CALIBRATION, TRUTH, cameras_of
from reproduction.one_camera.measuring import Compared, compare, figures_of

EARLY_FRAMES = 60
"""The first two seconds: what a track is like before it knows the person."""
WRONG_DEG = 3.0
"""A rotation that is off by more is wrong."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A result beside its truth.

    Attributes:
        figures: means over the tracked frames.
        first_px: (K, 2) how far off the points of the first tracked frame are on the image, pixels.
        confidence: (M,) of the frames with a truth.
        wrong: (M,) whether their rotation is off by more than ``WRONG_DEG`` after the offset.
        inside: (M, 6) whether the stated 90 % intervals of position and rotation hold the truth.
        tracked: (M,) frames in which the head was followed, also those that say they are lost.
    """

    figures: Mapping[str, float]
    first_px: FloatArray
    confidence: FloatArray
    wrong: BoolArray
    inside: BoolArray
    tracked: BoolArray


def judge(result: Path, truth: Path, camera: Camera) -> Judged:
    """Measure a result.

    Args:
        result: of ``posetrack head``.
        truth: a table.
        camera: the reference camera.

    Raises:
        PosetrackError: a file cannot be read, or they have no frame in common.
    """
    one = compare(result, truth)
    found = dict(figures_of(one)) | shares(one)
    found["factor"] = compare(result, truth, "factor").factor
    raw = evaluate(result, EvalOptions(truth=truth))
    return Judged(
        found,
        first_points(one, camera),
        np.nan_to_num(raw.series["confidence"]),
        one.rotation_deg > WRONG_DEG,
        inside_90(raw),
        one.tracked,
    )


def shares(one: Compared) -> dict[str, float]:
    """Return the rotation error early, late and as their ratio, its 95th percentile, and the gain of yaw."""
    early = np.arange(one.frames) < EARLY_FRAMES
    rows = one.tracked
    found = {"rotation_p95": float(np.quantile(one.rotation_deg[rows], 0.95))} if rows.any() else {}
    parts = [one.rotation_deg[rows & which] for which in (early, ~early)]
    if all(len(values) for values in parts):
        first, later = (float(values.mean()) for values in parts)
        found |= {"early_deg": first, "late_deg": later, "early_ratio": first / later}
    if rows.sum() > 1:
        found["yaw_gain"] = gain(one, rows)
    return found


def gain(one: Compared, rows: BoolArray) -> float:
    """Return the slope of estimated over true yaw: 1 where turns are seen as large as they are."""
    mine, theirs = (
        head_roll_pitch_yaw(np.asarray(track.quaternion))[rows, 2] for track in (one.track, one.reference)
    )
    return float(np.polyfit(np.unwrap(theirs), np.unwrap(mine), 1)[0])


def first_points(one: Compared, camera: Camera) -> FloatArray:
    """Return (K, 2) how far off the points of the first tracked frame are in the image, pixels."""
    row = int(np.argmax(one.tracked))
    mine, theirs = (
        pixels_from_points(camera, np.asarray(track.points)[row])[0] for track in (one.track, one.reference)
    )
    off: FloatArray = mine - theirs
    return off


def inside_90(evaluation: Evaluation) -> BoolArray:
    """Return (M, 6) which entries of the pose lie inside their 90 % intervals."""
    track, truth, pairs = evaluation.track, evaluation.truth, evaluation.pairs
    if truth is None or pairs is None or track.pose_variance is None:
        raise ValueError("no truth, or no covariance, to compare with")
    mine, theirs = pairs.estimate, pairs.truth
    sides: list[Any] = [track.position, track.quaternion, truth.position, truth.quaternion]
    rows = (mine, mine, theirs, theirs)
    errors = pose_difference(*(values[row] for values, row in zip(sides, rows, strict=True)))
    return inside_interval(normalised_squares(errors, track.pose_variance[mine, :6]))


def without_others(offsets: Sequence[FloatArray]) -> FloatArray:
    """Return (P, K) lengths of P people's point errors (K, 2), less the mean offset of the other people.

    Where a detector's point sits beside a mesh's vertex is a convention; that it does so for the person
    who is measured is none. Of one person nothing is removed.
    """
    every = np.array(offsets)
    others = (every.sum(axis=0) - every) / max(len(every) - 1, 1) if len(every) > 1 else np.zeros_like(every)
    lengths: FloatArray = np.linalg.norm(every - others, axis=-1)
    return lengths


def area(judged: Sequence[Judged]) -> float:
    """Return the area under the ROC curve of confidence against a right rotation, all frames pooled."""
    return roc_area(
        np.concatenate([one.confidence for one in judged]), ~np.concatenate([one.wrong for one in judged])
    )


class Measured:
    """Results below a folder, each measured once.

    Args:
        folder: the study's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, Judged] = {}
        self._noted: dict[str, dict[str, Any]] = {}

    def judged(self, result: str, person: Path) -> Judged | None:
        """A result, named by its path below the folder, beside a person's truth; None where it is missing."""
        path = self.folder / result
        if result not in self._known:
            if not path.exists():
                return None
            self._known[result] = judge(path, person / TRUTH, cameras_of(person / CALIBRATION)[0])
        return self._known[result]

    def note(self, part: str, row: str, figures: Mapping[str, Any]) -> None:
        """Keep figures for the JSON file."""
        self._noted.setdefault(part, {})[row] = dict(figures)

    @property
    def everything(self) -> dict[str, dict[str, Any]]:
        """All figures that were noted, by part and row."""
        return self._noted
