"""One expression of a synthetic face, and when it is made."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Episode:
    """One expression: its name, greatest strength, begin, and how long it rises, stays and falls, s."""

    name: str
    strength: float
    start: float
    rise: float
    hold: float
    fall: float

    @property
    def end(self) -> float:
        """When it is over, s."""
        return self.start + self.rise + self.hold + self.fall
