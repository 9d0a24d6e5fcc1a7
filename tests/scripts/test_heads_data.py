"""The camera file made of a calibration.json of the study's recordings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from posetrack_cli.recording.camera_file import load_rig
from reproduction.heads_data import camera_file_text, frame_rate


def test_a_calibration_becomes_a_camera_file(tmp_path: Path) -> None:
    turn = [[0.96, 0.0, 0.28], [0.0, 1.0, 0.0], [-0.28, 0.0, 0.96]]
    lens = {
        "width": 64,
        "height": 48,
        "K": [[90.0, 0, 31], [0, 91.0, 23], [0, 0, 1]],
        "distortion": [0.1, 0, 0, 0, 0],
    }
    left = lens | {"R_from_left": np.eye(3).tolist(), "t_from_left_mm": [0, 0, 0]}
    right = lens | {"R_from_left": turn, "t_from_left_mm": [-118.0, 0.0, 20.0]}
    source = tmp_path / "calibration.json"
    source.write_text(json.dumps({"fps": 30, "cameras": {"left": left, "right": right}}))
    (tmp_path / "camera.toml").write_text(camera_file_text(source))
    cameras = load_rig(tmp_path / "camera.toml").stored_cameras({"left": (64, 48), "right": (64, 48)})
    assert [(c.fx, c.fy, c.cx, c.cy, c.distortion[0]) for c in cameras] == [(90.0, 91.0, 31.0, 23.0, 0.1)] * 2
    np.testing.assert_allclose(
        cameras[1].camera_T_reference, np.column_stack([turn, [-118.0, 0.0, 20.0]]), atol=1e-9
    )
    assert frame_rate(source) == 30.0
