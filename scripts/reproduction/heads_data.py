"""The study recordings of heads: their calibration.json as a camera file of ours."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import placed
from posetrack_cli.recording import camera_file

CALIBRATION, TRUTH = "calibration.json", "truth.csv"


def camera_file_text(calibration_json: Path) -> str:
    """Return the camera.toml for a calibration.json, which has R_from_left and t_from_left_mm by camera."""
    return camera_file.camera_file_text(cameras_of(calibration_json))


def cameras_of(calibration_json: Path) -> list[Camera]:
    """Return the cameras that a calibration.json tells, the reference first."""
    values = json.loads(calibration_json.read_text())
    return [_camera(name, camera) for name, camera in values["cameras"].items()]


def reading_arguments(folder: Path, cameras: Path) -> tuple[str, ...]:
    """Return how a study recording is named on a command line; writes its camera file into ``cameras``."""
    camera = cameras / f"{folder.name}.camera.toml"
    camera.parent.mkdir(parents=True, exist_ok=True)
    camera.write_text(camera_file_text(folder / CALIBRATION), encoding="utf-8")
    return (str(folder), "--camera", str(camera), "--fps", f"{frame_rate(folder / CALIBRATION):g}")


def frame_rate(calibration_json: Path) -> float:
    """Return the frame rate, Hz, that a calibration.json tells."""
    return float(json.loads(calibration_json.read_text())["fps"])


def _camera(name: str, values: dict[str, Any]) -> Camera:
    matrix = np.array(values["K"])
    camera = Camera(
        values["width"],
        values["height"],
        fx=matrix[0, 0],
        fy=matrix[1, 1],
        cx=matrix[0, 2],
        cy=matrix[1, 2],
        distortion=tuple(map(float, values["distortion"])),
        name=name,
    )
    return placed(camera, np.column_stack([values["R_from_left"], values["t_from_left_mm"]]))
