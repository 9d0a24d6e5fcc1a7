"""``posetrack head stereo``: what it refuses, and what it writes of a recording that is measured with."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.recording.rig_file import camera_file_text

ASIDE = ((1.0, 0.0, 0.0, -120.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
CAMERAS = (
    Camera(160, 120, 250.0, 250.0, 79.5, 59.5, name="left"),
    Camera(160, 120, 250.0, 250.0, 79.5, 59.5, name="right", camera_T_reference=ASIDE),
)


def write_recording(folder: Path, cameras: tuple[Camera, ...] = CAMERAS, frames: int = 3) -> Path:
    """Folders of noise in which no face is."""
    rng = np.random.default_rng(0)
    for camera in cameras:
        (folder / camera.name).mkdir(parents=True)
        for index in range(frames):
            image = rng.integers(90, 110, (camera.height, camera.width), dtype=np.uint8)
            cv2.imwrite(str(folder / camera.name / f"{index:06d}.png"), image)
    (folder / "camera.toml").write_text(camera_file_text(cameras))
    return folder


def line(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize("passes", ["1", "2"])
def test_no_face_is_one_line_with_frames_and_score(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], passes: str
) -> None:
    recording = write_recording(tmp_path / "noise")
    output = tmp_path / "r.mcap"
    code = run(["head", "stereo", str(recording), "-o", str(output), "--fps", "30", "--passes", passes])
    assert code == 1
    told = line(capsys)
    assert "no face found, found 3 frames searched, best score 0.00" in told
    assert "kept" not in told
    assert [path.name for path in tmp_path.iterdir()] == ["noise"]


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["--detector", "yunet"], 2, "--detector-model"),
        (["--set", "model.component=3"], 2, "components"),
        (["--cameras", "left"], 2, "too few cameras"),
        (["--cameras", "left,rihgt"], 1, "right"),
        (["--start", "9"], 2, "no frame to track, found 3 frames"),
        (["--load-model", "nowhere.npz"], 2, "no such model file"),
        (["--init", "nowhere.csv"], 2, "nowhere.csv: clicked points not found"),
        (["--resume"], 1, "no unfinished result to resume"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_meant_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, expected: str
) -> None:
    recording = write_recording(tmp_path / "noise")
    asked = ["head", "stereo", str(recording), "-o", str(tmp_path / "r.mcap"), "--fps", "30", *arguments]
    assert run(asked) == code
    assert expected in line(capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["noise"]


def test_one_camera_is_refused_with_what_is_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_recording(tmp_path / "one", CAMERAS[:1])
    assert run(["head", "stereo", str(recording), "-o", str(tmp_path / "r.mcap"), "--fps", "30"]) == 2
    assert "too few cameras" in (told := line(capsys))
    assert "left/ and right/" in told
