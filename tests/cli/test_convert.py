"""``posetrack convert``: options, exit codes and what goes where."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.cli.export import convert
from posetrack_cli.cli.main import run
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, EXIT_INTERRUPTED, EXIT_USAGE, UsageError
from posetrack_cli.evaluation.reading.truth_topics import points_topic
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording import conversion
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.results.export.table import point_columns
from support.terminal import Terminal


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


def write_video(path: Path, *, b_frames: int = 0) -> Path:
    rng = np.random.default_rng(0)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"bf": str(b_frames)})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(5):
            picture = rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    return path


def test_what_a_video_loses_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing but a calibration that there is none of; with B-frames the pictures, too."""
    uncalibrated = "camera is not calibrated, so no calibration is written"
    for b_frames, notes in ((0, [uncalibrated]), (2, [uncalibrated, "it has B-frames"])):
        video = write_video(tmp_path / f"v{b_frames}.mp4", b_frames=b_frames)
        assert run(["convert", str(video), "-o", str(tmp_path / f"c{b_frames}.mcap")]) == EXIT_DONE
        caught = capsys.readouterr()
        assert "5 frames" in caught.out
        for note, line in zip(notes, caught.err.splitlines(), strict=True):
            assert line.startswith(f"{video}: ") and note in line


def test_progress_is_a_bar_of_frames_on_a_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    video, terminal = write_video(tmp_path / "v.mp4"), Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert run(["convert", str(video), "-o", str(tmp_path / "o.mcap")]) == EXIT_DONE
    assert re.match(r"convert: 100%\|.*\| 5/5 \[", terminal.lines[0]), terminal.lines


def test_images_are_converted_on_request(tmp_path: Path, folder: Path) -> None:
    reading = ["--camera", str(tmp_path / "camera.toml"), "--fps", "10"]
    assert run(["convert", str(folder), "-o", str(tmp_path / "i.mcap"), "--images", *reading]) == EXIT_DONE
    (image, *_) = next(open_recording(tmp_path / "i.mcap", "grey").frames()).images
    assert image.dtype == np.uint8
    raw = ["convert", str(folder), "-o", str(tmp_path / "r.mcap"), "--raw", *reading]
    assert run(raw) == EXIT_DONE
    kinds = {c.topic: s.name for s, c in McapFile(tmp_path / "r.mcap").channels() if s is not None}
    assert kinds["/camera/depth/image"] == "foxglove.RawImage"


def test_an_interruption_leaves_nothing_and_spares_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video, out = write_video(tmp_path / "v.mp4"), tmp_path / "o.mcap"
    out.write_bytes(b"precious")
    written: list[bytes] = []

    def image_message(*arguments: object) -> bytes:
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(b"")
        return b""

    monkeypatch.setattr(conversion, "image_message", image_message)
    assert run(["convert", str(video), "-o", str(out), "--overwrite"]) == EXIT_INTERRUPTED
    assert out.read_bytes() == b"precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.mcap", "v.mp4"]


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


def test_labels_of_a_dataset_have_the_stamps_of_their_frames(tmp_path: Path, folder: Path) -> None:
    """MSRA's rows are frames; its y points up and its z backwards, and a mirrored image has -x."""
    reading = ["--camera", str(tmp_path / "camera.toml"), "--fps", "30"]
    labels = tmp_path / "joint.txt"
    labels.write_text("9\n" + "".join(f"{' '.join([str(k), '2', '-3'] * 21)}\n" for k in range(9)))
    for extra, sign in (([], 1.0), (["--mirror"], -1.0)):
        out = tmp_path / f"out{sign}.mcap"
        assert run(["convert", str(folder), "-o", str(out), *reading, *extra, "--truth", str(labels)]) == 0
        messages = list(open_recording(out).truth())
        frames = [frame.stamp_ns for frame in open_recording(out).matched(LossLog()) if frame is not None]
        assert [message.log_time_ns for message in messages] == frames
        points = json.loads(messages[1].data)["points"]
        assert points[20] == {"name": "little_tip", "x": sign, "y": -2.0, "z": 3.0}
