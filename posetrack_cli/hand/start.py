"""How a track begins, and what a tracker offers to whoever runs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

import numpy as np
from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.configuration import Settings, validated
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_text
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.confidence import NO_EVIDENCE, NO_SIGNS, SIGN_NAMES
from posetrack_cli.hand.config import ComponentSettings
from posetrack_cli.hand.fit.skeleton import INNER_NUMBERS, NO_THUMB, THUMB, inner_numbers
from posetrack_cli.hand.model.anatomy import ANGLES, POSE_SIZE, HandAnatomy
from posetrack_cli.hand.model.hand import inside_limits, tangent_vector
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.search import Acquisition
from posetrack_cli.mcap.stream import McapFile, is_mcap
from posetrack_cli.recording.base import Frame
from posetrack_cli.results.estimate import Estimate
from posetrack_cli.results.estimate_json import estimate_from_json
from posetrack_cli.text import parse_toml
from posetrack_cli.tracking.confidence import RunningSigns
from posetrack_cli.tracking.loop import Tracker
from posetrack_cli.tracking.velocity import BodySpace, pose_rates

# Where a hand run starts: the middle of the image, or a pose from a file


ESTIMATE_TOPICS = ("/hand/estimate", "/truth/hand/estimate")
START_SPREAD = ComponentSettings(position_mm=20.0, rotation_rad=0.15, flexion_rad=0.15, abduction_rad=0.08)
"""Standard deviations of the first pose."""
USUAL_DEPTH_MM = 650.0
# The hand is the nearest thing in the middle half of the image, as deep as a hand is.
_HAND_DEPTH_MM = 100.0
_NEAREST_PERCENT = 2.0

Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class PoseFile(Settings):
    """A pose in a TOML or JSON file; what is left out is as in the rest pose."""

    position_mm: tuple[Number, Number, Number]
    quaternion_xyzw: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    angles_rad: Annotated[tuple[Number, ...], Field(min_length=15, max_length=15)] = (0.0,) * 15


def rest_pose(anatomy: HandAnatomy, centre: FloatArray) -> FloatArray:
    """The pose (22,) of an open hand, palm to the sensor, with the mean of its joints at a point (3,), mm."""
    pose = np.zeros(POSE_SIZE)
    pose[6] = 1.0
    pose[:3] = centre - joint_positions(anatomy, pose[None])[0].mean(axis=0)
    return pose


def scattered_poses(anatomy: HandAnatomy, count: int, rng: np.random.Generator) -> FloatArray:
    """Poses (N, 22) as the start's prior spreads them, 650 mm away: what benchmarks draw."""
    start = np.tile(rest_pose(anatomy, np.array([0.0, 0.0, USUAL_DEPTH_MM])), (count, 1))
    spread = tangent_vector(START_SPREAD)
    return inside_limits(BodySpace().retract(start, spread * rng.standard_normal((count, spread.size))))


def centre_pose(
    depth: ImageArray, camera: Camera, anatomy: HandAnatomy, depth_mm: float | None
) -> FloatArray:
    """The paper's start (7.3): an open hand, its palm to the sensor, in the middle of the image.

    Without ``depth_mm`` the nearest surface in the middle half of the image says where exactly **[ours]**;
    if nothing is read there the hand is put 650 mm away.

    Returns:
        (22,) pose.
    """
    middle = np.array([0.5 * (camera.width - 1), 0.5 * (camera.height - 1)])
    pixel, z = (middle, depth_mm) if depth_mm else _nearest_in_the_middle(depth, middle)
    return rest_pose(anatomy, camera.points_from_pixels(pixel, np.asarray(z)))


def _nearest_in_the_middle(depth: ImageArray, middle: FloatArray) -> tuple[FloatArray, float]:
    height, width = depth.shape
    part = depth[height // 4 : height - height // 4, width // 4 : width - width // 4]
    read = part[part > 0]
    if not read.size:
        return middle, USUAL_DEPTH_MM
    nearest = float(np.percentile(read, _NEAREST_PERCENT))
    rows, columns = np.nonzero((part > 0) & (part < nearest + _HAND_DEPTH_MM))
    pixel = np.array([columns.mean() + width // 4, rows.mean() + height // 4])
    return pixel, float(np.median(part[rows, columns]))


def read_pose(path: Path) -> FloatArray:
    """Read a start pose (22,).

    Args:
        path: TOML or JSON with ``position_mm``, ``quaternion_xyzw``, ``angles_rad`` (15); or MCAP: the first
            pose of a result, or of a recording's ``/truth/hand/estimate``.

    Raises:
        UsageError: no such file, or no pose in it.
    """
    if not path.exists():
        raise UsageError("no such file to start from", where=path, expected="a pose file, or --init center")
    if path.suffix == ".mcap" or is_mcap(path):  # also NAME.mcap.part
        return _first_pose(path)
    values = validated(PoseFile, _parse(path), path)
    quaternion = np.array(values.quaternion_xyzw)
    if np.linalg.norm(quaternion) < 1e-3:
        raise UsageError("'quaternion_xyzw' cannot be used", where=path, found="zero length")
    unit = rotations.canonical(quaternion / np.linalg.norm(quaternion))
    return np.concatenate([values.position_mm, unit, values.angles_rad])


def _parse(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path, limits.TEXT_BYTES)
        parsed = json.loads(text) if path.suffix == ".json" else parse_toml(text)
    except (OSError, ValueError, RecursionError) as error:
        found = getattr(error, "strerror", None) or error
        raise UsageError("start pose cannot be read", where=path, found=found) from error
    if not isinstance(parsed, dict):
        raise UsageError(
            "start pose cannot be used",
            where=path,
            found=repr(parsed),
            expected="an object with position_mm, quaternion_xyzw and angles_rad",
        )
    return parsed


def _first_pose(path: Path) -> FloatArray:
    """The first estimate in a result, or the first true pose in a recording."""
    for topic in ESTIMATE_TOPICS:
        for _, _, message in McapFile(path).messages([topic]):
            first = estimate_from_json(message.data)
            if first.shape.size == POSE_SIZE - 7:
                return np.concatenate([first.position, first.quaternion, first.shape])
            break
    raise UsageError("holds no hand pose", where=path, expected=" or ".join(ESTIMATE_TOPICS))


# What hand trackers have in common: how they begin, and what their estimates say of a pose


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


def detected_pose(finder: Acquisition | None, frame: Frame, otherwise: FloatArray) -> FloatArray:
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
