"""The hand tracker: one frame in, the next state and an estimate out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.filters import FILTERS, FilterState, Prior
from posetrack_cli.filtering.model import Dynamics, FilterModel, LogLikelihood
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import Posterior
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.acquisition import Acquisition, Candidate, better_of, depth_doubt, fingers_bonus
from posetrack_cli.hand.anatomy import POSE_SIZE, TANGENT_SIZE, HandAnatomy
from posetrack_cli.hand.confidence import (
    NO_EVIDENCE,
    SIGN_NAMES,
    probability,
    signs_of,
    with_model_error,
)
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.inner import INNER_SIZE, LOG_GIRTH, NO_INNER, RELAXED_INNER, THUMB
from posetrack_cli.hand.keypoints.told import ToldHand, ToldHands, candidates, likeliest, split
from posetrack_cli.hand.kinematics import joint_set_distance, mean_joint_distances
from posetrack_cli.hand.likelihood import PoseScorer
from posetrack_cli.hand.local_fits import LocalFits
from posetrack_cli.hand.monitor import TrackMonitor
from posetrack_cli.hand.observation import Observation
from posetrack_cli.hand.observer import Observer, Outline
from posetrack_cli.hand.proposals import PROPOSALS
from posetrack_cli.hand.protocol import found_pose, hand_estimate
from posetrack_cli.hand.space import inside_limits, pose_layout, space_of, tangent_vector
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.layouts import STAMPS_NS, Layout, floats
from posetrack_cli.tracking.confidence import PROBABLY, RunningSigns, signs_codec
from posetrack_cli.tracking.state_codec import Codec, Fields, Value, flag, real, stamp, whole

# The prior holds one usual frame before the first one, so the first frame is a step like all others.
FIRST_STEP_NS = 33_333_333
_GIRTH_MEMORY = 0.1  # share of a new frame in the running mean of the forearm's girth
THUMB_MEMORY = 0.4  # share of a thumb's departure from RELAXED_INNER that is expected of the next frame
NEAR_MM = 35.0  # distance of two sets of joints, up to which a better fit is of the hand that is tracked
SAME_PLACE_MM = 60.0
"""Up to here two hands are at one place **[ours]**: an adult's that is taken end for end, with its fingers
along the forearm, is 40 to 55 mm off, the other end of an arm 150 and more."""
_BETTER_MM = 0.4  # what another fold of fingers is cheaper by, at least, of a hand that faces the same way
_FACES_ALIKE = np.cos(np.deg2rad(60.0))


@dataclass(frozen=True, eq=False)
class HandState:
    """Everything the next step needs.

    Attributes:
        particles: the filter's state.
        stamp_ns: of the last frame.
        pose: (22,) last estimate.
        velocity: (21,) last estimate of the tangent velocity, mm/s and rad/s.
        monitor: how well frames were fitted.
        expected: (6,) inner numbers (``hand.inner``) that the next frame is expected to have, but for the
            forearm's direction, which its image tells.
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
    stamp_ns: int
    pose: FloatArray
    velocity: FloatArray
    monitor: TrackMonitor = field(default_factory=TrackMonitor)
    expected: FloatArray = field(default_factory=NO_INNER.copy)
    frames: int = 0
    doubtful: int = 0
    unseen_ns: int = 0
    dt: float = 0.0
    cut: bool = False
    evidence: RunningSigns = NO_EVIDENCE
    modes: LikelihoodModes | None = None
    observation: Observation | None = None


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


