"""``posetrack info`` of images of cameras: folders, MCAP files, videos."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.cli.info import info
from support import images as support

LEFT, RIGHT = support.grey_images(4), support.grey_images(4, seed=1)


def lines(path: Path) -> list[str]:
    return CliRunner().invoke(info, [str(path)], catch_exceptions=False).stdout.splitlines()


def report(path: Path) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(CliRunner().invoke(info, [str(path), "--json", "-"]).stdout)
    return values


def test_folders_of_two_cameras(tmp_path: Path) -> None:
    path = support.write_rig(tmp_path / "r", {"left": LEFT, "right": [*RIGHT[:3], None]})
    values = report(path)
    assert (values["kind"], values["frames"], values["incomplete_frames"]) == ("images", 4, 1)
    assert values["stamps"]["rate_hz"] == pytest.approx(30.0, rel=1e-6)
    assert [folder["images"] for folder in values["folders"]] == [4, 3]
    distance = np.linalg.norm(np.array(support.rig()[1].camera_T_reference)[:, 3])
    assert values["cameras"][1]["distance_mm"] == pytest.approx(distance)
    text = lines(path)
    assert text[0].startswith("r: 7 images of 2 cameras")
    assert text[1] == "images left: 4, 000000.png to 000003.png, 32x24, 8-bit grey"
    assert text[3] == "frames: 4, of which 1 lack a camera"
    assert text[-1].endswith("101.1 mm from the first (camera.toml)")


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    path = support.write_rig(tmp_path / "r", {"left": LEFT, "right": RIGHT})
    (path / "camera.toml").unlink()
    (path / "timestamps.csv").unlink()
    values = report(path)
    assert "pass --fps" in values["no_stamps"]
    assert "cameras are not calibrated" in values["no_camera"]
    assert values["cameras"] == []
    assert any("posetrack calibrate stereo" in line for line in lines(path))


def test_one_folder_of_8_bit_images(tmp_path: Path) -> None:
    support.write_images(tmp_path / "r", LEFT, suffix=".jpg")
    values = report(tmp_path / "r")
    assert values["kind"] == "images"
    assert values["folders"][0]["stored"] == "8-bit grey"
    assert lines(tmp_path / "r")[1] == "images: 4, 000000.jpg to 000003.jpg, 32x24, 8-bit grey"


def test_mcap_of_two_cameras_tells_how_they_stand(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    from posetrack_cli.mcap.sink import McapSink

    def write(path: Path, baseline_m: float) -> Path:
        with McapSink(path) as sink:
            for name, tx in (("left", 0.0), ("right", baseline_m)):
                k = [40, 0, 15, 0, 41, 12, 0, 0, 1]
                p = [40, 0, 15, -40 * tx, 0, 41, 12, 0, 0, 0, 1, 0]
                camera = CameraCalibration(width=32, height=24, frame_id=name, K=k, P=p)
                image = RawImage(width=32, height=24, frame_id=name, encoding="mono8", data=LEFT[0].tobytes())
                sink.write(sink.channel(f"/{name}/info", CameraCalibration), 1, camera.SerializeToString())
                sink.write(sink.channel(f"/{name}/image", RawImage), 1, image.SerializeToString())
            sink.finish()
        return path

    path = write(tmp_path / "r.mcap", 0.12)
    assert report(path)["rig"][1]["distance_mm"] == pytest.approx(120.0)
    assert "cameras together: left is the reference, right at 120.0 mm" in lines(path)
    unplaced = write(tmp_path / "u.mcap", 0.0)
    assert "no extrinsics for cameras left, right" in report(unplaced)["no_rig"]


def test_video(tmp_path: Path) -> None:
    import cv2

    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    for _ in range(5):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    values = report(tmp_path / "v.avi")
    assert (values["kind"], values["frames"], values["rate_hz"]) == ("video", 5, 25.0)
    assert values["image"] == {"width": 64, "height": 48}
    assert "cameras are not calibrated" in values["no_camera"]
    assert lines(tmp_path / "v.avi")[1].startswith("images: 5, 64x48, 25.00 Hz")
