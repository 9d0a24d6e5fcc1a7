"""Where a filter's particles are drawn, by the names that configurations call it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from posetrack_cli.filtering.annealed import Annealing
from posetrack_cli.filtering.errors import Registry
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.model import Sampling
from posetrack_cli.filtering.step import Proposer
from posetrack_cli.hand.config import FitSettings
from posetrack_cli.hand.local_fits import LocalFits

BLOCKS = (np.arange(6), *np.arange(6, 21).reshape(5, 3))
"""Components of the tangent space that move, or err, together: the palm, then each finger."""

MakeProposer: TypeAlias = Callable[[LocalFits | None, FitSettings], Proposer | None]


@dataclass(frozen=True)
class Proposal:
    """A way to draw particles.

    Attributes:
        proposer: makes what looks at a frame before particles are drawn, given the frame's local fits; None
            where nothing does.
        looks_at_frames: whether anything may.
        fits_frames: whether local fits are made of every frame, and the whole image is searched for a hand
            that was lost.
        sampling: where nothing looks at the frame.
    """

    proposer: MakeProposer
    looks_at_frames: bool = True
    fits_frames: bool = False
    sampling: Sampling = "marginal"


PROPOSALS: Registry[Proposal] = Registry("proposal")


def proposal(
    name: str, *, looks_at_frames: bool = True, fits_frames: bool = False, sampling: Sampling = "marginal"
) -> Callable[[MakeProposer], MakeProposer]:
    """Return the decorator that makes a proposal known by a name; see `Proposal`."""

    def add(make: MakeProposer) -> MakeProposer:
        PROPOSALS[name] = Proposal(make, looks_at_frames, fits_frames, sampling)
        return make

    return add


@proposal("guided", fits_frames=True)
def guided(fits: LocalFits | None, settings: FitSettings) -> Proposer | None:
    """Return the mixture of priors and local fits."""
    return None if fits is None else Guide(fits.modes, settings.prior_share)


@proposal("annealed")
def annealed(fits: LocalFits | None, settings: FitSettings) -> Proposer:
    """Return the tempered sampler, which needs no fits."""
    return Annealing(BLOCKS)


@proposal("paper", looks_at_frames=False, sampling="paper")
@proposal("marginal", looks_at_frames=False)
def from_motion(fits: LocalFits | None, settings: FitSettings) -> None:
    """Return nothing: the motion alone proposes."""
    return None
