"""Recordings of Stray Scanner, Record3D, Biwi and NYU, opened as their tools and authors store them."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import PosetrackError, RecordingError, UsageError
from posetrack_cli.recording.base import UnreadableImageError
from posetrack_cli.recording.conversion import convert_recording
from posetrack_cli.recording.datasets.biwi import decode_depth
from posetrack_cli.recording.opening import describe, open_recording
from support import datasets as data

KINECT_NS = 33_333_333
MM_ULP = 1e-4
"""Depth of less than 1 m in mm, from float32 in m."""


def depths(path: Path, **options: object) -> list[np.ndarray]:
    return [frame.depth for frame in open_recording(path, **options).frames()]  # type: ignore[arg-type]


def stamps(path: Path, kind: str = "depth", **options: object) -> list[int]:
    return [f.stamp_ns for f in open_recording(path, kind, **options).frames()]  # type: ignore[arg-type]


def write_video(path: Path, size: tuple[int, int], count: int = 3) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 60, size)
    for number in range(count):
        writer.write(cv2.imdecode(np.frombuffer(data.colour_image(number, size, ".png"), np.uint8), 1))
    writer.release()


@pytest.fixture
def stray(tmp_path: Path) -> Path:
    folder = data.write_files(tmp_path / "scan", data.stray_files())
    write_video(folder / "rgb.mp4", data.STRAY_VIDEO)
    return folder


# Stray Scanner


def test_stray_scanner_depth(stray: Path) -> None:
    recording = open_recording(stray)
    frames = list(recording.frames())
    for number, frame in enumerate(frames):
        expected = data.depth_codes(number, (256, 192)).astype(np.float32)
        expected[:, :7] = 0  # confidence 0; 1 stays
        np.testing.assert_array_equal(frame.depth, expected)
    assert [frame.stamp_ns for frame in frames] == [5_000_000_000_000, 5_000_016_667_000, 5_000_033_333_000]
    camera = recording.cameras[0]
    fx, _, cx, cy = data.STRAY_MATRIX
    scale = 256 / data.STRAY_VIDEO[0]
    found = (camera.width, camera.height, camera.fx, camera.cx, camera.cy)
    assert found == pytest.approx((256, 192, fx * scale, (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5))
    assert recording.why == ("camera_matrix.csv",)
    assert recording.remarks == (
        "Stray Scanner recording: 3 images",
        "images are landscape (sensor orientation); intrinsics are those of rgb.mp4",
        "depth with confidence 0 is ignored",
        "intrinsics for 320x240 are scaled to 256x192",
    )


def test_stray_scanner_video(stray: Path) -> None:
    recording = open_recording(stray, "grey")
    camera = recording.cameras[0]
    assert (camera.width, camera.height) == data.STRAY_VIDEO
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == data.STRAY_MATRIX
    assert len(list(recording.frames())) == 3


def test_stray_scanner_without_video_has_the_usual_size(tmp_path: Path) -> None:
    files = data.stray_files() | {"camera_matrix.csv": b"1600, 0, 960\n0, 1600, 720\n0, 0, 1\n"}
    camera = open_recording(data.write_files(tmp_path / "scan", files)).cameras[0]
    assert (camera.width, camera.fx) == (256, pytest.approx(1600 * 256 / 1920))


def test_stray_scanner_matrix_of_another_picture(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"does not fit the video.*found cx 159.5.*pass --camera"):
        open_recording(data.write_files(tmp_path / "scan", data.stray_files()))


def test_stray_scanner_intrinsics_of_each_image(stray: Path) -> None:
    data.write_files(stray, data.stray_files(focal=(266.0, 266.0, 320.0)))
    first, second, zoomed = depths(stray)
    row, centre = 95, 127
    expected = data.depth_codes(2, (256, 192)).astype(np.float32)
    expected[:, :7] = 0
    # 20 px right of the centre at a length of 266 is 20 * 320 / 266 = 24 px there at one of 320
    assert zoomed[row, centre + 20] == expected[row, centre + 24]
    assert zoomed[row, centre] == expected[row, centre]
    np.testing.assert_array_equal(second[:9, 7:], data.depth_codes(1, (256, 192))[:9, 7:])
    assert first.shape == zoomed.shape
    assert any("applied image by image" in remark for remark in open_recording(stray).remarks)


def test_stray_scanner_images_without_a_stamp(stray: Path) -> None:
    data.write_files(stray, data.stray_files(numbers=(0, 2)))
    recording = open_recording(stray)
    assert [frame.stamp_ns for frame in recording.frames()] == [5_000_000_000_000, 5_000_033_333_000]
    assert "skipped 1 depth images without a stamp in odometry.csv" in recording.remarks


@pytest.mark.parametrize(
    ("name", "content", "error"),
    [
        ("camera_matrix.csv", b"1, 2\n", "invalid camera matrix.*found 2 numbers"),
        ("camera_matrix.csv", b"fx, fy\n", "not a file of numbers"),
        ("camera_matrix.csv", b"0 0 160 0 0 120 0 0 1", "invalid intrinsics"),
        ("camera_matrix.csv", b"nan 0 160 0 nan 120 0 0 1", "invalid intrinsics"),
        ("odometry.csv", b"", "is empty, expected timestamp, frame"),
        ("odometry.csv", b"0.1, 0.2, 0.3, 0, 0, 0, 1\n", "unknown header.*expected timestamp, frame"),
        ("odometry.csv", b"timestamp, frame\nx, 000000\n", "line 2: stamp is not a number"),
        ("odometry.csv", b"timestamp, frame\n1e999999999, 000000\n", "stamp is not a number"),
        ("odometry.csv", b"timestamp, frame\n1e18, 000000\n", "stamp is out of range"),
        ("odometry.csv", b"timestamp, frame\nnan, 000000\n", "stamp is not a number"),
        ("odometry.csv", b"timestamp, frame\n1.0\n", "line 2: row does not fit the header"),
        ("odometry.csv", b"timestamp, frame\n1.0, 7\n", "no depth image has a stamp.*numbers 7 to 7"),
    ],
)
def test_stray_scanner_files_that_cannot_be_used(stray: Path, name: str, content: bytes, error: str) -> None:
    (stray / name).write_bytes(content)
    with pytest.raises(RecordingError, match=error):
        open_recording(stray)


def test_stray_scanner_confidence_of_another_size_is_a_loss(stray: Path) -> None:
    (stray / "confidence" / "000001.png").write_bytes(data.png(np.zeros((9, 9), np.uint8)))
    recording = open_recording(stray)
    assert [frame.index for frame in recording.frames()] == [0, 2]
    assert [loss.what for loss in recording.losses] == ["image skipped, confidence and depth differ in size"]


# Record3D


@pytest.fixture(params=["archive", "deflated archive", "folder"])
def record3d(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    files = data.r3d_files()
    if request.param == "folder":
        return data.write_files(tmp_path / "scan", files)
    deflated = request.param.startswith("deflated")
    method = zipfile.ZIP_DEFLATED if deflated else zipfile.ZIP_STORED
    return data.write_r3d(tmp_path / "scan.r3d", files, method)


def test_record3d_depth(record3d: Path) -> None:
    recording = open_recording(record3d)
    frames = list(recording.frames())
    expected = 1000 * data.r3d_depth()
    expected[: data.R3D_NOISY_BORDER - 1] = 0
    expected[:, : data.R3D_NOISY_BORDER] = 0
    for frame in frames:
        np.testing.assert_allclose(frame.depth, expected, atol=MM_ULP)
    assert [frame.stamp_ns for frame in frames] == [10**11, 100_016_666_667, 100_033_333_333]
    camera = recording.cameras[0]
    found = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    assert found == pytest.approx((64, 48, 60.0, 60.25, 31.5, 23.5))
    assert recording.losses == ()


def test_record3d_colour(record3d: Path) -> None:
    recording = open_recording(record3d, "grey")
    camera = recording.cameras[0]
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx) == (256, 192, 240.0, 241.0, 127.5)
    for number, frame in enumerate(recording.frames()):
        (image,) = frame.images
        assert image is not None
        bar = np.abs(image.astype(int) - int(image[0, -1])).max(axis=0) > 20
        assert bar[8 * number + 3]
        assert not bar[8 * number + 12 :].any()


def test_record3d_rate_in_place_of_stamps_is_reported(tmp_path: Path) -> None:
    path = data.write_r3d(tmp_path / "a.r3d", data.r3d_files(frameTimestamps=None, fps=50))
    assert stamps(path) == [0, 20_000_000, 40_000_000]
    assert "no stamps: assuming 50 frames/s, as stated in the metadata" in open_recording(path).remarks


def test_record3d_intrinsics_of_each_image(tmp_path: Path) -> None:
    own = [[240.0, 241.0, 127.5, 95.5], [240.0, 241.0, 127.5, 95.5], [240.0, 241.0, 147.5, 95.5]]
    path = data.write_r3d(tmp_path / "a.r3d", data.r3d_files(perFrameIntrinsicCoeffs=own))
    first, _, moved = depths(path)
    np.testing.assert_array_equal(moved[10:, 10:50], first[10:, 15:55])  # 20 px of colour are 5 of depth
    assert any("applied image by image" in remark for remark in open_recording(path).remarks)


@pytest.mark.parametrize("number", ["depth", "conf"])
def test_record3d_damage_is_a_loss(tmp_path: Path, number: str) -> None:
    files = data.r3d_files()
    files[f"rgbd/1.{number}"] = files[f"rgbd/1.{number}"][:100]
    recording = open_recording(data.write_r3d(tmp_path / "a.r3d", files))
    assert [frame.index for frame in recording.frames()] == [0, 2]
    assert [loss.what for loss in recording.losses] == ["image skipped, image is damaged"]


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"dw": None}, "invalid size of depth images"),
        ({"dw": 1 << 25, "dh": 1 << 25}, "invalid size of depth images"),
        ({"dw": -1}, "invalid metadata, found dw"),
        ({"K": [1.0] * 8}, "invalid metadata, found K"),
        ({"K": [0.0] * 9}, "invalid intrinsics"),
        ({"dw": 48, "dh": 64}, "differ in aspect ratio"),
        ({"fps": None, "frameTimestamps": []}, "no stamps and no frame rate"),
        ({"frameTimestamps": [-1.0, 4.0, 5.0]}, "frameTimestamps are negative"),
        ({"frameTimestamps": [0.0, 1.0, 1e12]}, "or too late"),
    ],
)
def test_record3d_metadata_that_cannot_be_used(
    tmp_path: Path, changes: dict[str, object], error: str
) -> None:
    path = data.write_r3d(tmp_path / "a.r3d", data.r3d_files(**changes))
    with pytest.raises(PosetrackError, match=error):
        list(open_recording(path).frames())


@pytest.mark.parametrize("keep", [4, 200, -30])
def test_record3d_archives_that_are_cut(tmp_path: Path, keep: int) -> None:
    path = data.write_r3d(tmp_path / "a.r3d", data.r3d_files())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(RecordingError, match="damaged zip archive"):
        open_recording(path)


def test_record3d_without_images_or_metadata(tmp_path: Path) -> None:
    files = data.r3d_files()
    with pytest.raises(RecordingError, match="no images of this kind"):
        open_recording(data.write_r3d(tmp_path / "a.r3d", {"metadata": files["metadata"]}))
    del files["metadata"]
    with pytest.raises(RecordingError, match="expected a file metadata"):
        open_recording(data.write_r3d(tmp_path / "b.r3d", files))


def test_record3d_export_of_exr(tmp_path: Path) -> None:
    files = data.r3d_files()
    exported = {"metadata.json": files["metadata"], "depth/0.exr": b"v/1\1", "rgb/0.jpg": files["rgbd/0.jpg"]}
    folder = data.write_files(tmp_path / "export", exported)
    with pytest.raises(RecordingError, match=r"EXR depth is not supported; export the recording as \.r3d"):
        open_recording(folder)
    assert [frame.stamp_ns for frame in open_recording(folder, "grey").frames()] == [10**11]


# Biwi


@pytest.fixture
def biwi(tmp_path: Path) -> Path:
    return data.write_files(tmp_path / "01", data.biwi_files())


def test_biwi_depth(biwi: Path) -> None:
    recording = open_recording(biwi)
    for number, frame in zip((3, 4, 6), recording.frames(), strict=True):
        np.testing.assert_array_equal(frame.depth, data.depth_codes(number, (640, 480)))
    camera = recording.cameras[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion) == (*data.BIWI_DEPTH, ())
    assert stamps(biwi) == [0, KINECT_NS, 100_000_000]  # frame 5 was lost
    assert stamps(biwi, fps=10.0) == [0, 100_000_000, 300_000_000]
    assert recording.remarks == (
        "Biwi Kinect head pose sequence: 3 images",
        "no stamps: assuming 30 frames/s, the rate of a Kinect; override with --fps",
    )


def test_biwi_colour(biwi: Path) -> None:
    recording = open_recording(biwi, "grey")
    camera = recording.cameras[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == data.BIWI_COLOUR
    bars = [8 * number for number in (3, 4, 6)]
    for left, frame in zip(bars, recording.frames(), strict=True):
        (image,) = frame.images
        assert image is not None
        assert set(np.flatnonzero(image[0] != image[0, -1])) == set(range(left, left + 8))


def test_biwi_distortion_and_size(biwi: Path) -> None:
    (biwi / "rgb.cal").write_bytes(data.biwi_calibration(data.BIWI_COLOUR, "0.1 -0.2 0.01 0.02"))
    camera = open_recording(biwi, "grey").cameras[0]
    assert (camera.width, camera.height, camera.distortion) == (640, 480, (0.1, -0.2, 0.01, 0.02))


@pytest.mark.parametrize("content", [b"", b"1 2 3", b"a b c", b"nan " * 27, b"0 " * 27, b"1.5 " * 27])
def test_biwi_calibrations_that_cannot_be_used(biwi: Path, content: bytes) -> None:
    (biwi / "depth.cal").write_bytes(content)
    with pytest.raises(RecordingError, match=r"depth\.cal: "):
        open_recording(biwi)


def test_biwi_runs_as_published() -> None:
    # 4x2: two pixels without, three with, one without, two with; a negative reading is none
    runs = struct.pack("<ii ii3h ii2h", 4, 2, 2, 3, 800, 801, 802, 1, 2, -5, 900)
    np.testing.assert_array_equal(decode_depth(runs), [[0, 0, 800, 801], [802, 0, 0, 900]])


@pytest.mark.parametrize(
    ("content", "error"),
    [
        (b"", "incomplete"),
        (struct.pack("<ii", 640, 480), "incomplete"),
        (struct.pack("<ii", -1, 480), "damaged"),
        (struct.pack("<ii", 1 << 20, 1 << 20), "more than"),
        (struct.pack("<iiii", 4, 2, 0, 0) * 3, "damaged"),
        (struct.pack("<iiii", 4, 2, -1, 2), "damaged"),
        (struct.pack("<iiii", 4, 2, 5, 4), "damaged"),
        (struct.pack("<iiii", 4, 2, 2**31 - 1, 2**31 - 1), "damaged"),
        (struct.pack("<iiii2h", 4, 2, 0, 8, 1, 2), "incomplete"),
    ],
)
def test_biwi_depth_that_is_damaged(content: bytes, error: str) -> None:
    with pytest.raises(UnreadableImageError, match=error):
        decode_depth(content)


# NYU


def test_nyu_depth(tmp_path: Path) -> None:
    recording = open_recording(data.write_files(tmp_path / "train", data.nyu_files()))
    for number, frame in zip((1, 2, 3), recording.frames(), strict=True):
        np.testing.assert_array_equal(frame.depth, data.depth_codes(number, (640, 480)) + 100)
    camera = recording.cameras[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (588.036865, 587.075073, 320.0, 240.0)
    left_out = "depth of camera 2, synthdepth of camera 1, synthdepth of camera 2"
    assert f"reading depth of camera 1; ignoring {left_out}" in recording.remarks


def test_nyu_camera_file_and_rate(tmp_path: Path) -> None:
    path = data.write_files(tmp_path / "train", data.nyu_files(cameras=(3,)))
    (tmp_path / "c.toml").write_text("fx = 600.0\nfy = 600.0\ncx = 319.5\ncy = 239.5\n")
    recording = open_recording(path, camera_file=tmp_path / "c.toml", fps=25.0)
    assert (recording.cameras[0].fx, recording.why) == (600.0, ("c.toml",))
    assert stamps(path, fps=25.0) == [0, 40_000_000, 80_000_000]


@pytest.mark.parametrize("order", [(1, 0, 2), (2, 1, 0)])
def test_colour_images_with_nyu_s_names_are_not_depth(tmp_path: Path, order: tuple[int, int, int]) -> None:
    files = data.nyu_files(cameras=(1,))
    for name, content in ((name, files[name]) for name in files if name.startswith("depth")):
        image = cv2.imdecode(np.frombuffer(content, np.uint8), 1)
        (tmp_path / name).write_bytes(data.png(image[..., order]))
    with pytest.raises(RecordingError, match=r"colour image given as depth.*NYU hand pose folders only"):
        open_recording(tmp_path)


# All of them


@pytest.mark.parametrize("kind", ["stray", "record3d", "biwi", "nyu"])
def test_conversion_keeps_depth_and_stamps(tmp_path: Path, stray: Path, kind: str) -> None:
    path = stray
    if kind == "record3d":
        path = data.write_r3d(tmp_path / "a.r3d", data.r3d_files())
    elif kind != "stray":
        path = data.write_files(tmp_path / kind, data.biwi_files() if kind == "biwi" else data.nyu_files())
    convert_recording(open_recording(path), tmp_path / "out.mcap")
    converted = tmp_path / "out.mcap"
    for one, other in zip(depths(path), depths(converted), strict=True):
        np.testing.assert_allclose(one, other, atol=MM_ULP)
    assert stamps(path) == stamps(converted)
    assert open_recording(path).cameras[0].fx == open_recording(converted).cameras[0].fx


def test_descriptions_name_the_layout_and_both_cameras(stray: Path, biwi: Path, tmp_path: Path) -> None:
    archive = data.write_r3d(tmp_path / "a.r3d", data.r3d_files())
    for path, words, width in (
        (stray, "Stray Scanner recording", 320),
        (biwi, "Biwi Kinect head pose sequence", 640),
        (archive, "Record3D recording", 256),
    ):
        found = describe(path)
        assert (found["kind"], found["format"], found["frames"]) == ("dataset", words, 3)
        assert found["stamps"]["messages"] == 3
        hand, head = found["used"]
        assert (hand["command"], head["command"], hand["problem"]) == ("hand run", "head mono", None)
        assert head["cameras"][0]["width"] == width


@pytest.mark.parametrize("option", [{"topic": "/a"}, {"camera_topic": "/b"}, {"tolerance_ms": 1.0}])
def test_options_that_do_not_apply(biwi: Path, option: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="does not apply to a Biwi Kinect head pose sequence"):
        open_recording(biwi, **option)  # type: ignore[arg-type]


def test_identities_change_with_any_file(stray: Path, biwi: Path, tmp_path: Path) -> None:
    for path, name in (
        (stray, "confidence/000001.png"),
        (stray, "odometry.csv"),
        (biwi, "depth.cal"),
        (data.write_files(tmp_path / "own", data.r3d_files()), "rgbd/2.conf"),
    ):
        before = open_recording(path).identity()["sha256"]
        content = (path / name).read_bytes()
        (path / name).write_bytes(content + b"\n")
        assert open_recording(path).identity()["sha256"] != before


def test_depth_units_and_mirror_are_as_asked(biwi: Path) -> None:
    (plain, *_), (halved, *_) = depths(biwi), depths(biwi, depth_unit_mm=0.5, mirror=True)
    np.testing.assert_array_equal(halved, plain[:, ::-1] / 2)
