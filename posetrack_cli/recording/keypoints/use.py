"""Which frames of a recording the keypoints of a file are of, and for how many of a run there were any."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice, pairwise
from statistics import median

import numpy as np

from posetrack_cli.losses import LossLog
from posetrack_cli.recording.keypoints.sets import NS_TOLERANCE, KeypointSets
from posetrack_cli.recording.recording import Recording
from posetrack_cli.units import NS_PER_S

COMPARED = 100
"""Early frames whose stamps are compared with those of a file."""


def fitted_to(sets: KeypointSets, recording: Recording) -> tuple[KeypointSets, str]:
    """Return the sets of a file as they belong to a recording's frames, and what was decided, for people.

    Where a file states frame numbers and stamps, the stamps count if they are the recording's, else the
    numbers: stamps that were computed from an average rate are not. Numbers count from 1 if the last one is
    the number of frames.

    Args:
        sets: as they were read.
        recording: whose early frames' stamps are compared.
    """
    if not sets.by_stamp:
        return _numbered(sets, recording)
    stamps = _early_stamps(recording)
    intervals = [b - a for a, b in pairwise(stamps.values()) if b > a] or [2 * NS_TOLERANCE]
    near = replace(sets, tolerance_ns=min(NS_TOLERANCE, min(intervals) // 2))
    if sets.numbers is None or (sets.numbers < 0).any():
        return near, ""
    numbered, words = _numbered(_by_number(sets), recording)
    order = np.argsort(sets.numbers, kind="stable")
    told = dict(zip(numbered.keys.tolist(), sets.keys[order].tolist(), strict=True))
    apart = [abs(told[number] - stamp) for number, stamp in stamps.items() if number in told]
    if not apart or 2 * sum(gap <= near.tolerance_ns for gap in apart) >= len(apart):
        return near, ""
    worst, usual = max(apart), median(intervals)
    off = f"its stamps are up to {worst / NS_PER_S:.2g} s ({worst / usual:.0f} frames) off the recording's"
    return numbered, f"{off}: frame numbers are used{words and f', {words}'}"


def _numbered(sets: KeypointSets, recording: Recording) -> tuple[KeypointSets, str]:
    """Return sets by numbers from 0."""
    count = recording.frame_count
    if count is None or not len(sets) or sets.keys[0] < 1 or sets.keys[-1] != count:
        return sets, ""
    return replace(sets, keys=sets.keys - 1), f"numbers count from 1: the last is {count} of {count} frames"


def _by_number(sets: KeypointSets) -> KeypointSets:
    """Return the sets of a file in order of its frame numbers."""
    numbers = sets.keys if sets.numbers is None else sets.numbers
    order = np.argsort(numbers, kind="stable")
    return replace(
        sets,
        keys=numbers[order],
        by_stamp=False,
        points=sets.points[order],
        scores=sets.scores[order],
        right=sets.right[order],
        numbers=None,
    )


def _early_stamps(recording: Recording) -> dict[int, int]:
    """Return the stamps, ns, of some early frames by their numbers."""
    frames = recording.stored_frames(LossLog())
    return {number: frame.stamp_ns for number, frame in islice(frames, COMPARED)}


class KeypointUse:
    """Counts for which frames of a run there are keypoints.

    Args:
        name: of the file.
        sets: what it holds.
        what: they are called.
    """

    def __init__(self, name: str, sets: KeypointSets, what: str = "keypoints") -> None:
        self._name, self._sets, self._what = name, sets, what
        self._frames, self._told = 0, 0

    def see(self, index: int, stamp_ns: int) -> None:
        """Count a frame."""
        rows = self._sets.of(index, stamp_ns)
        self._frames += 1
        self._told += int(rows.stop > rows.start)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to say at the end, in one line: most frames have none, so perhaps they are matched wrongly."""
        if 2 * self._told >= self._frames:
            return ()
        by = "by stamps, to 10 ms" if self._sets.by_stamp else "by number, counted from 0"
        return (f"{self._name} has {self._what} for {self._told} of {self._frames} frames, matched {by}",)
