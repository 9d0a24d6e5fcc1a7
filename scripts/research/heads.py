"""Head recordings with ground truth; errors of head results against ground truth or another result.

The position of the head frame is a convention, so one constant rigid offset is removed, as by ``eval --align
rigid``. It also absorbs the constant part of a depth error.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.measuring.evaluate import Alignment, EvalOptions, evaluate
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.head_metrics import HEAD_POSE
from posetrack_cli.evaluation.measuring.pose_metrics import distances
from posetrack_cli.evaluation.reading.alignment import tracked_pairs
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import in_object, placed, rigid_alignment
from posetrack_cli.geometry.rotations import head_roll_pitch_yaw
from posetrack_cli.recording import camera_file
from research.report import Column

CALIBRATION, TRUTH = "calibration.json", "truth.csv"
LEFT = "left"  # camera for tracking with one camera
FIRST, SECOND = ("--passes", "1"), ("--passes", "2")
AXES = ("x, mm", "y", "z", "roll, deg", "pitch", "yaw")
POSE_COLUMNS = tuple(Column(name, title) for name, title in zip(HEAD_POSE, AXES, strict=True))
TRACKED_COLUMNS = (
    Column("tracked", "tracked", 1, percent=True),
    Column("first", "first frame", 0, whole="max"),
    Column("wrong", "wrong", 0, whole="sum"),
)


def cameras_of(calibration_json: Path) -> list[Camera]:
    """Read the cameras of a calibration.json, reference first."""
    cameras = []
    for name, values in json.loads(calibration_json.read_text())["cameras"].items():
        (fx, _, cx), (_, fy, cy), _ = np.array(values["K"], dtype=float).tolist()
        lens = tuple(map(float, values["distortion"]))
        camera = Camera(values["width"], values["height"], fx, fy, cx, cy, distortion=lens, name=name)
        cameras.append(placed(camera, np.column_stack([values["R_from_left"], values["t_from_left_mm"]])))
    return cameras


def reading_arguments(folder: Path, cameras: Path) -> tuple[str, ...]:
    """Return the arguments that read a recording; write its camera file into the folder ``cameras``."""
    camera = cameras / f"{folder.name}.camera.toml"
    camera.parent.mkdir(parents=True, exist_ok=True)
    camera.write_text(camera_file.camera_file_text(cameras_of(folder / CALIBRATION)), encoding="utf-8")
    fps = float(json.loads((folder / CALIBRATION).read_text())["fps"])
    return (str(folder), "--camera", str(camera), "--fps", f"{fps:g}")


def persons_in(folder: Path | None) -> list[Path]:
    """Return the subfolders that contain a recording with calibration and ground truth."""
    found = [] if folder is None else sorted(folder.iterdir())
    return [one.resolve() for one in found if all((one / name).is_file() for name in (CALIBRATION, TRUTH))]


@dataclass(frozen=True, eq=False)
class Compared:
    """A result against a reference, in M frames."""

    seconds: FloatArray  # (M,) since the first frame
    # (M,) whether the head was followed, including frames with low confidence: leaving these out would make
    # errors small
    followed: BoolArray
    believed: BoolArray  # (M,) whether the status is not lost
    pose: FloatArray  # (M, 6) absolute errors, mm and deg, in the order of ``HEAD_POSE``
    position_mm: FloatArray  # (M,) Euclidean errors
    rotation_deg: FloatArray
    columns: FloatArray  # (M, 6) x, y, z (mm), roll, pitch, yaw (deg) of result and reference
    true_columns: FloatArray
    shape: FloatArray  # (M, K, 3) points in head coordinates, mm
    true_shape: FloatArray
    neutral: FloatArray  # (K, 3) shape in the reference's first frame
    points: FloatArray  # (M, K, 3) in camera axes, mm
    true_points: FloatArray
    milliseconds: FloatArray  # (M,) per frame, NaN where not timed
    confidence: FloatArray  # (M,) NaN where not stated
    stamp_ns: IntArray  # (M,)

    @property
    def moved_mm(self) -> FloatArray:
        """Distances (M, K) of the true points from their neutral positions."""
        return distances(self.true_shape, self.neutral)

    def points_mm(self) -> tuple[FloatArray, FloatArray]:
        """Return point errors (M, K) in head coordinates after the best constant rigid motion.

        In the second array, the constant offset of each point is removed as well.
        """
        counted = self.followed if self.followed.any() else ~self.followed
        weights = np.repeat(counted.astype(np.float64), self.shape.shape[1])
        flat, true = (points.reshape(-1, 3) for points in (self.shape, self.true_shape))
        rotation, translation = rigid_alignment(flat, true, weights)
        moved = self.shape @ rotation.T + translation
        offsets = (self.true_shape - moved)[counted].mean(axis=0)
        return distances(moved, self.true_shape), distances(moved + offsets, self.true_shape)


@cache
def evaluated(result: Path, reference: Path | None, align: Alignment) -> Evaluation:
    """Return the evaluation of a result (cached)."""
    return evaluate(result, EvalOptions(truth=reference, align=align))


def compare(result: Path, reference: Path | None, align: Alignment = "rigid") -> Compared:
    """Compare a result of ``posetrack head`` with a reference; None for the ground truth in the result.

    The reference is another result or a ground truth file.
    """
    found = evaluated(result, reference, align)
    track, truth, pairs = found.track, found.truth, found.pairs
    if truth is None or pairs is None or not len(pairs.estimate):
        raise ResultError("no frames in common with the reference", where=result)
    mine, theirs = pairs.estimate, pairs.truth
    nothing = np.full(len(track), np.nan)
    believed = np.ones(len(mine), dtype=np.bool_) if track.lost is None else ~track.lost[mine]
    confidence = (nothing if track.confidence is None else track.confidence)[mine]
    # without confidence, frames that are not lost count as followed
    followed = believed if track.confidence is None else believed | (np.nan_to_num(confidence) > 0.0)
    true_shape = in_head(truth)
    return Compared(
        seconds=(track.stamp_ns[mine] - track.stamp_ns[0]) * 1e-9,
        followed=followed,
        believed=believed,
        pose=np.stack([found.series[name] for name in HEAD_POSE], axis=1),
        position_mm=found.series["position_mm"],
        rotation_deg=found.series["rotation_deg"],
        columns=pose_columns(track)[mine],
        true_columns=pose_columns(truth)[theirs],
        shape=in_head(track)[mine],
        true_shape=true_shape[theirs],
        neutral=true_shape[0],
        points=_known(track.points)[mine],
        true_points=_known(truth.points)[theirs],
        milliseconds=(nothing if track.milliseconds is None else track.milliseconds)[mine],
        confidence=confidence,
        stamp_ns=track.stamp_ns[mine],
    )


def depth_factor(result: Path, reference: Path | None) -> float:
    """Return the scale s that fits a result best to a reference.

    Over the tracked pairs, s and the constant offset x of the head minimise sum |s t_i + R_i x - t_ref,i|^2,
    a linear least-squares problem in four unknowns.
    """
    found = evaluated(result, reference, "none")
    assert found.truth is not None and found.pairs is not None
    mine, theirs = tracked_pairs(found.track, found.pairs)
    turns = rotations.matrices_from_quaternions(_known(found.track.quaternion)[mine])
    design = np.concatenate([_known(found.track.position)[mine][:, :, None], turns], axis=2).reshape(-1, 4)
    (factor, *_), *_ = np.linalg.lstsq(design, _known(found.truth.position)[theirs].ravel())
    return float(factor)


def figures_of(one: Compared, rows: BoolArray, wrong: tuple[float, float]) -> dict[str, float]:
    """Return means and standard deviations (``sd``) of errors over the frames ``rows`` (M,).

    Frames whose error exceeds ``wrong`` (mm, deg) are counted as wrong.
    """
    is_wrong = (one.position_mm > wrong[0]) | (one.rotation_deg > wrong[1])
    found = {
        "frames": float(len(rows)),
        "tracked": float(one.believed.mean()),
        "wrong": float((rows & is_wrong).sum()),
        "first": float(np.argmax(rows)) if rows.any() else np.inf,
    }
    if not rows.any():
        return found
    series = {name: one.pose[:, column] for column, name in enumerate(HEAD_POSE)}
    for name, values in (series | {"position_mm": one.position_mm, "rotation_deg": one.rotation_deg}).items():
        found |= {name: float(values[rows].mean()), f"{name} sd": float(values[rows].std())}
    if np.isfinite(one.milliseconds).any():
        found["ms"] = float(np.nanmedian(one.milliseconds))
    return found


def mono_figures(result: Path | None, reference: Path | None, align: Alignment = "rigid") -> dict[str, float]:
    """Return the figures of a result of one camera over the followed frames.

    A pose error above 60 mm or 15 deg is wrong: 1.5 times the largest errors in the thesis's experiment B
    (mean plus two standard deviations). ``points_mm`` and ``shapes_mm``: see ``Compared.points_mm``.
    """
    if result is None or (reference is not None and not reference.exists()):
        return {}
    one = compare(result, reference, align)
    found = figures_of(one, one.followed, (60.0, 15.0))
    for name, errors in zip(("points_mm", "shapes_mm"), one.points_mm(), strict=True):
        if one.followed.any():
            found[name] = float(errors[one.followed].mean())
    found["factor"] = depth_factor(result, reference)
    return found


def pose_columns(track: Track) -> FloatArray:
    """Return x, y, z (mm), roll, pitch, yaw (deg), (N, 6), in camera axes."""
    angles = np.degrees(np.unwrap(head_roll_pitch_yaw(_known(track.quaternion)), axis=0))
    return np.hstack([_known(track.position), angles])


def in_head(track: Track) -> FloatArray:
    """Return points (N, K, 3) in head coordinates, mm."""
    points = _known(track.points)
    position, quaternion = (
        np.repeat(values, points.shape[1], axis=0)
        for values in (_known(track.position), _known(track.quaternion))
    )
    flat: FloatArray = in_object(points.reshape(-1, 3), position, quaternion)
    return flat.reshape(points.shape)


def _known(array: FloatArray | None) -> Any:
    """Return an array that every head track has."""
    return array
