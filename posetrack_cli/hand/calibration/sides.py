"""Right or left, decided again where a hand of average shape did not tell: by hands of the shapes found."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from posetrack_cli.hand.calibration.calibrate import Calibration
from posetrack_cli.hand.calibration.trial import CLEAR_LOG_ODDS, MOST_A_FRAME, Trial, log_odds_of

_COUNTED = 4.0
"""Independent frames that those of a shape count as: it is fitted to all of them, and errs in all alike."""


@dataclass(frozen=True)
class SideFound:
    """Which hand it is.

    Attributes:
        side: ``right`` or ``left``.
        log_odds: of that side against the other; infinite where no other was possible.
        found: its shape, where it was estimated.
    """

    side: str
    log_odds: float
    found: Calibration | None

    @property
    def probability(self) -> float:
        """Of the side."""
        return float(1.0 / (1.0 + np.exp(-self.log_odds)))

    @property
    def is_sure(self) -> bool:
        """Whether the side is certain."""
        return self.log_odds >= CLEAR_LOG_ODDS


def decide_side(trial: Trial, estimate: Callable[[str], Calibration | None]) -> SideFound:
    """Return the likelier side, and its shape.

    A pointing hand, or a fist, of average shape costs about the same as either hand; adjusted to the frames,
    the true one costs less. So both shapes are estimated where the trial's frames left the side open, or
    told of it by hands of a wrong size.

    Args:
        trial: what frames told of side and size.
        estimate: gives the shape of a side's hand; None where it has none that can be used.
    """
    shapes = {trial.side: estimate(trial.side)}
    if len(trial.sides) == 1 or (trial.is_sure_of_side and not _is_resized(trial, shapes)):
        return SideFound(trial.side, abs(trial.log_odds), shapes[trial.side])
    shapes |= {side: estimate(side) for side in trial.sides if side not in shapes}
    first, second = trial.sides
    one, other = shapes[first], shapes[second]
    log_odds = trial.told_log_odds if _is_resized(trial, shapes) else trial.log_odds
    if one is not None and other is not None:
        log_odds += _COUNTED * log_odds_of(one.costs_mm[1], other.costs_mm[1])
    elif _is_resized(trial, shapes):
        log_odds += MOST_A_FRAME * ((one is not None) - (other is not None))
    return SideFound(first, log_odds, one) if log_odds >= 0.0 else SideFound(second, -log_odds, other)


def _is_resized(trial: Trial, shapes: Mapping[str, Calibration | None]) -> bool:
    """Whether a shape was begun with another size than fitted best in the trial."""
    return any(one is not None and one.begun_scale != trial.scale(side) for side, one in shapes.items())
