"""Whether a track is to be believed: what is remembered of how well frames were fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

from posetrack_cli.hand.config import StatusSettings

_MEMORY = 0.1  # share of a new frame in the running mean of costs
_ENOUGH_FACTOR, _ENOUGH_MM = 1.25, 1.0
_MOST_WAIT, _MOST_WAIT_AS_USUAL = 4, 16  # frames


@dataclass(frozen=True)
class Watch:
    """What is remembered of a track's quality.

    Attributes:
        lost: whether the hand is gone and has to be found in the whole image.
        found: whether it was ever found; before, a first find is no re-initialisation.
        misses: frames in a row without confidence.
        usual_mm: running mean of the fits' costs, 0 before the first.
        wait: frames to let pass before the next costly search.
        pause: how many to let pass after the next one that fails.
    """

    lost: bool = False
    found: bool = True
    misses: int = 0
    usual_mm: float = 0.0
    wait: int = 0
    pause: int = 1

    @property
    def is_believed(self) -> bool:
        """Whether the hand is where it was seen: a start is but assumed until a frame bears it out."""
        return self.usual_mm > 0.0 and not self.lost

    @property
    def enough_mm(self) -> float:
        """The cost up to which a fit needs no further trial; infinite while nothing is usual yet."""
        return _ENOUGH_FACTOR * self.usual_mm + _ENOUGH_MM if self.usual_mm > 0.0 else float("inf")

    def is_worse(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Whether a fit's cost is far above the usual."""
        limit = settings.doubt_factor * self.usual_mm + settings.doubt_mm
        return self.usual_mm > 0.0 and cost_mm > limit

    def doubts(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Whether a fit is worse than usual, or no fit that would be good for a hand of known shape."""
        return self.is_worse(cost_mm, settings) or cost_mm > settings.sure_mm

    def is_replaced(self, cost_mm: float, other_mm: float, settings: StatusSettings) -> bool:
        """Whether another fit is so much better that it takes a fit's place.

        A share tells where the model is the hand; where it is not, all costs are high: a difference tells.
        """
        return other_mm < max(settings.better * cost_mm, cost_mm - settings.better_mm)

    def waits(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Whether a search is put off; one that was to come late comes at once when fits get worse."""
        most = _MOST_WAIT if self.is_worse(cost_mm, settings) else _MOST_WAIT_AS_USUAL
        return 0 < self.wait <= most

    def waiting(self) -> Watch:
        """After a frame that was let pass."""
        return replace(self, wait=max(0, self.wait - 1))

    def refused(self, cost_mm: float, settings: StatusSettings) -> Watch:
        """After a search that found nothing better: the next ones come ever more seldom.

        Where a hand of another shape than the model's costs as much as usual, much more seldom.
        """
        worse = self.lost or self.is_worse(cost_mm, settings)
        most = _MOST_WAIT if worse else _MOST_WAIT_AS_USUAL
        return replace(self, wait=min(self.pause, most), pause=min(2 * self.pause, _MOST_WAIT_AS_USUAL))

    def restarted(self, cost_mm: float) -> Watch:
        """After the hand was found, or found to be elsewhere: what it usually costs is not forgotten."""
        usual = cost_mm if self.usual_mm == 0.0 else min(self.usual_mm, cost_mm)
        return replace(self, lost=False, found=True, misses=0, usual_mm=usual)

    def seen(self, cost_mm: float, confidence: float, settings: StatusSettings) -> Watch:
        """After a frame in which the hand was fitted."""
        if confidence < settings.lost_below:
            return self.missed(settings)
        usual = cost_mm if self.usual_mm == 0.0 else self.usual_mm
        back = replace(self, misses=0, lost=False)
        if self.is_worse(cost_mm, settings):
            return back
        usual += _MEMORY * (cost_mm - usual)
        if cost_mm > settings.sure_mm:
            return replace(back, usual_mm=usual)
        return replace(back, usual_mm=usual, wait=0, pause=1)

    def missed(self, settings: StatusSettings) -> Watch:
        """After a frame without confidence."""
        misses = self.misses + 1
        lost = self.lost or misses >= settings.lost_after_frames
        return replace(self, misses=misses, lost=lost)
