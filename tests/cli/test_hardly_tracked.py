"""Depth in another unit than it looks, infrared, and what a run says that tracked hardly any frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_FAILED
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.reader import read_result

FRAMES = 6
PERFECT = ("--no-background", "--no-body", "--no-noise", "--no-edges", "--no-drops", "--no-late")
KNOWN = ("--hand-side", "right", "--shape", "average")
WELL_MM = 1.0
"""Mean joint error of a perfect sensor's images: .4 mm in the unit they are stored in; of no hand 100 mm."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("made") / "hand.mcap"
    assert (
        run(["hand", "synth", "-q", "-o", str(path), "--frames", str(FRAMES), "--seed", "5", *PERFECT]) == 0
    )
    return path


@pytest.fixture(scope="module")
def frames(made: Path) -> list[Frame]:
    return list(open_recording(made).frames())


def track(recording: Path, output: Path, *options: str) -> int:
    return run(["hand", "run", str(recording), "-o", str(output), "-q", *KNOWN, *options])


def joint_error_mm(result: Path, truth: Path) -> float:
    report = result.with_suffix(".json")
    assert run(["eval", str(result), "--truth", str(truth), "--json", str(report), "--overwrite"]) == 0
    (found,) = json.loads(report.read_text())["results"]
    return float(found["metrics"]["joint_error_mm"]["mean"])


def lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    said = capsys.readouterr().err.splitlines()
    return [line for line in said if not line.startswith("compiling")]


def write_folder(path: Path, frames: Sequence[Frame], images: Sequence[np.ndarray]) -> Path:
    path.mkdir()
    for frame, image in zip(frames, images, strict=True):
        assert cv2.imwrite(str(path / f"{frame.index:03d}.png"), image)
    (path / "timestamps.csv").write_text("\n".join(["stamp_ns", *(str(f.stamp_ns) for f in frames)]) + "\n")
    (path / "camera.toml").write_text("fx = 365.0\nfy = 365.0\ncx = 255.5\ncy = 211.5\n")
    return path


def write_topic(
    path: Path,
    make: SimpleNamespace,
    topic: str,
    encoding: str,
    frames: Sequence[Frame],
    images: Sequence[np.ndarray],
) -> Path:
    info = make.calibration_fields(512, 424) | {"K": [365.0, 0.0, 255.5, 0.0, 365.0, 211.5, 0.0, 0.0, 1.0]}
    stamp = frames[0].stamp_ns
    messages = [(f"{topic.rpartition('/')[0]}/info", "CameraInfo", stamp, stamp, info)]
    messages += [
        (topic, "Image", frame.stamp_ns, frame.stamp_ns, make.raw_fields(image, encoding))
        for frame, image in zip(frames, images, strict=True)
    ]
    return make.write_foxglove(path, messages)


@pytest.fixture(scope="module")
def players(frames: list[Frame], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As of a Kinect v1: millimetres in the upper 13 bits, the number of the player in the lower 3."""
    codes = [frame.depth.astype(np.uint16) for frame in frames]
    images = [code << 3 | (code > 0).astype(np.uint16) for code in codes]
    return write_folder(tmp_path_factory.mktemp("players") / "kinect", frames, images)


@pytest.mark.parametrize("options", [[], ["--depth-unit-mm", "0.125"]], ids=["by itself", "stated"])
def test_player_numbers_below_the_depth(
    players: Path, made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    assert track(players, tmp_path / "r.mcap", *options) == EXIT_DONE
    said = lines(capsys)
    assert len(said) == (0 if options else 1)
    assert all("depth unit detected as 0.125 mm: low bits are Kinect v1" in line for line in said)
    assert joint_error_mm(tmp_path / "r.mcap", made) < WELL_MM


def test_depth_eight_times_too_far(players: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The hand is 0.6 to 0.8 m away."""
    assert track(players, tmp_path / "r.mcap", "--depth-unit-mm", "1") == EXIT_DATA_LOST
    (said,) = lines(capsys)
    assert f"only 0 of {FRAMES} frames tracked: no hand-like region in {FRAMES} sampled frames" in said
    assert "depths 4.8 to 6.4 m" in said and "searched from 0.12 to 1.5 m" in said
    assert "depth was read as 1 mm per stored unit; --depth-unit-mm 0.1 or 0.125" in said
    assert "--hand-side" not in said
    result = read_result(tmp_path / "r.mcap")
    assert result.finished and said.endswith(result.summary["remarks"])


def test_the_line_of_the_start_names_depths(
    players: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is said of the side where no hand can be."""
    from posetrack_cli.hand.autodetect import detect_hand
    from posetrack_cli.hand.config import HandConfig

    found = detect_hand(open_recording(players, depth_unit_mm=1.0), HandConfig(), 0)
    assert found.is_doubtful and found.line.startswith("no hand in the first 10 s: no hand-like region")
    assert "4.8 to 6.4 m" in found.line and "--depth-unit-mm" in found.line
    assert "--hand-side" not in found.line


@pytest.mark.parametrize(
    "options", [[], ["--depth-unit-mm", "1"], ["--depth-unit-mm", "0.001"], ["--camera"]]
)
def test_floats_in_millimetres(
    frames: list[Frame], made: Path, tmp_path: Path, make: SimpleNamespace, options: list[str]
) -> None:
    path = write_topic(
        tmp_path / "in.mcap", make, "/kinect2/depth", "32FC1", frames, [f.depth for f in frames]
    )
    if options == ["--camera"]:
        camera = tmp_path / "camera.toml"
        camera.write_text("fx = 365.0\nfy = 365.0\ncx = 255.5\ncy = 211.5\ndepth_unit_mm = 0.001\n")
        options = ["--camera", str(camera)]
    assert track(path, tmp_path / "r.mcap", *options) == EXIT_DONE
    assert joint_error_mm(tmp_path / "r.mcap", made) < WELL_MM


def test_floats_read_as_metres(
    frames: list[Frame], tmp_path: Path, make: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_topic(
        tmp_path / "in.mcap", make, "/kinect2/depth", "32FC1", frames, [f.depth for f in frames]
    )
    assert track(path, tmp_path / "r.mcap", "--depth-unit-mm", "1000") == EXIT_DATA_LOST
    (said,) = lines(capsys)
    assert "depths 60" in said and " m, nearest surface" in said  # 600 m
    assert "depth was read as 1000 mm per stored unit; --depth-unit-mm 1 would fit" in said


def test_infrared(
    frames: list[Frame], tmp_path: Path, make: SimpleNamespace, capsys: pytest.CaptureFixture[str]
) -> None:
    """Brightness falls with the square of distance; where depth has no reading there is still light."""
    images = [np.where(f.depth > 0, 2e9 / np.maximum(f.depth, 1) ** 2, 90).astype(np.uint16) for f in frames]
    path = write_topic(tmp_path / "in.mcap", make, "/ir/image_raw", "mono16", frames, images)
    assert track(path, tmp_path / "r.mcap") == EXIT_FAILED
    (said,) = lines(capsys)
    assert said.endswith("; if it is depth, pass --topic /ir/image_raw")
    assert track(path, tmp_path / "r.mcap", "--topic", "/ir/image_raw") == EXIT_DATA_LOST
    (said,) = lines(capsys)
    assert "every pixel has a value, which is unusual for depth; are these infrared images?" in said
