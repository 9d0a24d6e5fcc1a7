"""Whether a track can be trusted: a record of how well frames were fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace

from posetrack_cli.hand.config import StatusSettings

_DOUBT_FACTOR, _DOUBT_MM = 1.5, 2.0
"""A fit that costs so many times the usual, and so much more, is reconsidered, and ..."""
_BETTER, MUCH_BETTER_MM = 0.7, 2.0
"""... replaced by another one that costs less than this share, or so much less."""
LEAVE_AFTER_FRAMES = 5
"""Searches in a row in which another place was better; then the hand is there."""
_MEMORY = 0.1  # share of a new frame in the running mean of costs
_MOST_WAIT, _MOST_WAIT_AS_USUAL = 4, 6  # frames
_GOOD_SHARE, _GOOD_RISE_MM = 0.3, 0.03
"""Share of a better frame in the level of good fits, and by how much that rises in a frame at most."""
_RAISED_FACTOR, _FAR_RAISED_FACTOR, _RAISED_MM = 1.15, 1.25, 0.5
_WORSE_FACTOR, _WORSE_MM = 1.05, 0.5
_MOST_LOOK_WAIT = 3  # frames
_FORGOTTEN_MM = 0.02  # a frame, of what fingers are worth


@dataclass(frozen=True)
class TrackMonitor:
    """The record of a track's quality.

    Attributes:
        lost: whether the hand is gone and has to be found in the whole image.
        found: whether it was ever found; before, a first find is no re-initialisation.
        misses: frames in a row that no hand fits.
        usual_mm: running mean of the fits' costs, 0 before the first.
        wait: frames to skip before the next costly search.
        next_wait: frames to skip after the next search that fails.
        elsewhere: searches in a row that found a better hand at another place.
        fingers_mm: what fingers seen at this place are worth (``acquisition.fingers_bonus``), slowly
            forgotten.
        good_mm: what good fits of this recording cost, 0 before the first: a level that falls quickly and
            rises slowly, so that a few bad frames do not make it their own, as ``usual_mm`` does.
        look_wait: frames to skip before the hand is looked for anew where it is (``is_raised``).
        next_look_wait: frames to skip after the next look that does not help.
        looked_mm: what the fit cost that the last such look did not better.
    """

    lost: bool = False
    found: bool = True
    misses: int = 0
    usual_mm: float = 0.0
    wait: int = 0
    next_wait: int = 1
    elsewhere: int = 0
    fingers_mm: float = 0.0
    good_mm: float = 0.0
    look_wait: int = 0
    next_look_wait: int = 1
    looked_mm: float = 0.0

    @property
    def is_believed(self) -> bool:
        """Whether the track was confirmed by a frame and is not lost."""
        return self.usual_mm > 0.0 and not self.lost

    @property
    def sufficient_mm(self) -> float:
        """What a fit may cost that is not raised above the usual; infinite before the first."""
        return _RAISED_FACTOR * self.usual_mm + _RAISED_MM if self.usual_mm > 0.0 else float("inf")

    def is_worse(self, cost_mm: float) -> bool:
        """Whether a fit's cost is far above the usual."""
        limit = _DOUBT_FACTOR * self.usual_mm + _DOUBT_MM
        return self.usual_mm > 0.0 and cost_mm > limit

    def is_doubtful(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Whether a fit is worse than usual, or poor for a hand whose shape is known."""
        return self.is_worse(cost_mm) or cost_mm > settings.sure_mm

    def prefers(self, cost_mm: float, other_mm: float) -> bool:
        """Whether another fit is so much better that it replaces a fit.

        A ratio decides where the model is the hand's; where it is not, all costs are high, and a
        difference decides.
        """
        return other_mm < max(_BETTER * cost_mm, cost_mm - MUCH_BETTER_MM)

    def raised(self, cost_mm: float, settings: StatusSettings) -> float:
        """What a fit costs over what good ones of this recording do, at least 1; 1 before the first.

        That is known from the frames so far, and before them of some recordings (``settings.good_mm``): in
        one that begins with poor fits these would else be its good ones.
        """
        levels = [level for level in (self.good_mm, settings.good_mm) if level > 0.0]
        return max(1.0, cost_mm / min(levels)) if levels else 1.0

    def is_raised(self, cost_mm: float) -> bool:
        """Whether a fit costs more than good ones do, be it ever so little for a hand of another shape."""
        return self.good_mm > 0.0 and cost_mm > _RAISED_FACTOR * self.good_mm + _RAISED_MM

    def is_far_raised(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Whether a fit costs so much more than good ones that the window about it may mislead, too.

        A search takes as long as ten frames, so none is made for hands whose shape is known.
        """
        limit = max(settings.sure_mm, _FAR_RAISED_FACTOR * self.good_mm + _RAISED_MM)
        return self.good_mm > 0.0 and cost_mm > limit

    def postpones_look(self, cost_mm: float) -> bool:
        """Whether no look is worth it after one that did not help; a fit that costs more now is."""
        return self.look_wait > 0 and cost_mm <= _WORSE_FACTOR * self.looked_mm + _WORSE_MM

    def after_look_wait(self) -> TrackMonitor:
        """Return the record after a frame without a look."""
        return replace(self, look_wait=max(0, self.look_wait - 1))

    def after_look(self, cost_mm: float, *, helped: bool) -> TrackMonitor:
        """Return the record after a look at a frame whose fit costs so much."""
        if helped:
            return replace(self, look_wait=0, next_look_wait=1)
        wait = self.next_look_wait
        return replace(self, looked_mm=cost_mm, look_wait=wait, next_look_wait=min(2 * wait, _MOST_LOOK_WAIT))

    def after_fingers(self, bonus_mm: float) -> TrackMonitor:
        """Return the record after a frame that shows fingers worth so much at the hand's place."""
        return replace(self, fingers_mm=max(bonus_mm, self.fingers_mm - _FORGOTTEN_MM))

    def leaves_for(self, here_mm: float, there_mm: float) -> TrackMonitor:
        """Return the record after a hand was found elsewhere, with the doubts that both places leave.

        A track is left for one that has been better for ``LEAVE_AFTER_FRAMES`` searches in a row, no sooner:
        what is better in a single frame is mostly the other end of the same arm.
        """
        better = there_mm < here_mm - MUCH_BETTER_MM
        return replace(self, elsewhere=self.elsewhere + 1 if better else 0)

    def postpones_search(self, cost_mm: float) -> bool:
        """Whether a search is postponed; a long wait is cut short when fits get worse."""
        most = _MOST_WAIT if self.is_worse(cost_mm) else _MOST_WAIT_AS_USUAL
        return self.elsewhere == 0 and 0 < self.wait <= most

    def after_wait(self) -> TrackMonitor:
        """Return the record after a frame without a search."""
        return replace(self, wait=max(0, self.wait - 1))

    def after_failed_search(self, cost_mm: float) -> TrackMonitor:
        """Return the record after a search that found nothing better: each such search doubles the wait.

        The limit is higher where the cost is as usual: the hand then has another shape than the model.
        """
        worse = self.lost or self.is_worse(cost_mm)
        most = _MOST_WAIT if worse else _MOST_WAIT_AS_USUAL
        return replace(
            self, wait=min(self.next_wait, most), next_wait=min(2 * self.next_wait, _MOST_WAIT_AS_USUAL)
        )

    def after_restart(self, cost_mm: float) -> TrackMonitor:
        """Return the record after the hand was found, or found elsewhere; the usual cost is kept."""
        usual = cost_mm if self.usual_mm == 0.0 else min(self.usual_mm, cost_mm)
        return replace(self, lost=False, found=True, misses=0, usual_mm=usual, elsewhere=0, fingers_mm=0.0)

    def after_fit(self, cost_mm: float, quality: float, settings: StatusSettings) -> TrackMonitor:
        """Return the record after a frame in which the hand was fitted."""
        if quality < settings.lost_below:
            return self.after_miss(settings)
        usual = cost_mm if self.usual_mm == 0.0 else self.usual_mm
        good = cost_mm if self.good_mm == 0.0 else self.good_mm
        good += min(_GOOD_RISE_MM, _GOOD_SHARE * (cost_mm - good))
        back = replace(self, misses=0, lost=False, good_mm=good)
        if not self.is_raised(cost_mm):
            back = replace(back, look_wait=0, next_look_wait=1)
        if self.is_worse(cost_mm):
            return back
        usual += _MEMORY * (cost_mm - usual)
        if cost_mm > settings.sure_mm:
            return replace(back, usual_mm=usual)
        return replace(back, usual_mm=usual, wait=0, next_wait=max(1, self.next_wait // 2))

    def after_miss(self, settings: StatusSettings) -> TrackMonitor:
        """Return the record after a frame that no hand fits."""
        misses = self.misses + 1
        lost = self.lost or misses >= settings.lost_after_frames
        return replace(self, misses=misses, lost=lost)
