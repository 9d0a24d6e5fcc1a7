"""Start of a track, and what hand trackers have in common."""

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
from posetrack_cli.results.estimate_json import estimate_from_json, json_of_estimate
from posetrack_cli.text import parse_toml
from posetrack_cli.tracking.confidence import RunningSigns
from posetrack_cli.tracking.loop import Tracker
from posetrack_cli.tracking.velocity import BodySpace, pose_rates

# Start pose: the middle of the image, or a file

ESTIMATE_TOPICS = ("/hand/estimate", "/truth/hand/estimate")
START_SPREAD = ComponentSettings(position_mm=20.0, rotation_rad=0.15, flexion_rad=0.15, abduction_rad=0.08)
"""Standard deviations of the first pose."""
USUAL_DEPTH_MM = 650.0
# The hand is the nearest surface in the middle half of the image; a percentile ignores outliers.
_HAND_DEPTH_MM = 100.0
_NEAREST_PERCENT = 2.0

Number = Annotated[float, Field(ge=-1e6, le=1e6)]


class PoseFile(Settings):
    """A pose in a TOML or JSON file; omitted values are those of the rest pose."""

    position_mm: tuple[Number, Number, Number]
    quaternion_xyzw: tuple[Number, Number, Number, Number] = (0.0, 0.0, 0.0, 1.0)
    angles_rad: Annotated[tuple[Number, ...], Field(min_length=15, max_length=15)] = (0.0,) * 15


def with_doubt(pose_variance: FloatArray, confidence: float) -> FloatArray:
    """Return the variance (21,) of a pose that is right with a probability, and else as vague as a start.

    By the law of total variance. A wrong estimate is off by about ``START_SPREAD``: with it, 90 % intervals
    hold 88 to 97 % of the annotated coordinates of three real hands, instead of 42 to 77 %.
    """
    return pose_variance + (1.0 - confidence) * tangent_vector(START_SPREAD) ** 2


def rest_pose(anatomy: HandAnatomy, centre: FloatArray) -> FloatArray:
    """Return the pose (22,) of an open hand, palm facing the sensor, with its joints' mean at (3,), mm."""
    pose = np.zeros(POSE_SIZE)
    pose[6] = 1.0
    pose[:3] = centre - joint_positions(anatomy, pose[None])[0].mean(axis=0)
    return pose


def scattered_poses(anatomy: HandAnatomy, count: int, rng: np.random.Generator) -> FloatArray:
    """Return poses (N, 22) drawn from the start's prior, 650 mm away, for benchmarks."""
    start = np.tile(rest_pose(anatomy, np.array([0.0, 0.0, USUAL_DEPTH_MM])), (count, 1))
    spread = tangent_vector(START_SPREAD)
    return inside_limits(BodySpace().retract(start, spread * rng.standard_normal((count, spread.size))))


def centre_pose(
    depth: ImageArray, camera: Camera, anatomy: HandAnatomy, depth_mm: float | None
) -> FloatArray:
    """Return the paper's start (7.3): an open hand, palm facing the sensor, in the middle of the image.

    Without ``depth_mm`` its position is that of the nearest surface in the middle half of the image
    **[ours]**; without a reading there, the hand is 650 mm away.

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
        raise UsageError("no such start pose file", where=path, expected="a pose file, or --init center")
    if path.suffix == ".mcap" or is_mcap(path):  # also NAME.mcap.part
        return _first_pose(path)
    values = validated(PoseFile, _parse(path), path)
    quaternion = np.array(values.quaternion_xyzw)
    if np.linalg.norm(quaternion) < 1e-3:
        raise UsageError("invalid 'quaternion_xyzw'", where=path, found="zero length")
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
            "invalid start pose",
            where=path,
            found=repr(parsed),
            expected="an object with position_mm, quaternion_xyzw and angles_rad",
        )
    return parsed


def _first_pose(path: Path) -> FloatArray:
    """Return the first estimate in a result, or the first true pose in a recording."""
    for topic in ESTIMATE_TOPICS:
        for item in McapFile(path).messages([topic]):
            first = estimate_from_json(json_of_estimate(item, NUMBER_NAMES))
            if first.shape.size == POSE_SIZE - 7:
                return np.concatenate([first.position, first.quaternion, first.shape])
            break
    raise UsageError("no hand pose in file", where=path, expected=" or ".join(ESTIMATE_TOPICS))


# Interface of hand trackers, and their estimates

NUMBER_NAMES = (*INNER_NUMBERS, *SIGN_NAMES, "forearm_confidence")
"""Numbers of an estimate: inner numbers, confidence signs, and the forearm's confidence (NaN without one)."""

State = TypeVar("State")


class HandTrackerProtocol(Tracker[State], Protocol[State]):
    """A hand tracker that starts at a pose or with a detection."""

    def start(self, pose: FloatArray, stamp_ns: int, rng: np.random.Generator) -> State:
        """Return the state around a pose (22,) before the first frame, whose stamp is given."""

    def start_unknown(self, pose: FloatArray, frame: Frame, rng: np.random.Generator) -> State:
        """Return the state before a first frame in which the hand is to be detected, else at a pose (22,)."""


def forearm_confidence_of(numbers: FloatArray | None) -> float:
    """Return the forearm's confidence among an estimate's numbers; NaN without one, as in older results."""
    return float(numbers[-1]) if numbers is not None and len(numbers) == len(NUMBER_NAMES) else np.nan


def detected_pose(finder: Acquisition | None, frame: Frame, otherwise: FloatArray) -> FloatArray:
    """Return the pose (22,) of the hand detected in a frame, else the given one."""
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
        velocity: (21,) in the tangent space; None if unknown.
        inner: (6,) inner numbers; None for a tracker without them.
        evidence: signs of the confidence; empty for a pose without its own.
        forearm_confidence: of the forearm, NaN if unknown.
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
