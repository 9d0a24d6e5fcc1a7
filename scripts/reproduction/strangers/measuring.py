"""What the results of strangers' recordings say frame by frame, and what was noted of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.figures import figure_of
from posetrack_cli.evaluation.honesty import JudgedFrames
from posetrack_cli.evaluation.metrics.hand_metrics import joint_errors
from posetrack_cli.evaluation.metrics.measures import Matched, common_columns, rows_of
from posetrack_cli.evaluation.metrics.pose_errors import distances
from posetrack_cli.hand.anatomy import JOINT_NAMES
from posetrack_cli.results.tracks import FILTERED
from reproduction.task import EntrantsTask

NAN = float("nan")
WRIST = JOINT_NAMES[0]


@dataclass(frozen=True, eq=False)
class Frames:
    """The frames (M,) of a track that have a truth, lost ones among them, in the order of time.

    Attributes:
        error: mean over the joints of the distance to the true one, mm.
        wrist: distance between estimated and true wrist, mm.
        moved: mean over the joints of how far each went since the frame before, mm; 0 in the first.
        truly_moved: the same of the truth.
        lost: frames whose status is lost.
    """

    error: FloatArray
    wrist: FloatArray
    moved: FloatArray
    truly_moved: FloatArray
    lost: BoolArray


def frames_of(evaluation: Evaluation) -> Frames | None:
    """The frames of an evaluation; None where there is no truth with a wrist, or it fits no frame."""
    track, truth, pairs = evaluation.track, evaluation.truth, evaluation.pairs
    joints = common_columns(track.point_names, () if truth is None else truth.point_names)
    if truth is None or pairs is None or not len(pairs.estimate) or WRIST not in joints.names:
        return None
    assert track.points is not None and truth.points is not None
    assert track.lost is not None
    errors = joint_errors(Matched(track, truth, pairs), joints)
    return Frames(
        error=errors.mean(axis=1),
        wrist=errors[:, joints.names.index(WRIST)],
        moved=path_lengths(rows_of(track.points, pairs.estimate)[:, joints.estimate]),
        truly_moved=path_lengths(rows_of(truth.points, pairs.truth)[:, joints.truth]),
        lost=rows_of(track.lost, pairs.estimate),
    )


def path_lengths(points: FloatArray) -> FloatArray:
    """Mean over the points (M, P, 3) of how far each went since the frame before, (M,); 0 in the first."""
    return np.concatenate([np.zeros(min(1, len(points))), distances(points[1:], points[:-1]).mean(axis=1)])


class Measured:
    """Results in a folder, each measured once; those of other code or arguments do not count.

    Args:
        folder: of the results.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, str, EvalOptions], Evaluation | None] = {}
        self._noted: dict[str, dict[str, Any]] = {}

    def frames(
        self,
        task: EntrantsTask,
        entrant: str,
        track: str = FILTERED,
        options: EvalOptions | None = None,
    ) -> Frames | None:
        """The frames of a track of a result; None without one."""
        found = self.evaluation(task, entrant, replace(options or EvalOptions(), track=track))
        return None if found is None else frames_of(found)

    def judged(self, task: EntrantsTask, entrant: str) -> JudgedFrames | None:
        """The frames of a result, right or wrong as ``posetrack eval`` judges them; None without one."""
        found = self.evaluation(task, entrant, EvalOptions())
        return None if found is None else found.judged

    def error(self, task: EntrantsTask, entrant: str, track: str = FILTERED) -> float:
        """Mean joint error of a track over all its frames, mm; NaN where it is missing."""
        frames = self.frames(task, entrant, track)
        return NAN if frames is None else float(frames.error.mean())

    def figure(
        self, task: EntrantsTask, entrant: str, address: str, options: EvalOptions | None = None
    ) -> float:
        """A figure of ``posetrack eval``; NaN where the result, or the figure, is missing."""
        found = self.evaluation(task, entrant, options or EvalOptions())
        value = None if found is None else figure_of(found, address).value
        return NAN if value is None else value

    def side(self, task: EntrantsTask, entrant: str) -> str:
        """Which hand was tracked, as the result's record says; nothing where there is none."""
        found = self.evaluation(task, entrant, EvalOptions())
        return "" if found is None else str(json.loads(found.run["configuration"])["hand"]["side"])

    def hand_file(self, task: EntrantsTask, entrant: str) -> str:
        """The text of a hand file that an entrant wrote; nothing where there is none."""
        made = task.is_current(self.folder, entrant)
        return task.result(self.folder, entrant).read_text("utf-8") if made else ""

    def evaluation(self, task: EntrantsTask, entrant: str, options: EvalOptions) -> Evaluation | None:
        """A result, measured; None without one."""
        key = (task.name, entrant, options)
        if key not in self._known:
            made = task.is_current(self.folder, entrant)
            self._known[key] = evaluate(task.result(self.folder, entrant), options) if made else None
        return self._known[key]

    def note(self, part: str, row: str, figures: Mapping[str, Any]) -> None:
        """Keep figures for the JSON file."""
        self._noted.setdefault(part, {})[row] = dict(figures)

    @property
    def everything(self) -> dict[str, dict[str, Any]]:
        """All figures that were noted, by part and row."""
        return self._noted
