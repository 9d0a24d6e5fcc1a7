"""What a proposal that looks at the frame gives a filter step, and what a step expects of any of them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.filtering.laplace import Prediction
from posetrack_cli.filtering.model import LogLikelihood, StateSpace
from posetrack_cli.filtering.step import Weighing


class Proposed(NamedTuple):
    """Poses drawn for one frame, and weighed.

    Attributes:
        poses: (N, S).
        increments: (N, D) from their ancestors' poses.
        ancestors: (N,) whom each comes from.
        weighing: their weights, hand paper (24).
    """

    poses: FloatArray
    increments: FloatArray
    ancestors: IntArray
    weighing: Weighing


class Proposer(Protocol):
    """A proposal that looks at the frame; false if it has nothing to look with."""

    def __bool__(self) -> bool: ...

    def propose(
        self,
        prediction: Prediction,
        space: StateSpace,
        log_likelihood: LogLikelihood,
        scheme: str,
        rng: np.random.Generator,
    ) -> Proposed:
        """Draw and weigh as many poses as there are particles.

        Args:
            prediction: the belief before the frame.
            space: the poses' space.
            log_likelihood: log p(y_t | x) of poses.
            scheme: how ancestors are drawn, one of `resampling_schemes`.
            rng: source of randomness.
        """
        ...
