"""The hand tracker: one frame in, the next state and an estimate out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.filters import FILTERS, FilterState, Prior
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.model import FilterModel
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import Posterior
from posetrack_cli.hand.confidence import probability, signs_of, with_model_error
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.likelihood import PROPOSALS, Counted, PoseScorer
from posetrack_cli.hand.fit.skeleton import LOG_GIRTH, NO_INNER, RELAXED_INNER, THUMB
from posetrack_cli.hand.keypoints.told import ToldHands, split
from posetrack_cli.hand.model.anatomy import POSE_SIZE, TANGENT_SIZE, HandAnatomy
from posetrack_cli.hand.model.hand import dynamics, inside_limits, space_of, tangent_vector
from posetrack_cli.hand.model.kinematics import mean_joint_distances
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.policy import Decision, Policy, Sight, TrackMonitor, status_of
from posetrack_cli.hand.search import Acquisition, fingers_bonus
from posetrack_cli.hand.start import START_SPREAD, found_pose, hand_estimate
from posetrack_cli.hand.state import FrameObservation, HandState, Judgement, state_codec
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.confidence import PROBABLY

# The prior holds one usual frame before the first one, so the first frame is a step like all others.
FIRST_STEP_NS = 33_333_333
_GIRTH_MEMORY = 0.1  # share of a new frame in the running mean of the forearm's girth
_PRIOR_SHARE = 0.05  # of particles drawn from the prior alone
THUMB_MEMORY = 0.4  # share of a thumb's departure from RELAXED_INNER that is expected of the next frame


class HandTracker:
    """Tracks one hand with a Rao-Blackwellized or a plain particle filter.

    Args:
        config: parameters.
        anatomy: the hand.
        scorer: the likelihood.
        observer: cuts out and segments windows.
        finder: local fits, and the search for a hand of which no pose is known. The guided proposal asks it
            in every frame, others for the start alone.
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
        self._proposal = PROPOSALS[config.filter.proposal]
        self._finder = finder if self._proposal.fits_frames else None
        self._policy = (
            None if self._finder is None else Policy(config.status, anatomy, self._finder, observer)
        )
        self._is_calibrated = self._finder is not None and config.observation.models_pixels
        self._space, self.dynamics = space_of(config.filter), dynamics(config)
        resampling = Resampling(config.filter.resampling, config.filter.ess_threshold)
        self._model = FilterModel(self.dynamics, self._space, resampling, self._proposal.sampling)
        self.codec = state_codec(config)

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> HandState:
        """Return the prior about a pose (22,): one usual frame before the first frame's stamp."""
        settings, init = self.config.filter, self.config.init
        prior = Prior(pose, tangent_vector(START_SPREAD), tangent_vector(init.velocity))
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
        judged = self._judge(seen, posterior.pose, frame)
        is_seen = seen.observation is not None
        new_state = HandState(
            particles,
            frame.stamp_ns,
            posterior.pose,
            posterior.velocity,
            judged.monitor,
            _expected_after(seen),
            frames=state.frames + int(is_seen),
            doubtful=state.doubtful + int(is_seen and judged.confidence < PROBABLY),
            unseen_ns=0 if is_seen else seen.state.unseen_ns + elapsed_ns,
            dt=max(seen.dt, 0.0),
            cut=seen.restarted,
            evidence=judged.evidence,
            modes=None if seen.fits is None else seen.fits.modes,
            observation=seen.observation,
        )
        variance = posterior.pose_variance
        if self._is_calibrated:
            variance = with_model_error(variance, judged.monitor.usual_mm)
        estimate = hand_estimate(
            self.anatomy,
            posterior.pose,
            posterior.velocity,
            seen.inner,
            judged.evidence,
            self._forearm_confidence(frame, posterior.pose, seen.inner),
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=status_of(
                is_believed=judged.is_believed, is_another=seen.restarted and state.monitor.found
            ),
            confidence=judged.confidence,
            pose_variance=variance,
            twist_variance=posterior.velocity_variance,
            effective_sample_size=posterior.effective_sample_size,
            resampled=posterior.resampled,
            cost=judged.cost,
            evaluations=drawn + (0 if seen.fits is None else seen.fits.renders) + 1 if is_seen else 0,
        )
        return new_state, estimate

    def _observe(
        self, state: HandState, frame: Frame, dt: float, rng: np.random.Generator
    ) -> FrameObservation:
        """What the frame shows; where the hand is lost or doubtful, it is searched for elsewhere."""
        told = () if self._told is None else self._told.of(frame)
        if self._policy is not None and state.monitor.lost:
            decision = self._policy.lost(state.monitor, frame.depth, told)
            return self._carried_out(decision, FrameObservation(state, 0.0, None), frame, rng)
        predicted = self.predict(state, dt)
        observation = self._observer.observe(frame.depth, predicted, state.expected)
        if observation.target_pixels == 0:
            return FrameObservation(
                state, min(dt, self.config.motion.gap_max_s - state.unseen_ns * 1e-9), None
            )
        if self._policy is None or self._finder is None or dt <= 0.0:
            return FrameObservation(state, dt, observation)
        fingers = fingers_bonus(self._observer.fingers_mm2(observation))
        state = replace(state, monitor=state.monitor.after_fingers(fingers))
        enough = state.monitor.sufficient_mm
        near, elsewhere = split(told, predicted, self.anatomy)
        if state.monitor.usual_mm > self.config.status.well_mm:  # a hand that fits well needs no more starts
            near = np.concatenate([near, self._finder.starts_of_fingers(observation)])
        fits = self._finder.local_fitter.fit(observation, predicted, state.pose[None], dt, rng, enough, near)
        observation = replace(observation, inner=fits.inner)
        sight = Sight(state.monitor, frame.depth, observation, fits, state.expected)
        decision = self._policy.followed(sight, None if self._told is None else elsewhere)
        return self._carried_out(decision, FrameObservation(state, dt, observation, fits), frame, rng)

    def _carried_out(
        self, decision: Decision, seen: FrameObservation, frame: Frame, rng: np.random.Generator
    ) -> FrameObservation:
        """What is seen of a frame once it was decided what to do with it."""
        found, others = decision.found, seen.state.pose[None]
        if found is not None and decision.restart:
            state = self.start(found.pose, frame.stamp_ns, rng)
            state = replace(state, monitor=decision.monitor.after_restart(found.cost))
            seen = FrameObservation(state, FIRST_STEP_NS * 1e-9, None, restarted=True)
            others = np.empty((0, POSE_SIZE))
        else:
            seen = seen._replace(state=replace(seen.state, monitor=decision.monitor))
        if found is None or self._finder is None:
            return seen
        observation = self._observer.observe(frame.depth, found.pose, RELAXED_INNER)
        if observation.target_pixels == 0:
            return seen
        fits = self._finder.local_fitter.fit(observation, found.pose, others, seen.dt, rng)
        return seen._replace(observation=replace(observation, inner=fits.inner), fits=fits)

    def _judge(self, seen: FrameObservation, pose: FloatArray, frame: Frame) -> Judgement:
        """How well a frame shows the hand at the estimated pose (22,)."""
        before, settings = seen.state, self.config.status
        if seen.observation is None:
            return Judgement(None, before.monitor.after_miss(settings), before.evidence, 0.0, False)
        cost = float(self.scorer.costs(pose[None], seen.observation)[0])
        outline = self._observer.outline(frame.depth, pose, seen.inner[THUMB])
        quality = 0.0  # the share of the most that a pose can cost, c_max, that this one does not
        shown = not seen.observation.reversed and outline.shows_hand(is_known=before.monitor.is_believed)
        if shown:
            quality = max(0.0, 1.0 - cost / self.config.observation.clamp_mm)
            fitted = cost if seen.fits is None else seen.fits.cost
            monitor = before.monitor.after_fit(fitted, quality, settings)
        else:
            monitor = before.monitor.after_miss(settings)
        evidence = before.evidence
        if seen.fits is not None:
            innovation = mean_joint_distances(self.anatomy, self.predict(before, seen.dt), pose[None])
            raised = monitor.raised(seen.fits.cost, settings)
            evidence = evidence.after(
                signs_of(
                    monitor.usual_mm or cost,
                    float(innovation[0]),
                    len(seen.fits.modes),
                    outline.contrast,
                    raised,
                )
            )
        confidence = probability(evidence) if quality and self._is_calibrated else quality
        is_believed = shown and monitor.is_believed and not (self._is_calibrated and confidence < PROBABLY)
        return Judgement(cost, monitor, evidence, confidence, is_believed)

    def _forearm_confidence(self, frame: Frame, pose: FloatArray, inner: FloatArray) -> float:
        """How far the frame explains the forearm of an estimate; NaN without one."""
        if not inner[:3].any():
            return np.nan
        return self._observer.forearm_confidence(frame.depth, *self.scorer.forearm(pose, inner))

    def predict(self, state: HandState, dt: float) -> FloatArray:
        """Return the expected pose (22,) after dt seconds."""
        moved = self._space.retract(state.pose[None], dt * state.velocity[None])
        pose: FloatArray = (inside_limits(moved) if self.config.filter.joint_limits else moved)[0]
        return pose

    def _log_likelihood(self, observation: Observation | None) -> Counted | None:
        """None where there is nothing to compare with: the filter then only predicts."""
        if observation is None:
            return None
        if self._finder is None:
            return Counted(lambda poses: self.scorer.log_likelihood(poses, observation))
        fitter = self._finder.local_fitter.fitter
        return Counted(
            lambda poses: (
                self.scorer.log_likelihood(poses, observation) - fitter.potentials(poses, observation.inner)
            )
        )

    def _filter(self, seen: FrameObservation, rng: np.random.Generator) -> tuple[FilterState, Posterior, int]:
        """Advance; also how many poses were drawn for it."""
        particles = seen.state.particles
        if seen.dt <= 0.0:
            return particles, particles.summary(self._space), 0
        guide = None if seen.fits is None else Guide(seen.fits.modes, _PRIOR_SHARE)
        score = self._log_likelihood(seen.observation)
        advanced = particles.step(seen.dt, self._model, score, rng, guide)
        return *advanced, 0 if score is None else score.count


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
