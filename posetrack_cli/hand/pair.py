"""Tracker of a person's two hands: one tracker per hand, each without what the other explains."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Annotated

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.skeleton import INNER_SIZE
from posetrack_cli.hand.model.kinematics import joint_set_distance
from posetrack_cli.hand.observe.observation import PixelSampler
from posetrack_cli.hand.observe.others import HandDrawer, SeenHand, without_others
from posetrack_cli.hand.policy import MOSTLY_HIDDEN, SAME_PLACE_MM
from posetrack_cli.hand.search import (
    ACCEPT_MM,
    LIKELY_PAIR_MM,
    Candidate,
    cheapest_pair,
    lead_of,
    least_cost_at,
)
from posetrack_cli.hand.state import HandState
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import Window
from posetrack_cli.results.columns import counts, floats
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.confidence import PROBABLY
from posetrack_cli.tracking.state_codec import Codec, Fields, codec_of

_BOTH = (0, 1)
_SEARCH_FRAMES = 4
"""A hand that is not where it is expected is searched in every so many frames."""
_BOTH_AFTER_FRAMES = 12
"""After so many frames without one hand, both are searched: what the other one explains may be wrong."""
_MAX_COST_RATIO = 1.5
"""Largest cost of a hand that is found again, relative to good fits: an elbow or a forearm costs more."""
_LEAD_MM = 1.0
"""By how much a pair has to cost less than the exchanged one: with the right shape, pairs lead by 2.7 mm or
more and lone hands by 1.3 mm."""
_MET_MM, _APART_FRAMES = 80.0, 8
"""Distance of wrists that have met, and frames after which the sides of hands that met are compared."""


@dataclass(frozen=True, eq=False)
class PairState:
    """State of both trackers.

    Attributes:
        hands: states of the trackers.
        inner: (2, 6) inner numbers of the last frame, without a forearm if none was visible.
        unsure: (2,) frames in a row in which a hand was probably elsewhere or lost.
        compare_in: frames until the sides are compared, after the hands met; 0 = never.
    """

    hands: tuple[HandState, HandState]
    inner: Annotated[FloatArray, floats(2, INNER_SIZE)]
    unsure: Annotated[IntArray, counts(2)]
    compare_in: int = _APART_FRAMES

    def is_sure(self, k: int) -> bool:
        """Return whether a hand is probably where its track is."""
        return not self.hands[k].monitor.lost and int(self.unsure[k]) == 0


def pinhole(camera: Camera) -> Camera:
    """Return a camera without its lens distortion."""
    return replace(camera, distortion=()) if camera.is_distorted else camera


def _state_of(hands: Iterable[HandState]) -> PairState:
    first, second = hands
    return PairState((first, second), np.array([first.expected, second.expected]), np.zeros(2, np.int64))


class PairTracker:
    """Tracks two hands.

    Args:
        trackers: of the hands, for pinhole images.
        drawers: of the hands, likewise.
        camera: of the depth images; lens distortion is removed here.
        reported: number of hands with an estimate, the first ones.
    """

    def __init__(
        self,
        trackers: Sequence[HandTracker],
        drawers: Sequence[HandDrawer],
        camera: Camera,
        reported: int = 2,
    ) -> None:
        self.trackers, self._drawers, self._reported = tuple(trackers), tuple(drawers), reported
        self._camera = pinhole(camera)
        self._sampler = PixelSampler(camera) if camera.is_distorted else None
        codecs = (tracker.codec for tracker in self.trackers)
        first, second = ((itemgetter(k), codec) for k, codec in enumerate(codecs))
        hands = Fields(lambda first, second: (first, second), first=first, second=second)
        self.codec: Codec[PairState] = codec_of(PairState, hands=hands)

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> PairState:
        """Return the state with both hands around a pose (22,)."""
        return _state_of(tracker.start(pose, stamp_ns, rng) for tracker in self.trackers)

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> PairState:
        """Return the state before a first frame in which both hands are to be detected."""
        return _state_of(tracker.start_unknown(pose, frame, rng) for tracker in self.trackers)

    def step(
        self, state: PairState, frame: Frame, rng: np.random.Generator
    ) -> tuple[PairState, tuple[Estimate, ...]]:
        """Advance both trackers by one frame, the hand nearer to the camera first."""
        if self._sampler is not None:
            whole = Window(0, 0, 1, self._camera.width, self._camera.height)
            frame = replace(frame, images=(self._sampler.sample(frame.depth, whole),))
        seen = [self._predicted(k, state, frame) for k in _BOTH]
        found = self._found(state, seen, frame.depth)
        for k, one in enumerate(found):
            if (at := self._seen_at(k, one)) is not None:
                seen[k] = replace(at, is_sure=not state.is_sure(1 - k))
        states, inner, unsure = list(state.hands), state.inner.copy(), state.unsure.copy()
        estimates: dict[int, Estimate] = {}
        for k in sorted(_BOTH, key=lambda k: _depth_mm(seen[k])):
            other = seen[1 - k]
            depth = without_others(frame.depth, seen[k], () if other is None else (other,), self._camera)
            after, estimates[k] = self.trackers[k].step(
                _with_common_baseline(states[k], states[1 - k]),
                replace(frame, images=(depth,)),
                rng,
                found[k],
            )
            is_sure = estimates[k].confidence >= PROBABLY
            states[k], unsure[k] = after, 0 if is_sure else unsure[k] + 1
            inner[k] = after.expected if after.observation is None else after.observation.inner
            seen[k] = SeenHand(self._drawers[k], after.pose, inner[k], is_sure)
            if after.monitor.lost:
                seen[k] = None
        compare_in = _APART_FRAMES if _have_met(states) else max(0, state.compare_in - 1)
        after_both = PairState((states[0], states[1]), inner, unsure, compare_in)
        return after_both, tuple(estimates[k] for k in range(self._reported))

    def _predicted(self, k: int, state: PairState, frame: Frame) -> SeenHand | None:
        """Return a hand at its predicted place; None if it is lost."""
        hand, tracker = state.hands[k], self.trackers[k]
        if hand.monitor.lost:
            return None
        dt = min((frame.stamp_ns - hand.stamp_ns) * 1e-9, tracker.config.motion.gap_max_s)
        return SeenHand(self._drawers[k], tracker.predict(hand, dt), state.inner[k], state.is_sure(k))

    def _found(
        self, state: PairState, seen: Sequence[SeenHand | None], depth: ImageArray
    ) -> list[Candidate | None]:
        """Return where unsure hands are, if they are not at their predicted places.

        If neither is sure, one was not found for long, or both have met, both are searched: of all pairs of
        places, the cheapest counts, if exchanged hands cost more. Then a hand is searched without what the
        other one explains: alone, a right hand's model would also fit the left one.
        """
        found: list[Candidate | None] = [None, None]
        turn = [k for k in _BOTH if not state.is_sure(k) and state.unsure[k] % _SEARCH_FRAMES == 0]
        is_long = any(state.unsure[k] and state.unsure[k] % _BOTH_AFTER_FRAMES == 0 for k in turn)
        if is_long or state.compare_in == 1 or (turn and not any(state.is_sure(k) for k in _BOTH)):
            places = self._places(depth)
            best_pair = cheapest_pair(*places)
            if lead_of(best_pair, *places) > _LEAD_MM:
                found = [
                    self._accepted(k, one, state, depth, best_pair[1 - k]) for k, one in enumerate(best_pair)
                ]
            if None in found:  # a sure hand moves only together with the other one
                found = [None if state.is_sure(k) else one for k, one in enumerate(found)]
        for k in turn:
            other = self._seen_at(1 - k, found[1 - k]) or seen[1 - k]
            if found[k] is None and other is not None and other.is_sure:
                found[k] = self._found_alone(k, state, without_others(depth, None, (other,), self._camera))
        return found

    def _places(self, depth: ImageArray) -> list[list[Candidate]]:
        """Return the candidates of both hands, with either hand at every place of the other one.

        A search that misses a hand at a place would otherwise leave the place to the other side.
        """
        found = [tracker.candidates(depth) for tracker in self.trackers]
        missed = ([one for one in found[1 - k] if least_cost_at(one, found[k]) == ACCEPT_MM] for k in _BOTH)
        return [
            known + [other for one in places if (other := tracker.lookalike(depth, one)) is not None]
            for tracker, known, places in zip(self.trackers, found, missed, strict=True)
        ]

    def _found_alone(self, k: int, state: PairState, rest: ImageArray) -> Candidate | None:
        """Return a hand in an image without the other one, unless the other side fits as well: an arm."""
        best = min(self.trackers[k].candidates(rest), key=lambda one: one.total_cost, default=None)
        best = self._accepted(k, best, state, rest, None)
        if best is None:
            return None
        exchanged = self.trackers[1 - k].lookalike(rest, best)
        return best if exchanged is None or exchanged.cost > best.cost + _LEAD_MM else None

    def _seen_at(self, k: int, found: Candidate | None) -> SeenHand | None:
        return None if found is None else SeenHand(self._drawers[k], found.pose, found.inner)

    def _accepted(
        self, k: int, found: Candidate | None, state: PairState, depth: ImageArray, other: Candidate | None
    ) -> Candidate | None:
        """Return a candidate if it is a visible hand, elsewhere than the hand's track.

        Its cost is compared with good fits in the recording, as far as these are known, and with the other
        hand's candidate.
        """
        hand, tracker = state.hands[k], self.trackers[k]
        levels = [tracker.config.status.baseline_cost_mm]
        levels += [one.monitor.baseline_cost_mm for one in state.hands]
        is_known = any(level > 0.0 for level in levels)
        if found is None or not (is_known or found.cautious_cost < LIKELY_PAIR_MM):
            return None
        ratio = max(one.monitor.cost_ratio(found.cost, tracker.config.status) for one in state.hands)
        ratio = max(ratio, 1.0 if other is None else found.cost / other.cost)
        is_hand = ratio < _MAX_COST_RATIO and tracker.visible_share(depth, found) > 1.0 - MOSTLY_HIDDEN
        is_elsewhere = joint_set_distance(tracker.anatomy, found.pose, hand.pose) > SAME_PLACE_MM
        return found if is_hand and (hand.monitor.lost or is_elsewhere) else None


def _with_common_baseline(hand: HandState, other: HandState) -> HandState:
    """Return a hand whose good fits cost little more than the other's: both have one shape."""
    levels = hand.monitor.baseline_cost_mm, _MAX_COST_RATIO * other.monitor.baseline_cost_mm
    baseline_mm = min((level for level in levels if level > 0.0), default=0.0)
    return replace(hand, monitor=replace(hand.monitor, baseline_cost_mm=baseline_mm))


def _have_met(hands: Sequence[HandState]) -> bool:
    """Return whether hands are so close, or one so hidden, that trackers may exchange them."""
    is_hidden = any(one.observation is None or one.observation.hidden > MOSTLY_HIDDEN for one in hands)
    return is_hidden or bool(np.linalg.norm(hands[0].pose[:3] - hands[1].pose[:3]) < _MET_MM)


def _depth_mm(hand: SeenHand | None) -> float:
    return np.inf if hand is None else float(hand.pose[2])
