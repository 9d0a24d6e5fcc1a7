"""How far a tracked head is from the truth, frame by frame, and in figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.metrics.pose_errors import distances
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.rigid import in_object
from posetrack_cli.head.config import HeadStereoConfig
from posetrack_cli.head.face.points import MOUTH, NOSTRILS, POINT_COUNT
from reproduction.heads.events import Events, events_of
from reproduction.heads.tasks import Task

RIGID_FRAMES = HeadStereoConfig().model.rigid_frames
"""So long every model is rigid: deformable and rigid ones are compared from there on."""
MOVING_MM, DEFORMING_MM = 3.0, 1.0
"""A point moves while it is farther than this from its neutral place; so does a face while one of its points
is."""
WRONG_MM, WRONG_DEG = 10.0, 5.0
"""A pose that is off by more is no head that is tracked."""
STEADY_S = 0.5
"""So long a head must be tracked to count as found again."""
FOLLOWED = np.setdiff1d(np.arange(POINT_COUNT), np.arange(POINT_COUNT)[NOSTRILS])
"""Points whose true movement is that of what is seen: the nostrils' vertices move with the mouth by some mm,
while the openings hardly do."""
Figures = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Course:
    """A result beside its truth, in M frames, after one constant rigid offset of the head's frame.

    Attributes:
        seconds: (M,) since the first frame.
        tracked: (M,) whether the tracker says that it has the head.
        pose: (M, 6) absolute errors, mm and deg, in the order of ``HEAD_POSE``.
        position_mm, rotation_deg: (M,) lengths of the whole errors.
        points_mm: (M, K) errors in head coordinates after each point's constant offset, too.
        moved_mm: (M, K) how far the true points are from their places in the first, neutral frame.
        milliseconds: (M,) per frame, NaN where not timed.
    """

    seconds: FloatArray
    tracked: BoolArray
    pose: FloatArray
    position_mm: FloatArray
    rotation_deg: FloatArray
    points_mm: FloatArray
    moved_mm: FloatArray
    milliseconds: FloatArray

    @property
    def deforming(self) -> BoolArray:
        """(M,) whether the face is not neutral."""
        deforming: BoolArray = self.moved_mm[:, FOLLOWED].max(axis=1) > DEFORMING_MM
        return deforming

    @property
    def wrong(self) -> BoolArray:
        """(M,) whether the pose is far off."""
        wrong: BoolArray = (self.position_mm > WRONG_MM) | (self.rotation_deg > WRONG_DEG)
        return wrong


def course(result: Path, truth: Path | None) -> Course:
    """Return how a result went.

    Args:
        result: of ``posetrack head stereo``.
        truth: a file; None where the result carries its truth.

    Raises:
        PosetrackError: it cannot be read, or there is no truth.
    """
    return course_of(evaluate(result, EvalOptions(truth=truth, align="rigid+points")))


def course_of(evaluation: Evaluation) -> Course:
    """Return how an evaluated result went; it was evaluated with ``rigid+points``."""
    track, theirs, pairs = evaluation.track, evaluation.truth, evaluation.pairs
    if theirs is None or pairs is None:
        raise ValueError("no truth to compare with")
    mine, true = _in_head(track)[pairs.estimate], _in_head(theirs)
    lost, times = track.lost, track.milliseconds
    series, count = evaluation.series, len(pairs.estimate)
    return Course(
        seconds=(track.stamp_ns[pairs.estimate] - track.stamp_ns[0]) * 1e-9,
        tracked=np.ones(count, dtype=np.bool_) if lost is None else ~lost[pairs.estimate],
        pose=np.stack([series[name] for name in HEAD_POSE], axis=1),
        position_mm=series["position_mm"],
        rotation_deg=series["rotation_deg"],
        points_mm=distances(mine, true[pairs.truth]),
        moved_mm=distances(true, true[0])[pairs.truth],
        milliseconds=np.full(count, np.nan) if times is None else times[pairs.estimate],
    )


def _in_head(track: Track) -> FloatArray:
    """Points (N, K, 3) in head coordinates."""
    points: Any = track.points
    position, quaternion = (np.repeat(v, points.shape[1], axis=0) for v in _pose(track))
    flat: FloatArray = in_object(points.reshape(-1, 3), position, quaternion)
    return flat.reshape(points.shape)


def _pose(track: Track) -> tuple[Any, Any]:
    return track.position, track.quaternion


def figures_of(one: Course, events: Events) -> dict[str, float]:
    """Return all that tables tell about a result; what there is nothing of is left out.

    Means are over frames that are reported as tracked: their share is a figure of its own. Those that begin
    with ``deforming`` and ``still`` are over the frames after the first ``RIGID_FRAMES`` in which the face is
    not, or is, neutral.
    """
    later = np.arange(len(one.tracked)) >= RIGID_FRAMES
    found = _means("", one, one.tracked)
    found |= _means("deforming ", one, one.tracked & later & one.deforming)
    found |= _means("still ", one, one.tracked & later & ~one.deforming)
    found["frames"] = float(len(one.tracked))
    found["tracked"] = float(one.tracked.mean())
    found["wrong"] = float((one.tracked & one.wrong).sum())
    found["first"] = float(np.argmax(one.tracked)) if one.tracked.any() else np.inf
    if events.end_s is not None and events.end_s <= one.seconds[-1]:
        found["recovery_s"] = recovery_s(one, events.end_s)
    if np.isfinite(one.milliseconds).any():
        found["ms"] = float(np.nanmedian(one.milliseconds))
    return found


def _means(prefix: str, one: Course, rows: BoolArray) -> dict[str, float]:
    """Mean errors over some frames; of points only while they move."""
    if not rows.any():
        return {}
    found = dict(zip(HEAD_POSE, one.pose[rows].mean(axis=0).tolist(), strict=True))
    found |= {"position_mm": one.position_mm[rows].mean(), "rotation_deg": one.rotation_deg[rows].mean()}
    moving = rows[:, None] & (one.moved_mm > MOVING_MM)
    for name, columns in {"mouth_mm": np.arange(POINT_COUNT)[MOUTH], "moving_mm": FOLLOWED}.items():
        values = one.points_mm[:, columns][moving[:, columns]]
        if values.size:
            found[name] = values.mean()
    return {f"{prefix}{name}": float(value) for name, value in found.items()}


def recovery_s(one: Course, end_s: float) -> float:
    """Return how long after ``end_s`` a head is tracked rightly, and goes on to be for ``STEADY_S``.

    Infinite if that never comes; where the recording ends sooner, until its end.
    """
    right = one.tracked & ~one.wrong
    for row in np.flatnonzero(one.seconds >= end_s):
        begin = one.seconds[row]
        if right[(one.seconds >= begin) & (one.seconds <= begin + STEADY_S)].all():
            return float(begin - end_s)
    return float("inf")


class Measured:
    """Figures of the results below a folder, each measured once.

    Args:
        folder: of results and recordings.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, str], Figures] = {}

    def figures(self, task: Task, entrant: str) -> Figures:
        """The figures of a task's result; none where it is missing."""
        key = (task.name, entrant)
        if key not in self._known:
            result = task.result(self.folder, entrant)
            if not result.exists():
                return {}
            self._known[key] = figures_of(course(result, task.truth), events_of(task.recording(self.folder)))
        return self._known[key]

    def values(self, tasks: Iterable[Task], entrant: str, name: str) -> FloatArray:
        """A figure of each task that has it, (n,)."""
        found = (self.figures(task, entrant) for task in tasks)
        return np.array([figures[name] for figures in found if name in figures])

    def pairs(self, tasks: Iterable[Task], entrants: Sequence[str], name: str) -> FloatArray:
        """A figure of two entrants for each task in which both have it, (n, 2)."""
        both = ([self.figures(task, entrant) for entrant in entrants] for task in tasks)
        return np.array([[f[name] for f in pair] for pair in both if all(name in f for f in pair)]).reshape(
            -1, 2
        )

    @property
    def everything(self) -> dict[str, dict[str, Figures]]:
        """All figures measured so far, by task and entrant."""
        tasks = sorted({task for task, _ in self._known})
        return {task: {name: f for (of, name), f in self._known.items() if of == task} for task in tasks}
