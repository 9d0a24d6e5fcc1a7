"""Tracking by particle swarm optimisation around the last solution (Oikonomidis et al., BMVC 2011).

As in the paper: swarm and constriction, 64 particles and 25 generations, start (the last solution and
perturbations of it, at rest), finger angles redrawn every third generation in half of the particles, and the
objective with its constants.

Different: their hand has 27 numbers (position, quaternion, four angles per finger). Ours has 22, of which the
swarm moves 21: position, body-frame rotation vector from the last solution, and 15 angles; the joint next to
a fingertip follows its neighbour. Bounds are the joint limits and a box around the last solution. The
perturbations' standard deviations are not published ("experimentally determined"); ours are tuned (the
authors' later public tracker uses 10 mm, .1 per quaternion component, that is .2 rad, and .1 rad). Window and
segmentation are those of our filters, from depth alone; theirs used skin colour.

The objective measures the discrepancy of a pose and the observation (section 2.3):

    E = D + lambda_k kc
    D = sum min(|o_d - r_d|, d_M) / (sum (o_s or r_m) + eps)
        + lambda (1 - 2 sum (o_s and r_m) / (sum (o_s and r_m) + sum (o_s or r_m)))

with o_d and r_d observed and rendered depth, o_s the observed hand, and r_m the rendered pixels whose depth
differs from the observed by less than d_m, or where none is observed. kc = sum over adjacent fingers of
-min(phi, 0), rad, with phi the difference of their abductions: negative where they cross.

Choices: o_s comes from depth, and o_d exists on o_s only. A rendered pixel without a sensor reading counts as
``unread_weight`` of one next to the hand, as in our other costs, since o_s is unknown there. lambda = 20 and
lambda_k = 10 are printed without the unit of depth; with millimetres they track at least as well as with
centimetres (200, 100).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.swarm import Box, Optimum, SwarmRules, minimise, scattered
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig, PsoSettings
from posetrack_cli.hand.model.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    ANGLES,
    FINGERS,
    TANGENT_ANGLES,
    TANGENT_SIZE,
    HandAnatomy,
)
from posetrack_cli.hand.model.hand import HandModel, inside_limits, pose_layout, tangent_vector
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.hand.start import detected_pose, hand_estimate
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.state_codec import Fields, Value, stamp, whole
from posetrack_cli.tracking.velocity import BodySpace

_ABDUCTIONS = [ANGLE_NAMES.index(f"{finger}_mcp_abduction") for finger in FINGERS[1:]]


class Objective(NamedTuple):
    """E of N poses and its depth term.

    Attributes:
        total: (N,) E, mm.
        depth: (N,) its first term, 0..d_M, mm: the same as ``union_cost`` with c_max = d_M.
    """

    total: FloatArray
    depth: FloatArray


class SwarmObjective(Protocol):
    """Objective of the swarm's tracker."""

    def evaluate(self, poses: FloatArray, observation: Observation) -> Objective:
        """Return E of poses (N, 22)."""


def discrepancy(sums: TileSums, settings: PsoSettings, unread_weight: float) -> Objective:
    """Return D (N,), mm, from sums over pixels; empty sums count as the largest discrepancy **[ours]**.

    Args:
        sums: with ``matched`` for d_m and ``error`` for d_M.
        settings: d_M and lambda.
        unread_weight: of a rendered pixel without a reading.
    """
    outside = sums.rendered_only + unread_weight * sums.unread  # in r_m, as nothing is observed there
    either = sums.observed + outside
    apart = sums.error + settings.clamp_mm * (sums.observed - sums.both + outside)
    seen = either > 0
    depth = np.divide(apart, either, out=np.full_like(apart, settings.clamp_mm), where=seen)
    agreeing = 2.0 * sums.matched
    share = np.divide(agreeing, sums.matched + either, out=np.zeros_like(apart), where=seen)
    return Objective(depth + settings.overlap_mm * (1.0 - share), depth)


def crossing(anatomy: HandAnatomy, poses: FloatArray) -> FloatArray:
    """Return kc (N,), rad, of poses (N, 22).

    phi is taken between finger directions in the palm, including the rest pose's fan: it is 0 for parallel
    neighbours. The three pairs exclude the thumb.
    """
    mirrored = -1.0 if anatomy.is_left else 1.0
    fan = mirrored * np.arctan2(anatomy.base_rotations[1:, 1, 0], anatomy.base_rotations[1:, 0, 0])
    directions = fan + poses[:, ANGLES][:, _ABDUCTIONS]
    apart = directions[:, :-1] - directions[:, 1:]
    return np.asarray(-np.minimum(apart, 0.0).sum(axis=1))


class RenderedObjective:
    """E of hand poses by rendering, one draw call for all poses.

    Args:
        device: renders the poses.
        hand: bones, and the lean skin, which is rendered.
        camera: pinhole intrinsics of the depth images.
        config: objective, tile and swarm size.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera, config: HandConfig) -> None:
        self._anatomy, self._camera, self._settings = hand.anatomy, camera, config.pso
        self._unread_weight = config.observation.unread_weight
        tile = (config.observation.tile_px, config.observation.tile_px)
        self._renderer = device.depth_renderer(hand.lean, tile, config.pso.particles)

    def evaluate(self, poses: FloatArray, observation: Observation) -> Objective:
        """Return E of poses (N, 22)."""
        transforms, settings = skinning_transforms(self._anatomy, poses), self._settings
        sums = self._renderer.sums(
            transforms,
            self._camera,
            observation.window,
            Comparison(observation.image, settings.clamp_mm, match_mm=settings.match_mm),
        )
        found = discrepancy(sums, settings, self._unread_weight)
        penalty = settings.crossing_mm_per_rad * crossing(self._anatomy, poses)
        return Objective(found.total + penalty, found.depth)


REDRAWN = np.arange(TANGENT_ANGLES.start, TANGENT_ANGLES.stop)
"""Redrawn components: the paper's 20 of the fingers, here 15."""


