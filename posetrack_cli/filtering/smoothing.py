"""What a backward pass over a filter's states yields, and what a run expects of any smoother."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.filters import FilterState
from posetrack_cli.filtering.model import Dynamics

Memory: TypeAlias = Mapping[str, Any]
"""What a smoother keeps of one frame: arrays and numbers of the same names and shapes at every frame."""
NOTHING: Memory = MappingProxyType({})


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Estimate of one frame from the whole recording; units as in `Posterior`.

    Attributes:
        pose: (S,) mean.
        pose_variance: (D,) about it, in the tangent space.
        velocity: (D,) mean; zeros of a filter without velocity.
        velocity_variance: (D,).
    """

    pose: FloatArray
    pose_variance: FloatArray
    velocity: FloatArray
    velocity_variance: FloatArray


class Step(NamedTuple):
    """How the filter came to a frame's state.

    Attributes:
        dt: seconds that it advanced by; 0 if it stood still.
        cut: whether the state does not follow from that of the frame before.
        frame: what is kept of the frame itself, for smoothers that look at it again; of the names of theirs
            none may be used.
    """

    dt: float
    cut: bool
    frame: Memory = NOTHING


class Smoother(Protocol):
    """A backward pass: each frame is remembered on the way forward, and smoothed on the way back."""

    def remember(self, state: FilterState, step: Step | None = None) -> Memory:
        """Return what to keep of the filter's state after a frame, and of how it came there."""
        ...

    def resume(self, last: Memory) -> None:
        """Go on after a frame that was remembered by another smoother, of a run that was interrupted."""
        ...

    def begin(self, last: Memory) -> Smoothed:
        """Start from a chain's last frame; there smoothed and filtered are the same."""
        ...

    def back(self, memory: Memory, dt: float) -> Smoothed:
        """Go on to the frame that was dt seconds, as the filter was given them, before the one smoothed last.

        Raises:
            FilterError: dt is not > 0.
        """
        ...

    def stay(self, memory: Memory, later: Smoothed) -> Smoothed:
        """Go on to the frame before where the filter stood still: the two frames have one state.

        Args:
            memory: of the frame before.
            later: what came of the one smoothed last.
        """
        ...


def noise_of(dynamics: Dynamics, moving: bool) -> Dynamics:
    """Return the noise that a filter had: without velocity none of the velocity's wandering."""
    return dynamics if moving else replace(dynamics, velocity_noise=np.zeros_like(dynamics.velocity_noise))
