"""The last identities that adjustments came to: their mean is where the next one starts (thesis, (4.36))."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posetrack_cli.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class IdentityHistory:
    """The last N_s identities; ``identities`` and ``size`` are all that a checkpoint must keep.

    Attributes:
        identities: (m, S), 1 <= m <= N_s, the newest last.
        size: N_s.
    """

    identities: FloatArray
    size: int

    @classmethod
    def of(cls, identity: FloatArray, size: int) -> IdentityHistory:
        """Return a history that begins with one identity (S,) and keeps ``size`` of them."""
        return cls(np.array(identity, dtype=np.float64)[None], size)

    def added(self, identity: FloatArray) -> IdentityHistory:
        """Return the history after another adjustment; the oldest goes where there are too many."""
        return replace(self, identities=np.vstack([self.identities, identity])[-self.size :])

    @property
    def mean(self) -> FloatArray:
        """(S,) start of the next adjustment, (4.36)."""
        mean: FloatArray = self.identities.mean(axis=0)
        return mean

    @property
    def spread(self) -> FloatArray:
        """(S,) standard deviations about the mean: how far estimates still wander; 0 of one."""
        spread: FloatArray = self.identities.std(axis=0)
        return spread
