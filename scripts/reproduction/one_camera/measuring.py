"""How far one camera's result is from a reference: two cameras' result, or the truth.

Where a head's frame sits is a convention, so one constant rigid offset of it is removed, and said to be. As
it brings the positions nearest, it takes in what is constant of an error in depth. The points in head
coordinates are therefore compared after a constant rigid movement of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.alignment import remove_constant_offset, tracked_pairs
from posetrack_cli.evaluation.association import Pairs
from posetrack_cli.evaluation.evaluate import EvalOptions, evaluate
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.metrics.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.metrics.pose_errors import distances, euler_errors_deg, rotation_errors_deg
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rigid import in_object, rigid_alignment

WRONG_MM, WRONG_DEG = 60.0, 15.0
"""[ours] A pose that is off by more, scale apart, is no head that is tracked: about one and a half times the
greatest errors of experiment B, mean and two standard deviations."""
KEPT_RESULTS = 4
Removed = Literal["nothing", "offset", "factor"]
"""What is removed of the difference: nothing, one constant rigid offset, or also one common factor on all
lengths, which one camera cannot see."""
SAID: Mapping[Removed, str] = {
    "nothing": "nothing removed",
    "offset": "one rigid offset removed",
    "factor": "one rigid offset and one depth factor removed",
}
Figures = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Compared:
    """A result beside a reference, in M frames.

    Attributes:
        track, reference: (M,) rows of the result, without what is removed, and of the reference.
        tracked: (M,) whether the head was followed, also where the tracker then says that it is more probably
            wrong than right: to doubt a frame must not make errors small.
        believed: (M,) whether the tracker says that it has the head.
        pose: (M, 6) absolute errors, mm and deg, in the order of ``HEAD_POSE``.
        position_mm, rotation_deg: (M,) lengths of the whole errors.
        points_mm: (M, K) distances of the points in head coordinates, after the one constant rigid movement
            that makes them least.
        shapes_mm: (M, K) the same after each point's own constant offset, too.
        factor: what all lengths of the result were multiplied by; 1 as measured.
        frames: M.
    """

    track: Track
    reference: Track
    tracked: BoolArray
    believed: BoolArray
    pose: FloatArray
    position_mm: FloatArray
    rotation_deg: FloatArray
    points_mm: FloatArray
    shapes_mm: FloatArray
    factor: float

    @property
    def frames(self) -> int:
        """M."""
        return len(self.tracked)

    @property
    def wrong(self) -> BoolArray:
        """(M,) whether the pose is far off."""
        wrong: BoolArray = (self.position_mm > WRONG_MM) | (self.rotation_deg > WRONG_DEG)
        return wrong


def compare(result: Path, reference: Path | None, removed: Removed = "offset") -> Compared:
    """Compare a result with a reference.

    Args:
        result: of ``posetrack head mono``.
        reference: a result, whose estimates are taken, or a file of truth; None for the truth it carries.
        removed: of their difference.

    Raises:
        PosetrackError: a file cannot be read, or there is no reference.
    """
    evaluation = _evaluated(result, reference)
    mine, theirs, pairs = evaluation.track, evaluation.truth, evaluation.pairs
    if theirs is None or pairs is None or not len(pairs.estimate):
        raise ResultError("has no truth in common with what it is compared with", where=result)
    factor = common_factor(mine, theirs, pairs) if removed == "factor" else 1.0
    track = _multiplied(mine, factor)
    if removed != "nothing":
        track, _ = remove_constant_offset(track, theirs, pairs)
    return _compared(rows_of(track, pairs.estimate), rows_of(theirs, pairs.truth), factor)


@lru_cache(maxsize=KEPT_RESULTS)
def _evaluated(result: Path, reference: Path | None) -> Evaluation:
    return evaluate(result, EvalOptions(truth=reference))


def _compared(track: Track, reference: Track, factor: float) -> Compared:
    believed = np.ones(len(track), dtype=np.bool_) if track.lost is None else ~track.lost
    tracked = believed if track.confidence is None else believed | (np.nan_to_num(track.confidence) > 0.0)
    position, quaternion = pose_of(track)
    true_position, true_quaternion = pose_of(reference)
    shape, true_shape = in_head(track), in_head(reference)
    counted = tracked if tracked.any() else ~tracked
    moved = _moved_onto(shape, true_shape, counted)
    offsets = (true_shape - moved)[counted].mean(axis=0)
    return Compared(
        track=track,
        reference=reference,
        tracked=tracked,
        believed=believed,
        pose=np.hstack([np.abs(position - true_position), euler_errors_deg(quaternion, true_quaternion)]),
        position_mm=distances(position, true_position),
        rotation_deg=rotation_errors_deg(quaternion, true_quaternion),
        points_mm=distances(moved, true_shape),
        shapes_mm=distances(moved + offsets, true_shape),
        factor=factor,
    )


def _moved_onto(shape: FloatArray, true_shape: FloatArray, counted: BoolArray) -> FloatArray:
    """Shapes (M, K, 3) after one constant rigid movement, the best over the frames that count."""
    weights = np.repeat(counted.astype(np.float64), shape.shape[1])
    rotation, translation = rigid_alignment(shape.reshape(-1, 3), true_shape.reshape(-1, 3), weights)
    moved: FloatArray = shape @ rotation.T + translation
    return moved


def common_factor(track: Track, reference: Track, pairs: Pairs) -> float:
    """Return the factor s on all lengths of a result that brings it nearest to a reference.

    Over the tracked pairs s and the head's constant offset x minimise sum |s t_i + R_i x - t_ref,i|^2, a
    linear least-squares problem in four unknowns.
    """
    mine, theirs = tracked_pairs(track, pairs)
    position, quaternion = pose_of(track)
    turns = rotations.matrices_from_quaternions(quaternion[mine])
    design = np.concatenate([position[mine][:, :, None], turns], axis=2).reshape(-1, 4)
    (factor, *_), *_ = np.linalg.lstsq(design, pose_of(reference)[0][theirs].ravel())
    return float(factor)


def _multiplied(track: Track, factor: float) -> Track:
    """The track in another unit of length: positions and points."""
    position, points = (
        None if values is None else factor * values for values in (track.position, track.points)
    )
    return replace(track, position=position, points=points)


def rows_of(track: Track, rows: Any) -> Track:
    """Return some frames of a track, as far as this study looks at them."""
    named = (
        "stamp_ns",
        "lost",
        "position",
        "quaternion",
        "points",
        "milliseconds",
        "frame_index",
        "confidence",
    )
    known = {name: values[rows] for name in named if (values := getattr(track, name)) is not None}
    fields = ("name", "subject", "shape_names", "point_names", "point_parents")
    return Track(**{name: getattr(track, name) for name in fields}, **known)


def in_head(track: Track) -> FloatArray:
    """Return points (N, K, 3) in head coordinates, mm."""
    points: Any = track.points
    position, quaternion = (np.repeat(values, points.shape[1], axis=0) for values in pose_of(track))
    flat: FloatArray = in_object(points.reshape(-1, 3), position, quaternion)
    return flat.reshape(points.shape)


def pose_of(track: Track) -> tuple[Any, Any]:
    """Return position and quaternion, which every track of a head has."""
    return track.position, track.quaternion


def figures_of(one: Compared) -> dict[str, float]:
    """Return all that tables tell about a result: means, and with ``sd`` deviations, over tracked frames."""
    found = {
        "frames": float(one.frames),
        "tracked": float((one.tracked & one.believed).mean()),
        "wrong": float((one.tracked & one.wrong).sum()),
        "factor": one.factor,
        "first": float(np.argmax(one.tracked)) if one.tracked.any() else np.inf,
    }
    if not one.tracked.any():
        return found
    series = {name: one.pose[:, column] for column, name in enumerate(HEAD_POSE)}
    series |= {"position_mm": one.position_mm, "rotation_deg": one.rotation_deg}
    series |= {"points_mm": one.points_mm.mean(axis=1), "shapes_mm": one.shapes_mm.mean(axis=1)}
    for name, values in series.items():
        found[name] = float(values[one.tracked].mean())
        found[f"{name} sd"] = float(values[one.tracked].std())
    if one.track.milliseconds is not None and np.isfinite(one.track.milliseconds).any():
        found["ms"] = float(np.nanmedian(one.track.milliseconds))
    return found


class Measured:
    """Figures of the results below a folder, each measured once.

    Args:
        folder: the study's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[tuple[str, str, Removed], Figures] = {}

    def figures(self, result: str, reference: str = "", removed: Removed = "offset") -> Figures:
        """The figures of a result, none where it is missing.

        Args:
            result: path below the folder.
            reference: path, below the folder or absolute; empty for the truth that the result carries.
            removed: of their difference.
        """
        key = (result, reference, removed)
        if key not in self._known:
            paths = [self.folder / name for name in (result, reference) if name]
            if not all(path.exists() for path in paths):
                return {}
            self._known[key] = figures_of(compare(paths[0], paths[1] if reference else None, removed))
        return self._known[key]

    @property
    def everything(self) -> dict[str, Figures]:
        """All figures measured so far."""
        return {_named(*key): figures for key, figures in sorted(self._known.items())}


def _named(result: str, reference: str, removed: Removed) -> str:
    against = Path(reference).name if reference else "the truth"
    return f"{Path(result).stem} against {against}, {SAID[removed]}"


def values_of(found: Iterable[Figures], name: str) -> FloatArray:
    """A figure of each result that has it, (n,)."""
    return np.array([figures[name] for figures in found if name in figures])
