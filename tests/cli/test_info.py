"""``posetrack info``: numbers that are known beforehand, for whole and broken files."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from posetrack_cli.cli.info import info
from posetrack_cli.errors import EXIT_DATA_LOST, EXIT_DONE, RecordingError
from posetrack_cli.mcap.sink import McapSink
from support import datasets as layouts

MS = 1_000_000
STAMPS_MS = [0, 100, 200, 300, 700, 800, 800, 650, 900]
"""10 Hz with one gap of 0.4 s, one doubled stamp and one that goes back."""


def write(path: Path, finish: bool = True) -> Path:
    with McapSink(path) as sink:
        info_id, image_id = sink.channel("/cam/info", CameraCalibration), sink.channel("/cam/image", RawImage)
        pose_id = sink.json_channel("/pose", "posetrack.pose", {"type": "object"})
        sink.json_channel("/never", "posetrack.pose", {"type": "object"})
        sink.metadata("posetrack.run", {"seed": "7", "configuration": "x" * 500})
        sink.metadata("other", {"a": "b"})
        sink.attachment("hand.json", "application/json", b"{}")
        camera = CameraCalibration(
            width=8, height=6, K=[9, 0, 3, 0, 9, 2.5, 0, 0, 1], distortion_model="plumb_bob", frame_id="cam"
        )
        sink.write(info_id, 1, camera.SerializeToString())
        for number, stamp in enumerate(STAMPS_MS, 1):
            image = RawImage(width=8, height=6, encoding="16UC1", step=16, data=bytes(96), frame_id="cam")
            image.timestamp.FromNanoseconds((1000 + stamp) * MS)
            sink.write(image_id, number * 100 * MS, image.SerializeToString())
            sink.write(pose_id, number * 100 * MS, b"{}")
            sink.flush()
        if finish:
            sink.finish()
    return path


def run(path: Path, *options: str) -> Result:
    return CliRunner().invoke(info, [str(path), *options], catch_exceptions=False)


def report(path: Path) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(run(path, "--json", "-").stdout)
    return values


def test_topics_rates_gaps_and_disorder(tmp_path: Path) -> None:
    values = report(write(tmp_path / "r.mcap"))
    topics = {topic["topic"]: topic for topic in values["topics"]}
    image = topics["/cam/image"]
    assert (image["type"], image["encoding"], image["width"], image["height"]) == (
        "foxglove.RawImage",
        "16UC1",
        8,
        6,
    )
    assert image["depth"] is True
    assert (image["messages"], image["stamps_not_later"], image["gaps"]) == (9, 2, 1)
    assert image["rate_hz"] == pytest.approx(10)
    assert image["largest_gap_s"] == pytest.approx(0.4)
    assert image["duration_s"] == pytest.approx(0.9)
    assert image["start_ns"] == 1000 * MS, "the images' own stamps, not the log times"
    assert (topics["/pose"]["messages"], topics["/pose"]["stamps_not_later"]) == (9, 0)
    assert topics["/never"]["messages"] == 0
    assert values["complete"] is True
    assert values["bytes"] == (tmp_path / "r.mcap").stat().st_size


def test_cameras_metadata_and_attachments(tmp_path: Path) -> None:
    values = report(write(tmp_path / "r.mcap"))
    (camera,) = values["cameras"]
    assert (camera["topic"], camera["fx"], camera["cy"], camera["width"]) == ("/cam/info", 9, 2.5, 8)
    run_record, other = values["metadata"]
    assert run_record["values"]["seed"] == "7"
    assert len(run_record["values"]["configuration"]) == 60
    assert other == {"name": "other", "entries": 1}
    assert values["attachments"] == [{"name": "hand.json", "media_type": "application/json", "bytes": 2}]


def test_text_for_people(tmp_path: Path) -> None:
    result = run(write(tmp_path / "r.mcap"))
    assert (result.exit_code, result.stderr) == (EXIT_DONE, "")
    text = result.stdout
    assert "topic /cam/image: foxglove.RawImage (protobuf), 16UC1 8x6, depth, frame cam" in text
    assert (
        "9 messages, 0.900 s, 10.00 Hz, largest gap 0.400 s, 1 gaps, 2 stamps doubled or out of order" in text
    )
    assert "camera /cam/info: 8x6, fx 9 fy 9 cx 3 cy 2.5, no distortion" in text
    assert "metadata posetrack.run: 2 entries" in text


def test_unfinished_file_is_listed_with_exit_code_3(tmp_path: Path) -> None:
    path = write(tmp_path / "r.mcap.part", finish=False)
    result = run(path)
    assert result.exit_code == EXIT_DATA_LOST
    assert "truncated" in result.stderr
    assert "INCOMPLETE" in result.stdout
    values = report(path)
    counts = {topic["topic"]: topic["messages"] for topic in values["topics"]}
    assert counts == {"/cam/image": 9, "/cam/info": 1, "/pose": 9}
    assert [record["name"] for record in values["metadata"]] == ["posetrack.run", "other"]
    assert len(values["attachments"]) == 1


def test_cut_anywhere_is_listed(tmp_path: Path) -> None:
    data = write(tmp_path / "r.mcap").read_bytes()
    path = tmp_path / "cut.mcap"
    for offset in range(8, len(data), 211):
        path.write_bytes(data[:offset])
        assert run(path, "--json", "-").exit_code == EXIT_DATA_LOST


def test_what_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("hello")
    with pytest.raises(RecordingError, match="not a recording or result"):
        run(tmp_path / "a.txt")
    with pytest.raises(RecordingError, match="no such file"):
        run(tmp_path / "gone")


def test_folder(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    for index in range(4):
        cv2.imwrite(str(folder / f"{index}.png"), np.full((6, 8), 500, np.uint16))
    values = report(folder)
    assert (values["images"], values["first"], values["last"]) == (4, "0.png", "3.png")
    assert values["image"] == {"width": 8, "height": 6, "bits": 16, "channels": 1}
    assert values["no_stamps"].startswith("no stamps; pass --fps, or add a timestamps.csv")
    assert "no intrinsics" in values["no_camera"]

    (folder / "timestamps.csv").write_text("stamp_ns\n0\n100000000\n200000000\n600000000\n")
    (folder / "camera.toml").write_text("fx = 9.0\nfy = 9.0\ncx = 3.0\ncy = 2.5\nmissing = 7\n")
    values = report(folder)
    assert values["stamps"]["rate_hz"] == pytest.approx(10)
    assert values["stamps"]["gaps"] == 1
    assert (values["cameras"][0]["fx"], values["cameras"][0]["missing"]) == (9, 7)
    result = run(folder)
    assert result.exit_code == EXIT_DONE
    assert "folder of 4 images" in result.stdout
    assert "8x6, 16 bit" in result.stdout


def test_commands_import_nothing_heavy() -> None:
    code = (
        "import sys, posetrack_cli.cli.info, posetrack_cli.cli.export;"
        "print([m for m in ('numpy', 'cv2', 'mcap', 'pydantic', 'google.protobuf') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_recording_of_another_tool(tmp_path: Path) -> None:
    archive = layouts.write_r3d(tmp_path / "a.r3d", layouts.r3d_files())
    printed = run(archive).stdout.splitlines()
    assert printed[0].startswith("a.r3d: Record3D recording, 3 frames, ")
    assert printed[1].startswith("stamps: 3 messages, 0.033 s, 60.00 Hz")
    camera = "64x48, fx 60 fy 60.25 cx 31.5 cy 23.5, no distortion (metadata of the recording)"
    assert printed[2] == f"hand run uses {camera}"
    assert "hand run: depth with confidence 0 is ignored" in printed
    camera = "256x192, fx 240 fy 241 cx 127.5 cy 95.5, no distortion (metadata of the recording)"
    assert f"head mono uses {camera}" in printed
