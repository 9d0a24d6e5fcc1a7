"""Tracks of results and ground truth, association of their frames, and coverage."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import ResultError, read_from
from posetrack_cli.losses import LossLog
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import Frame, StoredFrame, decode_frames
from posetrack_cli.recording.recording import Recording, read_ahead
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status, Subject
from posetrack_cli.results.fields import FIELD_NAMES, NUMBERS
from posetrack_cli.results.reader import Result
from posetrack_cli.results.topics import FILTERED

# One-to-one association of estimates and ground truth by stamp or frame number


@dataclass(frozen=True, eq=False)
class Pairs:
    """Associated rows of estimate and ground truth: (M,) row numbers each, increasing."""

    estimate: IntArray
    truth: IntArray


def associate(estimate_ns: IntArray, truth_ns: IntArray, tolerance_ns: int) -> Pairs:
    """Pair stamps one to one, greedily by increasing difference.

    Pairs (estimate, truth) with |difference| <= tolerance are taken by increasing difference, of equal ones
    the earlier first, if both stamps are free and the pair crosses no other, so that the order in time is
    preserved. Swapping the arguments swaps the pairs. A stamp that is in both is always paired with itself.

    Args:
        estimate_ns, truth_ns: (N,) and (M,) stamps, ns, strictly increasing.
        tolerance_ns: maximum difference, ns.

    Raises:
        ResultError: stamps do not increase strictly.
    """
    check_stamps(estimate_ns, "estimate")
    check_stamps(truth_ns, "ground truth")
    count = len(estimate_ns)
    # Only neighbours in the merged list are candidates: with another stamp between the two of a pair, that
    # stamp has a pair with a smaller difference, or the pairs would cross.
    merged = np.concatenate([estimate_ns, truth_ns])
    order = np.argsort(merged, kind="stable")
    steps = np.diff(merged[order])
    candidates = np.flatnonzero(np.diff(order < count) & (steps <= tolerance_ns))
    nearest_first = candidates[np.argsort(steps[candidates], kind="stable")]
    taken = _disjoint(nearest_first, len(merged))
    rows = np.sort([order[taken], order[taken + 1]], axis=0)
    return Pairs(rows[0], rows[1] - count)


def associate_frames(estimate: IntArray, truth: IntArray) -> Pairs:
    """Pair frames with equal numbers; both arrays, (N,) and (M,), increase strictly."""
    _, mine, theirs = np.intersect1d(estimate, truth, assume_unique=True, return_indices=True)
    return Pairs(mine, theirs)


def check_stamps(stamp_ns: IntArray, name: str) -> None:
    """Check that the stamps (N,) of a source increase strictly.

    Raises:
        ResultError: states the source, the first row (from 0) out of order, and its stamp.
    """
    back = np.flatnonzero(stamp_ns[1:] <= stamp_ns[:-1])
    if not back.size:
        return
    row = int(back[0]) + 1
    stamp, before = int(stamp_ns[row]), int(stamp_ns[row - 1])
    raise ResultError(
        "duplicate stamp" if stamp == before else "stamps are not sorted",
        where=f"{name}, row {row}",
        found=f"{stamp} ns after {before} ns",
        expected="strictly increasing stamps",
    )


def nearest_rows(stamp_ns: IntArray, others_ns: IntArray) -> IntArray:
    """Return for each stamp (N,) the row of the nearest of ``others_ns`` (M,), M >= 1; the earlier of two."""
    after = np.searchsorted(others_ns, stamp_ns)
    before = np.maximum(after - 1, 0)
    after = np.minimum(after, len(others_ns) - 1)
    is_before = stamp_ns - others_ns[before] <= others_ns[after] - stamp_ns  # beyond an end, both are equal
    return np.where(is_before, before, after)


def _disjoint(places: IntArray, count: int) -> IntArray:
    """Return the pairs (place, place + 1) that do not overlap a pair taken before, sorted.

    Args:
        places: (C,) places in the order of selection.
        count: total number of places.
    """
    taken = [False] * count
    kept = []
    for place in places.tolist():
        if not (taken[place] or taken[place + 1]):
            taken[place] = taken[place + 1] = True
            kept.append(place)
    return np.sort(np.array(kept, dtype=np.int64))


# Tracks as arrays


MOTION_FIELDS = ("stamp_ns", "status", "position", "quaternion", "shape", "twist", "points")
"""Fields of an Estimate that are used as ground truth."""
_TRACK_FIELDS = tuple(name for name in FIELD_NAMES if name != "pose_rate")  # redundant with twist
SINGLE_FIELDS = frozenset({"twist", "pose_variance", "twist_variance", "points"})
"""Fields whose single precision (6e-8) suffices for metrics; they dominate the memory of a long track."""


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory with N frames along the first axis of all arrays and strictly increasing stamps.

    Quantities that the source does not provide are None: a CSV of joints has no pose, for example.
    K shape entries (finger angles, rad; deformation coefficients), P points (joints, landmarks).

    Attributes:
        name: name in tables and errors.
        subject: ``hand`` or ``head``.
        shape_names: K names.
        point_names: P names.
        point_parents: P indices, -1 for a root; empty if unknown.
        stamp_ns: (N,) stamps, ns.
        lost: (N,) whether the status is lost; None for ground truth.
        reinitialised: (N,) whether the status is reinitialised; None for ground truth.
        position: (N, 3) mm, camera axes.
        quaternion: (N, 4) x y z w, unit, w >= 0: rotation of ``camera_T_object``.
        shape: (N, K).
        twist: (N, 6 + K) mm/s in camera axes; rad/s in the body frame; shape per second.
        pose_variance: (N, 6 + K) mm^2, rad^2 (rotation vector, body frame), shape^2.
        twist_variance: (N, 6 + K) of ``twist``.
        points: (N, P, 3) mm, camera axes.
        confidence, cost, effective_sample_size, milliseconds, evaluations: (N,); NaN where unknown.
        resampled: (N,) whether the particles were resampled.
        frame_index: (N,) frame numbers in the recording; None if unknown. For ground truth, None unless it is
            associated by frame number.
        numbers: (N, M) further numbers of the tracker; NaN where unknown.
        number_names: M names.
        pixels: (N, P, 2) image points, for ground truth without poses and 3D points.
    """

    name: str
    subject: str
    shape_names: tuple[str, ...]
    point_names: tuple[str, ...]
    point_parents: tuple[int, ...]
    stamp_ns: IntArray
    lost: BoolArray | None = None
    reinitialised: BoolArray | None = None
    position: FloatArray | None = None
    quaternion: FloatArray | None = None
    shape: FloatArray | None = None
    twist: FloatArray | None = None
    pose_variance: FloatArray | None = None
    twist_variance: FloatArray | None = None
    points: FloatArray | None = None
    confidence: FloatArray | None = None
    cost: FloatArray | None = None
    effective_sample_size: FloatArray | None = None
    evaluations: FloatArray | None = None
    milliseconds: FloatArray | None = None
    resampled: BoolArray | None = None
    frame_index: IntArray | None = None
    numbers: FloatArray | None = None
    number_names: tuple[str, ...] = ()
    pixels: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def status(self, row: int) -> Status:
        """Return the status of a frame; tracking if the track has no status."""
        if self.lost is not None and self.lost[row]:
            return Status.LOST
        if self.reinitialised is not None and self.reinitialised[row]:
            return Status.REINITIALISED
        return Status.TRACKING


