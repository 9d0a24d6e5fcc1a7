"""The hand tracker: one frame in, the next state and an estimate out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.marginal import MarginalState, initialise_marginal, marginal_step
from posetrack_cli.filtering.model import Dynamics, LogLikelihood
from posetrack_cli.filtering.particle import ParticleState, initialise_particle, particle_step
from posetrack_cli.filtering.posterior import Posterior, summarise, velocity_moments
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import weigh
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import ANGLES, HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.guiding import Guiding
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.likelihood import PoseScorer
from posetrack_cli.hand.observation import Observation
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.space import HandSpace, inside_limits, pose_rates, tangent_vector
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status

FilterState: TypeAlias = ParticleState | MarginalState
# The prior holds one usual frame before the first one, so the first frame is a step like all others.
FIRST_STEP_NS = 33_333_333


@dataclass(frozen=True, eq=False)
class HandState:
    """Everything the next step needs.

    Attributes:
        particles: the filter's state.
        stamp_ns: of the last frame.
        pose: (22,) last estimate.
        velocity: (21,) last estimate of the tangent velocity, mm/s and rad/s.
        misses: frames in a row without confidence.
        unseen_ns: time since the last frame in which there was something to compare with.
    """

    particles: FilterState
    stamp_ns: int
    pose: FloatArray
    velocity: FloatArray
    misses: int = 0
    unseen_ns: int = 0


class HandTracker:
    """Tracks one hand with a Rao-Blackwellized or a plain particle filter.

    Args:
        config: parameters.
        anatomy: the hand.
        camera: of the depth images.
        scorer: the likelihood.
        guiding: local fits for the guided proposal; None for proposals that do not look at the frame.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        camera: Camera,
        scorer: PoseScorer,
        guiding: Guiding | None = None,
    ) -> None:
        self.config, self.anatomy, self.camera = config, anatomy, camera
        self.scorer, self._guiding = scorer, guiding
        self._observer = Observer(config, anatomy, camera, segment=config.observation.cost != "paper")
        self._space = HandSpace()
        self._resampling = Resampling(config.filter.resampling, config.filter.ess_threshold)
        self._dynamics = dynamics(config)

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> HandState:
        """Return the prior about a pose (22,): one usual frame before the first frame's stamp."""
        settings, space = self.config, self._space
        spread, count = tangent_vector(settings.init.spread), settings.filter.particles
        velocity_sd = tangent_vector(settings.init.velocity)
        particles: FilterState
        if settings.filter.kind == "rbpf":
            particles = initialise_marginal(pose, spread, velocity_sd, count, space, rng)
        else:
            particles = initialise_particle(pose, spread, count, space, rng)
        return HandState(particles, stamp_ns - FIRST_STEP_NS, pose, np.zeros_like(spread))

    def step(self, state: HandState, frame: Frame, rng: np.random.Generator) -> tuple[HandState, Estimate]:
        """Advance by one frame; the state given is left as it is.

        The confidence is 1 - D / c_max of the estimate's own cost D. **[ours]** No gap counts for longer than
        ``gap_max_s``, whether frames are missing or have nothing to compare with: the velocity's random walk
        would else spread the hand over metres. Particles then stay where they are until something is seen.

        Args:
            state: after the frame before.
            frame: depth, mm.
            rng: source of randomness.

        Raises:
            FilterError: stamps do not increase.
        """
        elapsed_ns = frame.stamp_ns - state.stamp_ns
        check_time_step(elapsed_ns * 1e-9)
        dt = min(elapsed_ns * 1e-9, self.config.motion.gap_max_s)
        predicted = self.predict(state, dt)
        observation = self.observe(frame.depth, predicted)
        seen = observation.target_pixels > 0
        if not seen:
            dt = min(dt, self.config.motion.gap_max_s - state.unseen_ns * 1e-9)
        guide = self._guide(observation, predicted, state.pose, dt, rng) if seen else None
        particles, posterior = self._filter(
            state.particles, dt, self._log_likelihood(observation), guide, rng
        )
        cost = self._cost_of(posterior.pose, observation)
        confidence = 0.0 if cost is None else max(0.0, 1.0 - cost / self.config.observation.clamp_mm)
        misses = state.misses + 1 if confidence < self.config.status.lost_below else 0
        unseen_ns = 0 if seen else state.unseen_ns + elapsed_ns
        pose, velocity = posterior.pose, posterior.velocity
        following = HandState(particles, frame.stamp_ns, pose, velocity, misses, unseen_ns)
        lost = cost is None or misses >= self.config.status.lost_after_frames
        evaluations = len(particles.poses) + 1 if seen else 0  # the estimate's own is one more
        estimate = self._estimate(frame, posterior, cost, confidence, lost)
        return following, replace(estimate, evaluations=evaluations)

    def predict(self, state: HandState, dt: float) -> FloatArray:
        """Return the expected pose (22,) after dt seconds."""
        moved = self._space.retract(state.pose[None], dt * state.velocity[None])
        pose: FloatArray = inside_limits(moved)[0]
        return pose

    def observe(self, depth: ImageArray, predicted: FloatArray) -> Observation:
        """Cut the window around a predicted pose (22,) and find the target pixels in it."""
        return self._observer.observe(depth, predicted)

    def state_parts(self, state: HandState) -> tuple[dict[str, FloatArray], dict[str, int]]:
        """Take a state apart into arrays and whole numbers, for a checkpoint."""
        numbers = {"stamp_ns": state.stamp_ns, "misses": state.misses, "unseen_ns": state.unseen_ns}
        return state_arrays(state), numbers

    def state_from_parts(self, arrays: Mapping[str, FloatArray], numbers: Mapping[str, int]) -> HandState:
        """Put a state together from what ``state_parts`` made of it."""
        return state_from_arrays(arrays, **numbers)

    def _log_likelihood(self, observation: Observation) -> LogLikelihood | None:
        """None where there is nothing to compare with: the filter then only predicts."""
        if observation.target_pixels == 0:
            return None
        if self._guiding is None:
            return lambda poses: self.scorer.log_likelihood(poses, observation)
        fitter = self._guiding.fitter
        return lambda poses: self.scorer.log_likelihood(poses, observation) - fitter.potentials(poses)

    def _guide(
        self,
        observation: Observation,
        predicted: FloatArray,
        still: FloatArray,
        dt: float,
        rng: np.random.Generator,
    ) -> Guide | None:
        if self._guiding is None or dt <= 0.0:
            return None
        fits = self._guiding.fit(observation, predicted, still[None], dt, rng)
        return Guide(fits.modes, self.config.fit.prior_share)

    def _filter(
        self,
        particles: FilterState,
        dt: float,
        score: LogLikelihood | None,
        guide: Guide | None,
        rng: np.random.Generator,
    ) -> tuple[FilterState, Posterior]:
        if dt <= 0.0:
            return particles, self._standing_still(particles)
        common = (dt, self._dynamics, self._space, score, self._resampling, rng)
        if isinstance(particles, MarginalState):
            proposal = "paper" if self.config.filter.proposal == "paper" else "marginal"
            return marginal_step(particles, *common, proposal=proposal, guide=guide)
        return particle_step(particles, *common, guide=guide)

    def _standing_still(self, particles: FilterState) -> Posterior:
        """What is known of the hand when neither time nor an observation moves it."""
        weighing, velocity = weigh(particles.log_weights, particles.poses, None), None
        if isinstance(particles, MarginalState):
            velocity = velocity_moments(particles.velocities, particles.velocity_variance, weighing.weights)
        return summarise(self._space, particles.poses, velocity, weighing, resampled=False)

    def _cost_of(self, pose: FloatArray, observation: Observation) -> float | None:
        if observation.target_pixels == 0:
            return None
        return float(self.scorer.costs(pose[None], observation)[0])

    def _estimate(
        self, frame: Frame, posterior: Posterior, cost: float | None, confidence: float, lost: bool
    ) -> Estimate:
        pose = posterior.pose
        return Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=Status.LOST if lost else Status.TRACKING,
            confidence=confidence,
            position=pose[:3],
            quaternion=pose[3:7],
            shape=pose[ANGLES],
            pose_rate=pose_rates(pose, posterior.velocity),
            twist=posterior.velocity,
            pose_variance=posterior.pose_variance,
            twist_variance=posterior.velocity_variance,
            points=joint_positions(self.anatomy, pose[None])[0],
            effective_sample_size=posterior.effective_sample_size,
            resampled=posterior.resampled,
            cost=cost,
        )


