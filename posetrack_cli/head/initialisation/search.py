"""Why no head was found in a frame, and what looking for one has come to."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

NO_FACE = "no face"
# Images are exchanged for good if so many frames in a row say so; one may err.
EXCHANGED_FRAMES = 3


@dataclass(frozen=True)
class InitFailure:
    """Why no head was found.

    Attributes:
        reason: in a few words.
        score: 0 to 1, the surest face's score; 0 where there is none.
        order: the order of images that fits the calibration better than the recorded one, empty if none.
    """

    reason: str
    score: float = 0.0
    order: tuple[int, ...] = ()


@dataclass(frozen=True)
class Search:
    """What a search has come to.

    Attributes:
        frames: how many were searched.
        best_score: 0 to 1, of the surest face.
        reasons: how often each failed for which reason.
        order: the order of images that the last frames with faces fit better, empty if none.
        exchanged: how many frames in a row fit it.
    """

    frames: int = 0
    best_score: float = 0.0
    reasons: Counter[str] = field(default_factory=Counter)
    order: tuple[int, ...] = ()
    exchanged: int = 0

    def failed(self, failure: InitFailure) -> Search:
        """Return the search after one more frame without a start."""
        order, exchanged = self.order, self.exchanged
        if failure.reason != NO_FACE:
            before = self.exchanged if failure.order == self.order else 0
            order, exchanged = failure.order, before + 1 if failure.order else 0
        best = max(self.best_score, failure.score)
        reasons = self.reasons + Counter([failure.reason])
        return Search(self.frames + 1, best, reasons, order, exchanged)

    @property
    def images_exchanged(self) -> bool:
        """Whether the images seem to belong to other cameras than they are said to."""
        return self.exchanged >= EXCHANGED_FRAMES

    def __str__(self) -> str:
        """Such as ``600 frames searched, best score 0.31, mostly: no face``."""
        said = f"{self.frames} frame{'s' * (self.frames != 1)} searched, best score {self.best_score:.2f}"
        return f"{said}, mostly: {self.reasons.most_common(1)[0][0]}" if self.reasons else said
