"""Results of hands that turn around while their fingers go from limit to limit."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.skeleton import FOREARM, INNER_NUMBERS, NO_INNER, NO_THUMB, inner_numbers
from posetrack_cli.hand.model.anatomy import (
    ANGLE_LIMITS,
    ANGLE_NAMES,
    JOINT_NAMES,
    JOINT_PARENTS,
    HandAnatomy,
    HandShape,
    make_anatomy,
    reshaped_anatomy,
)
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.results import Estimate, ResultWriter, Status, Subject
from support.results import CAMERA, make_estimate, with_fields

FRAMES, STEP_NS = 40, 33_333_333
SUBJECT = Subject("hand", "kinect", ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
SHAPE = HandShape(0.9, (1.1, 1.0, 0.95, 1.0, 1.05), palm_width=1.1, thumb_place=1.2, coefficients=(1.0, -0.5))


def hand(side: str) -> HandAnatomy:
    return reshaped_anatomy(make_anatomy(), side, SHAPE)


def poses(anatomy: HandAnatomy) -> np.ndarray:
    """A hand that turns all the way around while its fingers go from limit to limit."""
    along = np.linspace(0.0, 1.0, FRAMES)[:, None]
    low, high = ANGLE_LIMITS.T
    turning = Rotation.from_rotvec(along * [5.0, 1.0, -2.0]).as_quat(canonical=True)
    places = [20.0, -30.0, 700.0] + 100.0 * np.sin(6.0 * along + [0.0, 1.0, 2.0])
    return np.hstack([places, turning, low + (high - low) * along])


def thumbs() -> np.ndarray:
    """Inner angles (F, 2) that come and go."""
    return 0.4 * np.sin(np.linspace(0.0, 7.0, FRAMES)[:, None] + [0.0, 1.0])


def estimate(
    anatomy: HandAnatomy, pose: np.ndarray, index: int, thumb: np.ndarray | None = None, **fields: object
) -> Estimate:
    made = make_estimate(index, k=15, p=21)
    stated = {"position": pose[:3], "quaternion": pose[3:7], "shape": pose[7:], "status": Status.TRACKING}
    stated |= {"stamp_ns": index * STEP_NS} | fields
    points = joint_positions(anatomy, pose[None], NO_THUMB if thumb is None else thumb)[0]
    if thumb is not None:
        stated["numbers"] = inner_numbers(np.concatenate([NO_INNER[FOREARM], thumb]))
    return with_fields(made, **stated, points=points)


def write(
    path: Path,
    anatomy: HandAnatomy,
    left_out: range = range(0),
    *,
    inner: bool = False,
    camera: Camera = CAMERA,
    lost: Collection[int] = (),
    first_ns: int = 0,
) -> Path:
    """A result, with a thumb's inner angles or as older versions wrote it.

    Args:
        path: where it goes.
        anatomy: whose joints it has.
        left_out: frames that it lacks.
        inner: whether it has the thumb's inner angles.
        camera: that recorded it.
        lost: frames that are lost; the one after each is reinitialised.
        first_ns: stamp of the first frame.
    """
    subject = replace(SUBJECT, number_names=INNER_NUMBERS) if inner else SUBJECT
    settings = {"side": anatomy.side, **{name: getattr(SHAPE, name) for name in ("scale", "finger_lengths")}}
    settings |= {name: getattr(SHAPE, name) for name in ("palm_width", "thumb_place", "coefficients")}
    configuration = HandConfig.model_validate({"hand": settings}).model_dump(mode="json")
    run = {"configuration": json.dumps(configuration), "camera": json.dumps(camera.values())}
    with ResultWriter(path, subject, camera, run) as writer:
        for index, pose in enumerate(poses(anatomy)):
            if index in left_out:
                continue
            known: dict[str, object] = {"stamp_ns": first_ns + index * STEP_NS}
            if index in lost or index - 1 in lost:
                known["status"] = Status.LOST if index in lost else Status.REINITIALISED
            writer.write(estimate(anatomy, pose, index, thumbs()[index] if inner else None, **known))
        writer.finish({})
    return path
