"""Hand tracker: one step takes a state and a frame to the next state and an estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.filters import FILTERS, FilterState, Prior
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.model import FilterModel
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import Posterior
from posetrack_cli.hand.confidence import NO_EVIDENCE, probability, signs_of, with_model_error
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.likelihood import PROPOSALS, CountedLikelihood, PoseScorer
from posetrack_cli.hand.fit.skeleton import LOG_GIRTH, NO_INNER, RELAXED_INNER, THUMB
from posetrack_cli.hand.keypoints.hands import KeypointHands, split_by_distance
from posetrack_cli.hand.model.anatomy import POSE_SIZE, TANGENT_SIZE, HandAnatomy
from posetrack_cli.hand.model.hand import dynamics, inside_limits, space_of, tangent_vector
from posetrack_cli.hand.model.kinematics import mean_joint_distances
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.policy import MOSTLY_HIDDEN, Decision, Policy, TrackedFrame, TrackMonitor, status_of
from posetrack_cli.hand.search import ACCEPT_MM, Acquisition, Candidate, detection_penalty, finger_bonus
from posetrack_cli.hand.start import START_SPREAD, detected_pose, hand_estimate, with_doubt
from posetrack_cli.hand.state import FrameAssessment, FrameFit, HandState, state_codec
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.confidence import PROBABLY

# The prior is one usual frame before the first one, so the first frame is a step like any other.
FIRST_STEP_NS = 33_333_333
_GIRTH_GAIN = 0.1  # of the running mean of the forearm's girth
_PRIOR_SHARE = 0.05  # of particles drawn from the prior alone
_CLEARLY_VISIBLE = 0.4  # share of a hand that another hand does not hide, from which confidence is full
_LIKELY_MM = 6.0  # largest penalty of a place at which one of several hands is searched
THUMB_MEMORY = 0.4  # share of a thumb's deviation from RELAXED_INNER that persists to the next frame


class HandTracker:
    """Tracks one hand with a Rao-Blackwellized or a plain particle filter.

    Args:
        config: parameters.
        anatomy: the hand.
        scorer: the likelihood.
        observer: cuts out and segments windows.
        finder: local fits and detection. The guided proposal uses it in every frame, others at the start
            only.
        keypoints: hands from keypoints, for proposals that fit frames; None without any.
        alone: whether no other hand is tracked in the images, whose tracker searches for both.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        scorer: PoseScorer,
        observer: Observer,
        finder: Acquisition | None = None,
        keypoints: KeypointHands | None = None,
        *,
        alone: bool = True,
    ) -> None:
        self.config, self.anatomy, self._keypoints = config, anatomy, keypoints
        self.scorer, self._observer, self._start_finder = scorer, observer, finder
        self._proposal = PROPOSALS[config.filter.proposal]
        self._finder = finder if self._proposal.fits_frames else None
        self._policy = (
            None
            if self._finder is None
            else Policy(config.status, anatomy, self._finder, observer, alone=alone)
        )
        self._is_calibrated = self._finder is not None and config.observation.models_pixels
        self._space, self.dynamics = space_of(config.filter), dynamics(config)
        resampling = Resampling(config.filter.resampling, config.filter.ess_threshold)
        self._model = FilterModel(self.dynamics, self._space, resampling, self._proposal.sampling)
        self.codec = state_codec(config)

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> HandState:
        """Return the prior around a pose (22,), one usual frame before the first frame's stamp."""
        settings, init = self.config.filter, self.config.init
        prior = Prior(pose, tangent_vector(START_SPREAD), tangent_vector(init.velocity))
        particles = FILTERS.find(settings.kind).initial(prior, settings.particles, self._space, rng)
        expected = NO_INNER if self._finder is None else RELAXED_INNER
        return HandState(
            particles, stamp_ns - FIRST_STEP_NS, pose, np.zeros(TANGENT_SIZE), expected=expected.copy()
        )

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> HandState:
        """Return the state before a first frame in which the hand has yet to be detected.

        Until then it is reported as lost at a pose (22,). Proposals that fit no frames detect it in the first
        frame or start at the pose.
        """
        if self._finder is not None:
            lost = TrackMonitor(lost=True, was_found=False)
            return replace(self.start(pose, frame.stamp_ns, rng), monitor=lost)
        return self.start(detected_pose(self._start_finder, frame, pose), frame.stamp_ns, rng)

    def step(
        self,
        state: HandState,
        frame: Frame,
        rng: np.random.Generator,
        found: Candidate | None = None,
    ) -> tuple[HandState, Estimate]:
        """Advance by one frame; the given state is not modified.

        The track starts again at a hand ``found`` in the frame.

        The confidence is the probability that the estimate is right (``hand.confidence``); for other
        proposals and costs it is 1 - D / c_max with D the cost of the estimate. Without the outline of a hand
        in the frame it is 0, and the hand is lost at once, as it is when it is probably wrong. Frames of high
        D lose the hand at the start, or after several in a row.

        **[ours]** The time step is limited to ``gap_max_s``, for missing frames as well as frames without an
        observation: the random walk of the velocity would otherwise spread the particles over metres. After
        that, particles do not move until the next observation.

        Raises:
            FilterError: stamps do not increase.
        """
        elapsed_ns = frame.stamp_ns - state.stamp_ns
        check_time_step(elapsed_ns * 1e-9)
        if found is None:
            frame_fit = self._observe(state, frame, min(elapsed_ns * 1e-9, self.config.motion.gap_max_s), rng)
        else:
            decision = Decision(state.monitor, found, restart=True)
            frame_fit = self._apply(decision, FrameFit(state, 0.0, None), frame, rng)
        particles, posterior, drawn = self._filter(frame_fit, rng)
        assessment = self._assess(frame_fit, posterior.pose, frame)
        is_seen = frame_fit.observation is not None
        monitor, evidence = assessment.monitor, assessment.evidence
        is_first = found is None and frame_fit.restarted and not state.monitor.was_found
        is_first &= state.frames < self.config.status.lost_after_frames
        if is_first and self._is_calibrated and probability(evidence) < PROBABLY:
            # probably another part of the body: search the next frame instead of following it
            monitor, evidence = state.monitor, NO_EVIDENCE
        new_state = HandState(
            particles,
            frame.stamp_ns,
            posterior.pose,
            posterior.velocity,
            monitor,
            _expected_after(frame_fit),
            frames=state.frames + int(is_seen),
            doubtful=state.doubtful + int(is_seen and assessment.confidence < PROBABLY),
            unseen_ns=0 if is_seen else frame_fit.state.unseen_ns + elapsed_ns,
            dt=max(frame_fit.dt, 0.0),
            cut=frame_fit.restarted,
            evidence=evidence,
            modes=None if frame_fit.fits is None else frame_fit.fits.modes,
            observation=frame_fit.observation,
        )
        variance = posterior.pose_variance
        if self._is_calibrated:
            variance = with_model_error(variance, assessment.monitor.mean_cost_mm)
            variance = with_doubt(variance, assessment.confidence)
        estimate = hand_estimate(
            self.anatomy,
            posterior.pose,
            posterior.velocity,
            frame_fit.inner,
            assessment.evidence,
            self._forearm_confidence(frame, posterior.pose, frame_fit.inner),
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=status_of(
                is_tracked=assessment.is_tracked, is_restarted=frame_fit.restarted and state.monitor.was_found
            ),
            confidence=assessment.confidence,
            pose_variance=variance,
            twist_variance=posterior.velocity_variance,
            effective_sample_size=posterior.effective_sample_size,
            resampled=posterior.resampled,
            cost=assessment.cost,
            evaluations=drawn + (0 if frame_fit.fits is None else frame_fit.fits.renders) + 1
            if is_seen
            else 0,
        )
        return new_state, estimate

    def candidates(self, depth: ImageArray) -> list[Candidate]:
        """Return the hands that fit a whole image (height, width), mm, if the proposal fits frames.

        Every place that is likely to be a hand is fitted as well as if it was the only one.
        """
        if self._finder is None:
            return []
        places = self._finder.detect(depth, is_sized=True)
        likely = (one for one in places if detection_penalty(one) < _LIKELY_MM)
        found = (one for place in likely for one in self._finder.candidates_at(depth, [place]))
        return [one for one in found if one.cost <= ACCEPT_MM]

    def lookalike(self, depth: ImageArray, place: Candidate) -> Candidate | None:
        """Return the hand that looks most like one of the other side in an image (height, width), mm."""
        return None if self._finder is None else self._finder.lookalike(depth, place)

    def visible_share(self, depth: ImageArray, found: Candidate) -> float:
        """Return the share of a hand in an image (height, width), mm, that no other hand hides."""
        return self._observer.outline(depth, found.pose, found.inner[THUMB]).visible

    def _observe(self, state: HandState, frame: Frame, dt: float, rng: np.random.Generator) -> FrameFit:
        """Fit the frame around its prediction; search where the hand is lost or the fit is doubtful."""
        hands = () if self._keypoints is None else self._keypoints.of(frame)
        if self._policy is not None and state.monitor.lost:
            monitor = replace(state.monitor, search_wait=0) if _is_after_gap(state, frame) else state.monitor
            decision = self._policy.decide_lost(monitor, frame.depth, hands)
            return self._apply(decision, FrameFit(state, 0.0, None), frame, rng)
        predicted = self.predict(state, dt)
        observation = self._observer.observe(frame.depth, predicted, state.expected)
        if observation.target_pixels == 0 and self._policy is not None and _is_after_gap(state, frame):
            decision = self._policy.decide_lost(replace(state.monitor, search_wait=0), frame.depth, hands)
            return self._apply(decision, FrameFit(state, dt, None), frame, rng)
        if observation.target_pixels == 0:
            dt = min(dt, self.config.motion.gap_max_s - state.unseen_ns * 1e-9)
            return FrameFit(state, dt, None, hidden=observation.hidden)
        if self._policy is None or self._finder is None or dt <= 0.0:
            return FrameFit(state, dt, observation)
        bonus = finger_bonus(self._observer.fingers_mm2(observation))
        state = replace(state, monitor=state.monitor.after_finger_bonus(bonus))
        near, elsewhere = split_by_distance(hands, predicted, self.anatomy)
        if state.monitor.mean_cost_mm > self.config.status.retry_above_mm:
            # a hand that fits well needs no further starts
            near = np.concatenate([near, self._finder.starts_from_fingers(observation)])
        refold_above_mm = state.monitor.accept_below_mm
        fits = self._finder.local_fitter.fit(
            observation, predicted, state.pose[None], dt, rng, refold_above_mm, near
        )
        observation = replace(observation, inner=fits.inner)
        tracked = TrackedFrame(state.monitor, frame.depth, observation, fits, state.expected)
        if _is_after_gap(state, frame):
            decision = self._policy.decide_after_gap(tracked)
        else:
            decision = self._policy.decide_tracked(tracked, None if self._keypoints is None else elsewhere)
        return self._apply(decision, FrameFit(state, dt, observation, fits), frame, rng)

    def _apply(
        self, decision: Decision, frame_fit: FrameFit, frame: Frame, rng: np.random.Generator
    ) -> FrameFit:
        """Carry out a decision: restart or refit the frame from the candidate."""
        candidate, others = decision.candidate, frame_fit.state.pose[None]
        if candidate is not None and decision.restart:
            state = self.start(candidate.pose, frame.stamp_ns, rng)
            state = replace(state, monitor=decision.monitor.after_restart(candidate.cost))
            frame_fit = FrameFit(state, FIRST_STEP_NS * 1e-9, None, restarted=True)
            others = np.empty((0, POSE_SIZE))
        else:
            frame_fit = frame_fit._replace(state=replace(frame_fit.state, monitor=decision.monitor))
        if candidate is None or self._finder is None:
            return frame_fit
        observation = self._observer.observe(frame.depth, candidate.pose, RELAXED_INNER)
        if observation.target_pixels == 0:
            return frame_fit
        fits = self._finder.local_fitter.fit(observation, candidate.pose, others, frame_fit.dt, rng)
        return frame_fit._replace(observation=replace(observation, inner=fits.inner), fits=fits)

    def _assess(self, frame_fit: FrameFit, pose: FloatArray, frame: Frame) -> FrameAssessment:
        """Assess the estimated pose (22,) against the frame."""
        before, settings = frame_fit.state, self.config.status
        steps = _usual_steps(before, frame)
        if frame_fit.observation is None:
            monitor = before.monitor
            monitor = monitor if frame_fit.hidden > MOSTLY_HIDDEN else monitor.after_miss(settings, steps)
            return FrameAssessment(None, monitor, before.evidence, 0.0, False)
        cost = float(self.scorer.costs(pose[None], frame_fit.observation)[0])
        outline = self._observer.outline(frame.depth, pose, frame_fit.inner[THUMB])
        quality = 0.0  # 1 - D / c_max
        has_outline = not frame_fit.observation.reversed and outline.shows_hand(
            is_known=before.monitor.is_tracked
        )
        if has_outline:
            quality = max(0.0, 1.0 - cost / self.config.observation.clamp_mm)
            fitted = cost if frame_fit.fits is None else frame_fit.fits.cost
            monitor = before.monitor.after_fit(fitted, quality, settings)
        elif outline.visible < 1.0 - MOSTLY_HIDDEN:
            monitor = before.monitor
        else:
            monitor = before.monitor.after_miss(settings, steps)
        evidence = before.evidence
        if frame_fit.fits is not None:
            innovation = mean_joint_distances(self.anatomy, self.predict(before, frame_fit.dt), pose[None])
            ratio = monitor.cost_ratio(frame_fit.fits.cost, settings)
            evidence = evidence.after(
                signs_of(
                    monitor.mean_cost_mm or cost,
                    float(innovation[0]) / steps,
                    len(frame_fit.fits.modes),
                    outline.contrast,
                    ratio,
                ),
                steps,
            )
        is_probability = quality > 0.0 and self._is_calibrated
        confidence = probability(evidence, settings.shape_doubt) if is_probability else quality
        confidence *= settings.hand_probability * min(1.0, outline.visible / _CLEARLY_VISIBLE)
        is_tracked = (
            has_outline and monitor.is_tracked and not (self._is_calibrated and confidence < PROBABLY)
        )
        return FrameAssessment(cost, monitor, evidence, confidence, is_tracked)

    def _forearm_confidence(self, frame: Frame, pose: FloatArray, inner: FloatArray) -> float:
        """Return how well the frame supports the forearm of an estimate; NaN without one."""
        if not inner[:3].any():
            return np.nan
        return self._observer.forearm_confidence(frame.depth, *self.scorer.forearm(pose, inner))

    def predict(self, state: HandState, dt: float) -> FloatArray:
        """Return the predicted pose (22,) after dt seconds."""
        moved = self._space.retract(state.pose[None], dt * state.velocity[None])
        pose: FloatArray = (inside_limits(moved) if self.config.filter.joint_limits else moved)[0]
        return pose

    def _log_likelihood(self, observation: Observation | None) -> CountedLikelihood | None:
        """Return the likelihood of the frame; None without an observation, when the filter only predicts."""
        if observation is None:
            return None
        if self._finder is None:
            return CountedLikelihood(lambda poses: self.scorer.log_likelihood(poses, observation))
        # as in the local fits, exp(-U) of the anatomical potential is a factor of the likelihood
        fitter = self._finder.local_fitter.fitter
        return CountedLikelihood(
            lambda poses: (
                self.scorer.log_likelihood(poses, observation) - fitter.potentials(poses, observation.inner)
            )
        )

    def _filter(self, frame_fit: FrameFit, rng: np.random.Generator) -> tuple[FilterState, Posterior, int]:
        """Advance the filter; return state, posterior and number of rendered poses."""
        particles = frame_fit.state.particles
        if frame_fit.dt <= 0.0:
            return particles, particles.summary(self._space), 0
        guide = None if frame_fit.fits is None else Guide(frame_fit.fits.modes, _PRIOR_SHARE)
        score = self._log_likelihood(frame_fit.observation)
        advanced = particles.step(frame_fit.dt, self._model, score, rng, guide)
        return *advanced, 0 if score is None else score.count


_MOST_STEPS = 3
"""Usual frame intervals after which a prediction is not trusted."""


def _usual_steps(state: HandState, frame: Frame) -> int:
    """Return the time since a state in usual frame intervals, at least 1."""
    return max(1, round((frame.stamp_ns - state.stamp_ns) / FIRST_STEP_NS))


def _is_after_gap(state: HandState, frame: Frame) -> bool:
    """Return whether so much time has passed since a state that the hand may be anywhere."""
    return _usual_steps(state, frame) > _MOST_STEPS


def _expected_after(frame_fit: FrameFit) -> FloatArray:
    """Return the predicted inner numbers (6,) after a frame; the forearm's direction is not predicted."""
    expected = frame_fit.state.expected.copy()
    if frame_fit.fits is None:
        return expected
    found = frame_fit.fits.inner
    if found[:3].any():
        expected[LOG_GIRTH] += _GIRTH_GAIN * (found[LOG_GIRTH] - expected[LOG_GIRTH])
    # not a running mean: fits of a hidden thumb would drift
    expected[THUMB] = RELAXED_INNER[THUMB] + THUMB_MEMORY * (found[THUMB] - RELAXED_INNER[THUMB])
    return expected
