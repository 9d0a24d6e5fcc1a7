"""Outcome of a failed detection, and statistics of the search for a head."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

NO_FACE = "no face"
# Consecutive frames that must agree before images count as swapped; a single one may be wrong.
SWAPPED_FRAMES = 3


@dataclass(frozen=True)
class InitFailure:
    """Reason why no head was found in a frame.

    Attributes:
        reason: short text.
        score: 0 to 1, of the best face; 0 without one.
        order: image order that fits the calibration better than the recorded one; empty if none.
    """

    reason: str
    score: float = 0.0
    order: tuple[int, ...] = ()


@dataclass(frozen=True)
class Search:
    """Statistics of a search.

    Attributes:
        frames: number of frames searched.
        best_score: 0 to 1, of the best face.
        reasons: number of failures by reason.
        order: image order that the last frames with faces fit better; empty if none.
        swapped: number of consecutive frames that fit it.
    """

    frames: int = 0
    best_score: float = 0.0
    reasons: Counter[str] = field(default_factory=Counter)
    order: tuple[int, ...] = ()
    swapped: int = 0

    def failed(self, failure: InitFailure) -> Search:
        """Return the search after another failed frame."""
        order, swapped = self.order, self.swapped
        if failure.reason != NO_FACE:
            before = self.swapped if failure.order == self.order else 0
            order, swapped = failure.order, before + 1 if failure.order else 0
        best = max(self.best_score, failure.score)
        reasons = self.reasons + Counter([failure.reason])
        return Search(self.frames + 1, best, reasons, order, swapped)

    @property
    def images_swapped(self) -> bool:
        """Whether the images seem to belong to other cameras."""
        return self.swapped >= SWAPPED_FRAMES

    def __str__(self) -> str:
        """Return a summary such as ``600 frames searched, best score 0.31, mostly: no face``."""
        said = f"{self.frames} frame{'s' * (self.frames != 1)} searched, best score {self.best_score:.2f}"
        return f"{said}, mostly: {self.reasons.most_common(1)[0][0]}" if self.reasons else said
