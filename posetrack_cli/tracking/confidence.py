"""How probable it is that an estimate is right: logistic regression on signs of its track **[ours]**.

    logit p = w_0 + sum_j w_j s_j

The signs s, and the weights, are a subject's own (``hand.confidence``, ``head.tracker.frame_tracker``). Signs
that are noisy in single frames count as running means: each new frame by ``MEMORY``, the first ones alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.results.columns import floats
from posetrack_cli.tracking.state_codec import Codec, Fields, Value, whole

SIGN = "sign_"
"""What names of signs begin with, among the numbers of a result."""
PROBABLY = 0.5
"""The probability of being right below which nothing is said to be tracked."""
MEMORY = 0.2
"""Share of a new frame in the running means: five frames count."""
_LARGEST = 50.0


@dataclass(frozen=True, eq=False)
class RunningSigns:
    """Running means of signs.

    Attributes:
        signs: (S,) the means.
        frames: how many there were; of few all count alike.
    """

    signs: FloatArray
    frames: int = 0

    @classmethod
    def before(cls, count: int) -> RunningSigns:
        """Return those of so many signs before any frame."""
        return cls(np.zeros(count))

    def after(self, signs: FloatArray) -> RunningSigns:
        """Return the means with the signs of one more frame (S,)."""
        share = max(MEMORY, 1.0 / (self.frames + 1))
        return RunningSigns(self.signs + share * (signs - self.signs), self.frames + 1)


def signs_codec(count: int) -> Codec[RunningSigns]:
    """Return how the running means of so many signs become arrays."""
    return Fields(RunningSigns, signs=Value(floats(count)), frames=whole())


class Regression(NamedTuple):
    """w_0 and (S,) w."""

    bias: float
    weights: FloatArray

    def probability(self, signs: FloatArray) -> float:
        """Return p of signs (S,)."""
        logit = self.bias + float(self.weights @ signs)
        return float(1.0 / (1.0 + np.exp(-np.clip(logit, -_LARGEST, _LARGEST))))