def track_of_result(result: Result, name: str, which: str = FILTERED) -> Track:
    """Return a track of a result, including lost frames.

    Args:
        result: finished or unfinished result; unreadable parts are added to ``result.losses``.
        name: name in tables and errors.
        which: ``filtered`` or ``smoothed``.

    Raises:
        ResultError: nothing is readable, stamps do not increase strictly, or the track does not exist.
    """
    return track_of_columns(result.columns(result.topic_of_track(which), track_fields(result)), result, name)


def track_fields(result: Result) -> tuple[str, ...]:
    """Return the fields that ``track_of_columns`` requires."""
    return (*_TRACK_FIELDS, NUMBERS) if result.subject.number_names else _TRACK_FIELDS


def track_of_columns(columns: Columns, result: Result, name: str) -> Track:
    """Return the track of a result's columns; see ``track_of_result``."""
    status = columns["status"]
    return Track(
        **_motion(columns, name, result.subject),
        lost=status == Status.LOST.value,
        reinitialised=status == Status.REINITIALISED.value,
        pose_variance=_known(columns["pose_variance"]),
        twist_variance=_known(columns["twist_variance"]),
        confidence=columns["confidence"],
        cost=columns["cost"],
        effective_sample_size=_known(columns["effective_sample_size"]),
        milliseconds=columns["milliseconds"],
        evaluations=_known(columns["evaluations"]),
        resampled=columns["resampled"],
        frame_index=columns["frame_index"],
    )


