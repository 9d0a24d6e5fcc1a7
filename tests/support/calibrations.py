"""Calibrations as they may come out, without one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.hand.model.anatomy import HandShape, PopulationSpace
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.shape_fit import Calibration, measured, measures_of

GOOD_MM = 1.8


def calibration_of(
    shape: HandShape,
    side: str = "right",
    costs_mm: tuple[float, float] = (4.0, 2.0),
    known: float = 0.2,
    begun_scale: float = 1.0,
    each_mm: Sequence[float] = (),
) -> Calibration:
    """What a calibration that found a shape says; ``known`` is the share of the prior's deviations left.

    Without costs of frames ``each_mm``, one frame costs as much as their median.
    """
    space = PopulationSpace()
    covariance = np.diag((known * space.sd) ** 2)
    numbers = measured(average_hand, space, side, shape, covariance)
    begun_mm = float(measures_of(average_hand(side, HandShape(begun_scale)).anatomy)[0])
    begun = begun_scale, begun_mm, covariance
    each = dict(enumerate(each_mm or costs_mm[1:]))
    return Calibration(side, shape, numbers, 20, 9, 1.234, costs_mm, GOOD_MM, *begun, frame_costs=each)