@dataclass(frozen=True, eq=False)
class SwarmState:
    """Everything the next step needs; a swarm keeps only its solution between frames.

    Attributes:
        pose: (22,) last solution.
        stamp_ns: of the last frame; None before the first.
        misses: frames in a row without confidence. It starts at the limit of a lost hand, as the start pose
            is only assumed.
    """

    pose: FloatArray
    stamp_ns: int | None = None
    misses: int = 0


class SwarmTracker:
    """Tracks one hand by particle swarm optimisation.

    Args:
        config: parameters.
        anatomy: the hand.
        objective: to be minimised.
        observer: cuts out and segments windows.
        finder: detection at the start.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        objective: SwarmObjective,
        observer: Observer,
        finder: Acquisition | None = None,
    ) -> None:
        self.config, self.anatomy, self.objective = config, anatomy, objective
        self._observer, self._finder = observer, finder
        self._space = BodySpace()
        self._rules = swarm_rules(config.pso)
        self._spread = tangent_vector(config.pso.spread)
        self.codec = Fields(SwarmState, pose=Value(pose_layout()), stamp_ns=stamp(), misses=whole())

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> SwarmState:
        """Return the state with the hand at a pose (22,)."""
        return SwarmState(inside_limits(pose[None])[0], misses=self.config.status.lost_after_frames)

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> SwarmState:
        """Return the state before a first frame: the hand detected in it, else a pose (22,)."""
        return self.start(detected_pose(self._finder, frame, pose), frame.stamp_ns, rng)

    def step(self, state: SwarmState, frame: Frame, rng: np.random.Generator) -> tuple[SwarmState, Estimate]:
        """Advance by one frame; the given state is not modified.

        Without target pixels the hand does not move. The estimate's cost is the first term of E; its
        confidence is 1 - cost / d_M, or 0 without the outline of a hand: the same measures as a filter's.

        Raises:
            FilterError: stamps do not increase.
        """
        if state.stamp_ns is not None:
            check_time_step((frame.stamp_ns - state.stamp_ns) * 1e-9)
        observation = self._observer.observe(frame.depth, state.pose)
        if observation.target_pixels == 0:
            new_state = SwarmState(state.pose, frame.stamp_ns, state.misses + 1)
            return new_state, self._estimate(frame, new_state, None, None, 0)
        pose, optimum = self._search(state.pose, observation, rng)
        cost = float(self.objective.evaluate(pose[None], observation).depth[0])  # one evaluation more
        is_known = state.misses < self.config.status.lost_after_frames
        shown = self._observer.outline(frame.depth, pose).shows_hand(is_known=is_known)
        confidence = max(0.0, 1.0 - cost / self.config.pso.clamp_mm) if shown else None
        missed = confidence is None or confidence < self.config.status.lost_below
        new_state = SwarmState(pose, frame.stamp_ns, state.misses + 1 if missed else 0)
        return new_state, self._estimate(frame, new_state, cost, confidence, optimum.evaluations + 1)

    def _search(
        self, last: FloatArray, observation: Observation, rng: np.random.Generator
    ) -> tuple[FloatArray, Optimum]:
        """Return the best pose (22,) of a swarm around the last one."""
        box = search_box(last, self.config.pso.reach_mm)
        start = scattered(np.zeros(TANGENT_SIZE), self._spread, self.config.pso.particles, box, rng)
        around = np.broadcast_to(last, (len(start), len(last)))

        def total(offsets: FloatArray) -> FloatArray:
            return self.objective.evaluate(self._space.retract(around, offsets), observation).total

        optimum = minimise(total, start, box, self._rules, rng)
        moved = self._space.retract(last[None], optimum.position[None])
        return inside_limits(moved)[0], optimum  # limit - angle + angle may exceed the limit by rounding

    def _estimate(
        self, frame: Frame, state: SwarmState, cost: float | None, confidence: float | None, evaluations: int
    ) -> Estimate:
        lost = confidence is None or state.misses >= self.config.status.lost_after_frames
        return hand_estimate(
            self.anatomy,
            state.pose,
            None,
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=Status.LOST if lost else Status.TRACKING,
            confidence=confidence or 0.0,
            pose_variance=None,
            twist_variance=None,
            effective_sample_size=None,
            resampled=False,
            cost=cost,
            evaluations=evaluations,
        )


def swarm_rules(settings: PsoSettings) -> SwarmRules:
    """Return the swarm's rules of motion from a configuration.

    Raises:
        FilterError: with these coefficients the swarm does not converge.
    """
    return SwarmRules(
        settings.generations,
        settings.cognitive,
        settings.social,
        settings.redraw_every,
        settings.redraw_share,
    )


def search_box(last: FloatArray, reach_mm: float) -> Box:
    """Return the search box as tangent vectors (21,) from the last solution (22,).

    The position is within ``reach_mm`` along each axis, the rotation vector within pi, and angles are within
    their limits.
    """
    rigid = np.repeat([reach_mm, np.pi], 3)
    low = np.concatenate([-rigid, ANGLE_LIMITS[:, 0] - last[ANGLES]])
    high = np.concatenate([rigid, ANGLE_LIMITS[:, 1] - last[ANGLES]])
    return Box(low, high, REDRAWN)
