"""Azure Kinect recordings: depth by its own track, with the camera that the file's calibration tells."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hostile.container_cases import matroska, matroska_bytes
from posetrack_cli.cli.info import report_lines
from posetrack_cli.errors import PosetrackError, RecordingError
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.conversion import convert_recording
from posetrack_cli.recording.kinect import camera_of_calibration
from posetrack_cli.recording.opening import describe, open_recording
from support.kinect import COUNT, DEPTH_640X576, DEPTH_PARAMETERS, calibration, codes, write_kinect

SDK_PX = 1e-4
"""Six decimals of what the SDK printed, which reckons in single precision."""
OF_MATROSKA_NS = 500_000


def camera(values: dict[str, Any], width: int, height: int) -> Any:
    return camera_of_calibration(json.dumps(values).encode(), width, height, "r.mkv")


def test_the_camera_is_what_the_sdk_makes_of_it() -> None:
    found = camera(calibration(), 640, 576)
    for name, value in DEPTH_640X576.items():
        assert getattr(found, name) == pytest.approx(value, abs=SDK_PX)
    k1, k2, p1, p2, k3, k4, k5, k6 = found.distortion
    assert (k1, k2, k3, k4, k5, k6) == DEPTH_PARAMETERS[4:10]
    assert (p2, p1) == DEPTH_PARAMETERS[12:14]


@pytest.mark.parametrize("size", [(320, 288), (512, 512), (1024, 1024)])
def test_a_mode_sees_what_the_whole_sensor_sees(size: tuple[int, int]) -> None:
    """The same ray meets the same place of the sensor, from the corner on, in parts of it."""
    whole, mode = camera(calibration(), 1024, 1024), camera(calibration(), *size)
    binned = 1 if size[0] == 1024 else 2
    left, top = {320: (96, 90)}.get(size[0], (0, 0))
    assert binned * (mode.cx + 0.5 + left) == pytest.approx(whole.cx + 0.5)
    assert binned * (mode.cy + 0.5 + top) == pytest.approx(whole.cy + 0.5)
    assert (binned * mode.fx, binned * mode.fy) == pytest.approx((whole.fx, whole.fy))


def test_depth_is_the_depth_track_s(tmp_path: Path) -> None:
    path = write_kinect(tmp_path / "r.mkv")
    recording = open_recording(path)
    frames = list(recording.frames())
    assert (len(frames), recording.losses) == (COUNT, ())
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.depth, codes(number, (320, 288)))
        assert abs(frame.stamp_ns - round(number * 1e9 / 30)) <= OF_MATROSKA_NS
    assert (recording.cameras[0].width, recording.cameras[0].distortion_model) == (320, "rational_polynomial")
    mirrored = next(open_recording(path, mirror=True).frames())
    np.testing.assert_array_equal(mirrored.depth, codes(0, (320, 288))[:, ::-1])


FIRST = codes(0, (320, 288))
OTHERS = {
    "gray": FIRST.astype(np.uint8),
    "rgb24": np.full((*FIRST.shape, 3), 90, np.uint8),
    "rgba": np.full((*FIRST.shape, 4), 90, np.uint8),
    "rgb48be": np.full((*FIRST.shape, 3), 900, np.uint16),
    "rgba64be": np.full((*FIRST.shape, 4), 900, np.uint16),
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_later_frame_of_another_format_is_left_out(tmp_path: Path, name: str) -> None:
    """Also by ``convert``, whose result posetrack then reads."""
    images = [FIRST, OTHERS[name], codes(2, (320, 288)), codes(3, (320, 288))[:100]]
    frames = tuple(bytes(cv2.imencode(".png", image)[1]) for image in images)
    path, out = tmp_path / "r.mkv", tmp_path / "out.mcap"
    path.write_bytes(matroska_bytes(matroska(frames, json.dumps(calibration()).encode())))
    recording = open_recording(path)
    found = [(frame.index, frame.depth) for frame in recording.frames()]
    assert [index for index, _ in found] == [0, 2]
    np.testing.assert_array_equal([depth for _, depth in found], [images[0], images[2]])
    assert [(loss.what, loss.first) for loss in recording.losses] == [
        (f"image skipped, pixel format is {name}, not gray16be", "frame 1, video frame 1"),
        ("image skipped, size is 320x100, not 320x288 like the first", "frame 3, video frame 3"),
    ]
    assert convert_recording(recording, out).frames == 2
    assert len(list(open_recording(out).frames())) == 2


def test_heads_are_tracked_in_its_colour(tmp_path: Path) -> None:
    path = write_kinect(tmp_path / "r.mkv")
    frames = list(open_recording(path, "grey", guess=Guess()).frames())
    assert [frame.images[0].shape for frame in frames] == [(96, 128)] * COUNT
    assert [abs(int(frame.images[0][5, 5]) - 40 * k) <= 2 for k, frame in enumerate(frames)] == [True] * COUNT
    described = describe(path)
    assert described["image"] == {"width": 128, "height": 96}
    (depth,) = described["depth"]["cameras"]
    assert (depth["width"], depth["height"]) == (320, 288)
    assert any(line.startswith("depth: 320x288, fx 251.964") for line in report_lines(described))


def test_a_recording_without_colour_or_depth_says_so(tmp_path: Path) -> None:
    path = write_kinect(tmp_path / "depth.mkv", titles=("DEPTH",))
    assert len(list(open_recording(path).frames())) == COUNT
    with pytest.raises(
        RecordingError, match=r"depth\.mkv: only depth, .*; to track hands in it use posetrack hand run"
    ):
        open_recording(path, "grey", guess=Guess())
    with pytest.raises(RecordingError, match="video has no depth stream"):
        open_recording(write_kinect(tmp_path / "colour.mkv", titles=("COLOR",)))


@pytest.mark.parametrize(
    ("attached", "words"),
    [
        ({}, "invalid calibration, found Field required; pass --camera"),
        (calibration(Location="elsewhere"), "no intrinsics"),
        (calibration(SensorWidth=2048), "no intrinsics"),
        (calibration(DEPTH_PARAMETERS[:13]), "unsupported lens model"),
        (calibration((*DEPTH_PARAMETERS[:10], 0.1, *DEPTH_PARAMETERS[11:])), "unsupported lens model"),
        (calibration((float("nan"), *DEPTH_PARAMETERS[1:])), "invalid intrinsics"),
    ],
)
def test_a_calibration_that_cannot_be_used_is_one_line(
    tmp_path: Path, attached: dict[str, Any], words: str
) -> None:
    path = write_kinect(tmp_path / "r.mkv", attached=attached)
    with pytest.raises(PosetrackError, match=words):
        open_recording(path)
    (tmp_path / "camera.toml").write_text("fx = 250.0\nfy = 250.0\ncx = 160.0\ncy = 144.0\n")
    recording = open_recording(path, camera_file=tmp_path / "camera.toml")
    assert recording.cameras[0].fx == 250.0


def test_images_of_no_mode_have_no_camera(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no intrinsics"):
        open_recording(write_kinect(tmp_path / "r.mkv", (330, 288)))
