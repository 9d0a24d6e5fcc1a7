"""Where a hand run starts: the middle of the image, or a pose from a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.configuration import Settings, validated
from posetrack_cli.errors import UsageError
from posetrack_cli.files import read_text
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import POSE_SIZE, HandAnatomy
from posetrack_cli.hand.config import ComponentSettings
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.space import inside_limits, tangent_vector
from posetrack_cli.mcap.stream import McapFile, is_mcap
from posetrack_cli.results.estimate_json import estimate_from_json
from posetrack_cli.text import parse_toml
from posetrack_cli.tracking.body_space import BodySpace

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
