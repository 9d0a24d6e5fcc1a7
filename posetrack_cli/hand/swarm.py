"""Tracking by optimisation: every frame a swarm looks for the hand around the last frame's (BMVC 2011).

Taken over from the paper: the swarm and its constriction, 64 particles and 25 generations, the swarm's start
(the last solution and perturbations of it, at rest), the finger angles that are redrawn every third
generation in half of the particles, the objective and its numbers.

Otherwise: their hand has 27 numbers (position, quaternion, four angles a finger). Ours has 22, of which the
swarm moves 21: position, body-frame rotation vector from the last solution, and 15 angles; a joint next to a
fingertip is not free but follows its neighbour. Bounds are the joint limits and, beyond them, a box about the
last solution. The standard deviations of the perturbations were "experimentally determined" there, as here
(the authors' later public tracker has 10 mm, .1 per component of the quaternion, that is .2 rad, and .1 rad).
Window and segmentation are those of our filters, in depth alone; theirs used skin colour.

The objective says how far a hand pose is from what is seen (section 2.3):

    E = D + lambda_k kc
    D = sum min(|o_d - r_d|, d_M) / (sum (o_s or r_m) + eps)
        + lambda (1 - 2 sum (o_s and r_m) / (sum (o_s and r_m) + sum (o_s or r_m)))

with o_d and r_d observed and rendered depth, o_s the observed hand, and r_m the rendered pixels whose depth
differs from the observed by less than d_m, or where none is observed. kc = sum over adjacent fingers of
-min(phi, 0), rad, with phi the difference of their abductions: below 0 they go through each other.

What is taken how: o_s comes from depth alone (the paper: skin colour), and there is no o_d outside of it. A
rendered pixel where the sensor has no reading counts as ``unread_weight`` of one beside the hand, as in every
cost of ours: o_s is not known there. lambda = 20 and lambda_k = 10 are printed without the unit that depth is
in: they are taken with millimetres, which tracked as well as or better than with centimetres (200, 100).
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
    """E of N poses and the part of it that is a distance in depth.

    Attributes:
        total: (N,) E, mm.
        depth: (N,) its first term, 0..d_M, mm: the same number as ``union_cost`` with c_max = d_M.
    """

    total: FloatArray
    depth: FloatArray


class SwarmObjective(Protocol):
    """What the swarm's tracker asks for."""

    def evaluate(self, poses: FloatArray, observation: Observation) -> Objective:
        """E of poses (N, 22)."""


def discrepancy(sums: TileSums, settings: PsoSettings, unread_weight: float) -> Objective:
    """D (N,), mm, of its sums over the pixels; both sums empty count as the largest discrepancy **[ours]**.

    Args:
        sums: with ``matched`` for d_m and ``error`` for d_M.
        settings: d_M and lambda.
        unread_weight: of a rendered pixel without a reading.
    """
    beside = sums.rendered_only + unread_weight * sums.unread  # in r_m, for nothing is observed there
    either = sums.observed + beside
    apart = sums.error + settings.clamp_mm * (sums.observed - sums.both + beside)
    seen = either > 0
    depth = np.divide(apart, either, out=np.full_like(apart, settings.clamp_mm), where=seen)
    agreeing = 2.0 * sums.matched
    share = np.divide(agreeing, sums.matched + either, out=np.zeros_like(apart), where=seen)
    return Objective(depth + settings.overlap_mm * (1.0 - share), depth)


def crossing(anatomy: HandAnatomy, poses: FloatArray) -> FloatArray:
    """kc (N,), rad, of poses (N, 22).

    phi is taken between the fingers' directions in the palm, fan of the rest pose included: it is 0 where
    neighbours are parallel. The three pairs leave out the thumb.
    """
    mirrored = -1.0 if anatomy.is_left else 1.0
    fan = mirrored * np.arctan2(anatomy.base_rotations[1:, 1, 0], anatomy.base_rotations[1:, 0, 0])
    directions = fan + poses[:, ANGLES][:, _ABDUCTIONS]
    apart = directions[:, :-1] - directions[:, 1:]
    return np.asarray(-np.minimum(apart, 0.0).sum(axis=1))


class RenderedObjective:
    """E of hand poses by rendering them: one draw for all poses of a call.

    Args:
        device: draws the poses.
        hand: its bones, and its lean skin, which is drawn.
        camera: pinhole intrinsics of the depth images.
        config: objective, size of a tile, size of the swarm.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera, config: HandConfig) -> None:
        self._anatomy, self._camera, self._settings = hand.anatomy, camera, config.pso
        self._unread_weight = config.observation.unread_weight
        tile = (config.observation.tile_px, config.observation.tile_px)
        self._renderer = device.depth_renderer(hand.lean, tile, config.pso.particles)

    def evaluate(self, poses: FloatArray, observation: Observation) -> Objective:
        """E of poses (N, 22)."""
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
"""The components that are redrawn: the paper's 20 of the fingers, here 15."""


@dataclass(frozen=True, eq=False)
class SwarmState:
    """Everything the next step needs: a swarm keeps nothing from frame to frame but its solution.

    Attributes:
        pose: (22,) last solution.
        stamp_ns: of the last frame; None before the first.
        misses: frames in a row without confidence. It starts at the number that makes a hand lost, as the
            start pose is only assumed.
    """

    pose: FloatArray
    stamp_ns: int | None = None
    misses: int = 0


class SwarmTracker:
    """Tracks one hand by particle swarm optimisation.

    Args:
        config: parameters.
        anatomy: the hand.
        objective: what is minimised.
        observer: cuts out and segments windows.
        finder: the search for a hand of which no pose is known, for the start.
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
        """Return the state in which the hand is at a pose (22,)."""
        return SwarmState(inside_limits(pose[None])[0], misses=self.config.status.lost_after_frames)

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> SwarmState:
        """Return the state before a first frame: the hand that is found in it, else a pose (22,)."""
        return self.start(detected_pose(self._finder, frame, pose), frame.stamp_ns, rng)

    def step(self, state: SwarmState, frame: Frame, rng: np.random.Generator) -> tuple[SwarmState, Estimate]:
        """Advance by one frame; the state given is left as it is.

        Where there is nothing to compare with, the hand stays where it was. The estimate's cost is the
        objective's first term, its confidence 1 - cost / d_M, and 0 where the frame shows no outline of a
        hand there: the same measures as a filter's.

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
        """The best pose (22,) that a swarm finds around the last one."""
        box = search_box(last, self.config.pso.reach_mm)
        start = scattered(np.zeros(TANGENT_SIZE), self._spread, self.config.pso.particles, box, rng)
        around = np.broadcast_to(last, (len(start), len(last)))

        def total(offsets: FloatArray) -> FloatArray:
            return self.objective.evaluate(self._space.retract(around, offsets), observation).total

        optimum = minimise(total, start, box, self._rules, rng)
        moved = self._space.retract(last[None], optimum.position[None])
        return inside_limits(moved)[0], optimum  # limit - angle + angle may round to beyond the limit

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
    """The rules of the swarm's motion that a configuration states.

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
    """Where the swarm looks, as tangent vectors (21,) from the last solution (22,).

    The position is within ``reach_mm`` along each axis, the rotation vector within pi, and the angles are
    within their limits.
    """
    rigid = np.repeat([reach_mm, np.pi], 3)
    low = np.concatenate([-rigid, ANGLE_LIMITS[:, 0] - last[ANGLES]])
    high = np.concatenate([rigid, ANGLE_LIMITS[:, 1] - last[ANGLES]])
    return Box(low, high, REDRAWN)
