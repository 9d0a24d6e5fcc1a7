"""Poses that a hand may have of which only the place is known."""

from __future__ import annotations

from itertools import product

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.anatomy import ANGLES, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.segmentation import Detection

_D = np.pi / 180.0
# Thumb CMC, MCP, abduction; then MCP flexion, abduction, PIP flexion of each finger, degrees.
_FOLDED = (80.0, 0.0, 95.0)
_SHAPES: FloatArray = _D * np.array(
    [
        (-5, 5, 0, 3, 5, 5, 3, 0, 5, 3, -4, 5, 4, -8, 6),  # open
        (8, 20, 0, 30, 2, 40, 30, 0, 42, 32, -2, 43, 35, -5, 44),  # half closed
        (15, 45, -20, *_FOLDED, *_FOLDED, *_FOLDED, *_FOLDED),  # fist
        (35, 34, -25, 3, 5, 5, 3, -5, 5, *_FOLDED, *_FOLDED),  # two fingers
    ]
)
_TURNS = _D * np.arange(0.0, 360.0, 30.0)  # about the hand's own length
_TILTS = _D * np.array([-35.0, 0.0, 35.0])  # of the wrist, towards palm and back
_SURFACE_MM = 12.0  # from the skin to the bones of a palm
_IN_PLANE = _D * np.arange(0.0, 360.0, 30.0)
_KNUCKLES = [0, 5, 9, 13, 17]  # joints whose mean is the palm's middle


def detected_poses(detection: Detection, anatomy: HandAnatomy) -> FloatArray:
    """Poses (H, 22) of a detected hand: turned about its length, tilted, open to closed **[ours]**.

    The fingers point away from the elbow; where no forearm is seen, in all directions of the image.
    """
    if detection.arm is not None:
        turns = _turned(detection.arm, _TILTS)
    else:
        ways = np.stack([np.sin(_IN_PLANE), -np.cos(_IN_PLANE), np.zeros(len(_IN_PLANE))], axis=1)
        turns = [rotation for way in ways for rotation in _turned(way, np.zeros(1))]
    middle = detection.palm + _SURFACE_MM * detection.palm / np.linalg.norm(detection.palm)
    return _placed(np.array(turns), middle, anatomy)


def turned_poses(pose: FloatArray, anatomy: HandAnatomy) -> FloatArray:
    """Poses (H, 22) that look much like one that was lost: turned about its length, and closed or opened."""
    palm = joint_positions(anatomy, pose[None])[0, _KNUCKLES].mean(axis=0)
    about = [rotations.exponential(np.array([0.0, turn, 0.0])) for turn in _TURNS]
    turns = np.array([rotations.multiply(pose[3:7], turn) for turn in about])
    return np.concatenate([_placed(turns, palm, anatomy), _placed(turns, palm, anatomy, pose[None, ANGLES])])


def _turned(along: FloatArray, tilts: FloatArray) -> list[FloatArray]:
    """Rotations of a hand whose forearm points along a unit vector."""
    arm = _pointing(along)
    return [
        rotations.multiply(
            rotations.multiply(arm, rotations.exponential(np.array([0.0, turn, 0.0]))),
            rotations.exponential(np.array([tilt, 0.0, 0.0])),
        )
        for turn, tilt in product(_TURNS, tilts)
    ]


def _pointing(along: FloatArray) -> FloatArray:
    """The smallest rotation (4,) that points the fingers, -y, along a unit vector."""
    up = np.array([0.0, -1.0, 0.0])
    axis, cosine = np.cross(up, along), float(up @ along)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return rotations.exponential(np.array([0.0, 0.0, 0.0 if cosine > 0 else np.pi]))
    return rotations.exponential(axis / sine * np.arctan2(sine, cosine))


def _placed(
    turns: FloatArray, middle: FloatArray, anatomy: HandAnatomy, shapes: FloatArray = _SHAPES
) -> FloatArray:
    """Every rotation (M, 4) with every shape (K, 15), the palm's middle at a point (3,): (M K, 22)."""
    poses = np.zeros((len(turns) * len(shapes), POSE_SIZE))
    poses[:, 3:7] = np.repeat(rotations.canonical(turns), len(shapes), axis=0)
    poses[:, ANGLES] = np.tile(shapes, (len(turns), 1))
    poses[:, :3] = middle - joint_positions(anatomy, poses)[:, _KNUCKLES].mean(axis=1)
    return poses