class HandTracker:
    """Tracks one hand with a Rao-Blackwellized or a plain particle filter.

    Args:
        config: parameters.
        anatomy: the hand.
        scorer: the likelihood.
        observer: cuts out and segments windows.
        finder: local fits, and the search for a hand of which no pose is known. The guided proposal asks it
            in every frame, others for the start alone; annealing takes the anatomy's potential from it.
        told: hands that keypoints from elsewhere tell of, for a proposal that fits frames; None for none.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        scorer: PoseScorer,
        observer: Observer,
        finder: Acquisition | None = None,
        told: ToldHands | None = None,
    ) -> None:
        self.config, self.anatomy, self._told = config, anatomy, told
        self.scorer, self._observer, self._start_finder = scorer, observer, finder
        self._proposal = PROPOSALS.find(config.filter.proposal)
        self._finder = finder if self._proposal.fits_frames else None
        plausible = finder is not None and self._proposal.looks_at_frames
        self._fitter = finder.local_fitter.fitter if finder is not None and plausible else None
        self._is_calibrated = self._finder is not None and config.observation.models_pixels
        self._space, self.dynamics = space_of(config.filter), dynamics(config)
        resampling = Resampling(config.filter.resampling, config.filter.ess_threshold)
        self._model = FilterModel(self.dynamics, self._space, resampling, self._proposal.sampling)
        self.codec = state_codec(config)

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> HandState:
        """Return the prior about a pose (22,): one usual frame before the first frame's stamp."""
        settings, init = self.config.filter, self.config.init
        prior = Prior(pose, tangent_vector(init.spread), tangent_vector(init.velocity))
        particles = FILTERS.find(settings.kind).initial(prior, settings.particles, self._space, rng)
        expected = NO_INNER if self._finder is None else RELAXED_INNER
        return HandState(
            particles, stamp_ns - FIRST_STEP_NS, pose, np.zeros(TANGENT_SIZE), expected=expected.copy()
        )

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> HandState:
        """Return the state before a first frame in which the hand has yet to be found.

        Until it is, it is reported as lost at a pose (22,). Proposals that fit no frames find it in the first
        frame or start at the pose.
        """
        if self._finder is not None:
            lost = TrackMonitor(lost=True, found=False)
            return replace(self.start(pose, frame.stamp_ns, rng), monitor=lost)
        return self.start(found_pose(self._start_finder, frame, pose), frame.stamp_ns, rng)

    def step(self, state: HandState, frame: Frame, rng: np.random.Generator) -> tuple[HandState, Estimate]:
        """Advance by one frame; the state given is left as it is.

        The confidence is the probability that the estimate is right (``hand.confidence``), of other proposals
        and costs 1 - D / c_max of the estimate's own cost D; and 0 where the frame shows no outline of a hand
        there, which is lost at once, as is what is more probably wrong than right. After frames of a high D a
        hand is lost if it was never seen, or after several. **[ours]** No gap counts for longer than
        ``gap_max_s``, whether frames are missing or have nothing to compare with: the velocity's random walk
        would else spread the hand over metres. Particles then stay where they are until something is seen.

        Raises:
            FilterError: stamps do not increase.
        """
        elapsed_ns = frame.stamp_ns - state.stamp_ns
        check_time_step(elapsed_ns * 1e-9)
        seen = self._observe(state, frame, min(elapsed_ns * 1e-9, self.config.motion.gap_max_s), rng)
        particles, posterior, drawn = self._filter(seen, rng)
        scores = (
            None if seen.observation is None else self.scorer.costs(posterior.pose[None], seen.observation)
        )
        cost = None if scores is None else float(scores[0])
        inner = _inner_of(seen)
        outline = None if cost is None else self._observer.outline(frame.depth, posterior.pose, inner[THUMB])
        shown = (
            outline is not None
            and not (seen.observation is not None and seen.observation.reversed)
            and outline.shows_hand(is_known=seen.state.monitor.is_believed)
        )
        quality = self._quality(cost) if shown else 0.0
        monitor = self._monitored(seen, cost if shown else None, quality)
        evidence = self._evidence(seen, posterior.pose, monitor, cost, outline)
        confidence = probability(evidence) if quality and self._is_calibrated else quality
        unseen_ns = seen.state.unseen_ns + elapsed_ns if seen.observation is None else 0
        pose, velocity = posterior.pose, posterior.velocity
        new_state = HandState(
            particles,
            frame.stamp_ns,
            pose,
            velocity,
            monitor,
            _expected_after(seen),
            state.frames + int(seen.observation is not None),
            state.doubtful + int(seen.observation is not None and confidence < PROBABLY),
            unseen_ns,
            max(seen.dt, 0.0),
            seen.restarted,
            evidence,
        )
        modes = None if seen.fits is None else seen.fits.modes
        new_state = replace(new_state, modes=modes, observation=seen.observation)
        again = seen.restarted and state.monitor.found
        believed = shown and monitor.is_believed and not (self._is_calibrated and confidence < PROBABLY)
        status = Status.TRACKING if believed else Status.LOST
        status = Status.REINITIALISED if again and status == Status.TRACKING else status
        variance = posterior.pose_variance
        if self._is_calibrated:
            variance = with_model_error(variance, monitor.usual_mm)
        forearm = self._forearm_confidence(frame, pose, inner)
        estimate = self._estimate(
            frame, posterior, inner, evidence, forearm, variance, cost, confidence, status
        )
        return new_state, replace(estimate, evaluations=_evaluations(seen, drawn))

    def _observe(
        self, state: HandState, frame: Frame, dt: float, rng: np.random.Generator
    ) -> FrameObservation:
        """What the frame shows; where the hand is lost or doubtful, it is searched for elsewhere."""
        told = () if self._told is None else self._told.of(frame)
        if self._finder is not None and state.monitor.lost:
            return self._search(self._finder, state, frame, rng, told)
        predicted = self.predict(state, dt)
        observation = self._observer.observe(frame.depth, predicted, state.expected)
        if observation.target_pixels == 0:
            return FrameObservation(
                state, min(dt, self.config.motion.gap_max_s - state.unseen_ns * 1e-9), None
            )
        if self._finder is None or dt <= 0.0:
            return FrameObservation(state, dt, observation)
        fingers = fingers_bonus(self._observer.fingers_mm2(observation))
        state = replace(state, monitor=state.monitor.after_fingers(fingers))
        enough = state.monitor.sufficient_mm
        near, elsewhere = split(told, predicted, self.anatomy)
        if state.monitor.usual_mm > self.config.status.well_mm:  # a hand that fits well needs no more starts
            near = np.concatenate([near, self._finder.starts_of_fingers(observation)])
        fits = self._finder.local_fitter.fit(observation, predicted, state.pose[None], dt, rng, enough, near)
        seen = FrameObservation(state, dt, replace(observation, inner=fits.inner), fits)
        there = self._told_elsewhere(self._finder, seen, elsewhere, frame, rng)
        return there or self._reconsidered(self._finder, seen, frame, rng)

    def _search(
        self,
        finder: Acquisition,
        state: HandState,
        frame: Frame,
        rng: np.random.Generator,
        told: Sequence[ToldHand],
    ) -> FrameObservation:
        """Search the whole image for a lost hand, with ever longer pauses while it is not there.

        During a pause it is only looked for where keypoints tell of it.
        """
        there = candidates(finder, frame.depth, told)
        if state.monitor.wait > 0:
            found = likeliest(there, state.monitor.sufficient_mm)
            if found is not None:
                return self._restarted(finder, found, state.monitor, frame, rng)
            return FrameObservation(replace(state, monitor=state.monitor.after_wait()), 0.0, None)
        found = finder.search(frame.depth, there)
        if found is None:
            monitor = state.monitor.after_failed_search(np.inf, self.config.status)
            return FrameObservation(replace(state, monitor=monitor), 0.0, None)
        return self._restarted(finder, found, state.monitor, frame, rng)

    def _told_elsewhere(
        self,
        finder: Acquisition,
        seen: FrameObservation,
        told: Sequence[ToldHand],
        frame: Frame,
        rng: np.random.Generator,
    ) -> FrameObservation | None:
        """What is seen where keypoints tell of a better hand at another place; None where they do not.

        Told so in several frames in a row, the hand is there (``TrackMonitor.leaves_for``). A frame that fits
        and tells of nothing better ends the row: no search would.
        """
        if self._told is None or seen.fits is None:
            return None
        before, settings = seen.state.monitor, self.config.status
        is_doubtful = before.is_doubtful(seen.fits.cost, settings)
        there = likeliest(candidates(finder, frame.depth, told))
        monitor = replace(before, elsewhere=0)
        if there is not None:
            doubt = _doubt_here(seen.fits, before)
            doubt -= 0.0 if is_doubtful else settings.better_mm
            monitor = before.leaves_for(doubt, there.doubt, settings)
        if monitor.elsewhere <= before.elsewhere and is_doubtful:
            return None
        if there is not None and monitor.elsewhere >= settings.leave_after_frames:
            return self._restarted(finder, there, monitor, frame, rng)
        return seen._replace(state=replace(seen.state, monitor=monitor))

    def _reconsidered(
        self, finder: Acquisition, seen: FrameObservation, frame: Frame, rng: np.random.Generator
    ) -> FrameObservation:
        """Where the fit is bad, search for a hand that looks alike and fits far better, or is elsewhere."""
        state, settings, fits = seen.state, self.config.status, seen.fits
        if fits is None or seen.observation is None:
            return seen
        if not state.monitor.is_doubtful(fits.cost, settings):
            return self._looked_again(finder, seen, frame, rng)
        if state.monitor.postpones_search(fits.cost, settings):
            waited = seen._replace(state=replace(state, monitor=state.monitor.after_wait()))
            return self._looked_again(finder, waited, frame, rng)
        here, monitor = fits.modes.poses[0], state.monitor
        found = finder.reconsider(seen.observation, here)
        if found is None or monitor.is_doubtful(found.cost, settings):
            there = finder.search(frame.depth)  # the window may be misled, too
            if there is None or self._is_near(there.pose, here):
                found, monitor = better_of(found, there), replace(monitor, elsewhere=0)
            else:
                monitor = monitor.leaves_for(*self._doubts(fits, there, monitor), settings)
                if monitor.elsewhere >= settings.leave_after_frames:
                    return self._restarted(finder, there, monitor, frame, rng)
        seen = seen._replace(state=replace(state, monitor=monitor))
        if found is not None and monitor.prefers(fits.cost, found.cost, settings):
            return self._refined(finder, found, seen, frame, rng)
        refused = monitor.after_failed_search(fits.cost, settings)
        return seen._replace(state=replace(seen.state, monitor=refused))

    def _looked_again(
        self, finder: Acquisition, seen: FrameObservation, frame: Frame, rng: np.random.Generator
    ) -> FrameObservation:
        """Where the fit costs more than good ones of this recording, look for the hand anew where it is.

        A hand that turns or opens faster than expected leaves the reach of its prediction. On another
        person's hand that costs little: two fingers on one of the image are 2 mm among 10. A fit that
        faces the same way needs to be but a little better; palm and back are not exchanged for that.
        The window about a wrong prediction may have cut fingers off, so it is laid about the fit, and where
        a doubtful fit costs far more than good ones the whole image is searched at once, too.
        """
        state, fits = seen.state, seen.fits
        if fits is None or seen.observation is None or fits.cost <= self.config.status.well_mm:
            return seen
        if not state.monitor.is_raised(fits.cost):
            return seen
        if state.monitor.postpones_look(fits.cost):
            return seen._replace(state=replace(state, monitor=state.monitor.after_look_wait()))
        here = fits.modes.poses[0]
        found = finder.reconsider(self._observer.observe(frame.depth, here, state.expected), here)
        if state.monitor.is_far_raised(fits.cost, self.config.status):
            there = finder.search(frame.depth)
            if there is not None and self._is_alike(there.pose, here):
                found = better_of(found, there)
        helped = found is not None and (
            state.monitor.prefers(fits.cost, found.cost, self.config.status)
            or (found.cost < fits.cost - _BETTER_MM and self._is_alike(found.pose, here))
        )
        monitor = state.monitor.after_look(fits.cost, helped=helped)
        seen = seen._replace(state=replace(state, monitor=monitor))
        return self._refined(finder, found, seen, frame, rng) if found is not None and helped else seen

    def _is_alike(self, pose: FloatArray, other: FloatArray) -> bool:
        """Whether two poses (22,) are of a hand at one place that faces one way."""
        facing, there = (rotations.rotate(one[3:7], np.array([0.0, 0.0, 1.0])) for one in (pose, other))
        return self._is_near(pose, other) and bool(facing @ there > _FACES_ALIKE)

    def _is_near(self, pose: FloatArray, other: FloatArray) -> bool:
        """Whether two poses (22,) are of a hand at one place, folded otherwise, not of two."""
        return joint_set_distance(self.anatomy, pose, other) < NEAR_MM

    def _doubts(self, fits: LocalFits, there: Candidate, monitor: TrackMonitor) -> tuple[float, float]:
        """What speaks against the hand that is followed and against one found elsewhere, mm of cost.

        Of two hands at one place the costs alone decide: the fingers that were seen there are either's.
        """
        if joint_set_distance(self.anatomy, there.pose, fits.modes.poses[0]) < SAME_PLACE_MM:
            return fits.cost, there.cost
        return _doubt_here(fits, monitor), there.doubt

    def _refined(
        self,
        finder: Acquisition,
        found: Candidate,
        seen: FrameObservation,
        frame: Frame,
        rng: np.random.Generator,
    ) -> FrameObservation:
        """The same track, fitted once more from a hand that was found near it."""
        observation = self._observer.observe(frame.depth, found.pose, RELAXED_INNER)
        if observation.target_pixels == 0:
            return seen
        fits = finder.local_fitter.fit(observation, found.pose, seen.state.pose[None], seen.dt, rng)
        return seen._replace(observation=replace(observation, inner=fits.inner), fits=fits)

    def _restarted(
        self,
        finder: Acquisition,
        found: Candidate,
        monitor: TrackMonitor,
        frame: Frame,
        rng: np.random.Generator,
    ) -> FrameObservation:
        """Restart the track at a hand that was found."""
        state = self.start(found.pose, frame.stamp_ns, rng)
        state = replace(state, monitor=monitor.after_restart(found.cost))
        dt = FIRST_STEP_NS * 1e-9
        observation = self._observer.observe(frame.depth, found.pose, RELAXED_INNER)
        if observation.target_pixels == 0:
            return FrameObservation(state, dt, None, restarted=True)
        fits = finder.local_fitter.fit(observation, found.pose, np.empty((0, POSE_SIZE)), dt, rng)
        return FrameObservation(state, dt, replace(observation, inner=fits.inner), fits, restarted=True)

    def _quality(self, cost: float | None) -> float:
        """The share of the most that a pose can cost, c_max, that an estimate does not."""
        return 0.0 if cost is None else max(0.0, 1.0 - cost / self.config.observation.clamp_mm)

    def _evidence(
        self,
        seen: FrameObservation,
        pose: FloatArray,
        monitor: TrackMonitor,
        cost: float | None,
        outline: Outline | None,
    ) -> RunningSigns:
        """What the track's last frames tell of it, with this one where it was fitted."""
        before, usual_mm = seen.state.evidence, monitor.usual_mm or cost
        if seen.fits is None or outline is None or usual_mm is None:
            return before
        expected = self.predict(seen.state, seen.dt)
        innovation = float(mean_joint_distances(self.anatomy, expected, pose[None])[0])
        raised = monitor.raised(seen.fits.cost, self.config.status)
        return before.after(signs_of(usual_mm, innovation, len(seen.fits.modes), outline.contrast, raised))

    def _forearm_confidence(self, frame: Frame, pose: FloatArray, inner: FloatArray) -> float:
        """How far the frame explains the forearm of an estimate; NaN without one."""
        if not inner[:3].any():
            return np.nan
        return self._observer.forearm_confidence(frame.depth, *self.scorer.forearm(pose, inner))

    def _monitored(self, seen: FrameObservation, cost: float | None, quality: float) -> TrackMonitor:
        """The record of the track's quality after a frame."""
        monitor, settings = seen.state.monitor, self.config.status
        if cost is None:
            return monitor.after_miss(settings)
        fitted = cost if seen.fits is None else seen.fits.cost
        return monitor.after_fit(fitted, quality, settings)

    def predict(self, state: HandState, dt: float) -> FloatArray:
        """Return the expected pose (22,) after dt seconds."""
        moved = self._space.retract(state.pose[None], dt * state.velocity[None])
        pose: FloatArray = (inside_limits(moved) if self.config.filter.joint_limits else moved)[0]
        return pose

    def _log_likelihood(self, observation: Observation | None) -> _Counted | None:
        """None where there is nothing to compare with: the filter then only predicts."""
        if observation is None:
            return None
        fitter = self._fitter
        if fitter is None:
            return _Counted(lambda poses: self.scorer.log_likelihood(poses, observation))
        return _Counted(
            lambda poses: (
                self.scorer.log_likelihood(poses, observation) - fitter.potentials(poses, observation.inner)
            )
        )

    def _filter(self, seen: FrameObservation, rng: np.random.Generator) -> tuple[FilterState, Posterior, int]:
        """Advance; also how many poses were drawn for it."""
        particles = seen.state.particles
        if seen.dt <= 0.0:
            return particles, particles.summary(self._space), 0
        guide = self._proposal.proposer(seen.fits, self.config.fit)
        score = self._log_likelihood(seen.observation)
        advanced = particles.step(seen.dt, self._model, score, rng, guide)
        return *advanced, 0 if score is None else score.count

    def _estimate(
        self,
        frame: Frame,
        posterior: Posterior,
        inner: FloatArray,
        evidence: RunningSigns,
        forearm_confidence: float,
        pose_variance: FloatArray,
        cost: float | None,
        confidence: float,
        status: Status,
    ) -> Estimate:
        return hand_estimate(
            self.anatomy,
            posterior.pose,
            posterior.velocity,
            inner,
            evidence,
            forearm_confidence,
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=status,
            confidence=confidence,
            pose_variance=pose_variance,
            twist_variance=posterior.velocity_variance,
            effective_sample_size=posterior.effective_sample_size,
            resampled=posterior.resampled,
            cost=cost,
        )


