"""The tracks of a result and of its truth, which frames belong together, how many were tracked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import ResultError, read_from
from posetrack_cli.losses import LossLog
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import Frame, StoredFrame, decode_frames
from posetrack_cli.recording.recording import Recording, read_ahead
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.results.channels import FILTERED
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status, Subject
from posetrack_cli.results.fields import FIELD_NAMES, NUMBERS
from posetrack_cli.results.reader import Result

# Which estimate and which truth belong together: one to one, by their stamps or frame numbers


@dataclass(frozen=True, eq=False)
class Pairs:
    """Which rows of an estimate and a truth belong together: (M,) row numbers each, increasing."""

    estimate: IntArray
    truth: IntArray


def associate(estimate_ns: IntArray, truth_ns: IntArray, tolerance_ns: int) -> Pairs:
    """Pair stamps one to one, the nearest first, without turning time round.

    Of all (estimate, truth) with |difference| <= tolerance the pair with the smallest difference is taken,
    of equal ones the earlier; then the next that is free and crosses none that is taken: of two estimates
    the later one never gets the earlier truth. A pair that had another stamp between its two would cross or
    lose against one of that stamp, so only neighbours in the list of both sources' stamps are candidates.
    Swapping the arguments swaps the pairs; a stamp that is in both is always paired with itself.

    Args:
        estimate_ns, truth_ns: (N,) and (M,) stamps, ns, strictly increasing.
        tolerance_ns: largest difference, ns.

    Raises:
        ResultError: stamps do not increase strictly.
    """
    check_stamps(estimate_ns, "estimate")
    check_stamps(truth_ns, "truth")
    count = len(estimate_ns)
    merged = np.concatenate([estimate_ns, truth_ns])
    order = np.argsort(merged, kind="stable")
    steps = np.diff(merged[order])
    candidates = np.flatnonzero(np.diff(order < count) & (steps <= tolerance_ns))
    nearest_first = candidates[np.argsort(steps[candidates], kind="stable")]
    taken = _disjoint(nearest_first, len(merged))
    rows = np.sort([order[taken], order[taken + 1]], axis=0)
    return Pairs(rows[0], rows[1] - count)


def associate_frames(estimate: IntArray, truth: IntArray) -> Pairs:
    """Pair the frames that are in both, by their numbers (N,) and (M,), strictly increasing."""
    _, mine, theirs = np.intersect1d(estimate, truth, assume_unique=True, return_indices=True)
    return Pairs(mine, theirs)


def check_stamps(stamp_ns: IntArray, name: str) -> None:
    """Raise unless the stamps (N,) of a source of this name increase strictly.

    Raises:
        ResultError: names the source, the first row (from 0) that is not later than the one before, and
            its stamp.
    """
    back = np.flatnonzero(stamp_ns[1:] <= stamp_ns[:-1])
    if not back.size:
        return
    row = int(back[0]) + 1
    stamp, before = int(stamp_ns[row]), int(stamp_ns[row - 1])
    raise ResultError(
        "stamp occurs twice" if stamp == before else "stamps are not sorted",
        where=f"{name}, row {row}",
        found=f"{stamp} ns after {before} ns",
        expected="each later than the one before",
    )


def nearest_rows(stamp_ns: IntArray, others_ns: IntArray) -> IntArray:
    """Return for each stamp (N,) the row of the nearest of ``others_ns`` (M,), M >= 1; of two the earlier."""
    after = np.searchsorted(others_ns, stamp_ns)
    before = np.maximum(after - 1, 0)
    after = np.minimum(after, len(others_ns) - 1)
    is_before = stamp_ns - others_ns[before] <= others_ns[after] - stamp_ns  # beyond an end both are the last
    return np.where(is_before, before, after)


def _disjoint(places: IntArray, count: int) -> IntArray:
    """Return those of the pairs (place, place + 1) that share nothing with one before them, sorted.

    Args:
        places: (C,) in the order in which they are taken.
        count: number of places.
    """
    taken = [False] * count
    kept = []
    for place in places.tolist():
        if not (taken[place] or taken[place + 1]):
            taken[place] = taken[place + 1] = True
            kept.append(place)
    return np.sort(np.array(kept, dtype=np.int64))


# A trajectory as arrays: of a result, or of a truth from wherever it comes


MOTION_FIELDS = ("stamp_ns", "status", "position", "quaternion", "shape", "twist", "points")
"""What a truth is made from, of the fields of an Estimate."""
_TRACK_FIELDS = tuple(name for name in FIELD_NAMES if name != "pose_rate")  # twist says the same


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory, frames (N) along the first axis of every array, stamps strictly increasing.

    What a source does not know is None: a CSV of joints has no pose, a random walk no velocity.
    K shape entries (finger angles, rad; deformation coefficients), P points (joints, landmarks).

    Attributes:
        name: what tables and errors call it.
        subject: ``hand`` or ``head``.
        shape_names: K names.
        point_names: P names.
        point_parents: P indices, -1 for a root; empty when the source does not tell.
        stamp_ns: (N,) integer nanoseconds.
        lost: (N,) frames whose status is lost; None for a truth.
        reinitialised: (N,) frames whose status is reinitialised; None for a truth.
        position: (N, 3) mm, camera axes.
        quaternion: (N, 4) x y z w, unit, w >= 0: rotation of ``camera_T_object``.
        shape: (N, K).
        twist: (N, 6 + K) mm/s in camera axes; rad/s in the body frame; shape per second.
        pose_variance: (N, 6 + K) mm^2, rad^2 (rotation vector, body frame), shape^2.
        twist_variance: (N, 6 + K) of ``twist``.
        points: (N, P, 3) mm, camera axes.
        confidence, cost, effective_sample_size, milliseconds, evaluations: (N,); NaN where unknown.
        resampled: (N,).
        frame_index: (N,) positions of the frames in the recording; None where unknown, of a truth unless it
            is matched by them.
        numbers: (N, M) further numbers of the tracker; NaN where unknown.
        number_names: what it calls them.
        pixels: (N, P, 2) points in the images, of a truth that has nothing else.
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
        """The status of a frame; of a track that does not say, tracking."""
        if self.lost is not None and self.lost[row]:
            return Status.LOST
        if self.reinitialised is not None and self.reinitialised[row]:
            return Status.REINITIALISED
        return Status.TRACKING


def track_of_result(result: Result, name: str, which: str = FILTERED) -> Track:
    """Return the estimates of one of a result's tracks, lost ones included.

    Args:
        result: finished or not; what of it cannot be read is in ``result.losses`` afterwards.
        name: what tables and errors call it.
        which: ``filtered`` or ``smoothed``.

    Raises:
        ResultError: nothing can be read, the stamps do not increase strictly, or there is no such track.
    """
    further = (NUMBERS,) if result.subject.number_names else ()
    columns = result.columns(result.topic_of_track(which), _TRACK_FIELDS + further)
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
        numbers=columns.get(NUMBERS),
        number_names=result.subject.number_names,
    )


def truth_of_columns(columns: Columns, name: str, subject: Subject) -> Track:
    """Return the trajectory of estimates that are taken for the truth.

    It has no status, variances and particles of its own. Estimates that are lost are no truth and are left
    out: frames without a truth count as unmatched.

    Args:
        columns: of ``MOTION_FIELDS``.
        name: what tables and errors call it.
        subject: whose shape entries and points they are.

    Raises:
        ResultError: the stamps do not increase strictly.
    """
    known = columns["status"] != Status.LOST.value
    if not known.all():
        columns = {key: column[known] for key, column in columns.items()}
        name = f"{name} without its {int((~known).sum())} lost frames"
    return Track(**_motion(columns, name, subject))


def _motion(columns: Columns, name: str, subject: Subject) -> dict[str, Any]:
    """Return what estimate and truth have in common."""
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
    }


def _known(column: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """Return the column, or None if no message had it."""
    return None if len(column) and np.isnan(column).all() else column


_PART = part_path(Path("x")).suffix


def plain_name(path: Path) -> str:
    """Return a file's name without folder and ending; NAME.part of an unfinished run counts as NAME.

    Line ends, control codes and bytes of no encoding, which a terminal would obey, are written as escapes.
    """
    return _printable(Path(path.name.removesuffix(_PART)).stem)


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each path: its plain name, with the folder's where plain names are alike.

    What is still alike, such as one file given twice, is numbered.
    """
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
    """Return what a track is called beside others of its result: the filtered one as the result itself."""
    return name if which == FILTERED else _free(f"{name} {which}", taken)