def dynamics(config: HandConfig) -> Dynamics:
    """The motion model of eq. (44) with the configuration's noise densities."""
    settings = config.motion
    pose = settings.pose if config.filter.kind == "rbpf" else settings.pose_alone
    return Dynamics(
        pose_noise=tangent_vector(pose) ** 2,
        velocity_noise=tangent_vector(settings.velocity) ** 2,
        discretisation=config.filter.discretisation,
        constrain=inside_limits,
    )


def state_arrays(state: HandState) -> dict[str, FloatArray]:
    """The arrays of a state, for a checkpoint."""
    arrays = {"pose": state.pose, "velocity": state.velocity, "particles_poses": state.particles.poses}
    arrays["particles_log_weights"] = state.particles.log_weights
    if isinstance(state.particles, MarginalState):
        arrays["particles_velocities"] = state.particles.velocities
        arrays["particles_velocity_variance"] = state.particles.velocity_variance
    return arrays


def state_from_arrays(
    arrays: Mapping[str, FloatArray], stamp_ns: int, misses: int, unseen_ns: int
) -> HandState:
    """The state that ``state_arrays`` took apart, with the numbers that are no arrays."""
    poses, log_weights = arrays["particles_poses"], arrays["particles_log_weights"]
    particles: FilterState = ParticleState(poses, log_weights)
    if "particles_velocities" in arrays:
        particles = MarginalState(
            poses, arrays["particles_velocities"], arrays["particles_velocity_variance"], log_weights
        )
    return HandState(particles, stamp_ns, arrays["pose"], arrays["velocity"], misses, unseen_ns)