class _Counted:
    """A log-likelihood that counts the poses it is asked about."""

    def __init__(self, log_likelihood: LogLikelihood) -> None:
        self._log_likelihood, self.count = log_likelihood, 0

    def __call__(self, poses: FloatArray) -> FloatArray:
        self.count += len(poses)
        return self._log_likelihood(poses)


def _evaluations(seen: FrameObservation, drawn: int) -> int:
    """How many poses were drawn for a frame: the filter's, local fits, and the estimate itself."""
    if seen.observation is None:
        return 0
    return drawn + 1 + (0 if seen.fits is None else seen.fits.renders)


def _doubt_here(fits: LocalFits, monitor: TrackMonitor) -> float:
    """What speaks against the hand that is followed, mm of cost, as ``Candidate.doubt`` of another place."""
    return fits.cost - monitor.fingers_mm + depth_doubt(float(fits.modes.poses[0, 2]))


def _expected_after(seen: FrameObservation) -> FloatArray:
    """The inner numbers (6,) that are expected after a frame, but for the forearm's direction.

    A thumb's lie between a relaxed one's and the last: a running mean of what hidden thumbs were taken for
    wanders off.
    """
    expected = seen.state.expected.copy()
    if seen.fits is None:
        return expected
    found = seen.fits.inner
    if found[:3].any():
        expected[LOG_GIRTH] += _GIRTH_MEMORY * (found[LOG_GIRTH] - expected[LOG_GIRTH])
    expected[THUMB] = RELAXED_INNER[THUMB] + THUMB_MEMORY * (found[THUMB] - RELAXED_INNER[THUMB])
    return expected


