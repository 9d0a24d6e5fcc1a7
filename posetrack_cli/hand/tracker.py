"""The hand tracker: one frame in, the next state and an estimate out."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.annealed import Annealing
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.guided import Guide
from posetrack_cli.filtering.marginal import MarginalState, initialise_marginal, marginal_step
from posetrack_cli.filtering.model import Dynamics, LogLikelihood
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.particle import ParticleState, initialise_particle, particle_step
from posetrack_cli.filtering.posterior import Posterior, summarise, velocity_moments
from posetrack_cli.filtering.proposed import Proposer
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import weigh
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.acquisition import Acquisition, Candidate, better_of
from posetrack_cli.hand.anatomy import ANGLES, POSE_SIZE, TANGENT_SIZE, HandAnatomy
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.guiding import LocalFits
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.likelihood import PoseScorer
from posetrack_cli.hand.observation import Observation
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.space import HandSpace, inside_limits, pose_layout, pose_rates, tangent_vector
from posetrack_cli.hand.watch import Watch
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.results.layouts import STAMPS_NS, floats
from posetrack_cli.tracking.state_codec import Codec, Fields, Value, flag, real, stamp, whole

FilterState: TypeAlias = ParticleState | MarginalState
# The prior holds one usual frame before the first one, so the first frame is a step like all others.
FIRST_STEP_NS = 33_333_333
# Components of the tangent space that annealing moves together: the palm, then each finger.
BLOCKS = (np.arange(6), *np.arange(6, 21).reshape(5, 3))
NEAR_MM = 40.0  # mean distance of the joints, up to which a better fit is of the hand that is tracked


@dataclass(frozen=True, eq=False)
class HandState:
    """Everything the next step needs.

    Attributes:
        particles: the filter's state.
        stamp_ns: of the last frame.
        pose: (22,) last estimate.
        velocity: (21,) last estimate of the tangent velocity, mm/s and rad/s.
        watch: how well frames were fitted.
        unseen_ns: time since the last frame in which there was something to compare with.
        dt: seconds that the filter advanced by to this frame; 0 if it stood still.
        cut: whether the state does not follow from that of the frame before.
        modes: local fits to the frame; None without any. No step needs them, and no checkpoint has them.
        observation: what was seen of the frame; the same holds of it.
    """

    particles: FilterState
    stamp_ns: int
    pose: FloatArray
    velocity: FloatArray
    watch: Watch = field(default_factory=Watch)
    unseen_ns: int = 0
    dt: float = 0.0
    cut: bool = False
    modes: LikelihoodModes | None = None
    observation: Observation | None = None


class Look(NamedTuple):
    """What is seen in a frame before the filter takes it in.

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
        camera: of the depth images.
        scorer: the likelihood.
        observer: cuts out and segments windows.
        finder: local fits, and the search for a hand of which no pose is known. The guided proposal asks it
            in every frame, others for the start alone; annealing takes the anatomy's potential from it.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        camera: Camera,
        scorer: PoseScorer,
        observer: Observer,
        finder: Acquisition | None = None,
    ) -> None:
        self.config, self.anatomy, self.camera = config, anatomy, camera
        self.scorer, self._observer, self._start_finder = scorer, observer, finder
        self._finder = finder if config.filter.proposal == "guided" else None
        plausible = finder is not None and config.filter.proposal in ("guided", "annealed")
        self._fitter = finder.guiding.fitter if finder is not None and plausible else None
        self._space = HandSpace()
        self._resampling = Resampling(config.filter.resampling, config.filter.ess_threshold)
        self.dynamics = dynamics(config)
        self.codec = state_codec(config)

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

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> HandState:
        """Return the state before a first frame in which the hand has yet to be found.

        Until it is, it is said to be lost at a pose (22,). Proposals that do not look at frames find it in
        the first frame or start at the pose.
        """
        if self._finder is not None:
            lost = Watch(lost=True, found=False)
            return replace(self.start(pose, frame.stamp_ns, rng), watch=lost)
        found = None if self._start_finder is None else self._start_finder.search(frame.depth)
        return self.start(pose if found is None else found.pose, frame.stamp_ns, rng)

    def step(self, state: HandState, frame: Frame, rng: np.random.Generator) -> tuple[HandState, Estimate]:
        """Advance by one frame; the state given is left as it is.

        The confidence is 1 - D / c_max of the estimate's own cost D, and 0 where the frame shows no
        outline of a hand there, which is lost at once; after frames of low confidence a hand is lost if it
        was never seen, or after several. **[ours]** No gap counts for longer than
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
        look = self._look(state, frame, min(elapsed_ns * 1e-9, self.config.motion.gap_max_s), rng)
        particles, posterior, drawn = self._filter(look, rng)
        scores = (
            None if look.observation is None else self.scorer.costs(posterior.pose[None], look.observation)
        )
        cost = None if scores is None else float(scores[0])
        shown = cost is not None and self._observer.shows_hand(
            frame.depth, posterior.pose, is_known=look.state.watch.is_believed
        )
        confidence = self._confidence(cost) if shown else 0.0
        watch = self._watched(look, cost if shown else None, confidence)
        unseen_ns = look.state.unseen_ns + elapsed_ns if look.observation is None else 0
        pose, velocity = posterior.pose, posterior.velocity
        following = HandState(
            particles, frame.stamp_ns, pose, velocity, watch, unseen_ns, max(look.dt, 0.0), look.restarted
        )
        modes = None if look.fits is None else look.fits.modes
        following = replace(following, modes=modes, observation=look.observation)
        again = look.restarted and state.watch.found
        status = Status.TRACKING if shown and watch.is_believed else Status.LOST
        status = Status.REINITIALISED if again and status == Status.TRACKING else status
        estimate = self._estimate(frame, posterior, cost, confidence, status)
        return following, replace(estimate, evaluations=_evaluations(look, drawn))

    def _look(self, state: HandState, frame: Frame, dt: float, rng: np.random.Generator) -> Look:
        """What the frame shows; where the hand is gone or doubtful, it is looked for elsewhere."""
        if self._finder is not None and state.watch.lost:
            return self._search(self._finder, state, frame, rng)
        predicted = self.predict(state, dt)
        observation = self._observer.observe(frame.depth, predicted)
        if observation.target_pixels == 0:
            return Look(state, min(dt, self.config.motion.gap_max_s - state.unseen_ns * 1e-9), None)
        if self._finder is None or dt <= 0.0:
            return Look(state, dt, observation)
        enough = state.watch.enough_mm
        fits = self._finder.guiding.fit(observation, predicted, state.pose[None], dt, rng, enough)
        look = Look(state, dt, observation, fits)
        return self._reconsidered(self._finder, look, frame, rng)

    def _search(self, finder: Acquisition, state: HandState, frame: Frame, rng: np.random.Generator) -> Look:
        """Look for a lost hand in the whole image, ever more seldom while it is not there."""
        if state.watch.wait > 0:
            return Look(replace(state, watch=state.watch.waiting()), 0.0, None)
        found = finder.search(frame.depth)
        if found is None:
            watch = state.watch.refused(np.inf, self.config.status)
            return Look(replace(state, watch=watch), 0.0, None)
        return self._restarted(finder, found, state.watch, frame, rng)

    def _reconsidered(self, finder: Acquisition, look: Look, frame: Frame, rng: np.random.Generator) -> Look:
        """The look, or that at a hand which looks alike and fits far better where this one fits badly."""
        state, settings = look.state, self.config.status
        if look.fits is None or look.observation is None or not state.watch.doubts(look.fits.cost, settings):
            return look
        if state.watch.waits(look.fits.cost, settings):
            return look._replace(state=replace(state, watch=state.watch.waiting()))
        found = finder.reconsider(look.observation, look.fits.modes.poses[0])
        if found is None or state.watch.doubts(found.cost, settings):
            found = better_of(found, finder.search(frame.depth))  # the window may be misled, too
        if found is not None and state.watch.is_replaced(look.fits.cost, found.cost, settings):
            if self._is_near(found.pose, look.fits.modes.poses[0]):
                return self._refined(finder, found, look, frame, rng)
            return self._restarted(finder, found, state.watch, frame, rng)
        refused = state.watch.refused(look.fits.cost, settings)
        return look._replace(state=replace(state, watch=refused))

    def _is_near(self, pose: FloatArray, other: FloatArray) -> bool:
        """Whether two poses (22,) are of a hand at one place: another fold of fingers, not another hand."""
        joints = joint_positions(self.anatomy, np.stack([pose, other]))
        return float(np.linalg.norm(joints[0] - joints[1], axis=1).mean()) < NEAR_MM

    def _refined(
        self, finder: Acquisition, found: Candidate, look: Look, frame: Frame, rng: np.random.Generator
    ) -> Look:
        """The same track, fitted once more from a hand that was found near it."""
        observation = self._observer.observe(frame.depth, found.pose)
        if observation.target_pixels == 0:
            return look
        fits = finder.guiding.fit(observation, found.pose, look.state.pose[None], look.dt, rng)
        return look._replace(observation=observation, fits=fits)

    def _restarted(
        self, finder: Acquisition, found: Candidate, watch: Watch, frame: Frame, rng: np.random.Generator
    ) -> Look:
        """Begin anew about a hand that was found."""
        state = self.start(found.pose, frame.stamp_ns, rng)
        state = replace(state, watch=watch.restarted(found.cost))
        dt = FIRST_STEP_NS * 1e-9
        observation = self._observer.observe(frame.depth, found.pose)
        if observation.target_pixels == 0:
            return Look(state, dt, None, restarted=True)
        fits = finder.guiding.fit(observation, found.pose, np.empty((0, POSE_SIZE)), dt, rng)
        return Look(state, dt, observation, fits, restarted=True)

    def _confidence(self, cost: float | None) -> float:
        return 0.0 if cost is None else max(0.0, 1.0 - cost / self.config.observation.clamp_mm)

    def _watched(self, look: Look, cost: float | None, confidence: float) -> Watch:
        """What is remembered of the track's quality after a frame."""
        watch, settings = look.state.watch, self.config.status
        if cost is None:
            return watch.missed(settings)
        fitted = cost if look.fits is None else look.fits.cost
        return watch.seen(fitted, confidence, settings)

    def predict(self, state: HandState, dt: float) -> FloatArray:
        """Return the expected pose (22,) after dt seconds."""
        moved = self._space.retract(state.pose[None], dt * state.velocity[None])
        pose: FloatArray = inside_limits(moved)[0]
        return pose

    def _log_likelihood(self, observation: Observation | None) -> _Counted | None:
        """None where there is nothing to compare with: the filter then only predicts."""
        if observation is None:
            return None
        fitter = self._fitter
        if fitter is None:
            return _Counted(lambda poses: self.scorer.log_likelihood(poses, observation))
        return _Counted(
            lambda poses: self.scorer.log_likelihood(poses, observation) - fitter.potentials(poses)
        )

    def _proposer(self, look: Look) -> Proposer | None:
        """What looks at the frame before particles are drawn; None if nothing does."""
        if self.config.filter.proposal == "annealed":
            return Annealing(BLOCKS)
        return None if look.fits is None else Guide(look.fits.modes, self.config.fit.prior_share)

    def _filter(self, look: Look, rng: np.random.Generator) -> tuple[FilterState, Posterior, int]:
        """Advance; also how many poses were drawn for it."""
        particles = look.state.particles
        if look.dt <= 0.0:
            return particles, self._standing_still(particles), 0
        guide = self._proposer(look)
        score = self._log_likelihood(look.observation)
        common = (look.dt, self.dynamics, self._space, score, self._resampling, rng)
        if isinstance(particles, MarginalState):
            proposal = "paper" if self.config.filter.proposal == "paper" else "marginal"
            advanced = marginal_step(particles, *common, proposal=proposal, guide=guide)
            return *advanced, 0 if score is None else score.count
        moved = particle_step(particles, *common, guide=guide)
        return *moved, 0 if score is None else score.count

    def _standing_still(self, particles: FilterState) -> Posterior:
        """What is known of the hand when neither time nor an observation moves it."""
        weighing, velocity = weigh(particles.log_weights, particles.poses, None), None
        if isinstance(particles, MarginalState):
            velocity = velocity_moments(particles.velocities, particles.velocity_variance, weighing.weights)
        return summarise(self._space, particles.poses, velocity, weighing, resampled=False)

    def _estimate(
        self, frame: Frame, posterior: Posterior, cost: float | None, confidence: float, status: Status
    ) -> Estimate:
        pose = posterior.pose
        return Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=status,
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


