"""Where a filter's particles are drawn, by the names that configurations call it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from posetrack_cli.filtering.model import Sampling


class Proposal(NamedTuple):
    """A way to draw particles.

    Attributes:
        fits_frames: whether local fits are made of every frame, particles are drawn about them, and the whole
            image is searched for a hand that was lost; else the motion alone proposes.
        sampling: where no fits are there.
    """

    fits_frames: bool
    sampling: Sampling


PROPOSALS: Mapping[str, Proposal] = MappingProxyType(
    {
        "guided": Proposal(fits_frames=True, sampling="marginal"),
        "marginal": Proposal(fits_frames=False, sampling="marginal"),
        "paper": Proposal(fits_frames=False, sampling="paper"),
    }
)