def _inner_of(seen: FrameObservation) -> FloatArray:
    """The inner numbers (6,) of a frame's estimate."""
    return seen.state.expected if seen.observation is None else seen.observation.inner


def dynamics(config: HandConfig) -> Dynamics:
    """The motion model of eq. (44) with the configuration's noise densities."""
    settings = config.motion
    pose = settings.pose if FILTERS.find(config.filter.kind).has_velocity else settings.pose_alone
    return Dynamics(
        pose_noise=tangent_vector(pose) ** 2,
        velocity_noise=tangent_vector(settings.velocity) ** 2,
        discretisation=config.filter.discretisation,
        constrain=inside_limits if config.filter.joint_limits else None,
        gain=config.filter.gain,
    )


def state_codec(config: HandConfig) -> Codec[HandState]:
    """Return how the tracker's states are kept; local fits and what was seen of a frame are not."""
    kind, count = FILTERS.find(config.filter.kind), config.filter.particles
    layouts = _particle_layouts(count)
    particles = Fields(kind, **{name: Value[FloatArray](layouts[name]) for name in kind.shapes})
    monitor = Fields(
        TrackMonitor,
        lost=flag(),
        found=flag(),
        misses=whole(),
        usual_mm=real(floats(least=0.0)),
        wait=whole(),
        next_wait=whole(),
        elsewhere=whole(),
        fingers_mm=real(floats()),
        good_mm=real(floats(least=0.0)),
        look_wait=whole(),
        next_look_wait=whole(),
        looked_mm=real(floats(least=0.0)),
    )
    return Fields(
        HandState,
        particles=particles,
        stamp_ns=stamp(),
        pose=Value(pose_layout()),
        velocity=Value(floats(TANGENT_SIZE)),
        monitor=monitor,
        expected=Value(floats(INNER_SIZE)),
        frames=whole(),
        doubtful=whole(),
        unseen_ns=whole((0, STAMPS_NS[1])),
        evidence=signs_codec(len(SIGN_NAMES)),
    )


def _particle_layouts(count: int) -> dict[str, Layout]:
    """What the arrays of ``count`` particles must be, for any filter."""
    return {
        "poses": pose_layout(count),
        "velocities": floats(count, TANGENT_SIZE),
        "velocity_variance": floats(TANGENT_SIZE, least=0.0),
        "log_weights": floats(count, least=-np.inf),
    }
