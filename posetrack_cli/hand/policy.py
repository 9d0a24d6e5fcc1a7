"""State machine of a hand track: when to search, which fit to keep, when the hand is lost.

                        hand found
         +------------------------------------------+
         |                                          v
       LOST                                      TRACKED <--+  better hand elsewhere in
         ^                                          |  |    |  LEAVE_AFTER_SEARCHES searches
         +------------------------------------------+  +----+  in a row: restart there
              `lost_after_frames` misses in a row

LOST (`Policy.decide_lost`): search the whole image. The pause doubles after each failed search; during a
pause only keypoints are tried.

TRACKED (`Policy.decide_tracked`): the frame was fitted around its prediction. In this order:

1. Keypoints show a better hand elsewhere: count it, and restart there when it persists.
2. The fit is doubtful (cost far above the track's mean or good fits of the recording): search the window for
   hands that look alike, then the whole image. Replace the fit by a much better one at the same place, or
   count one elsewhere.
3. The fit is poor (cost above the recording's baseline): retry around the fitted pose.

`TrackMonitor` holds the counters and cost levels. `after_fit` and `after_miss` end every frame.
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
from posetrack_cli.hand.keypoints.hands import KeypointHand, best_candidate, fit_candidates
from posetrack_cli.hand.model.anatomy import HandAnatomy
from posetrack_cli.hand.model.kinematics import joint_set_distance
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.search import NO_BAR, Acquisition, Bar, Candidate, cheaper_of, depth_penalty
from posetrack_cli.results.columns import NotNegative
from posetrack_cli.results.estimate import Status

# Joint set distances: below NEAR_MM another fold of the tracked hand. Below SAME_PLACE_MM still the same
# place **[ours]**: a back-to-front fit is off by 40-55 mm, the other end of an arm by > 150 mm.
NEAR_MM, SAME_PLACE_MM = 35.0, 60.0

# A fit is doubtful above this multiple of the track's mean cost plus an offset. The ratio matters for a
# hand of the model's shape; with another shape all costs are high, and the difference decides.
_DOUBT_FACTOR, _DOUBT_MM = 1.5, 2.0
_SWITCH_FACTOR, SWITCH_MARGIN_MM = 0.7, 2.0
LEAVE_AFTER_SEARCHES = 5

# A fit is poor above this multiple of the baseline cost plus an offset; far above it also the image is
# searched.
_POOR_FACTOR, _FAR_FACTOR, _POOR_MM = 1.15, 1.25, 0.5
_SAME_FACING_COSINE = np.cos(np.deg2rad(60.0))
_SAME_FACING_MARGIN_MM = 0.4  # enough to switch between folds of a hand that faces the same way
_RETRY_FACTOR, _RETRY_MM = 1.05, 0.5  # a fit this much worse than at the last retry ends the pause

_MEAN_GAIN = 0.1  # of the running mean cost
_BASELINE_GAIN, _BASELINE_RISE_MM = 0.3, 0.03  # per frame; it falls fast and rises slowly
_BONUS_DECAY_MM = 0.02  # per frame

MOSTLY_HIDDEN = 0.4
"""Share of a hand behind another from which it follows its motion: any search would find the other."""

_AFTER_GAP_MM = 0.5
"""After a gap, a search replaces a fit that costs this much more: the noise of two fits of one hand."""

# Longest pauses between searches, frames.
_MAX_WAIT, _MAX_WAIT_AT_MEAN, _MAX_RETRY_WAIT = 4, 6, 3


@dataclass(frozen=True)
class TrackMonitor:
    """Counters and cost levels of a track.

    Attributes:
        lost: the hand has to be found in the whole image.
        was_found: False until the first find, which is not a reinitialisation.
        misses: frames in a row without a fit.
        mean_cost_mm: running mean of fit costs, 0 before the first.
        search_wait: frames to skip before the next search.
        next_search_wait: frames to skip after the next failed search.
        better_elsewhere: searches in a row that found a better hand at another place.
        finger_bonus_mm: bonus for fingers seen at this place (``search.finger_bonus``), decaying slowly.
        baseline_cost_mm: cost of good fits in this recording, 0 before the first. It falls quickly and rises
            slowly, so unlike ``mean_cost_mm`` it does not follow a few bad frames.
        retry_wait: frames to skip before the next retry around a poor fit.
        next_retry_wait: frames to skip after the next retry that does not help.
        last_retry_cost_mm: cost at the last retry that did not help.
    """

    lost: bool = False
    was_found: bool = True
    misses: int = 0
    mean_cost_mm: NotNegative = 0.0
    search_wait: int = 0
    next_search_wait: int = 1
    better_elsewhere: int = 0
    finger_bonus_mm: float = 0.0
    baseline_cost_mm: NotNegative = 0.0
    retry_wait: int = 0
    next_retry_wait: int = 1
    last_retry_cost_mm: NotNegative = 0.0

    @property
    def is_tracked(self) -> bool:
        """Whether a frame has confirmed the track and it is not lost."""
        return self.mean_cost_mm > 0.0 and not self.lost

    # How good is a fit?

    @property
    def accept_below_mm(self) -> float:
        """Cost up to which a fit is as good as the track's mean; infinite before the first fit."""
        return _POOR_FACTOR * self.mean_cost_mm + _POOR_MM if self.mean_cost_mm > 0.0 else float("inf")

    def is_far_above_mean(self, cost_mm: float) -> bool:
        """Return whether a cost is far above the track's mean."""
        limit = _DOUBT_FACTOR * self.mean_cost_mm + _DOUBT_MM
        return self.mean_cost_mm > 0.0 and cost_mm > limit

    def is_doubtful(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Return whether a fit is far above the mean, or poor even for a hand of another shape.

        Poor means far above good fits of the whole recording, where their cost is known: of 132 searches that
        doubted cheaper fits in four real recordings, none found a better hand.
        """
        good = self._good_cost_mm(settings) if settings.baseline_cost_mm > 0.0 else 0.0
        return self.is_far_above_mean(cost_mm) or cost_mm > _far_above(good, settings)

    def prefers(self, cost_mm: float, other_mm: float) -> bool:
        """Return whether a fit of cost ``other_mm`` is good enough to replace one of ``cost_mm``."""
        return other_mm < self.limit_mm(cost_mm)

    def limit_mm(self, cost_mm: float) -> float:
        """Return the cost below which a fit replaces one of another cost."""
        return max(_SWITCH_FACTOR * cost_mm, cost_mm - SWITCH_MARGIN_MM)

    def cost_ratio(self, cost_mm: float, settings: StatusSettings) -> float:
        """Return the ratio of a cost to the baseline, at least 1; 1 without a baseline.

        The configured baseline of the whole recording also counts: in a recording that begins with poor
        fits, these would otherwise be the baseline.
        """
        good = self._good_cost_mm(settings)
        return max(1.0, cost_mm / good) if good > 0.0 else 1.0

    def _good_cost_mm(self, settings: StatusSettings) -> float:
        """Return the cost of good fits here or in the whole recording, the lower one; 0 if unknown."""
        levels = (self.baseline_cost_mm, settings.baseline_cost_mm)
        return min((level for level in levels if level > 0.0), default=0.0)

    def is_above_baseline(self, cost_mm: float) -> bool:
        """Return whether a fit costs more than good fits of this recording."""
        return self.baseline_cost_mm > 0.0 and cost_mm > _POOR_FACTOR * self.baseline_cost_mm + _POOR_MM

    def is_far_above_baseline(self, cost_mm: float, settings: StatusSettings) -> bool:
        """Return whether the cost is so high that the window around the fit may be wrong as well.

        A search takes as long as ten frames, so hands of known shape are left out (``doubt_above_mm``).
        """
        return self.baseline_cost_mm > 0.0 and cost_mm > _far_above(self.baseline_cost_mm, settings)

    # Search of the window and the image

    def skips_search(self, cost_mm: float) -> bool:
        """Return whether this frame waits; long waits end early when fits get worse."""
        most = _MAX_WAIT if self.is_far_above_mean(cost_mm) else _MAX_WAIT_AT_MEAN
        return self.better_elsewhere == 0 and 0 < self.search_wait <= most

    def after_search_wait(self) -> TrackMonitor:
        """Return the record after a frame without a search."""
        return replace(self, search_wait=max(0, self.search_wait - 1))

    def after_failed_search(self, cost_mm: float) -> TrackMonitor:
        """Return the record after a search without a better hand: the wait doubles up to a limit.

        The limit is higher at mean cost: then the hand has another shape than the model.
        """
        most = _MAX_WAIT if self.lost or self.is_far_above_mean(cost_mm) else _MAX_WAIT_AT_MEAN
        return replace(
            self,
            search_wait=min(self.next_search_wait, most),
            next_search_wait=min(2 * self.next_search_wait, _MAX_WAIT_AT_MEAN),
        )

    def after_elsewhere(self, here_mm: float, elsewhere_mm: float) -> TrackMonitor:
        """Return the record after comparing the total costs of this place and another one.

        A single better frame is usually the other end of the same arm, so the track is left only after
        `LEAVE_AFTER_SEARCHES` in a row.
        """
        is_better = elsewhere_mm < here_mm - SWITCH_MARGIN_MM
        return replace(self, better_elsewhere=self.better_elsewhere + 1 if is_better else 0)

    def after_restart(self, cost_mm: float) -> TrackMonitor:
        """Return the record after the hand was found, here or elsewhere; the mean cost does not rise."""
        mean = cost_mm if self.mean_cost_mm == 0.0 else min(self.mean_cost_mm, cost_mm)
        return replace(
            self,
            lost=False,
            was_found=True,
            misses=0,
            mean_cost_mm=mean,
            better_elsewhere=0,
            finger_bonus_mm=0.0,
        )

    def after_finger_bonus(self, bonus_mm: float) -> TrackMonitor:
        """Return the record after a frame whose fingers are worth ``bonus_mm``."""
        return replace(self, finger_bonus_mm=max(bonus_mm, self.finger_bonus_mm - _BONUS_DECAY_MM))

    # Retry around a poor fit

    def skips_retry(self, cost_mm: float) -> bool:
        """Return whether this frame waits after a retry that did not help; worse fits do not wait."""
        return self.retry_wait > 0 and cost_mm <= _RETRY_FACTOR * self.last_retry_cost_mm + _RETRY_MM

    def after_retry_wait(self) -> TrackMonitor:
        """Return the record after a frame without a retry."""
        return replace(self, retry_wait=max(0, self.retry_wait - 1))

    def after_retry(self, cost_mm: float, *, helped: bool) -> TrackMonitor:
        """Return the record after a retry at a fit of a cost."""
        if helped:
            return replace(self, retry_wait=0, next_retry_wait=1)
        return replace(
            self,
            last_retry_cost_mm=cost_mm,
            retry_wait=self.next_retry_wait,
            next_retry_wait=min(2 * self.next_retry_wait, _MAX_RETRY_WAIT),
        )

    # End of a frame

    def after_fit(self, cost_mm: float, quality: float, settings: StatusSettings) -> TrackMonitor:
        """Return the record after a fitted frame; one of low quality (0 to 1) is a miss."""
        if quality < settings.lost_below:
            return self.after_miss(settings)
        mean = cost_mm if self.mean_cost_mm == 0.0 else self.mean_cost_mm
        baseline = cost_mm if self.baseline_cost_mm == 0.0 else self.baseline_cost_mm
        baseline += min(_BASELINE_RISE_MM, _BASELINE_GAIN * (cost_mm - baseline))
        after = replace(self, misses=0, lost=False, baseline_cost_mm=baseline)
        if not self.is_above_baseline(cost_mm):
            after = replace(after, retry_wait=0, next_retry_wait=1)
        if self.is_far_above_mean(cost_mm):
            return after
        after = replace(after, mean_cost_mm=mean + _MEAN_GAIN * (cost_mm - mean))
        if cost_mm > settings.doubt_above_mm:
            return after
        return replace(after, search_wait=0, next_search_wait=max(1, self.next_search_wait // 2))

    def after_miss(self, settings: StatusSettings, frames: int = 1) -> TrackMonitor:
        """Return the record after a frame without a fit, which counts as several after a gap."""
        misses = self.misses + frames
        return replace(self, misses=misses, lost=self.lost or misses >= settings.lost_after_frames)


def _far_above(baseline_mm: float, settings: StatusSettings) -> float:
    """Return the cost that is far above a baseline, mm."""
    return max(settings.doubt_above_mm, _FAR_FACTOR * baseline_mm + _POOR_MM)


class Decision(NamedTuple):
    """What to do with a frame.

    Attributes:
        monitor: the record from here on.
        candidate: refit the frame from this hand; None keeps the fit.
        restart: start a new track at the candidate instead of continuing this one.
    """

    monitor: TrackMonitor
    candidate: Candidate | None = None
    restart: bool = False


class TrackedFrame(NamedTuple):
    """A fitted frame of a tracked hand.

    Attributes:
        monitor: the record before the frame.
        depth: (height, width) mm, the image.
        observation: the window around the prediction.
        fits: of that window.
        expected: (6,) predicted inner numbers.
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

    @property
    def total_cost(self) -> float:
        """Cost with the penalties of the place, mm: comparable with ``Candidate.total_cost``."""
        return self.fits.cost - self.monitor.finger_bonus_mm + depth_penalty(float(self.pose[2]))


class Policy:
    """Decides whether to keep a frame's fit, refit it from a better candidate, or restart elsewhere.

    Args:
        settings: limits of doubt and loss.
        anatomy: the hand.
        finder: search without a prediction.
        observer: cuts out windows.
        alone: whether to search whole images; with other hands in them, their tracker does.
    """

    def __init__(
        self,
        settings: StatusSettings,
        anatomy: HandAnatomy,
        finder: Acquisition,
        observer: Observer,
        *,
        alone: bool = True,
    ) -> None:
        self._settings, self._anatomy = settings, anatomy
        self._finder, self._observer, self._alone = finder, observer, alone

    def decide_lost(
        self, monitor: TrackMonitor, depth: ImageArray, hands: Sequence[KeypointHand]
    ) -> Decision:
        """Search the whole image (height, width), mm, for a lost hand, or during a pause only keypoints.

        Without a candidate the frame is a miss.
        """
        from_keypoints = fit_candidates(self._finder, depth, hands)
        if monitor.search_wait > 0 or not self._alone:
            candidate = best_candidate(from_keypoints, monitor.accept_below_mm)
            otherwise = monitor.after_search_wait()
        else:
            candidate = self._finder.search(depth, from_keypoints)
            otherwise = monitor.after_failed_search(np.inf)
        return Decision(otherwise) if candidate is None else Decision(monitor, candidate, restart=True)

    def decide_tracked(self, frame: TrackedFrame, elsewhere: Sequence[KeypointHand] | None) -> Decision:
        """Decide on a fitted frame.

        Args:
            frame: the fitted frame.
            elsewhere: hands that keypoints show at other places; None without keypoints.
        """
        if frame.observation.hidden > MOSTLY_HIDDEN:
            return Decision(frame.monitor)
        if elsewhere is not None:
            decision = self._compare_keypoints(frame, elsewhere)
            if decision is not None:
                return decision
        monitor, cost = frame.monitor, frame.fits.cost
        if not monitor.is_doubtful(cost, self._settings):
            return self._retry_in_place(frame)
        if monitor.skips_search(cost):
            return self._retry_in_place(frame._replace(monitor=monitor.after_search_wait()))
        return self._search(frame)

    def decide_after_gap(self, frame: TrackedFrame) -> Decision:
        """Decide on a frame after a gap **[ours]**: the hand may be anywhere, the cheapest place counts."""
        monitor = replace(frame.monitor, better_elsewhere=0, search_wait=0)
        candidate = self._in_image(frame)
        if candidate is None or candidate.cost > frame.fits.cost - _AFTER_GAP_MM:
            return Decision(monitor)
        return Decision(monitor, candidate, restart=True)

    def _compare_keypoints(self, frame: TrackedFrame, hands: Sequence[KeypointHand]) -> Decision | None:
        """Compare the track with hands from keypoints; None leaves the frame to the next steps."""
        before = frame.monitor
        is_doubtful = before.is_doubtful(frame.fits.cost, self._settings)
        candidate = best_candidate(fit_candidates(self._finder, frame.depth, hands))
        monitor = replace(before, better_elsewhere=0)
        if candidate is not None:
            # twice the margin is needed to leave a track that fits well
            here = frame.total_cost - (0.0 if is_doubtful else SWITCH_MARGIN_MM)
            monitor = before.after_elsewhere(here, candidate.total_cost)
        if monitor.better_elsewhere <= before.better_elsewhere and is_doubtful:
            return None
        # a frame that fits resets the count here: no later step would search elsewhere
        if candidate is not None and monitor.better_elsewhere >= LEAVE_AFTER_SEARCHES:
            return Decision(monitor, candidate, restart=True)
        return Decision(monitor)

    def _search(self, frame: TrackedFrame) -> Decision:
        """Search the window for a hand that looks alike and, if that does not help, the whole image."""
        monitor, cost = frame.monitor, frame.fits.cost
        bar = Bar(monitor.limit_mm(cost), frame.total_cost - SWITCH_MARGIN_MM)
        candidate = self._finder.reconsider(frame.observation, frame.pose, bar.cost)
        if candidate is None or monitor.is_doubtful(candidate.cost, self._settings):
            in_image = self._in_image(frame, bar)  # the window itself may be wrong
            if in_image is None or self._is_near(in_image.pose, frame.pose):
                candidate = cheaper_of(candidate, in_image)
                monitor = replace(monitor, better_elsewhere=0)
            else:
                monitor = monitor.after_elsewhere(*self._total_costs(frame, in_image))
                if monitor.better_elsewhere >= LEAVE_AFTER_SEARCHES:
                    return Decision(monitor, in_image, restart=True)
        if candidate is not None and monitor.prefers(cost, candidate.cost):
            return Decision(monitor, candidate)
        return Decision(monitor.after_failed_search(cost))

    def _retry_in_place(self, frame: TrackedFrame) -> Decision:
        """Retry a fit above the baseline in a window around the fitted pose.

        A hand that turns or opens fast leaves the reach of its prediction. With a model of another shape that
        costs little: two fingers fitted to one are 2 mm of 10. So a fit that faces the same way replaces this
        one for a small gain; palm and back are exchanged only for a large one.
        """
        monitor, cost, pose = frame.monitor, frame.fits.cost, frame.pose
        if cost <= self._settings.retry_above_mm or not monitor.is_above_baseline(cost):
            return Decision(monitor)
        if monitor.skips_retry(cost):
            return Decision(monitor.after_retry_wait())
        # the window around the prediction may have cut fingers off
        window = self._observer.observe(frame.depth, pose, frame.expected)
        bar = Bar(max(monitor.limit_mm(cost), cost - _SAME_FACING_MARGIN_MM))
        candidate = self._finder.reconsider(window, pose, bar.cost)
        if not self._helps(candidate, frame) and monitor.is_far_above_baseline(cost, self._settings):
            in_image = self._in_image(frame, bar, around=pose)
            candidate = in_image if in_image is not None and self._faces_alike(in_image.pose, pose) else None
        helped = self._helps(candidate, frame)
        return Decision(monitor.after_retry(cost, helped=helped), candidate if helped else None)

    def _helps(self, candidate: Candidate | None, frame: TrackedFrame) -> bool:
        """Return whether a candidate is enough better than a poor fit to replace it."""
        cost = frame.fits.cost
        if candidate is None:
            return False
        is_better = candidate.cost < cost - _SAME_FACING_MARGIN_MM
        return frame.monitor.prefers(cost, candidate.cost) or (
            is_better and self._faces_alike(candidate.pose, frame.pose)
        )

    def _in_image(
        self, frame: TrackedFrame, bar: Bar = NO_BAR, around: FloatArray | None = None
    ) -> Candidate | None:
        """Return the best hand of the whole image, or of those around a pose (22,)."""
        return self._finder.search(frame.depth, bar=bar, around=around) if self._alone else None

    def _faces_alike(self, pose: FloatArray, other: FloatArray) -> bool:
        """Return whether two poses (22,) are at one place and face the same way."""
        first, second = (rotations.rotate(one[3:7], np.array([0.0, 0.0, 1.0])) for one in (pose, other))
        return self._is_near(pose, other) and bool(first @ second > _SAME_FACING_COSINE)

    def _is_near(self, pose: FloatArray, other: FloatArray) -> bool:
        return joint_set_distance(self._anatomy, pose, other) < NEAR_MM

    def _total_costs(self, frame: TrackedFrame, candidate: Candidate) -> tuple[float, float]:
        """Return total costs of the track and of a candidate, mm.

        At one place the costs alone decide: the fingers seen there belong to both.
        """
        if joint_set_distance(self._anatomy, candidate.pose, frame.pose) < SAME_PLACE_MM:
            return frame.fits.cost, candidate.cost
        return frame.total_cost, candidate.total_cost


def status_of(*, is_tracked: bool, is_restarted: bool) -> Status:
    """Return the status of an estimate: lost unless tracked, reinitialised where the track restarted."""
    if not is_tracked:
        return Status.LOST
    return Status.REINITIALISED if is_restarted else Status.TRACKING