def _printable(name: str) -> str:
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in name)


def _free(name: str, taken: Sequence[str]) -> str:
    """The name, or the first ``name (2)``, ``name (3)``, ... that is not taken."""
    number = 2
    free = name
    while free in taken:
        free, number = f"{name} ({number})", number + 1
    return free


# The frames of a recording that belong to the estimates of a result, in one pass


def matched_frames(
    recording: Recording, stamp_ns: IntArray, frame_index: IntArray | None, losses: LossLog
) -> Iterator[tuple[int, Frame]]:
    """Yield (position in ``stamp_ns``, frame) in the recording's order; only these frames are decoded.

    A frame belongs to the estimate of its stamp. Where no stamp at all agrees, as after reading a folder
    at another rate, frames are matched by their number.

    Args:
        recording: read once; twice if no stamp agrees.
        stamp_ns: (N,) of the estimates, unique.
        frame_index: (N,) their frames' positions in the recording, None if unknown.
        losses: gets what cannot be decoded, and the estimates without a frame.
    """
    met: list[int] = []  # numbers of the frames that belong to an estimate, those that do not decode, too
    for keys in (stamp_ns, frame_index):
        if keys is None or met:
            continue
        positions = {int(key): position for position, key in enumerate(keys)}
        by_number = keys is frame_index
        for frame in _frames_at(recording, positions, met, losses, by_number=by_number):
            yield positions[frame.index if by_number else frame.stamp_ns], frame
    for _ in range(len(stamp_ns) - len(met)):
        losses.add("estimates whose frame the recording does not give", str(recording.path))


