"""Conversion to MCAP: no depth value changes, little is added, equal input gives equal bytes."""

from __future__ import annotations

import filecmp
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import RecordingError, ResultError, UsageError
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.conversion import CALIBRATION_TOPIC, IMAGE_TOPIC, convert_recording
from posetrack_cli.recording.opening import open_recording

SIZE_MARGIN = 0.02
ULP = float(np.finfo(np.float32).eps)


def same(a: Any, b: Any, rtol: float = 0.0) -> None:
    """Both recordings give the same frames and cameras."""
    assert a.cameras[0] == b.cameras[0]
    for one, other in zip(a.frames(), b.frames(), strict=True):
        assert one.stamp_ns == other.stamp_ns
        np.testing.assert_allclose(one.depth, other.depth, rtol=rtol, atol=0)


def test_folder_goes_through_without_change(tmp_path: Path, make: SimpleNamespace) -> None:
    camera = make.CAMERA_TOML + "distortion = [0.1, -0.2, 0.001, 0.002, 0.05]\n"
    source = open_recording(make.write_folder(tmp_path / "r", make.depth_codes(6), camera=camera))
    out = tmp_path / "out.mcap"
    conversion = convert_recording(source, out)
    assert (conversion.frames, conversion.losses) == (6, ())
    same(source, open_recording(out))
    assert not (tmp_path / "out.mcap.part").exists()


def test_png_bytes_are_copied_and_stamped(tmp_path: Path, make: SimpleNamespace) -> None:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    folder = make.write_folder(tmp_path / "r", make.depth_codes(3))
    convert_recording(open_recording(folder), tmp_path / "out.mcap")
    items = list(McapFile(tmp_path / "out.mcap").messages())
    assert [channel.topic for _, channel, _ in items] == [CALIBRATION_TOPIC, *[IMAGE_TOPIC] * 3]
    files = sorted(folder.glob("*.png"))
    for (_, _, message), file, stamp in zip(items[1:], files, make.stamps(3), strict=True):
        image = CompressedImage.FromString(message.data)
        assert (image.data, image.format, image.frame_id) == (file.read_bytes(), "png", "camera")
        assert message.log_time == message.publish_time == image.timestamp.ToNanoseconds() == stamp


def test_equal_input_gives_equal_bytes(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(4))
    for name in ("a.mcap", "b.mcap"):
        convert_recording(open_recording(folder), tmp_path / name)
    assert filecmp.cmp(tmp_path / "a.mcap", tmp_path / "b.mcap", shallow=False)


def test_size_stays_within_the_margin_of_the_pngs(tmp_path: Path, make: SimpleNamespace) -> None:
    rng = np.random.default_rng(0)
    images = list(rng.integers(400, 900, size=(12, 200, 200)).astype(np.uint16))
    camera = "fx = 300.0\nfy = 300.0\ncx = 99.5\ncy = 99.5\n"
    folder = make.write_folder(tmp_path / "r", images, camera=camera)
    convert_recording(open_recording(folder), tmp_path / "out.mcap")
    pngs = sum(file.stat().st_size for file in folder.glob("*.png"))
    assert (tmp_path / "out.mcap").stat().st_size < pngs * (1 + SIZE_MARGIN)


@pytest.mark.parametrize(
    "options", [{"missing": 555}, {"mirror": True}, {"depth_unit_mm": 0.125}, {"depth_unit_mm": 0.3}]
)
def test_options_are_applied_once(tmp_path: Path, make: SimpleNamespace, options: dict[str, Any]) -> None:
    source = open_recording(make.write_folder(tmp_path / "r", make.depth_codes(3)), **options)
    convert_recording(source, tmp_path / "out.mcap")
    # metres in float32 and back round twice
    same(source, open_recording(tmp_path / "out.mcap"), rtol=2 * ULP if "depth_unit_mm" in options else 0.0)


def test_crop_and_other_formats(tmp_path: Path, make: SimpleNamespace) -> None:
    camera = make.CAMERA_TOML + "crop = [3, 2, 10, 9]\nmissing = 32001\n"
    source = open_recording(
        make.write_folder(tmp_path / "r", make.depth_codes(2), camera=camera, suffix=".tif")
    )
    convert_recording(source, tmp_path / "out.mcap")
    same(source, open_recording(tmp_path / "out.mcap"))


