"""What tests of the studies of heads share: cameras, poses, folders of recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import head_quaternion_from_roll_pitch_yaw
from posetrack_cli.head.face.points import MEAN_SHAPE, POINT_NAMES, HeadPose

FRAME_NS = 33_333_333
CAMERAS = (
    Camera(64, 48, 90.0, 90.0, 31.5, 23.5, name="left"),
    Camera(
        64,
        48,
        90.0,
        90.0,
        31.5,
        23.5,
        name="right",
        camera_T_reference=((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)),
    ),
)


_COLUMNS = ["t_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"]
_COLUMNS += [f"{name}_{axis}_mm" for name in POINT_NAMES for axis in "xyz"]
_FIRST = [0.0, 10.0, -20.0, 700.0, 1.0, 0.0, 0.0, 0.0, *MEAN_SHAPE.ravel()]
TRUTH = "\n".join([",".join(_COLUMNS), ",".join(map(str, _FIRST)), ""])
"""Of a mean face that looks at the camera, one frame."""


def pose(index: int) -> HeadPose:
    turn = np.radians([3.0 * np.sin(index), 5.0 * np.cos(2 * index), 10.0 * np.sin(0.5 * index)])
    return HeadPose(np.array([2.0 * index, -index, 700.0 + index]), head_quaternion_from_roll_pitch_yaw(turn))


def heads_folder(tmp_path: Path, *names: str) -> Path:
    lens = {"width": 64, "height": 48, "K": [[90, 0, 31], [0, 90, 23], [0, 0, 1]], "distortion": [0] * 5}
    placed = lens | {"R_from_left": np.eye(3).tolist(), "t_from_left_mm": [0, 0, 0]}
    for name in names:
        folder = tmp_path / "heads" / name
        folder.mkdir(parents=True)
        calibration = {"fps": 25, "cameras": {"left": placed, "right": placed}}
        (folder / "calibration.json").write_text(json.dumps(calibration))
        (folder / "truth.csv").write_text(TRUTH)
    return tmp_path / "heads"
