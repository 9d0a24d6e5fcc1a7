"""Which estimate and which truth belong together: one to one, by their stamps or frame numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import IntArray
from posetrack_cli.errors import ResultError


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
