"""Metrics of the dense face: lips, lids, brows and blinks against landmarks, or lids, blinks and gaze against
the ground truth of synthetic recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, Metric
from posetrack_cli.evaluation.measuring.pose_metrics import inside_interval
from posetrack_cli.evaluation.reading.tracks import Track, associate
from posetrack_cli.evaluation.reading.truth_tables import Columns, open_table, read_columns
from posetrack_cli.geometry.rotations import conjugate, rotate
from posetrack_cli.head.blinks import intervals
from posetrack_cli.head.dense.numbers import CLOSED, CLOSED_BELOW, SIDES

NUMBERS_USED = (*range(17, 27), *range(36, 48), 62, 66)
"""Points of the usual 68 that the metrics need."""
SLACK_S = 0.1
"""Time by which a detected blink may miss a true one."""


def _pair(name: str, of: str) -> tuple[Metric, Metric]:
    return (
        Metric(f"{name}_error_mm", "mm", f"Absolute error of {of}."),
        Metric(f"{name}_r", "", f"Correlation of {of} with the truth.", better="higher", scalar=True),
    )


FACE_METRICS = (
    *_pair("lip_gap", "the gap between the inner lips"),
    *_pair("lid_opening", "the opening of both eyes' lids, without the mean difference"),
    *_pair("brow_height", "the height of both brows, without the mean difference"),
    Metric(
        "blink_f1",
        "",
        "F1 score of blinks, as intervals with both eyes closed.",
        better="higher",
        scalar=True,
    ),
    *(
        Metric(f"{side}_gaze_deg", "deg", f"Angle between the estimated and the true gaze of the {side} eye.")
        for side in SIDES
    ),
    Metric(
        "gaze_inside_90",
        "",
        "Share of the gazes' angles within their stated 90 % interval.",
        better="neither",
        scalar=True,
        pooled=True,
    ),
)
NAMES = tuple(metric.name for metric in FACE_METRICS)
GAZE_NAMES = NAMES[-3:]


def face_metrics(measures: Measures, track: Track, path: Path, tolerance_ns: int) -> None:
    """Add the metrics of a track against landmarks.

    Args:
        measures: collector.
        track: of the result.
        path: CSV with ``t_s`` or ``stamp_ns`` and ``p0_x_mm`` to ``p67_z_mm``, points in the head's frame.
        tolerance_ns: maximum difference of stamps.

    Raises:
        TruthError: the file is invalid.
    """
    if CLOSED not in track.number_names or track.numbers is None:
        return measures.lack("the result has no dense face", *NAMES)
    truth = read_columns(open_table(path), [f"p{k}_{axis}_mm" for k in NUMBERS_USED for axis in "xyz"])
    pairs = associate(track.stamp_ns, truth.stamp_ns, tolerance_ns)
    stated = _stated(track, pairs.estimate)
    true = _lengths(truth, pairs.truth)
    _compare(measures, "lip_gap", stated["action_lip_gap_mm"][:, None], true["gap"])
    _compare(measures, "lid_opening", _lids(stated), true["lids"], relative=True)
    brows = np.stack(
        [0.5 * sum(stated[f"action_{side}_brow_{part}_mm"] for part in ("inner", "outer")) for side in SIDES],
        axis=1,
    )
    _compare(measures, "brow_height", brows, true["brows"], relative=True)
    lid = true["lids"].mean(axis=1)
    low, usual = np.quantile(lid, [0.02, 0.6]) if len(lid) else (0.0, 0.0)
    closed = lid < low + CLOSED_BELOW * (usual - low)
    _blinks(measures, stated, closed, truth.stamp_ns[pairs.truth])


def eye_metrics(measures: Measures, matched: Matched) -> None:
    """Add the metrics of lids, blinks and gaze against true numbers (``TRUE_NUMBERS``), if there are some."""
    track, truth = matched.estimate, matched.truth
    if CLOSED not in track.number_names or truth.numbers is None or np.isnan(truth.numbers).all():
        return None
    stated, true = _stated(track, matched.pairs.estimate), _stated(truth, matched.pairs.truth)
    _compare(measures, "lid_opening", _lids(stated), _lids(true), relative=True)
    _blinks(measures, stated, true[CLOSED] == 1.0, truth.stamp_ns[matched.pairs.truth])
    if matched.lacks("quaternion"):
        return None
    from_camera = conjugate(matched.of_truth("quaternion"))
    normalised = []
    for side in SIDES:
        mine, theirs = (
            np.stack([numbers[f"{side}_gaze_{axis}"] for axis in "xyz"], axis=1) for numbers in (stated, true)
        )
        known = ~np.isnan((mine + theirs).sum(axis=1))
        if not known.any():
            return measures.lack("no gaze is known", *GAZE_NAMES)
        cosine = np.clip(np.sum(mine * theirs, axis=1), -1.0, 1.0)
        measures.add(f"{side}_gaze_deg", np.degrees(np.arccos(cosine)), known)
        off = _angles(rotate(from_camera, mine)) - _angles(rotate(from_camera, theirs))
        normalised.append(np.square(off / stated[f"{side}_gaze_sd_rad"][:, None])[known])
    return measures.share("gaze_inside_90", inside_interval(np.concatenate(normalised)))


def _angles(gaze: FloatArray) -> FloatArray:
    """Return the angles (..., 2) to the left and up of directions (..., 3) in the head's axes."""
    x, y, z = np.moveaxis(gaze, -1, 0)
    return np.stack([np.arctan2(x, z), np.arcsin(np.clip(y, -1.0, 1.0))], axis=-1)


