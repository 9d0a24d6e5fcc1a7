"""One measured figure, and what it is held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Row:
    """One measured figure.

    Attributes:
        name: what was measured.
        value: how much.
        unit: of it; empty for a ratio.
        target: what it should be at most; None without one.
    """

    name: str
    value: float
    unit: str
    target: float | None = None

    @property
    def verdict(self) -> str:
        """Whether the target is met."""
        return "" if self.target is None else ("ok" if self.value <= self.target else "MISSED")

    @property
    def line(self) -> str:
        """The row of the printed table."""
        held = "" if self.target is None else f"target {self.target:g}  {self.verdict}"
        return f"{self.name:66} {self.value:10.3f} {self.unit:9} {held}".rstrip()


def median_ms(seconds: Sequence[float]) -> float:
    """The median of times, in ms."""
    return 1e3 * float(np.median(seconds))


def median_of_pairs(one: Sequence[float], other: Sequence[float]) -> float:
    """The median ratio of times that were measured in turn."""
    return float(np.median(np.divide(one, other)))