def truth_of_columns(columns: Columns, name: str, subject: Subject) -> Track:
    """Return a track of estimates that serve as ground truth, without status and variances.

    Lost estimates are left out, so that their frames count as unmatched.

    Args:
        columns: columns of ``MOTION_FIELDS``.
        name: name in tables and errors.
        subject: subject with the names of shape entries and points.

    Raises:
        ResultError: the stamps do not increase strictly.
    """
    known = columns["status"] != Status.LOST.value
    # Lost estimates would count as errors of the evaluated result.
    if not known.all():
        columns = {key: column[known] for key, column in columns.items()}
        name = f"{name} without its {int((~known).sum())} lost frames"
    return Track(**_motion(columns, name, subject))


def _motion(columns: Columns, name: str, subject: Subject) -> dict[str, Any]:
    """Return the fields that estimate and ground truth have in common."""
    check_stamps(columns["stamp_ns"], name)
    return {
        "name": name,
        "subject": subject.name,
        "shape_names": subject.shape_names,
        "point_names": subject.point_names,
        "point_parents": subject.point_parents,
        "stamp_ns": columns["stamp_ns"],
        "position": columns["position"],
        "quaternion": columns["quaternion"],
        "shape": columns["shape"],
        "twist": _known(columns["twist"]),
        "points": columns["points"] if subject.point_names else None,
        "numbers": columns.get(NUMBERS),
        "number_names": subject.number_names if NUMBERS in columns else (),
    }


