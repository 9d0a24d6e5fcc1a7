"""A result or a truth as it is drawn: which estimate belongs to a frame, its colour, its words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.association import associate, nearest_rows
from posetrack_cli.evaluation.metrics.pose_errors import distances
from posetrack_cli.evaluation.track import Track
from posetrack_cli.evaluation.viewing.colours import FOUND_ANEW, LOST, SKIN, Colour
from posetrack_cli.evaluation.viewing.drawing import Drawer, Shown
from posetrack_cli.evaluation.viewing.segments import HandSegments

TOLERANCE_NS = 5_000_000
"""How far apart the stamps of a frame and of an estimate of it may be."""


@dataclass(frozen=True, eq=False)
class Layer:
    """One track to draw.

    Attributes:
        track: its poses.
        drawer: draws them.
        colour: of what has none of its own.
        name: what captions call it; empty where there is only one.
        error_mm: (N,) mean distance of the points from the truth, NaN where there is none.
        segments: tells the hand's pixels from others; None where that is not drawn.
    """

    track: Track
    drawer: Drawer
    colour: Colour = SKIN
    name: str = ""
    error_mm: FloatArray | None = None
    segments: HandSegments | None = None

    def row(self, stamp_ns: int) -> int | None:
        """The row of the estimate whose stamp is nearest within the tolerance; None without one."""
        stamps = self.track.stamp_ns
        if not stamps.size:
            return None
        row = int(nearest_rows(np.array([stamp_ns]), stamps)[0])
        return row if abs(int(stamps[row]) - stamp_ns) <= TOLERANCE_NS else None

    def shown(self, stamp_ns: int) -> Shown:
        """What to draw at a stamp; nothing where there is no estimate."""
        row = self.row(stamp_ns)
        return Shown() if row is None else Shown.of_row(self.track, row)

    def status(self, stamp_ns: int) -> str:
        """``tracking``, ``lost``, ``reinitialised`` or ``no estimate``."""
        row = self.row(stamp_ns)
        return "no estimate" if row is None else self.track.status(row).value

    def mark(self, stamp_ns: int) -> Colour | None:
        """The colour that marks a frame which is not simply tracked; None for one that is."""
        status = self.status(stamp_ns)
        return {"tracking": None, "reinitialised": FOUND_ANEW}.get(status, LOST)

    def words(self, stamp_ns: int) -> list[str]:
        """What a caption says of the estimate at a stamp."""
        row = self.row(stamp_ns)
        status = self.status(stamp_ns)
        words = [self.name] if self.name else []
        words.append(status.upper() if status in ("lost", "no estimate") else status)
        if row is not None:
            words += _figure(self.track.confidence, row, lambda value: f"confidence {value:.2f}")
            words += _figure(self.error_mm, row, lambda value: f"error {value:.1f} mm")
        return words


def _figure(values: FloatArray | None, row: int, words: Callable[[float], str]) -> list[str]:
    known = values is not None and np.isfinite(values[row])
    return [words(float(values[row]))] if values is not None and known else []


def point_errors(track: Track, truth: Track | None) -> FloatArray | None:
    """Mean distance (N,) of the points of each frame from the truth's, mm; NaN without truth at its stamp.

    None where either knows no points, or they are others.
    """
    if truth is None or truth.points is None or track.points is None:
        return None
    if truth.points.shape[1:] != track.points.shape[1:]:
        return None
    errors = np.full(len(track), np.nan)
    pairs = associate(track.stamp_ns, truth.stamp_ns, TOLERANCE_NS)
    apart = distances(track.points[pairs.estimate], truth.points[pairs.truth])
    errors[pairs.estimate] = apart.mean(axis=1)
    return errors
