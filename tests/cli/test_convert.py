"""``posetrack convert``: options, exit codes and what goes where."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.cli.export import convert
from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_USAGE, UsageError
from posetrack_cli.evaluation.reading.truth_topics import points_topic
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.export.table import point_columns


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four images without stamps, calibrated by a file beside the folder."""
    path = tmp_path / "images"
    path.mkdir()
    for index in range(4):
        image = np.full((6, 8), 500 + index, np.uint16)
        image[0, 0] = 32001
        cv2.imwrite(str(path / f"{index}.png"), image)
    (tmp_path / "camera.toml").write_text("fx = 9.0\nfy = 9.0\ncx = 3.0\ncy = 2.5\n")
    return path


def test_options_reach_the_recording(tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "out.mcap"
    arguments = [str(folder), "-o", str(out), "--fps", "10", "--camera", str(tmp_path / "camera.toml")]
    result = CliRunner().invoke(convert, [*arguments, "--missing", "32001", "--mirror"])
    assert (result.exit_code, result.stderr) == (EXIT_DONE, "")
    assert "4 frames" in result.stdout
    recording = open_recording(out)
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == [0, 100_000_000, 200_000_000, 300_000_000]
    assert recording.cameras[0].cx == 8 - 1 - 3.0
    assert [frame.depth[0, 7] for frame in frames] == [0] * 4
    assert [frame.depth[0, 0] for frame in frames] == [500, 501, 502, 503]


def test_lost_frames_give_exit_code_3_and_a_line(tmp_path: Path, folder: Path) -> None:
    (folder / "2.png").write_bytes(b"broken")
    out = tmp_path / "out.mcap"
    arguments = [str(folder), "-o", str(out), "--fps", "10", "--camera", str(tmp_path / "camera.toml")]
    result = CliRunner().invoke(convert, arguments)
    assert result.exit_code == EXIT_DATA_LOST
    assert "first frame 2, 2.png" in result.stderr
    assert result.stderr.count("\n") == 1
    assert "3 frames" in result.stdout


def test_existing_output_needs_overwrite(tmp_path: Path, folder: Path) -> None:
    out = tmp_path / "out.mcap"
    arguments = [str(folder), "-o", str(out), "--fps", "10", "--camera", str(tmp_path / "camera.toml")]
    CliRunner().invoke(convert, arguments, catch_exceptions=False)
    first = out.read_bytes()
    with pytest.raises(UsageError, match="--overwrite"):
        CliRunner().invoke(convert, arguments, catch_exceptions=False)
    result = CliRunner().invoke(convert, [*arguments, "--overwrite"])
    assert result.exit_code == EXIT_DONE
    assert out.read_bytes() == first, "equal input gives equal bytes"


def test_joints_of_a_csv_go_along(tmp_path: Path, folder: Path) -> None:
    reading = ["--camera", str(tmp_path / "camera.toml"), "--fps", "30"]
    columns = point_columns(JOINT_NAMES)
    stamps = [0, 33_333_333, 66_666_667]  # the last frame has none
    rows = [",".join(["stamp_ns", *columns]), *(f"{stamp}{',1.5' * len(columns)}" for stamp in stamps)]
    truth = tmp_path / "truth.csv"
    truth.write_text("\n".join(rows) + "\n")
    out = tmp_path / "out.mcap"
    assert run(["convert", str(folder), "-o", str(out), *reading, "--truth", str(truth)]) == 0
    messages = list(open_recording(out).truth())
    assert [(m.topic, m.log_time_ns) for m in messages] == [(points_topic("hand"), s) for s in stamps]
    again = ["convert", str(out), "-o", str(tmp_path / "again.mcap")]
    assert run(again) == 0
    assert list(open_recording(tmp_path / "again.mcap").truth()) == messages
    assert run([*again, "--overwrite", "--truth", str(truth)]) == EXIT_USAGE
