"""What the hand tracker knows between frames, and how checkpoints keep it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.filters import FILTERS, FilterState
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.hand.confidence import NO_EVIDENCE, SIGN_NAMES
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.local_fits import LocalFits
from posetrack_cli.hand.fit.skeleton import INNER_SIZE, NO_INNER
from posetrack_cli.hand.model.anatomy import TANGENT_SIZE
from posetrack_cli.hand.model.hand import pose_layout
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.policy import TrackMonitor
from posetrack_cli.results.columns import STAMPS_NS, Layout, Stamp, counts, floats
from posetrack_cli.tracking.confidence import RunningSigns, signs_codec
from posetrack_cli.tracking.state_codec import NOT_KEPT, Codec, Fields, Value, codec_of


@dataclass(frozen=True, eq=False)
class HandState:
    """Everything the next step needs.

    Attributes:
        particles: the filter's state.
        stamp_ns: of the last frame.
        pose: last estimate.
        velocity: last estimate of the tangent velocity, mm/s and rad/s.
        monitor: how well frames were fitted.
        expected: inner numbers (``hand.fit.skeleton``) that the next frame is expected to have, but for
            the forearm's direction, which its image tells.
        frames, doubtful: how many showed anything to compare with, and how many of them are more probably
            wrong than right.
        unseen_ns: time since the last frame in which there was something to compare with.
        dt: seconds that the filter advanced by to this frame; 0 if it stood still.
        cut: whether the state does not follow from that of the frame before.
        evidence: of whether the track is right.
        modes: local fits to the frame; None without any. No step needs them, and no checkpoint has them.
        observation: what was seen of the frame; the same holds of it.
    """

    particles: FilterState
    stamp_ns: Stamp
    pose: Annotated[FloatArray, pose_layout()]
    velocity: Annotated[FloatArray, floats(TANGENT_SIZE)]
    monitor: TrackMonitor = field(default_factory=TrackMonitor)
    expected: Annotated[FloatArray, floats(INNER_SIZE)] = field(default_factory=NO_INNER.copy)
    frames: int = 0
    doubtful: int = 0
    unseen_ns: Annotated[int, counts(most=STAMPS_NS[1])] = 0
    dt: Annotated[float, NOT_KEPT] = 0.0
    cut: Annotated[bool, NOT_KEPT] = False
    evidence: Annotated[RunningSigns, signs_codec(len(SIGN_NAMES))] = NO_EVIDENCE
    modes: Annotated[LikelihoodModes | None, NOT_KEPT] = None
    observation: Annotated[Observation | None, NOT_KEPT] = None


class FrameObservation(NamedTuple):
    """What is known of a frame before the filter takes it in.

    Attributes:
        state: before the frame; another one if the hand was found to be elsewhere.
        dt: seconds to advance by.
        observation: None where there is nothing to compare with.
        fits: local fits to it; None without a guided proposal.
        restarted: whether the state is about a hand that was found without a prediction.
    """

    state: HandState
    dt: float
    observation: Observation | None
    fits: LocalFits | None = None
    restarted: bool = False

    @property
    def inner(self) -> FloatArray:
        """The inner numbers (6,) of the frame's estimate."""
        return self.state.expected if self.observation is None else self.observation.inner


class Judgement(NamedTuple):
    """How well a frame shows the hand at an estimate.

    Attributes:
        cost: of the estimate, mm; None where there was nothing to compare with.
        monitor: the record after the frame.
        evidence: of whether the track is right.
        confidence: 0 to 1.
        is_believed: whether the hand is there.
    """

    cost: float | None
    monitor: TrackMonitor
    evidence: RunningSigns
    confidence: float
    is_believed: bool


def state_codec(config: HandConfig) -> Codec[HandState]:
    """Return how the tracker's states are kept; local fits and what was seen of a frame are not."""
    kind, count = FILTERS.find(config.filter.kind), config.filter.particles
    layouts = _particle_layouts(count)
    particles = Fields(kind, **{name: Value[FloatArray](layouts[name]) for name in kind.shapes})
    return codec_of(HandState, particles=particles)


def _particle_layouts(count: int) -> dict[str, Layout]:
    """What the arrays of ``count`` particles must be, for any filter."""
    return {
        "poses": pose_layout(count),
        "velocities": floats(count, TANGENT_SIZE),
        "velocity_variance": floats(TANGENT_SIZE, least=0.0),
        "log_weights": floats(count, least=-np.inf),
    }
