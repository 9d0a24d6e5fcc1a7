"""Tracker of a person's two hands: one tracker per hand, each without what the other explains."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Annotated

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.skeleton import INNER_SIZE
from posetrack_cli.hand.observe.observation import PixelSampler
from posetrack_cli.hand.observe.others import HandDrawer, SeenHand, without_others
from posetrack_cli.hand.search import cheapest_pair
from posetrack_cli.hand.state import HandState
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import Window
from posetrack_cli.results.columns import floats
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.confidence import PROBABLY
from posetrack_cli.tracking.state_codec import Codec, Fields, codec_of


@dataclass(frozen=True, eq=False)
class PairState:
    """State of both trackers.

    Attributes:
        hands: states of the trackers.
        inner: (2, 6) inner numbers of the last frame, without a forearm if none was visible.
        confidence: (2,) of the last frame.
    """

    hands: tuple[HandState, HandState]
    inner: Annotated[FloatArray, floats(2, INNER_SIZE)]
    confidence: Annotated[FloatArray, floats(2)]


def pinhole(camera: Camera) -> Camera:
    """Return a camera without its lens distortion."""
    return replace(camera, distortion=()) if camera.is_distorted else camera


def _state_of(hands: Iterable[HandState]) -> PairState:
    first, second = hands
    return PairState((first, second), np.array([first.expected, second.expected]), np.zeros(2))


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
        seen = self._with_candidates([self._predicted(k, state, frame) for k in (0, 1)], state, frame.depth)
        states, inner, confidence = list(state.hands), state.inner.copy(), state.confidence.copy()
        estimates: dict[int, Estimate] = {}
        for k in sorted((0, 1), key=lambda k: _depth_mm(seen[k])):
            other = seen[1 - k]
            depth = without_others(frame.depth, seen[k], () if other is None else (other,), self._camera)
            after, estimates[k] = self.trackers[k].step(states[k], replace(frame, images=(depth,)), rng)
            states[k], confidence[k] = after, estimates[k].confidence
            inner[k] = after.expected if after.observation is None else after.observation.inner
            seen[k] = None
            if not after.monitor.lost:
                seen[k] = SeenHand(self._drawers[k], after.pose, inner[k], bool(confidence[k] >= PROBABLY))
        after_both = PairState((states[0], states[1]), inner, confidence)
        return after_both, tuple(estimates[k] for k in range(self._reported))

    def _predicted(self, k: int, state: PairState, frame: Frame) -> SeenHand | None:
        """Return a hand at its predicted place; None if it is lost."""
        hand, tracker = state.hands[k], self.trackers[k]
        if hand.monitor.lost:
            return None
        dt = min((frame.stamp_ns - hand.stamp_ns) * 1e-9, tracker.config.motion.gap_max_s)
        is_sure = bool(state.confidence[k] >= PROBABLY)
        return SeenHand(self._drawers[k], tracker.predict(hand, dt), state.inner[k], is_sure)

    def _with_candidates(
        self, seen: list[SeenHand | None], state: PairState, depth: ImageArray
    ) -> list[SeenHand | None]:
        """Return the hands with places for two lost ones, so that each searches without the other's.

        Alone, a right hand's model would also fit the left hand. Of all pairs of places, the cheapest counts.
        """
        if any(one is not None for one in seen) or any(hand.monitor.search_wait for hand in state.hands):
            return seen
        best = cheapest_pair(*(tracker.candidates(depth) for tracker in self.trackers))
        return [
            None if one is None else SeenHand(drawer, one.pose, one.inner)
            for drawer, one in zip(self._drawers, best, strict=True)
        ]


def _depth_mm(hand: SeenHand | None) -> float:
    return np.inf if hand is None else float(hand.pose[2])
