"""A hand followed through a recording by local fits alone: the poses that a calibration starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import POSE_SIZE
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fitting.fitter import PosePrior
from posetrack_cli.hand.guiding import Guiding
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.observer import Observer
from posetrack_cli.hand.segmentation import Detection, detect
from posetrack_cli.hand.space import HandSpace, inside_limits
from posetrack_cli.recording.base import Frame

_KEPT_VELOCITY = 0.8
_LOST_COST_SHARE = 0.45
"""Of the clamp: a hand that fits no better is looked for anew."""
_FIRST_ITERATIONS = 12
_FREE_PRECISION: FloatArray = 1.0 / np.repeat([60.0, 0.8, 0.7], [3, 3, 15]) ** 2
_BENT = np.array([0.2, 0.2, 0.0, *[0.5, 0.0, 0.7] * 4])
_SPACE = HandSpace()


@dataclass(frozen=True, eq=False)
class Followed:
    """Poses of a hand in frames.

    Attributes:
        poses: (F, 22).
        costs: (F,) union costs, mm; infinite where no hand was found.
    """

    poses: FloatArray
    costs: FloatArray


class Follower:
    """Follows one hand model.

    Args:
        config: of window, segmentation, detection and fits.
        hand: the model.
        camera: of the depth images.
    """

    def __init__(self, config: HandConfig, hand: HandModel, camera: Camera) -> None:
        self._config, self._hand, self._camera = config, hand, camera
        self._observer = Observer(config, hand.anatomy, camera, segment=True)
        self._guiding = Guiding(config, hand, camera)

    def follow(self, frames: Sequence[Frame], rng: np.random.Generator) -> Followed:
        """Return the hand's poses; where it is lost it is looked for in the whole image."""
        poses, costs = np.zeros((len(frames), POSE_SIZE)), np.full(len(frames), np.inf)
        poses[:, 6] = 1.0
        worst = _LOST_COST_SHARE * self._config.observation.clamp_mm
        for k, frame in enumerate(frames):
            known = k > 0 and costs[k - 1] < worst
            before = poses[k - 2] if k > 1 and costs[k - 2] < worst else poses[k - 1]
            found = self._next(frame, poses[k - 1], before, rng) if known else self._first(frame)
            if found is not None:
                poses[k], costs[k] = found
        return Followed(poses, costs)

    def _next(
        self, frame: Frame, last: FloatArray, before: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, float] | None:
        moved = _KEPT_VELOCITY * _SPACE.local(before[None], last[None])
        expected = inside_limits(_SPACE.retract(last[None], moved))[0]
        observation = self._observer.observe(frame.depth, expected)
        if observation.target_pixels == 0:
            return None
        fits = self._guiding.fit(observation, expected, last[None], 1.0 / 30.0, rng)
        return inside_limits(fits.modes.poses[:1])[0], fits.cost

    def _first(self, frame: Frame) -> tuple[FloatArray, float] | None:
        """The best fit to the likeliest hand in the image from several starts."""
        detections = detect(frame.depth, self._camera, self._config.detection)
        if not detections:
            return None
        starts = first_poses(detections[0], self._hand)
        observation = self._observer.observe(frame.depth, starts[0])
        if observation.target_pixels == 0:
            return None
        fitter = self._guiding.fitter
        tile = fitter.tile(observation)
        starts = fitter.aligned(tile, starts)
        fits = fitter.descend(
            tile, starts, [PosePrior(start, _FREE_PRECISION) for start in starts], _FIRST_ITERATIONS
        )
        best = min(fits, key=lambda fit: float(fit.cost[0]))
        return inside_limits(best.pose[None])[0], float(best.cost[0])


def first_poses(detection: Detection, hand: HandModel) -> FloatArray:
    """Poses (8, 22) that a detected hand may have.

    The fingers point away from the elbow, or up where no forearm is seen; the palm or the back faces the
    sensor, straight or turned by half a right angle to either side; fingers open, and bent a little.
    """
    along = detection.arm if detection.arm is not None else np.array([0.0, -1.0, 0.0])
    turns = [
        (0.0, 0),
        (np.pi, 0),
        (0.0, 1),
        (np.pi, 1),
        (0.8, 0),
        (-0.8, 0),
        (np.pi + 0.8, 0),
        (np.pi - 0.8, 0),
    ]
    poses = np.zeros((len(turns), POSE_SIZE))
    upright = _pointing(along)
    for pose, (turn, bent) in zip(poses, turns, strict=True):
        pose[3:7] = rotations.multiply(upright, rotations.exponential(np.array([0.0, turn, 0.0])))
        pose[7:] = bent * _BENT
        palm = joint_positions(hand.anatomy, pose[None])[0, [0, 5, 9, 13, 17]].mean(axis=0)
        pose[:3] = detection.palm + np.array([0.0, 0.0, 10.0]) - palm
    poses[:, 3:7] = rotations.canonical(poses[:, 3:7])
    return poses


def _pointing(along: FloatArray) -> FloatArray:
    """The smallest rotation (4,) that points the fingers, -y, along a unit vector."""
    up = np.array([0.0, -1.0, 0.0])
    axis, cosine = np.cross(up, along), float(up @ along)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return rotations.exponential(np.array([0.0, 0.0, 0.0 if cosine > 0 else np.pi]))
    return rotations.exponential(axis / sine * np.arctan2(sine, cosine))
