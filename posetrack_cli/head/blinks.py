"""Blinks: intervals with closed eyes, and their export as CSV."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import UsageError
from posetrack_cli.head.dense.numbers import CLOSED
from posetrack_cli.results.derived import is_tracked
from posetrack_cli.results.export.source import ExportSource
from posetrack_cli.results.fields import NUMBERS
from posetrack_cli.tables import csv_of
from posetrack_cli.units import NS_PER_S

FIELDS = ("stamp_ns", "status", NUMBERS)


def intervals(inside: BoolArray, stamp_ns: IntArray) -> FloatArray:
    """Return begin and end (N, 2), s, of the runs of frames that are inside."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2] - 1
    found: FloatArray = np.stack([stamp_ns[begins], stamp_ns[ends]], axis=1) / NS_PER_S
    return found


def blinks_text(source: ExportSource) -> Iterator[str]:
    """Yield a CSV with the first and the last frame of each blink, s from the first frame of the result.

    Raises:
        UsageError: the result has no dense face.
        ResultError: see ``ExportSource.blocks``.
    """
    names = source.result.subject.number_names
    if CLOSED not in names:
        raise UsageError(
            "blinks requires a result with the dense face",
            where=source.result.path,
            found=f"a {source.result.subject.name} without it",
            hint="track again with posetrack head and face.use = true",
        )
    column, closed, stamps = names.index(CLOSED), [], []
    for block in source.begun_blocks(FIELDS):
        closed.append((block[NUMBERS][:, column] == 1.0) & is_tracked(block))
        stamps.append(block["stamp_ns"])
    yield csv_of([["begin_s", "end_s"]])
    if stamps:
        all_stamps = np.concatenate(stamps)
        yield csv_of(intervals(np.concatenate(closed), all_stamps - all_stamps[0]).tolist())