def _stated(track: Track, rows: IntArray) -> dict[str, FloatArray]:
    """Return rows of a track's numbers by name; NaN in lost frames."""
    assert track.numbers is not None
    numbers = track.numbers[rows].copy()
    if track.lost is not None:
        numbers[track.lost[rows]] = np.nan
    return dict(zip(track.number_names, numbers.T, strict=True))


def _lids(numbers: dict[str, FloatArray]) -> FloatArray:
    return np.stack([numbers[f"action_{side}_lid_mm"] for side in SIDES], axis=1)


def _blinks(measures: Measures, stated: dict[str, FloatArray], closed: BoolArray, stamp_ns: IntArray) -> None:
    score = blink_f1(intervals(stated[CLOSED] == 1.0, stamp_ns), intervals(closed, stamp_ns))
    if np.isnan(score):
        measures.lack("no blink in result or truth", "blink_f1")
    else:
        measures.metrics["blink_f1"] = score


def _compare(
    measures: Measures, name: str, mine: FloatArray, theirs: FloatArray, *, relative: bool = False
) -> None:
    """Add error and correlation of lengths (M, S), where they are known; each column has its own mean."""
    known = ~np.isnan(mine).any(axis=1)
    mine, theirs = mine[known], theirs[known]
    if len(mine) < 2:
        return measures.lack("too few frames", f"{name}_error_mm", f"{name}_r")
    centred, true_centred = mine - mine.mean(axis=0), theirs - theirs.mean(axis=0)
    errors = np.abs(centred - true_centred if relative else mine - theirs).mean(axis=1)
    measures.summarise(f"{name}_error_mm", errors)
    spread = float(np.sqrt(np.square(centred).sum() * np.square(true_centred).sum()))
    if spread <= 0.0:
        return measures.lack("it does not move", f"{name}_r")
    measures.metrics[f"{name}_r"] = float((centred * true_centred).sum()) / spread
    return None


def _lengths(truth: Columns, rows: IntArray) -> dict[str, FloatArray]:
    """Return lip gap (M, 1), lid openings and brow heights (M, 2), mm, right side first."""
    values = truth.values[rows].reshape(len(rows), -1, 3)

    def at(*numbers: int) -> FloatArray:
        chosen: FloatArray = values[:, [NUMBERS_USED.index(number) for number in numbers]]
        return chosen

    def apart(pairs: tuple[tuple[int, int], ...]) -> FloatArray:
        first, second = zip(*pairs, strict=True)
        distances: FloatArray = np.linalg.norm(at(*first) - at(*second), axis=-1).mean(axis=1)
        return distances

    def height(brow: range, corners: tuple[int, int]) -> FloatArray:
        above: FloatArray = at(*brow)[..., 1].mean(axis=1) - at(*corners)[..., 1].mean(axis=1)
        return above

    return {
        "gap": apart(((62, 66),))[:, None],
        "lids": np.stack([apart(((37, 41), (38, 40))), apart(((43, 47), (44, 46)))], axis=1),
        "brows": np.stack([height(range(17, 22), (36, 39)), height(range(22, 27), (42, 45))], axis=1),
    }


def blink_f1(found: FloatArray, true: FloatArray) -> float:
    """Return the F1 score of intervals (N, 2), s; NaN if there are none at all.

    A found interval is right if it overlaps a true one, up to ``SLACK_S``. Each true one counts once.
    """
    if not len(found) and not len(true):
        return np.nan
    starts, ends = found[:, :1] - SLACK_S, found[:, 1:] + SLACK_S
    overlaps = (starts <= true[:, 1]) & (ends >= true[:, 0])
    hits, right = int(overlaps.any(axis=0).sum()), int(overlaps.any(axis=1).sum())
    return (hits + right) / (len(true) + len(found))
