"""Frames that show a face from all sides, kept while it is tracked **[ours]**.

The n frames of the running adjustment are few, and change. For an adjustment over a whole recording one frame
is kept for every direction that the face was seen in: the one whose points looked most like themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.adjustment.views import PointView

CELL_DEG = 5.0
"""Directions are told apart in cells of so many degrees of yaw and pitch."""
PER_CELL = 2
"""Frames kept of a cell: one view's error must not count for a direction alone."""


@dataclass(frozen=True, eq=False)
class Album:
    """The frames kept.

    Attributes:
        pages: by cell, frames with their scores, the best first.
    """

    pages: Mapping[tuple[int, int], tuple[tuple[float, PointView], ...]] = field(default_factory=dict)

    @property
    def views(self) -> tuple[PointView, ...]:
        """All frames, in the order of their time."""
        kept = (view for page in self.pages.values() for _, view in page)
        return tuple(sorted(kept, key=lambda view: view.stamp_ns))

    def some(self, count: int) -> tuple[PointView, ...]:
        """Return ``count`` frames evenly spread over the kept ones, all if there are no more."""
        views = self.views
        if len(views) <= count:
            return views
        return tuple(views[i] for i in np.linspace(0, len(views) - 1, count).astype(int))

    def added(self, view: PointView, score: float) -> Album:
        """Return the album with a frame, if none better shows that direction."""
        cell = _cell(view.pose.facing)
        page = sorted((*self.pages.get(cell, ()), (score, view)), key=lambda one: -one[0])
        return Album({**self.pages, cell: tuple(page[:PER_CELL])})


def _cell(facing: FloatArray) -> tuple[int, int]:
    """The cell of a direction (3,): yaw and pitch from the camera's axis."""
    yaw = np.degrees(np.arctan2(facing[0], -facing[2]))
    pitch = np.degrees(np.arcsin(np.clip(facing[1], -1.0, 1.0)))
    return round(yaw / CELL_DEG), round(pitch / CELL_DEG)
