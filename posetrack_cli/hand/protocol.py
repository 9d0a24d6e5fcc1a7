"""What hand trackers have in common: how they begin, and what their estimates say of a pose."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.anatomy import ANGLES, HandAnatomy
from posetrack_cli.hand.confidence import NO_EVIDENCE, NO_SIGNS, SIGN_NAMES
from posetrack_cli.hand.inner import INNER_NUMBERS, NO_THUMB, THUMB, inner_numbers
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.tracking.body_space import pose_rates
from posetrack_cli.tracking.confidence import RunningSigns
from posetrack_cli.tracking.loop import Tracker

NUMBER_NAMES = (*INNER_NUMBERS, *SIGN_NAMES, "forearm_confidence")
"""Of an estimate's numbers: the inner ones, what its confidence is made of, and the forearm's own; NaN where
it has none."""

State = TypeVar("State")


class HandTrackerProtocol(Tracker[State], Protocol[State]):
    """A hand tracker: begins at a pose, or without one."""

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> State:
        """Return the state about a pose (22,) before the first frame, whose stamp is given."""

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame in which the hand is not found yet, else at a pose (22,)."""


def forearm_confidence_of(numbers: FloatArray | None) -> float:
    """The confidence of the forearm that an estimate's numbers tell; NaN where there is none.

    Results of before it was stated have none either.
    """
    return float(numbers[-1]) if numbers is not None and len(numbers) == len(NUMBER_NAMES) else np.nan


def found_pose(finder: Acquisition | None, frame: Frame, otherwise: FloatArray) -> FloatArray:
    """Return the pose (22,) of the hand that is found in a frame, else the one given."""
    found = None if finder is None else finder.search(frame.depth)
    return otherwise if found is None else found.pose


def hand_estimate(
    anatomy: HandAnatomy,
    pose: FloatArray,
    velocity: FloatArray | None,
    inner: FloatArray | None = None,
    evidence: RunningSigns = NO_EVIDENCE,
    forearm_confidence: float = np.nan,
    **others: Any,
) -> Estimate:
    """Return the estimate of a hand at a pose.

    Args:
        anatomy: the hand.
        pose: (22,).
        velocity: (21,) in the tangent space; None where it is not known.
        inner: (6,) inner numbers; None of a tracker that has none.
        evidence: of what its confidence is made; none of a pose that has none of its own.
        forearm_confidence: of the forearm, if it has one; NaN of a pose of which it is not known.
        others: the estimate's further fields.
    """
    thumb = NO_THUMB if inner is None else inner[THUMB]
    signs = evidence.signs if evidence.frames else NO_SIGNS
    numbers = None
    if inner is not None:
        arm = forearm_confidence if inner[:3].any() else np.nan
        numbers = np.concatenate([inner_numbers(inner), signs, [arm]])
    return Estimate(
        position=pose[:3],
        quaternion=pose[3:7],
        shape=pose[ANGLES],
        pose_rate=None if velocity is None else pose_rates(pose, velocity),
        twist=velocity,
        points=joint_positions(anatomy, pose[None], thumb)[0],
        numbers=numbers,
        **others,
    )
