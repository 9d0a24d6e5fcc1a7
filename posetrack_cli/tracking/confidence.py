"""Confidence of an estimate: logistic regression on signs of its track **[ours]**.

    logit p = w_0 + sum_j w_j s_j

Signs s and weights are specific to a subject (``hand.confidence``, ``head.tracker.frame_tracker``). Signs
that are noisy in single frames enter as running means: each new frame has the weight ``MEMORY``, the first
ones equal weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.results.columns import floats
from posetrack_cli.tracking.state_codec import Codec, Fields, Value, whole

SIGN = "sign_"
"""Prefix of sign names among the numbers of a result."""
PROBABLY = 0.5
"""Confidence below which a frame does not count as tracked."""
MEMORY = 0.2
"""Weight of a new frame in the running means, i.e. an average over about five frames."""
_LARGEST = 50.0


@dataclass(frozen=True, eq=False)
class RunningSigns:
    """Running means of signs.

    Attributes:
        signs: (S,) means.
        frames: number of frames; the first few have equal weights.
    """

    signs: FloatArray
    frames: int = 0

    @classmethod
    def before(cls, count: int) -> RunningSigns:
        """Return the initial state for ``count`` signs."""
        return cls(np.zeros(count))

    def after(self, signs: FloatArray, steps: int = 1) -> RunningSigns:
        """Return the means updated with one frame's signs (S,), ``steps`` usual frame intervals later."""
        share = max(1.0 - (1.0 - MEMORY) ** steps if steps > 1 else MEMORY, 1.0 / (self.frames + 1))
        return RunningSigns(self.signs + share * (signs - self.signs), self.frames + 1)


def signs_codec(count: int) -> Codec[RunningSigns]:
    """Return the codec of running means of ``count`` signs."""
    return Fields(RunningSigns, signs=Value(floats(count)), frames=whole())


class Regression(NamedTuple):
    """w_0 and w (S,); ``most`` is the probability that nothing beyond the signs makes the estimate wrong."""

    bias: float
    weights: FloatArray
    most: float = 1.0

    def probability(self, signs: FloatArray) -> float:
        """Return p given signs (S,)."""
        logit = self.bias + float(self.weights @ signs)
        return float(self.most / (1.0 + np.exp(-np.clip(logit, -_LARGEST, _LARGEST))))
