"""State of the hand tracker between frames, and its checkpoint codec."""

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
        monitor: record of the track's quality.
        expected: inner numbers (``hand.fit.skeleton``) predicted for the next frame, apart from the forearm's
            direction, which is taken from the image.
        frames, doubtful: number of frames with an observation, and of those that are probably wrong.
        unseen_ns: time since the last frame with an observation.
        dt: seconds that the filter advanced to this frame; 0 if it did not move.
        cut: whether the state does not follow from that of the previous frame.
        evidence: running signs of the confidence.
        modes: local fits to the frame, None without any; for smoothing only, not in checkpoints.
        observation: window of the frame; likewise.
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


class FrameFit(NamedTuple):
    """A frame as fitted, before the filter's update.

    Attributes:
        state: before the frame; a new one if the hand was found elsewhere.
        dt: seconds to advance by.
        observation: None without target pixels.
        fits: local fits; None without a guided proposal.
        restarted: True if the track was reinitialised in this frame.
        hidden: share of the hand behind another hand.
    """

    state: HandState
    dt: float
    observation: Observation | None
    fits: LocalFits | None = None
    restarted: bool = False
    hidden: float = 0.0

    @property
    def inner(self) -> FloatArray:
        """Return the inner numbers (6,) of the frame's estimate."""
        return self.state.expected if self.observation is None else self.observation.inner


class FrameAssessment(NamedTuple):
    """Assessment of an estimate against its frame.

    Attributes:
        cost: of the estimate, mm; None without an observation.
        monitor: the record after the frame.
        evidence: running signs of the confidence.
        confidence: 0 to 1.
        is_tracked: whether the frame shows the hand.
    """

    cost: float | None
    monitor: TrackMonitor
    evidence: RunningSigns
    confidence: float
    is_tracked: bool


def state_codec(config: HandConfig) -> Codec[HandState]:
    """Return the codec of the tracker's states."""
    kind, count = FILTERS.find(config.filter.kind), config.filter.particles
    layouts = _particle_layouts(count)
    particles = Fields(kind, **{name: Value[FloatArray](layouts[name]) for name in kind.shapes})
    return codec_of(HandState, particles=particles)


def _particle_layouts(count: int) -> dict[str, Layout]:
    """Return the array layouts of ``count`` particles, for all filters."""
    return {
        "poses": pose_layout(count),
        "velocities": floats(count, TANGENT_SIZE),
        "velocity_variance": floats(TANGENT_SIZE, least=0.0),
        "log_weights": floats(count, least=-np.inf),
    }