def _known(column: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """Return the column, or None if no message has it."""
    # Readers fill missing optional fields with NaN.
    return None if len(column) and np.isnan(column).all() else column


_PART = part_path(Path("x")).suffix


def plain_name(path: Path) -> str:
    """Return the file name without extension, and without ``.part`` of an unfinished run.

    Control characters and undecodable bytes, which could manipulate a terminal, are escaped.
    """
    return _printable(Path(path.name.removesuffix(_PART)).stem)


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Return unique names: plain names, with the folder name for duplicates, numbered if still duplicate."""
    plain = [plain_name(path) for path in paths]
    counts = Counter(plain)
    with_folder = [
        name if counts[name] == 1 else f"{_printable(path.absolute().parent.name)}/{name}"
        for name, path in zip(plain, paths, strict=True)
    ]
    unique: list[str] = []
    for name in with_folder:
        unique.append(_free(name, unique))
    return unique


def track_name(name: str, which: str, taken: Sequence[str]) -> str:
    """Return the display name of a track of a result; the filtered track has the name of the result."""
    return name if which == FILTERED else _free(f"{name} {which}", taken)


def _printable(name: str) -> str:
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in name)


def _free(name: str, taken: Sequence[str]) -> str:
    """Return the name, or the first of ``name (2)``, ``name (3)``, ... that is not taken."""
    number = 2
    free = name
    while free in taken:
        free, number = f"{name} ({number})", number + 1
    return free


# Frames of a recording that belong to the estimates of a result


class Matched(Protocol):
    """A frame, decoded or encoded otherwise."""

    @property
    def index(self) -> int:
        """Position in the recording."""

    @property
    def stamp_ns(self) -> int:
        """Time of capture, ns."""


AnyFrame = TypeVar("AnyFrame", bound=Matched)
Read: TypeAlias = Callable[[Iterable[tuple[int, StoredFrame]], LossLog], Iterator[AnyFrame]]


def matched_frames(
    recording: Recording, stamp_ns: IntArray, frame_index: IntArray | None, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield (position in ``stamp_ns``, decoded frame); see ``matched_stored``."""
    return matched_stored(recording, stamp_ns, frame_index, losses, decode_frames)


def matched_stored(
    recording: Recording,
    stamp_ns: IntArray,
    frame_index: IntArray | None,
    losses: LossLog,
    read: Read[AnyFrame],
) -> Iterator[tuple[int, AnyFrame]]:
    """Yield (position in ``stamp_ns``, frame) in recording order; only these frames are read.

    Frames are matched by stamp. If no stamp matches, as after reading a folder at another rate, they are
    matched by number.

    Args:
        recording: read once, or twice if no stamp matches.
        stamp_ns: (N,) stamps of the estimates, unique.
        frame_index: (N,) frame numbers of the estimates in the recording; None if unknown.
        losses: receives undecodable frames and estimates without a frame.
        read: yields the frames of stored ones; in a thread, some frames ahead.
    """
    met: list[int] = []  # numbers of matched frames, including undecodable ones
    for keys in (stamp_ns, frame_index):
        if keys is None or met:
            continue
        positions = {int(key): position for position, key in enumerate(keys)}
        by_number = keys is frame_index
        for frame in _frames_at(recording, positions, met, losses, read, by_number=by_number):
            yield positions[frame.index if by_number else frame.stamp_ns], frame
    for _ in range(len(stamp_ns) - len(met)):
        losses.add("estimates without a frame in the recording", str(recording.path))


def _frames_at(
    recording: Recording,
    keys: Collection[int],
    met: list[int],
    losses: LossLog,
    read: Read[AnyFrame],
    *,
    by_number: bool,
) -> Iterator[AnyFrame]:
    """Yield the frames whose stamps or numbers are among the keys."""
    if not keys:
        return
    last = max(keys)

    def chosen() -> Iterator[tuple[int, StoredFrame]]:
        # Losses in frames that are not requested are ignored.
        for index, stored in recording.stored_frames(LossLog()):
            key = index if by_number else stored.stamp_ns
            if key > last:
                return  # stamps and numbers increase
            if key in keys:
                met.append(index)
                yield index, stored

    decoded = read_from(recording.path, read(chosen(), losses), "frame")
    with closing(read_ahead(decoded)) as frames:
        yield from frames


# Coverage


@dataclass(frozen=True)
class Coverage:
    """Frame counts.

    Attributes:
        frames: estimates in the result.
        tracked: estimates that are not lost, including reinitialised ones.
        lost: lost estimates; their errors are included in all metrics.
        reinitialised: estimates at which the track was reinitialised.
        unmatched: estimates without ground truth at their stamp; all estimates if there is no ground truth.
        missed: frames with ground truth within the time span of the result that have no estimate.
        outside: ground-truth frames before the first or after the last estimate; not counted as missed.
        has_truth: whether there is ground truth.
        tracked_and_matched: estimates that are tracked and matched.
        has_identities: whether there are several tracks, or ground truth of several subjects.
        identity_switches: how often a subject changed from one track to another.
        false_tracks, missed_tracks: tracks without a subject, and subjects without a track.
    """

    frames: int
    tracked: int
    lost: int
    reinitialised: int
    unmatched: int
    missed: int
    outside: int
    has_truth: bool
    tracked_and_matched: int
    has_identities: bool = False
    identity_switches: int = 0
    false_tracks: int = 0
    missed_tracks: int = 0

    @property
    def share(self) -> float:
        """Metric ``coverage``: (tracked and matched) / (frames + missed), or tracked / frames without ground
        truth; 0 for an empty result."""
        due = self.frames + self.missed
        good = self.tracked_and_matched if self.has_truth else self.tracked
        return good / due if due else 0.0


def measure_coverage(
    track: Track, truth: Track | None, pairs: Pairs | None, *, tolerance_ns: int = 0
) -> Coverage:
    """Count tracked, lost, matched and missed frames.

    Ground truth can have a higher rate than the frames, and a run can use every second frame, so ground truth
    without an estimate is not necessarily a missed frame. Missed frames are counted in gaps between two
    estimates: ground-truth frames whose distance from both exceeds half the frame interval and the tolerance,
    but no more than fit into the gap at the frame interval.

    Args:
        track: the estimate.
        truth, pairs: ground truth and association; None without ground truth.
        tolerance_ns: tolerance of the association, ns.
    """
    frames = len(track)
    lost = np.zeros(frames, dtype=np.bool_) if track.lost is None else track.lost
    matched = np.zeros(frames, dtype=np.bool_)
    if pairs is not None:
        matched[pairs.estimate] = True
    true_ns = np.empty(0, dtype=np.int64) if truth is None else truth.stamp_ns
    return Coverage(
        frames=frames,
        tracked=int((~lost).sum()),
        lost=int(lost.sum()),
        reinitialised=0 if track.reinitialised is None else int(track.reinitialised.sum()),
        unmatched=int((~matched).sum()),
        missed=_missed(track.stamp_ns, true_ns, tolerance_ns),
        outside=int(_is_outside(track.stamp_ns, true_ns, tolerance_ns).sum()),
        has_truth=truth is not None,
        tracked_and_matched=int((matched & ~lost).sum()),
    )


def usual_interval(stamp_ns: IntArray) -> float:
    """Return the frame interval, ns: the mean interval between stamps (N,), N >= 2, without gaps."""
    intervals = np.diff(stamp_ns)
    # The median only detects the gaps: with jitter, intervals can be alternately long and short, and the
    # median would be one of the two.
    return float(intervals[intervals <= GAP_FACTOR * np.median(intervals)].mean())


def _is_outside(stamp_ns: IntArray, true_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return the mask (M,) of ground truth outside the time span of the estimates; all True without any."""
    if not stamp_ns.size:
        return np.ones(len(true_ns), dtype=np.bool_)
    before, after = true_ns < stamp_ns[0] - tolerance_ns, true_ns > stamp_ns[-1] + tolerance_ns
    outside: BoolArray = before | after
    return outside


def _missed(stamp_ns: IntArray, true_ns: IntArray, tolerance_ns: int) -> int:
    """Return the number of missed frames; see ``measure_coverage``."""
    if len(stamp_ns) < 2:
        return 0
    intervals, usual = np.diff(stamp_ns), usual_interval(stamp_ns)
    interval = np.searchsorted(stamp_ns, true_ns, side="right") - 1  # index of the preceding estimate
    inside = (interval >= 0) & (interval < len(intervals))
    interval, true_ns = interval[inside], true_ns[inside]
    distance = np.minimum(true_ns - stamp_ns[interval], stamp_ns[interval + 1] - true_ns)
    far = distance > max(0.5 * usual, tolerance_ns)
    truths = np.bincount(interval[far], minlength=len(intervals))
    room = np.maximum(np.rint(intervals / usual) - 1.0, 0.0)  # intervals can be shorter than the mean
    return int(np.minimum(truths, room).sum())