@pytest.mark.parametrize("flavour", ["ros1", "ros2", "foxglove"])
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_mcap_to_mcap(tmp_path: Path, make: SimpleNamespace, flavour: str, encoding: str) -> None:
    calibration = make.calibration_fields(upper=flavour != "ros2")
    messages = [("/cam/info", "CameraInfo", 5, 5, calibration)]
    for stamp, image in zip(make.stamps(3), make.depth_codes(3), strict=True):
        stored = image if encoding == "16UC1" else image.astype(np.float32) / 1234
        messages.append(("/cam/image", "Image", stamp, stamp, make.raw_fields(stored, encoding)))
    source = open_recording(make.WRITERS[flavour](tmp_path / "in.mcap", messages))
    convert_recording(source, tmp_path / "out.mcap")
    same(source, open_recording(tmp_path / "out.mcap"), rtol=0.0 if encoding == "16UC1" else 2 * ULP)


def test_mirrored_mcap_does_not_copy_its_pngs(tmp_path: Path, foxglove_file: Path) -> None:
    source = open_recording(foxglove_file, mirror=True)
    convert_recording(source, tmp_path / "out.mcap")
    same(source, open_recording(tmp_path / "out.mcap"))


def test_converted_file_converts_to_itself(tmp_path: Path, foxglove_file: Path) -> None:
    convert_recording(open_recording(foxglove_file), tmp_path / "a.mcap")
    convert_recording(open_recording(tmp_path / "a.mcap"), tmp_path / "b.mcap")
    first, second = (
        [(c.topic, m.log_time, m.data) for _, c, m in McapFile(tmp_path / name).messages()]
        for name in ("a.mcap", "b.mcap")
    )
    assert first == second


def test_truth_travels_along(tmp_path: Path, make: SimpleNamespace) -> None:
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    with McapSink(tmp_path / "in.mcap") as sink:
        info, image = sink.channel("/cam/info", CameraCalibration), sink.channel("/cam/image", RawImage)
        truth = sink.json_channel("/truth/hand", "hand", {"type": "object"})
        sink.write(info, 1, CameraCalibration(**make.calibration_fields()).SerializeToString())
        for stamp, codes in ((10, make.depth_codes(1)[0]), (20, make.depth_codes(1)[0])):
            sink.write(image, stamp, RawImage(**make.raw_fields(codes, "16UC1")).SerializeToString())
            sink.write(truth, stamp, f'{{"stamp":{stamp}}}'.encode())
        sink.finish()
    source = open_recording(tmp_path / "in.mcap")
    convert_recording(source, tmp_path / "out.mcap")
    found = list(open_recording(tmp_path / "out.mcap").truth())
    assert found == list(source.truth())
    assert [message.data for message in found] == [b'{"stamp":10}', b'{"stamp":20}']


def test_lost_frames_are_told(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(4))
    (folder / "000001.png").write_bytes((folder / "000001.png").read_bytes()[:-60])
    conversion = convert_recording(open_recording(folder), tmp_path / "out.mcap")
    assert conversion.frames == 3
    (loss,) = conversion.losses
    assert loss.first == "frame 1, 000001.png"


def test_existing_output_is_kept_unless_asked(tmp_path: Path, make: SimpleNamespace) -> None:
    source = open_recording(make.write_folder(tmp_path / "r", make.depth_codes(2)))
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(UsageError, match="already exists"):
        convert_recording(source, out)
    assert out.read_bytes() == b"precious"
    convert_recording(source, out, overwrite=True)
    same(source, open_recording(out))
    with pytest.raises(UsageError, match="replace the recording"):
        convert_recording(open_recording(out), out, overwrite=True)
    with pytest.raises(UsageError, match=r"ending in \.mcap"):
        convert_recording(source, tmp_path / "out.bag")


def test_failure_leaves_nothing_behind_and_spares_the_old_file(tmp_path: Path, make: SimpleNamespace) -> None:
    source = open_recording(make.write_folder(tmp_path / "r", make.depth_codes(3)))
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    for image in (tmp_path / "r").glob("*.png"):
        image.write_bytes(b"damaged meanwhile")
    with pytest.raises(RecordingError, match="no frame can be decoded"):
        convert_recording(source, out, overwrite=True)
    assert out.read_bytes() == b"precious"
    assert not (tmp_path / "out.mcap.part").exists()
    with pytest.raises(ResultError, match="no folder"):
        convert_recording(source, tmp_path / "gone" / "out.mcap")


def test_a_kinect_recording_keeps_its_size_and_all_its_frames(
    tmp_path: Path, make: SimpleNamespace, measured_data: Path
) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text("fx = 363.9\nfy = 363.9\ncx = 255.4\ncy = 206.3\n")
    folder = measured_data / "kinect2-hand"
    source = open_recording(folder, camera_file=camera, fps=30)
    convert_recording(source, tmp_path / "out.mcap")
    pngs = sum(file.stat().st_size for file in folder.glob("*.png"))
    assert (tmp_path / "out.mcap").stat().st_size == pytest.approx(pngs, rel=SIZE_MARGIN)
    same(source, open_recording(tmp_path / "out.mcap"))
