"""Folders of images: pixels, stamps, camera.toml, and what goes wrong with them."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.records import Metadata

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.conversion import convert_recording
from posetrack_cli.recording.opening import describe, open_recording


def test_frames_are_the_images_in_order_with_their_stamps(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(5)
    recording = open_recording(make.write_folder(tmp_path / "r", images))
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == make.stamps(5)
    assert [frame.index for frame in frames] == [0, 1, 2, 3, 4]
    for frame, image in zip(frames, images, strict=True):
        assert frame.depth.dtype == np.float32
        assert frame.depth.flags.c_contiguous
        np.testing.assert_array_equal(frame.depth, image)
    assert recording.losses == ()
    assert recording.frame_count == 5
    assert (recording.cameras[0].width, recording.cameras[0].fx) == (make.WIDTH, 30.0)


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".pgm"])
def test_other_image_formats_keep_their_values(tmp_path: Path, make: SimpleNamespace, suffix: str) -> None:
    images = make.depth_codes(2)
    recording = open_recording(make.write_folder(tmp_path / "r", images, suffix=suffix))
    for frame, image in zip(recording.frames(), images, strict=True):
        np.testing.assert_array_equal(frame.depth, image)


def test_range_and_stride_keep_the_index_of_the_whole_recording(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    recording = open_recording(make.write_folder(tmp_path / "r", make.depth_codes(9)))
    frames = list(recording.frames(start=1, end=8, stride=3))
    assert [frame.index for frame in frames] == [1, 4, 7]
    assert [frame.stamp_ns for frame in frames] == [make.stamps(9)[i] for i in (1, 4, 7)]
    assert len(list(recording.frames())) == 9, "a second pass starts from the beginning"


def test_missing_code_and_zero_both_mean_no_reading(tmp_path: Path, make: SimpleNamespace) -> None:
    codes = np.full((make.HEIGHT, make.WIDTH), 500, np.uint16)
    codes[0, 0], codes[0, 1] = 0, 32001
    folder = make.write_folder(tmp_path / "r", [codes], camera=make.CAMERA_TOML + "missing = 32001\n")
    depth = next(iter(open_recording(folder).frames())).depth
    assert depth[0, 0] == depth[0, 1] == 0
    assert np.count_nonzero(depth) == codes.size - 2
    kept = next(iter(open_recording(folder, missing=7).frames())).depth
    assert kept[0, 1] == 32001, "the option replaces the file's code"


def test_depth_unit_scales_and_the_option_overrides_the_file(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(1)
    folder = make.write_folder(tmp_path / "r", images, camera=make.CAMERA_TOML + "depth_unit_mm = 0.125\n")
    np.testing.assert_array_equal(next(iter(open_recording(folder).frames())).depth, images[0] * 0.125)
    scaled = next(iter(open_recording(folder, depth_unit_mm=2).frames())).depth
    np.testing.assert_array_equal(scaled, images[0] * 2.0)


def test_crop_keeps_the_rays_of_the_pixels(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(1)
    whole = open_recording(make.write_folder(tmp_path / "a", images))
    cropped = open_recording(
        make.write_folder(tmp_path / "b", images, camera=make.CAMERA_TOML + "crop = [3, 2, 10, 9]\n")
    )
    depth = next(iter(cropped.frames())).depth
    np.testing.assert_array_equal(depth, images[0][2:11, 3:13])
    point = np.array([12.0, -7.0, 600.0])
    difference = (
        whole.cameras[0].pixels_from_points(point)[0] - cropped.cameras[0].pixels_from_points(point)[0]
    )
    np.testing.assert_allclose(difference, [3, 2])
    assert (cropped.cameras[0].width, cropped.cameras[0].height) == (10, 9)


@pytest.mark.parametrize("crop", [None, (3, 2, 10, 9)])
def test_mirrored_point_projects_to_the_mirrored_pixel(
    tmp_path: Path, make: SimpleNamespace, crop: tuple[int, ...] | None
) -> None:
    image = np.zeros((make.HEIGHT, make.WIDTH), np.uint16)
    image[5, 7] = 640  # one pixel with depth, at a known place in space
    camera = make.CAMERA_TOML + (f"crop = {list(crop)}\n" if crop else "")
    folder = make.write_folder(tmp_path / "r", [image], camera=camera)
    plain = open_recording(folder)
    v, u = np.argwhere(next(iter(plain.frames())).depth)[0]
    point = plain.cameras[0].points_from_pixels(np.array([float(u), float(v)]), np.array(640.0))

    mirrored = open_recording(folder, mirror=True)
    pixel, _ = mirrored.cameras[0].pixels_from_points(point * [-1, 1, 1])
    depth = next(iter(mirrored.frames())).depth
    assert depth.flags.c_contiguous
    np.testing.assert_allclose(pixel, np.argwhere(depth)[0][::-1], atol=1e-9)


def test_camera_file_mirror_can_be_undone(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(1)
    folder = make.write_folder(tmp_path / "r", images, camera=make.CAMERA_TOML + "mirror = true\n")
    np.testing.assert_array_equal(next(iter(open_recording(folder).frames())).depth, images[0][:, ::-1])
    straight = open_recording(folder, mirror=False)
    np.testing.assert_array_equal(next(iter(straight.frames())).depth, images[0])


def test_fps_gives_rounded_stamps_that_do_not_drift(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(4), stamp_lines=[])
    found = [frame.stamp_ns for frame in open_recording(folder, fps=30).frames()]
    assert found == [0, 33_333_333, 66_666_667, 100_000_000]


@pytest.mark.parametrize(
    "lines",
    [
        ["filename,stamp_ns", "000001.png,20", "000000.png,10"],
        ["time_s", "0.00000001", "2e-8"],
        ["filename,time_s", "000000.png,0.00000001", "000001.png,0.00000002"],
        ["stamp_ns", "10", "", "20"],
    ],
)
def test_stamp_files(tmp_path: Path, make: SimpleNamespace, lines: list[str]) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(2), stamp_lines=lines)
    assert [frame.stamp_ns for frame in open_recording(folder).frames()] == [10, 20]


def test_seconds_are_exact_even_for_epoch_times(tmp_path: Path, make: SimpleNamespace) -> None:
    lines = ["time_s", "1700000000.123456789"]  # a float would be off by about 100 ns
    folder = make.write_folder(tmp_path / "r", make.depth_codes(1), stamp_lines=lines)
    assert [frame.stamp_ns for frame in open_recording(folder).frames()] == [1700000000123456789]


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        (["stamp_ns", "1"], "found 1 stamps, expected 2"),
        (["stamp_ns", "1", "2", "3"], "found 3 stamps, expected 2"),
        (["1", "2"], "unknown header"),
        (["stamp_ns", "1", "x"], "line 3: stamp is not a number, found 'x'"),
        (["stamp_ns", "1", "2.5"], "stamp is not a whole number"),
        (["time_s", "nan", "2.5"], "stamp is not a number"),
        (
            ["stamp_ns", "-1", "2"],
            "line 2: stamp is out of range, found '-1', expected 0 to 9",
        ),
        (["stamp_ns", "1", "9223372036854775808"], "line 3: stamp is out of range"),
        (["time_s", "1", "1e99999"], "stamp is out of range"),
        (["time_s", "1", "1e999999999999999999"], "stamp is not a number"),
        (["filename,stamp_ns", "000000.png,1", "other.png,2"], "no stamp for image 000001.png"),
        (["filename,stamp_ns", "000000.png,1", "2"], "line 3: row does not fit the header"),
        ([""], "is empty"),
    ],
)
def test_stamp_files_that_cannot_be_used(
    tmp_path: Path, make: SimpleNamespace, lines: list[str], says: str
) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(2), stamp_lines=lines)
    assert says in message_of(folder)


def test_no_stamps_says_what_to_do(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(1), stamp_lines=[])
    assert "--fps" in message_of(folder)
    assert "timestamps.csv" in message_of(folder)


@pytest.mark.parametrize("fps", [0.0, -1.0, 1e-300, 1e300, float("nan"), float("inf")])
def test_frame_rate_must_be_usable(tmp_path: Path, make: SimpleNamespace, fps: float) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(1))
    with pytest.raises(UsageError, match="frame rate"):
        open_recording(folder, fps=fps)


def test_no_intrinsics_shows_what_to_write(tmp_path: Path, make: SimpleNamespace) -> None:
    text = message_of(make.write_folder(tmp_path / "r", make.depth_codes(1), camera=None))
    assert "no intrinsics" in text
    assert "camera.toml" in text
    assert "fx = " in text


def test_camera_option_replaces_the_folders_file(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(1))
    other = tmp_path / "other.toml"
    other.write_text(make.CAMERA_TOML.replace("30.0", "99.0"))
    assert open_recording(folder, camera_file=other).cameras[0].fx == 99.0
    with pytest.raises(RecordingError, match=r"gone\.toml: cannot be read"):
        open_recording(folder, camera_file=tmp_path / "gone.toml")


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        ("fx = 1.0\nfy = 1.0\ncx = 1.0\n", "key 'cy' is missing"),
        ("FXY", "not valid TOML"),
        ("{c}depth_unit = 1.0\n", "unknown key 'depth_unit'; did you mean 'depth_unit_mm'"),
        ("{c}mirror = 'maybe'\n", "invalid value for 'mirror', found maybe"),
        ("{c}missing = -1\n", "invalid value for 'missing'"),
        ("{c}distortion = [0.1, 0.2]\n", "plumb_bob with 2 coefficients"),
        ("{c}distortion_model = 'fish'\n", "invalid value for 'distortion_model'"),
        ("{c}width = 640\n", "found images of 24x16, expected 640x16"),
        ("{c}crop = [20, 0, 10, 10]\n", "crop exceeds the image"),
        ("{c}crop = [-1, 0, 10, 10]\n", "crop exceeds the image"),
        ("fx = 0.0\nfy = 1.0\ncx = 1.0\ncy = 1.0\n", "invalid value for 'fx'"),
        ("{c}depth_unit_mm = 1e300\n", "invalid value for 'depth_unit_mm'"),
        ("fx = inf\nfy = 1.0\ncx = 1.0\ncy = 1.0\n", "invalid value for 'fx'"),
    ],
)
def test_camera_files_that_cannot_be_used(
    tmp_path: Path, make: SimpleNamespace, camera: str, says: str
) -> None:
    text = message_of(
        make.write_folder(tmp_path / "r", make.depth_codes(1), camera=camera.replace("{c}", make.CAMERA_TOML))
    )
    assert says in text
    assert "\n" not in text


def test_images_that_are_no_depth(tmp_path: Path, make: SimpleNamespace) -> None:
    grey = np.full((make.HEIGHT, make.WIDTH), 100, np.uint8)
    assert "8-bit image given as depth" in message_of(make.write_folder(tmp_path / "grey", [grey]))
    colour = np.zeros((make.HEIGHT, make.WIDTH, 3), np.uint16)
    assert "colour image" in message_of(make.write_folder(tmp_path / "colour", [colour]))


@pytest.mark.parametrize(
    ("odd", "says"),
    [
        (np.ones((8, 8), np.uint16), "size is 8x8, not 24x16 like the first"),
        (np.ones((16, 24), np.uint8), "8-bit image given as depth"),
    ],
)
def test_an_image_of_another_kind_is_left_out_and_counted(
    tmp_path: Path, make: SimpleNamespace, odd: np.ndarray, says: str
) -> None:
    images = [*make.depth_codes(3), odd, *make.depth_codes(1)]
    recording = open_recording(make.write_folder(tmp_path / "r", images))
    assert [frame.index for frame in recording.frames()] == [0, 1, 2, 4]
    (loss,) = recording.losses
    assert says in loss.what and "000003.png" in loss.first


@pytest.mark.parametrize("damage", ["empty", "garbage", "cut", "gone"])
def test_unreadable_image_is_skipped_and_counted(tmp_path: Path, make: SimpleNamespace, damage: str) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(5))
    recording = open_recording(folder)
    bad = folder / "000002.png"
    if damage == "gone":
        bad.unlink()
    else:
        contents = {"empty": b"", "garbage": b"not an image", "cut": bad.read_bytes()[:200]}
        bad.write_bytes(contents[damage])
    assert [frame.index for frame in recording.frames()] == [0, 1, 3, 4]
    (loss,) = recording.losses
    assert loss.count == 1
    assert "frame 2, 000002.png" in loss.first
    assert len(list(recording.frames(start=3))) == 2
    assert recording.losses == (), "losses are those of the last pass"


def test_unreadable_first_image_is_no_obstacle(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(3))
    (folder / "000000.png").write_bytes(b"")
    recording = open_recording(folder)
    assert [frame.index for frame in recording.frames()] == [1, 2]


def test_nothing_readable_is_an_error(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(3))
    for image in folder.glob("*.png"):
        image.write_bytes(b"x")
    assert "no image can be decoded, found 3 files" in message_of(folder)


def test_paths_that_are_no_recording(tmp_path: Path) -> None:
    assert "no such file or folder" in message_of(tmp_path / "gone")
    (tmp_path / "empty").mkdir()
    assert "no images, found empty folder" in message_of(tmp_path / "empty")
    (tmp_path / "notes.txt").write_text("hello")
    assert "not a recording" in message_of(tmp_path / "notes.txt")
    (tmp_path / "zero.mcap").write_bytes(b"")
    assert "an empty file" in message_of(tmp_path / "zero.mcap")


def test_options_that_do_not_apply(tmp_path: Path, make: SimpleNamespace, foxglove_file: Path) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(1))
    with pytest.raises(UsageError, match="--topic does not apply to a folder"):
        open_recording(folder, topic="/x")
    with pytest.raises(UsageError, match="--camera-topic does not apply"):
        open_recording(folder, camera_topic="/x")
    with pytest.raises(UsageError, match="--fps does not apply to an MCAP file"):
        open_recording(foxglove_file, fps=30.0)
    for path in (folder, foxglove_file):
        with pytest.raises(UsageError, match="depth option"):
            open_recording(path, depth_unit_mm=-1.0)
        with pytest.raises(UsageError, match="depth option"):
            open_recording(path, missing=65536)


def test_identity_depends_on_contents_and_names_no_path(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(3)
    first = open_recording(make.write_folder(tmp_path / "a" / "r", images)).identity()
    same = open_recording(make.write_folder(tmp_path / "b" / "r", images)).identity()
    other = open_recording(make.write_folder(tmp_path / "c" / "r", images[::-1])).identity()
    assert first == same
    assert first["sha256"] != other["sha256"]
    assert str(tmp_path) not in str(first)
    assert (first["name"], first["kind"], first["frames"]) == ("r", "folder", "3")


def test_a_name_that_is_no_text_is_told_and_stored(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / os.fsdecode(b"r\xff\xc3\xb6"), make.depth_codes(2))
    out = tmp_path / "out.mcap"
    convert_recording(open_recording(folder), out)
    assert open_recording(folder).identity()["name"] == describe(folder)["name"] == "r\ufffdö"
    (source,) = (record for record in McapFile(out).extras() if isinstance(record, Metadata))
    assert source.metadata["name"] == "r\ufffdö"


def test_a_link_to_nowhere_is_an_error_on_one_line(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(2))
    (folder / "000001.png").unlink()
    (folder / "000001.png").symlink_to(tmp_path / "nowhere.png")
    recording = open_recording(folder)
    assert len(list(recording.frames())) == 1 and recording.losses[0].first == "frame 1, 000001.png"
    with pytest.raises(RecordingError, match=r"000001.png: cannot be read"):
        recording.identity()


def test_hidden_files_are_no_images(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(2))
    (folder / "._000000.png").write_bytes(b"left by another system")
    assert open_recording(folder).frame_count == 2


def test_senz3d_recording_is_read_without_its_empty_column(tmp_path: Path, measured_data: Path) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text(
        "fx = 224.5\nfy = 230.5\ncx = 160\ncy = 120\nmissing = 32001\ncrop = [0, 0, 320, 240]\n"
    )
    recording = open_recording(measured_data / "cvar-hand" / "P1", camera_file=camera, fps=30)
    frames = list(recording.frames(end=5))
    assert all(frame.depth.shape == (240, 320) for frame in frames)
    assert all(0 < frame.depth.max() < 32001 for frame in frames)


def message_of(path: Path) -> str:
    """The line that opening a recording fails with."""
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    return str(caught.value)
