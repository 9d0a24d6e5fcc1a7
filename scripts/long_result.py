"""A result as long as one likes, with truth: natural motion, and estimates off by noise of known strength."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, ANGLES, JOINT_NAMES, JOINT_PARENTS, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import (
    ESTIMATE_SCHEMA,
    ESTIMATE_SCHEMA_NAME,
    Estimate,
    ResultWriter,
    Status,
    Subject,
    estimate_to_json,
)
from posetrack_cli.synthesis.hand.frames import CAMERA
from posetrack_cli.synthesis.hand.motion import natural_motion
from posetrack_cli.tracking.velocity import BodySpace, pose_rates

SUBJECT = Subject("hand", CAMERA.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
SD = np.r_[np.full(3, 5.0), np.full(3, 0.06), np.full(15, 0.12)]
"""Of the estimates' errors, mm and rad; stated as their covariance, too."""
FRAME_S = 1.0 / 30.0
SCRIPT_S = 300.0
LOST_EVERY, LOST_FOR = 1000, 10


def write_long_result(path: Path, frames: int, seed: int = 0) -> None:
    """Write a result of so many frames; every thousandth begins ten that are lost."""
    rng = np.random.default_rng(seed)
    times: FloatArray = np.mod(FRAME_S * np.arange(frames), SCRIPT_S, dtype=np.float64)
    script = natural_motion(min(SCRIPT_S, frames * FRAME_S), 1.0, rng)
    anatomy, schema = make_anatomy(), json.dumps(ESTIMATE_SCHEMA).encode()
    run = {"tracker": "hand", "configuration": json.dumps(HandConfig().model_dump(mode="json"))}
    with ResultWriter(path, SUBJECT, CAMERA, run) as writer:
        for block in np.array_split(np.arange(frames), max(1, frames // 1000)):
            true, twists = script.poses(times[block]), script.twists(times[block])
            poses = BodySpace().retract(true, SD * rng.standard_normal((len(block), len(SD))))
            poses[:, 3:7] = rotations.canonical(poses[:, 3:7])
            joints = joint_positions(anatomy, np.concatenate([poses, true])).reshape(2, len(block), -1, 3)
            for row, index in enumerate(block.tolist()):
                truth = _estimate(index, true[row], twists[row], joints[1, row])
                topic, stamp, data = "/truth/hand/estimate", truth.stamp_ns, estimate_to_json(truth)
                writer.add_truth(
                    TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", schema, "json", stamp, data)
                )
                lost = index % LOST_EVERY < LOST_FOR
                writer.write(_estimate(index, poses[row], twists[row], joints[0, row], lost=lost))
        writer.finish({})


def _estimate(
    index: int, pose: FloatArray, twist: FloatArray, joints: FloatArray, *, lost: bool = False
) -> Estimate:
    return Estimate(
        frame_index=index,
        stamp_ns=round(1e9 * FRAME_S * (index + 1)),
        status=Status.LOST if lost else Status.TRACKING,
        confidence=0.2 if lost else 0.8,
        position=pose[:3],
        quaternion=pose[3:7],
        shape=pose[ANGLES],
        pose_rate=pose_rates(pose, twist),
        twist=twist,
        pose_variance=SD**2,
        twist_variance=SD**2,
        points=joints,
        effective_sample_size=100.0,
        resampled=True,
        cost=10.0,
        milliseconds=30.0,
    )
