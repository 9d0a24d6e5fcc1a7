"""Which ground truth belongs to which track, if a recording shows several subjects of a kind.

Tracks named with words (``left``) belong to the ground truth of the same name. Numbers (``1``) are no names:
tracks are assigned so that the mean distance over all frames is smallest. Distances are those in the image,
at the depth of the ground truth, because one camera does not measure depth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.reading.tracks import Track, associate, track_of_result
from posetrack_cli.evaluation.reading.truth import load_truth, truth_labels
from posetrack_cli.results.reader import Result
from posetrack_cli.results.topics import FILTERED

FARTHEST_MM = 150.0
"""A track farther than this from the ground truth does not show this subject."""
CLEARLY = 0.5
"""A track shows a subject in a frame if its distance is at most this share of its distance from any other
subject, and of the subject's distance from any other track."""


@dataclass(frozen=True)
class Identity:
    """Identity of one track.

    Attributes:
        truth: label of its ground truth; None if it follows no subject.
        switches: number of times that the subject changed from one track to another.
    """

    truth: str | None
    switches: int = 0


@dataclass(frozen=True)
class Identities:
    """Identities of all tracks of a result.

    Attributes:
        of: by label of the track.
        missed: labels of ground truth that no track follows.
    """

    of: Mapping[str, Identity]
    missed: tuple[str, ...] = ()


def identities(
    result: Result,
    truth: Path | None,
    which: str = FILTERED,
    *,
    time_offset_s: float = 0.0,
    tolerance_ns: int = 5_000_000,
) -> Identities | None:
    """Assign the ground truth of a recording to the tracks of a result.

    Args:
        result: with all its subjects.
        truth: ground-truth file; None for the ground truth in the result.
        which: ``filtered`` or ``smoothed``.
        time_offset_s: added to the ground-truth stamps, s.
        tolerance_ns: maximum difference of stamps, ns.

    Returns:
        None if there is one track and at most one ground truth, or no ground truth.

    Raises:
        PosetrackError: a track or the ground truth cannot be read.
    """
    known = truth_labels(result, truth)
    if not known or known == result.labels[:1] == result.labels:
        return None
    tracks = {part.subject.label: track_of_result(part, part.subject.label, which) for part in result.parts}
    truths = {
        label: found
        for label in known
        if (found := load_truth(result.parts[0], truth, time_offset_s=time_offset_s, label=label)) is not None
    }
    stamps = np.unique(np.concatenate([track.stamp_ns for track in tracks.values()]))
    apart = np.array(
        [[_apart(track, one, stamps, tolerance_ns) for track in tracks.values()] for one in truths.values()]
    )
    chosen = _chosen(list(tracks), dict(zip(truths, apart, strict=True)))
    switches = dict(zip(truths, _switches(apart), strict=True))
    of = {one: Identity(chosen.get(one), switches.get(chosen.get(one, ""), 0)) for one in tracks}
    return Identities(of, tuple(label for label in truths if label not in chosen.values()))


def _apart(track: Track, truth: Track, stamps: IntArray, tolerance_ns: int) -> FloatArray:
    """Return the distance (N,), mm, of a ground truth from a track at N stamps; ``inf`` where unknown."""
    apart = np.full(len(stamps), np.inf)
    mine, its = _places(track), _places(truth)
    if mine is None or its is None:
        return apart
    pairs = associate(track.stamp_ns, truth.stamp_ns, tolerance_ns)
    shown = np.ones(len(pairs.estimate), dtype=np.bool_)
    if track.lost is not None:
        shown = ~track.lost[pairs.estimate]
    own, true = mine[pairs.estimate[shown]], its[pairs.truth[shown]]
    far = np.linalg.norm(true, axis=1)
    ray = own * (far / np.maximum(np.linalg.norm(own, axis=1), 1e-9))[:, None]
    rows = np.searchsorted(stamps, track.stamp_ns[pairs.estimate[shown]])
    apart[rows] = np.linalg.norm(ray - true, axis=1)
    return apart


def _places(track: Track) -> FloatArray | None:
    """Return the middle of the points (N, 3), mm, else the position."""
    if track.points is not None and track.points.shape[1]:
        middle: FloatArray = track.points.mean(axis=1)
        return middle
    return track.position


def _chosen(tracks: list[str], apart: Mapping[str, FloatArray]) -> dict[str, str]:
    """Return the ground truth of each track that has one."""
    from scipy.optimize import linear_sum_assignment

    named = {label: label for label in tracks if label in apart and not label.isdigit() and label}
    rows = [k for k, label in enumerate(tracks) if label not in named]
    free = [label for label in apart if label not in named]
    if not (rows and free):
        return named
    cost = np.array([[np.minimum(apart[label][row], FARTHEST_MM).mean() for label in free] for row in rows])
    pairs = zip(*linear_sum_assignment(cost), strict=True)
    return named | {tracks[rows[i]]: free[j] for i, j in pairs if cost[i, j] < FARTHEST_MM}


def _switches(apart: FloatArray) -> list[int]:
    """Return how often each subject changed from one of the tracks to another.

    Only frames count in which a track clearly shows one subject, not those in which two subjects cross.

    Args:
        apart: (S, T, N) distance of S subjects from T tracks in N frames.
    """
    alone = (_next(apart, 0) * CLEARLY >= apart) & (_next(apart, 1) * CLEARLY >= apart)
    shown = alone & (apart < FARTHEST_MM)
    return [int(np.count_nonzero(np.diff(one.argmax(axis=0)[one.any(axis=0)]))) for one in shown]


def _next(apart: FloatArray, axis: int) -> FloatArray:
    """Return for each entry the smallest other entry along an axis, ``inf`` without any."""
    if apart.shape[axis] < 2:
        return np.full_like(apart, np.inf)
    first, second = np.split(np.sort(apart, axis=axis).take([0, 1], axis=axis), 2, axis=axis)
    return np.where(apart <= first, second, first)