def _frames_at(
    recording: Recording, keys: Collection[int], met: list[int], losses: LossLog, *, by_number: bool
) -> Iterator[Frame]:
    """Yield the frames whose stamps, or numbers, are among the keys."""
    if not keys:
        return
    last = max(keys)

    def chosen() -> Iterator[tuple[int, StoredFrame]]:
        # what is wrong with frames that nobody asked for is no loss here
        for index, stored in recording.stored_frames(LossLog()):
            key = index if by_number else stored.stamp_ns
            if key > last:
                return  # both keys increase
            if key in keys:
                met.append(index)
                yield index, stored

    decoded = read_from(recording.path, decode_frames(chosen(), losses), "frame")
    with closing(read_ahead(decoded)) as frames:
        yield from frames


# How much of a recording was tracked: part of every table, so that errors never hide lost frames


@dataclass(frozen=True)
class Coverage:
    """Counts of frames.

    Attributes:
        frames: estimates in the result.
        tracked: of these, not lost (reinitialised ones count as tracked).
        lost: of these, lost. Their errors count all the same.
        reinitialised: of these, found anew.
        unmatched: of these, without a truth at their stamp; all of them when there is no truth.
        missed: frames within the result's span that the run left out though there is a truth for them.
        outside: truths before its first or after its last estimate: not asked for, not counted.
        has_truth: whether there was a truth to match.
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

    @property
    def share(self) -> float:
        """Metric ``coverage``: (tracked and matched) / (frames + missed); without truth tracked / frames.

        0 for an empty result.
        """
        due = self.frames + self.missed
        good = self.tracked_and_matched if self.has_truth else self.tracked
        return good / due if due else 0.0


def measure_coverage(
    track: Track, truth: Track | None, pairs: Pairs | None, *, tolerance_ns: int = 0
) -> Coverage:
    """Count the frames of an estimate, and those of the truth that it should have had.

    A truth may come at another rate than the frames, and a run may have taken every second frame on purpose;
    so a truth without an estimate is no missed frame by itself. Frames are missed where a gap between two
    estimates holds truths that are farther than half the usual interval (and than the tolerance) from both:
    as many as there are such truths, but no more than fit in at the usual interval.

    Args:
        track: the estimate.
        truth, pairs: None without truth.
        tolerance_ns: of the association.
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
    """Return the mean interval, ns, between stamps (N,), N >= 2, that have no gap between them.

    The median tells the gaps (at least half of the intervals are none); the mean of the rest is the frame
    rate's, also where jitter makes intervals long and short in turn, between which a median has to choose.
    """
    intervals = np.diff(stamp_ns)
    return float(intervals[intervals <= GAP_FACTOR * np.median(intervals)].mean())


def _is_outside(stamp_ns: IntArray, true_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return which truths (M,) are before the first or after the last estimate; all if there is none."""
    if not stamp_ns.size:
        return np.ones(len(true_ns), dtype=np.bool_)
    before, after = true_ns < stamp_ns[0] - tolerance_ns, true_ns > stamp_ns[-1] + tolerance_ns
    outside: BoolArray = before | after
    return outside


def _missed(stamp_ns: IntArray, true_ns: IntArray, tolerance_ns: int) -> int:
    """Return how many frames are missing between the estimates, as ``measure_coverage`` counts them."""
    if len(stamp_ns) < 2:
        return 0
    intervals, usual = np.diff(stamp_ns), usual_interval(stamp_ns)
    interval = np.searchsorted(stamp_ns, true_ns, side="right") - 1  # between this estimate and the next
    inside = (interval >= 0) & (interval < len(intervals))
    interval, true_ns = interval[inside], true_ns[inside]
    distance = np.minimum(true_ns - stamp_ns[interval], stamp_ns[interval + 1] - true_ns)
    far = distance > max(0.5 * usual, tolerance_ns)
    truths = np.bincount(interval[far], minlength=len(intervals))
    room = np.maximum(np.rint(intervals / usual) - 1.0, 0.0)  # two frames may be nearer than usual
    return int(np.minimum(truths, room).sum())
