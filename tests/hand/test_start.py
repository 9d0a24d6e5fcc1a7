"""Where a run starts: the middle of the image, or a pose from a file."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.errors import UsageError
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.start import USUAL_DEPTH_MM, centre_pose, read_pose, rest_pose, scattered_poses
from support.hand import KINECT

ANATOMY = make_anatomy(scale=0.9)
ROUNDING_MM = 1e-9


def centre_of(pose: np.ndarray) -> np.ndarray:
    np.testing.assert_array_equal(pose[3:], [0, 0, 0, 1, *[0.0] * 15])  # open, palm to the sensor
    return joint_positions(ANATOMY, pose[None])[0].mean(axis=0)


def test_a_rest_pose_has_its_joints_about_the_point() -> None:
    point = np.array([10.0, -20.0, 700.0])
    np.testing.assert_allclose(centre_of(rest_pose(ANATOMY, point)), point, atol=ROUNDING_MM)


def blob_image(wall: float) -> np.ndarray:
    """A blob 30 mm deep, rows 180..219 and columns 270..309, in front of a wall; things at the edges."""
    depth = np.full((424, 512), wall, dtype=np.float32)
    depth[180:220, 270:310] = np.linspace(600.0, 630.0, 40)
    depth[:100] = 300.0  # nearer, but outside the middle half
    depth[:, 400:] = 300.0
    return depth


@pytest.mark.parametrize("wall", [0.0, 1500.0])
def test_the_start_is_the_nearest_thing_in_the_middle_half(wall: float) -> None:
    centre = centre_of(centre_pose(blob_image(wall), KINECT, ANATOMY, None))
    (u, v), _ = KINECT.pixels_from_points(centre)
    assert abs(u - 289.5) < 1e-6
    assert abs(v - 199.5) < 1e-6
    assert abs(centre[2] - 615.0) < 1.0  # the median depth, to a pixel's 30 / 39 mm


def test_single_wild_readings_do_not_move_the_start() -> None:
    depth = blob_image(1500.0)
    usual = centre_pose(depth, KINECT, ANATOMY, None)
    depth[150, 200] = 100.0
    moved = centre_pose(depth, KINECT, ANATOMY, None)
    assert np.abs(moved[:3] - usual[:3]).max() < 1.0


def test_a_given_depth_or_no_reading_put_it_into_the_very_middle() -> None:
    given = centre_of(centre_pose(blob_image(1500.0), KINECT, ANATOMY, 800.0))
    np.testing.assert_allclose(given, [0.0, 0.0, 800.0], atol=ROUNDING_MM)  # KINECT's axis is the middle
    blank = centre_of(centre_pose(np.zeros((424, 512), np.float32), KINECT, ANATOMY, None))
    np.testing.assert_allclose(blank, [0.0, 0.0, USUAL_DEPTH_MM], atol=ROUNDING_MM)


def test_scattered_poses_are_a_prior_within_the_limits() -> None:
    poses = scattered_poses(ANATOMY, 400, np.random.default_rng(0))
    assert (poses[:, 7:] >= ANGLE_LIMITS[:, 0]).all()
    assert (poses[:, 7:] <= ANGLE_LIMITS[:, 1]).all()
    sd = poses[:, :3].std(axis=0)
    np.testing.assert_allclose(sd, 20.0, rtol=4.0 / np.sqrt(2 * 400))  # four standard errors of an sd
    np.testing.assert_array_equal(scattered_poses(ANATOMY, 400, np.random.default_rng(0)), poses)


POSE = {"position_mm": [1.0, 2.0, 650.0], "quaternion_xyzw": [0.0, 0.0, -2.0, -2.0], "angles_rad": [0.1] * 15}


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def as_toml(values: dict[str, list[float]]) -> str:
    return "\n".join(f"{key} = {value}" for key, value in values.items())


def test_a_pose_from_toml_or_json(tmp_path: Path) -> None:
    half = np.sqrt(0.5)
    expected = [1.0, 2.0, 650.0, 0.0, 0.0, half, half, *[0.1] * 15]  # unit and w > 0, however it was written
    for path in (
        written(tmp_path, "pose.json", json.dumps(POSE)),
        written(tmp_path, "pose.toml", as_toml(POSE)),
    ):
        np.testing.assert_allclose(read_pose(path), expected, atol=1e-15)
    short = written(tmp_path, "short.toml", "position_mm = [1, 2, 650]")
    np.testing.assert_array_equal(read_pose(short), [1, 2, 650, 0, 0, 0, 1, *[0.0] * 15])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", "{", "start pose cannot be read, found "),
        ("a.toml", "position_mm = ", "start pose cannot be read, found "),
        ("a.json", "[1, 2]", "invalid start pose, found [1, 2], expected an object with position_mm"),
        ("a.json", "[" * 100_000, "start pose cannot be read, found "),
        ("a.toml", "position_mm = [1e300, 0, 600]", "'position_mm.0' cannot be used, found 1e+300"),
        ("a.json", "7", "invalid start pose, found 7, expected an object with position_mm"),
        ("a.toml", "angles_rad = []", "'position_mm' is missing"),
        ("a.toml", "position_mm = [1, 2]", "'position_mm' cannot be used, found [1, 2], expected 3 values"),
        ("a.toml", as_toml({**POSE, "angles_rad": [0.0] * 14}), "'angles_rad' cannot be used"),
        ("a.toml", as_toml({**POSE, "quaternion_xyzw": [0.0] * 4}), "invalid 'quaternion_xyzw'"),
        ("a.toml", as_toml(POSE) + "\npositon = [1]", "unknown configuration key 'positon'; did you mean"),
        ("a.toml", "position_mm = [1, nan, 3]", "'position_mm.1' cannot be used, found nan"),
    ],
)
def test_a_file_that_is_no_pose_is_told_on_one_line(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    path = written(tmp_path, name, text)
    with pytest.raises(UsageError) as caught:
        read_pose(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert message in line
    assert "\n" not in line


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such start pose file, expected a pose file, or --init center"):
        read_pose(tmp_path / "none.toml")
