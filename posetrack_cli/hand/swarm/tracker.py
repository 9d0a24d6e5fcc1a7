"""Tracking by optimisation: every frame a swarm looks for the hand around the last frame's (BMVC 2011).

Taken over from the paper: the swarm and its constriction, 64 particles and 25 generations, the swarm's start
(the last solution and perturbations of it, at rest), the finger angles that are redrawn every third
generation in half of the particles, the objective and its numbers (see ``objective``).

Otherwise: their hand has 27 numbers (position, quaternion, four angles a finger). Ours has 22, of which the
swarm moves 21: position, body-frame rotation vector from the last solution, and 15 angles; a joint next to a
fingertip is not free but follows its neighbour. Bounds are the joint limits and, beyond them, a box about the
last solution. The standard deviations of the perturbations were "experimentally determined" there, as here
(the authors' later public tracker has 10 mm, .1 per component of the quaternion, that is .2 rad, and .1 rad).
Window and segmentation are those of our filters, in depth alone; theirs used skin colour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.filtering.swarm import Box, Optimum, SwarmRules, minimise, scattered
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.anatomy import ANGLE_LIMITS, ANGLES, TANGENT_ANGLES, TANGENT_SIZE, HandAnatomy
from posetrack_cli.hand.config import HandConfig, PsoSettings
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.observation import Observation
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.space import HandSpace, inside_limits, pose_layout, tangent_vector
from posetrack_cli.hand.swarm.objective import SwarmObjective
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate, Status
from posetrack_cli.tracking.state_codec import Fields, Value, stamp, whole

REDRAWN = np.arange(TANGENT_ANGLES.start, TANGENT_ANGLES.stop)
"""The components that are redrawn: the paper's 20 of the fingers, here 15."""


@dataclass(frozen=True, eq=False)
class SwarmState:
    """Everything the next step needs: a swarm keeps nothing from frame to frame but its solution.

    Attributes:
        pose: (22,) last solution.
        stamp_ns: of the last frame; None before the first.
        misses: frames in a row without confidence; those before the first one with it count as many as make
            a hand lost, for its start is but assumed.
    """

    pose: FloatArray
    stamp_ns: int | None = None
    misses: int = 0


class SwarmTracker:
    """Tracks one hand by particle swarm optimisation.

    Args:
        config: parameters.
        anatomy: the hand.
        camera: of the depth images.
        objective: what is minimised.
        finder: the search for a hand of which no pose is known, for the start.
    """

    def __init__(
        self,
        config: HandConfig,
        anatomy: HandAnatomy,
        camera: Camera,
        objective: SwarmObjective,
        finder: Acquisition | None = None,
    ) -> None:
        self.config, self.anatomy, self.objective = config, anatomy, objective
        self._finder = finder
        self._observer = Observer(config, anatomy, camera, segment=True)
        self._space = HandSpace()
        self._rules = swarm_rules(config.pso)
        self._spread = tangent_vector(config.pso.spread)
        self.codec = Fields(SwarmState, pose=Value(pose_layout()), stamp_ns=stamp(), misses=whole())

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> SwarmState:
        """Return the state in which the hand is at a pose (22,)."""
        return SwarmState(inside_limits(pose[None])[0], misses=self.config.status.lost_after_frames)

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> SwarmState:
        """Return the state before a first frame: the hand that is found in it, else a pose (22,)."""
        found = None if self._finder is None else self._finder.search(frame.depth)
        return self.start(pose if found is None else found.pose, frame.stamp_ns, rng)

    def step(self, state: SwarmState, frame: Frame, rng: np.random.Generator) -> tuple[SwarmState, Estimate]:
        """Advance by one frame; the state given is left as it is.

        Where there is nothing to compare with, the hand stays where it was. The estimate's cost is the
        objective's first term, its confidence 1 - cost / d_M, and 0 where the frame shows no outline of a
        hand there: the same measures as a filter's.

        Args:
            state: after the frame before.
            frame: depth, mm.
            rng: source of randomness.

        Raises:
            FilterError: stamps do not increase.
        """
        if state.stamp_ns is not None:
            check_time_step((frame.stamp_ns - state.stamp_ns) * 1e-9)
        observation = self._observer.observe(frame.depth, state.pose)
        if observation.target_pixels == 0:
            following = SwarmState(state.pose, frame.stamp_ns, state.misses + 1)
            return following, self._estimate(frame, following, None, None, 0)
        pose, optimum = self._search(state.pose, observation, rng)
        cost = float(self.objective.evaluate(pose[None], observation).depth[0])  # one evaluation more
        is_known = state.misses < self.config.status.lost_after_frames
        shown = self._observer.shows_hand(frame.depth, pose, is_known=is_known)
        confidence = max(0.0, 1.0 - cost / self.config.pso.clamp_mm) if shown else None
        missed = confidence is None or confidence < self.config.status.lost_below
        following = SwarmState(pose, frame.stamp_ns, state.misses + 1 if missed else 0)
        return following, self._estimate(frame, following, cost, confidence, optimum.evaluations + 1)

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
        return Estimate(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            status=Status.LOST if lost else Status.TRACKING,
            confidence=confidence or 0.0,
            position=state.pose[:3],
            quaternion=state.pose[3:7],
            shape=state.pose[ANGLES],
            pose_rate=None,
            twist=None,
            pose_variance=None,
            twist_variance=None,
            points=joint_positions(self.anatomy, state.pose[None])[0],
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
