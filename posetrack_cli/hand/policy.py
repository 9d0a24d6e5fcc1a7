"""The state machine of a hand's track: when to search, where, what to accept, and when a hand is lost.

A hand is *followed* or *lost*. A lost hand is searched for in the whole image, with pauses that double while
it is not found. A hand that is followed is fitted about its prediction; then one of these decides, in this
order:

1. Keypoints tell of a better hand elsewhere, in several frames in a row: the track restarts there.
2. The fit is doubtful (far above the usual cost): the window is searched for a hand that looks alike, and
   where that does not help the whole image; a better hand at the same place is taken over, one elsewhere
   restarts the track once it has been better in several searches in a row.
3. The fit costs more than good fits of this recording: the hand is looked for anew about the fit.

After the frame, `TrackMonitor.after_fit` and `after_miss` say whether the hand is lost, `status_of` what the
estimate states.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import StatusSettings
from posetrack_cli.hand.fit.local_fits import LocalFits
from posetrack_cli.hand.keypoints.told import ToldHand, candidates, likeliest
from posetrack_cli.hand.model.anatomy import HandAnatomy
from posetrack_cli.hand.model.kinematics import joint_set_distance
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.search import Acquisition, Candidate, better_of, depth_doubt
from posetrack_cli.results.columns import NotNegative
from posetrack_cli.results.estimate import Status

NEAR_MM = 35.0  # distance of two sets of joints, up to which a better fit is of the hand that is tracked
SAME_PLACE_MM = 60.0
"""Up to here two hands are at one place **[ours]**: an adult's that is taken end for end, with its fingers
along the forearm, is 40 to 55 mm off, the other end of an arm 150 and more."""
_ALIKE_BETTER_MM = 0.4
"""What another fold of fingers is cheaper by, at least, of a hand that faces the same way."""
_FACES_ALIKE = np.cos(np.deg2rad(60.0))
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
    usual_mm: NotNegative = 0.0
    wait: int = 0
    next_wait: int = 1
    elsewhere: int = 0
    fingers_mm: float = 0.0
    good_mm: NotNegative = 0.0
    look_wait: int = 0
    next_look_wait: int = 1
    looked_mm: NotNegative = 0.0

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

        A track is left for one that has been better for `LEAVE_AFTER_FRAMES` searches in a row, no sooner:
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


class Decision(NamedTuple):
    """What to do with a frame.

    Attributes:
        monitor: the record from here on.
        found: a hand to fit once more from; None: what was fitted stays.
        restart: whether the track begins anew at that hand, else it is the same track.
    """

    monitor: TrackMonitor
    found: Candidate | None = None
    restart: bool = False


class Sight(NamedTuple):
    """A frame of a hand that is followed.

    Attributes:
        monitor: the record before the frame.
        depth: (height, width) mm, the image.
        observation: the window about the prediction.
        fits: to that window.
        expected: (6,) inner numbers that the hand is expected to have.
    """

    monitor: TrackMonitor
    depth: ImageArray
    observation: Observation
    fits: LocalFits
    expected: FloatArray

    @property
    def pose(self) -> FloatArray:
        """The best fit (22,)."""
        pose: FloatArray = self.fits.modes.poses[0]
        return pose


class Policy:
    """Decides whether a frame's fit is kept, refined from a better hand there, or left for one elsewhere.

    Args:
        settings: of doubt and loss.
        anatomy: the hand.
        finder: the search for a hand of which no pose is known.
        observer: cuts out the windows of the hand that is followed.
    """

    def __init__(
        self, settings: StatusSettings, anatomy: HandAnatomy, finder: Acquisition, observer: Observer
    ) -> None:
        self._settings, self._anatomy = settings, anatomy
        self._finder, self._observer = finder, observer

    def lost(self, monitor: TrackMonitor, depth: ImageArray, told: Sequence[ToldHand]) -> Decision:
        """Search the whole image (height, width), mm, for a lost hand, with ever longer pauses.

        During a pause it is only looked for where keypoints tell of it. Without a find nothing was seen.
        """
        there = candidates(self._finder, depth, told)
        if monitor.wait > 0:
            found = likeliest(there, monitor.sufficient_mm)
            otherwise = monitor.after_wait()
        else:
            found = self._finder.search(depth, there)
            otherwise = monitor.after_failed_search(np.inf)
        return Decision(otherwise) if found is None else Decision(monitor, found, restart=True)

    def followed(self, sight: Sight, told: Sequence[ToldHand] | None) -> Decision:
        """Decide on a frame that was fitted.

        Args:
            sight: the frame.
            told: hands elsewhere that keypoints tell of; None where there are no keypoints.
        """
        decision = None if told is None else self._told_elsewhere(sight, told)
        return decision or self._reconsidered(sight)

    def _told_elsewhere(self, sight: Sight, told: Sequence[ToldHand]) -> Decision | None:
        """Leave for a better hand that keypoints tell of; None where they tell of none.

        A frame that fits and tells of nothing better ends the row: no search would.
        """
        before, cost = sight.monitor, sight.fits.cost
        is_doubtful = before.is_doubtful(cost, self._settings)
        there = likeliest(candidates(self._finder, sight.depth, told))
        monitor = replace(before, elsewhere=0)
        if there is not None:
            doubt = _doubt_here(sight) - (0.0 if is_doubtful else MUCH_BETTER_MM)
            monitor = before.leaves_for(doubt, there.doubt)
        if monitor.elsewhere <= before.elsewhere and is_doubtful:
            return None
        if there is not None and monitor.elsewhere >= LEAVE_AFTER_FRAMES:
            return Decision(monitor, there, restart=True)
        return Decision(monitor)

    def _reconsidered(self, sight: Sight) -> Decision:
        """Where the fit is bad, search for a hand that looks alike and fits far better, or is elsewhere."""
        monitor, cost = sight.monitor, sight.fits.cost
        if not monitor.is_doubtful(cost, self._settings):
            return self._looked_again(sight)
        if monitor.postpones_search(cost):
            return self._looked_again(sight._replace(monitor=monitor.after_wait()))
        found = self._finder.reconsider(sight.observation, sight.pose)
        if found is None or monitor.is_doubtful(found.cost, self._settings):
            there = self._finder.search(sight.depth)  # the window may be misled, too
            if there is None or self._is_near(there.pose, sight.pose):
                found, monitor = better_of(found, there), replace(monitor, elsewhere=0)
            else:
                monitor = monitor.leaves_for(*self._doubts(sight, there))
                if monitor.elsewhere >= LEAVE_AFTER_FRAMES:
                    return Decision(monitor, there, restart=True)
        if found is not None and monitor.prefers(cost, found.cost):
            return Decision(monitor, found)
        return Decision(monitor.after_failed_search(cost))

    def _looked_again(self, sight: Sight) -> Decision:
        """Where the fit costs more than good ones of this recording, look for the hand anew where it is.

        A hand that turns or opens faster than expected leaves the reach of its prediction. On another
        person's hand that costs little: two fingers on one of the image are 2 mm among 10. A fit that
        faces the same way needs to be but a little better; palm and back are not exchanged for that.
        The window about a wrong prediction may have cut fingers off, so it is laid about the fit, and where
        a doubtful fit costs far more than good ones the whole image is searched at once, too.
        """
        monitor, cost, here = sight.monitor, sight.fits.cost, sight.pose
        if cost <= self._settings.well_mm or not monitor.is_raised(cost):
            return Decision(monitor)
        if monitor.postpones_look(cost):
            return Decision(monitor.after_look_wait())
        found = self._finder.reconsider(self._observer.observe(sight.depth, here, sight.expected), here)
        if monitor.is_far_raised(cost, self._settings):
            there = self._finder.search(sight.depth)
            if there is not None and self._is_alike(there.pose, here):
                found = better_of(found, there)
        helped = found is not None and (
            monitor.prefers(cost, found.cost)
            or (found.cost < cost - _ALIKE_BETTER_MM and self._is_alike(found.pose, here))
        )
        return Decision(monitor.after_look(cost, helped=helped), found if helped else None)

    def _is_alike(self, pose: FloatArray, other: FloatArray) -> bool:
        """Whether two poses (22,) are of a hand at one place that faces one way."""
        facing, there = (rotations.rotate(one[3:7], np.array([0.0, 0.0, 1.0])) for one in (pose, other))
        return self._is_near(pose, other) and bool(facing @ there > _FACES_ALIKE)

    def _is_near(self, pose: FloatArray, other: FloatArray) -> bool:
        """Whether two poses (22,) are of a hand at one place, folded otherwise, not of two."""
        return joint_set_distance(self._anatomy, pose, other) < NEAR_MM

    def _doubts(self, sight: Sight, there: Candidate) -> tuple[float, float]:
        """What speaks against the hand that is followed and against one found elsewhere, mm of cost.

        Of two hands at one place the costs alone decide: the fingers that were seen there are either's.
        """
        if joint_set_distance(self._anatomy, there.pose, sight.pose) < SAME_PLACE_MM:
            return sight.fits.cost, there.cost
        return _doubt_here(sight), there.doubt


def _doubt_here(sight: Sight) -> float:
    """What speaks against the hand that is followed, mm of cost, as ``Candidate.doubt`` of another place."""
    return sight.fits.cost - sight.monitor.fingers_mm + depth_doubt(float(sight.pose[2]))


def status_of(*, is_believed: bool, is_another: bool) -> Status:
    """Return what an estimate states: lost if it is not believed, reinitialised where the track restarted."""
    if not is_believed:
        return Status.LOST
    return Status.REINITIALISED if is_another else Status.TRACKING