class _Counted:
    """A log-likelihood that counts the poses it is asked about."""

    def __init__(self, log_likelihood: LogLikelihood) -> None:
        self._log_likelihood, self.count = log_likelihood, 0

    def __call__(self, poses: FloatArray) -> FloatArray:
        self.count += len(poses)
        return self._log_likelihood(poses)


def _evaluations(look: Look, drawn: int) -> int:
    """How many poses were drawn for a frame: the filter's, local fits, and the estimate itself."""
    if look.observation is None:
        return 0
    return drawn + 1 + (0 if look.fits is None else look.fits.renders)


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


def state_codec(config: HandConfig) -> Codec[HandState]:
    """Return how the tracker's states are kept; local fits and what was seen of a frame are not."""
    count = config.filter.particles
    weighted: dict[str, Codec[FloatArray]] = {
        "poses": Value(pose_layout(count)),
        "log_weights": Value(floats(count, least=-np.inf)),
    }
    particles: Codec[Any] = Fields(ParticleState, **weighted)
    if config.filter.kind == "rbpf":
        weighted["velocities"] = Value(floats(count, TANGENT_SIZE))
        weighted["velocity_variance"] = Value(floats(TANGENT_SIZE, least=0.0))
        particles = Fields(MarginalState, **weighted)
    watch = Fields(
        Watch,
        lost=flag(),
        found=flag(),
        misses=whole(),
        usual_mm=real(floats(least=0.0)),
        wait=whole(),
        pause=whole(),
    )
    return Fields(
        HandState,
        particles=particles,
        stamp_ns=stamp(),
        pose=Value(pose_layout()),
        velocity=Value(floats(TANGENT_SIZE)),
        watch=watch,
        unseen_ns=whole((0, STAMPS_NS[1])),
    )
