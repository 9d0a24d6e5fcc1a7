"""Drawing of heads: feature points, axes, and the dense face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.evaluation.viewing.drawing import Canvas, Colour, Shown, SkeletonDrawer
from posetrack_cli.geometry.rigid import in_camera
from posetrack_cli.head.dense.numbers import dense_points
from posetrack_cli.head.dense.points import DENSE_LINES

DENSE_COLOUR: Colour = (140, 230, 140)


@dataclass(frozen=True)
class HeadDrawer:
    """Draws the ten points with lines and axes, and the dense face if it was measured.

    Attributes:
        skeleton: draws points and axes.
        number_names: names of the result's numbers.
    """

    skeleton: SkeletonDrawer
    number_names: tuple[str, ...]

    def draw(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw an estimate."""
        self._draw_dense(canvas, shown)
        self.skeleton.draw(canvas, shown, colour)

    def outline(self, canvas: Canvas, shown: Shown, colour: Colour) -> None:
        """Draw points and axes in one colour."""
        self.skeleton.outline(canvas, shown, colour)

    def _draw_dense(self, canvas: Canvas, shown: Shown) -> None:
        if shown.numbers is None or shown.position is None or shown.quaternion is None:
            return
        dense = dense_points(self.number_names, shown.numbers)
        if dense is None:
            return
        places = in_camera(dense[:, :3], shown.position, shown.quaternion)
        known = ~np.isnan(places[:, 0])
        for line in DENSE_LINES:
            if known[list(line)].all():
                canvas.draw_line(places[list(line)], DENSE_COLOUR, canvas.thickness)
        canvas.draw_dots(places[known], DENSE_COLOUR, canvas.thickness)
