"""Conversion of images and videos: what is copied, what is written of the rest, and the cameras read back."""

from __future__ import annotations

import filecmp
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from posetrack_cli.errors import RecordingError
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import NotCalibratedError
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.conversion import Conversion, convert_recording
from posetrack_cli.recording.opening import open_any, open_recording
from posetrack_cli.recording.recording import Recording
from support import images as support

JPEG_LEVELS = 3.0
"""Mean error of smooth pictures at quality 95."""
ONE_CAMERA = "width = 32\nheight = 24\nfx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n"


def converted(source: Recording, out: Path, **options: Any) -> tuple[Recording, Conversion]:
    """The file that a recording is converted to, opened by default."""
    conversion = convert_recording(source, out, **options)
    return open_recording(out, "grey", guess=Guess()) if source.is_guessed else open_recording(
        out, "grey"
    ), conversion


def same(source: Recording, made: Recording, *, levels: float = 0.0) -> None:
    """Both have the same cameras and frames; ``levels`` is the mean difference allowed."""
    assert made.cameras == source.cameras
    for one, other in zip(source.frames(), made.frames(), strict=True):
        assert (other.index, other.stamp_ns) == (one.index, one.stamp_ns)
        for image, copy in zip(one.images, other.images, strict=True):
            assert (image is None) == (copy is None)
            if image is not None:
                assert np.abs(image.astype(int) - copy).mean() <= levels


def messages(path: Path, topic: str, kind: Any) -> list[Any]:
    return [kind.FromString(message.data) for _, _, message in McapFile(path).messages([topic])]


def colours(count: int = 4) -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [
        cv2.GaussianBlur(rng.integers(0, 256, (24, 32, 3), dtype=np.uint8), (0, 0), 2) for _ in range(count)
    ]


def folder_of(path: Path, images: list[np.ndarray], suffix: str, camera: str = ONE_CAMERA) -> Path:
    support.write_images(path, images, suffix=suffix)
    support.write_stamps(path, support.stamps(len(images)))
    (path / "camera.toml").write_text(camera)
    return path


@pytest.mark.parametrize(("suffix", "name"), [(".jpg", "jpeg"), (".png", "png"), (".webp", "webp")])
def test_files_are_copied_byte_by_byte(tmp_path: Path, suffix: str, name: str) -> None:
    folder = folder_of(tmp_path / "r", colours(), suffix)
    source = open_any(folder)
    made, conversion = converted(source, tmp_path / "o.mcap")
    assert (conversion.frames, conversion.losses, conversion.notes) == (4, (), ())
    same(source, made)
    found = messages(tmp_path / "o.mcap", "/camera/image", CompressedImage)
    assert [m.data for m in found] == [file.read_bytes() for file in sorted(folder.glob(f"*{suffix}"))]
    assert {(m.format, m.frame_id) for m in found} == {(name, "camera")}
    assert [m.timestamp.ToNanoseconds() for m in found] == support.stamps(4)


def turned(path: Path) -> None:
    """State in each JPEG that it is shown turned by 90 degrees."""
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    block = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif
    for file in path.glob("*.jpg"):
        data = file.read_bytes()
        file.write_bytes(data[:2] + block + data[2:])


def deep(images: list[np.ndarray]) -> list[np.ndarray]:
    return [image[..., 0].astype(np.uint16) * 16 for image in images]


CHANGED: dict[str, tuple[Callable[[Path], Path], dict[str, Any]]] = {
    "bitmap": (lambda path: folder_of(path, colours(), ".bmp"), {}),
    "cropped": (lambda path: folder_of(path, colours(), ".jpg", f"{ONE_CAMERA}crop = [4, 2, 20, 16]\n"), {}),
    "mirrored": (lambda path: folder_of(path, colours(), ".jpg"), {"mirror": True}),
    "deep": (lambda path: folder_of(path, deep(colours()), ".png"), {"images": True}),
}


@pytest.mark.parametrize("name", CHANGED)
def test_other_images_are_written_as_they_are_tracked(tmp_path: Path, name: str) -> None:
    make, options = CHANGED[name]
    source = open_any(make(tmp_path / "r"), **options)
    made, conversion = converted(source, tmp_path / "o.mcap")
    same(source, made)
    (note,) = conversion.notes
    assert "as the 8-bit grey that is tracked, not as" in note
    assert {m.format for m in messages(tmp_path / "o.mcap", "/camera/image", CompressedImage)} == {"png"}


def test_turned_images_are_written_as_they_are_shown(tmp_path: Path) -> None:
    camera = ONE_CAMERA.replace("width = 32\nheight = 24", "width = 24\nheight = 32").replace("15.0", "11.5")
    folder = folder_of(tmp_path / "r", colours(), ".jpg", camera)
    turned(folder)
    source = open_any(folder)
    assert source.cameras[0].width == 24
    same(source, converted(source, tmp_path / "o.mcap")[0])


@pytest.mark.parametrize("names", [("left", "right"), ("right", "left"), ("b", "a", "c")])
def test_cameras_keep_their_order_and_every_digit(tmp_path: Path, names: tuple[str, ...]) -> None:
    """The reference need not come first by name; poses go through metadata, as transforms round them."""
    images = {name: support.grey_images(4, seed=k) for k, name in enumerate(names)}
    images[names[1]][2] = None
    source = open_any(support.write_rig(tmp_path / "r", images))
    made, conversion = converted(source, tmp_path / "o.mcap")
    assert (conversion.frames, conversion.losses, conversion.notes) == (4, (), ())
    assert [camera.name for camera in made.cameras] == list(names)
    same(source, made)
    topics = {channel.topic for _, channel in McapFile(tmp_path / "o.mcap").channels()}
    own = {f"/camera/{name}/{what}" for name in names for what in ("image", "calibration")}
    assert topics == {*own, "/tf_static"}
    chosen = open_recording(tmp_path / "o.mcap", "grey", cameras=[names[1], names[0]])
    assert [camera.name for camera in chosen.cameras] == [names[1], names[0]]
    assert chosen.cameras[0].camera_T_reference[0] == (1.0, 0.0, 0.0, 0.0)


def test_transforms_say_the_same_to_viewers(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

    images = {name: support.grey_images(2) for name in ("left", "right")}
    source = open_any(support.write_rig(tmp_path / "r", images))
    convert_recording(source, tmp_path / "o.mcap")
    ((transform,),) = (m.transforms for m in messages(tmp_path / "o.mcap", "/tf_static", FrameTransforms))
    assert (transform.parent_frame_id, transform.child_frame_id) == ("left", "right")
    placed = np.array(source.cameras[1].camera_T_reference)
    centre = -placed[:, :3].T @ placed[:, 3] / 1e3
    found = [transform.translation.x, transform.translation.y, transform.translation.z]
    np.testing.assert_allclose(found, centre, rtol=0, atol=1e-12)  # rounding of metres


def test_stamps_of_a_frame_s_images_become_one(tmp_path: Path) -> None:
    """So that a tolerance needs to be given once."""
    path = tmp_path / "r"
    for name, offset in (("left", 0), ("right", 12_000_000)):
        stems = [str(stamp) for stamp in support.stamps(3, offset)]
        support.write_images(path / name, support.grey_images(3), stems)
    from posetrack_cli.recording.camera_file import camera_file_text

    (path / "camera.toml").write_text(camera_file_text(support.rig()))
    source = open_any(path, tolerance_ms=15.0)
    assert source.frame_count == 3
    same(source, converted(source, tmp_path / "o.mcap")[0])


@pytest.mark.parametrize("encoding", ["mono8", "rgb8", "bgr8", "rgba8", "bayer_rggb8", "yuv422"])
def test_raw_images_of_messages_are_copied(tmp_path: Path, make: SimpleNamespace, encoding: str) -> None:
    from posetrack_cli.recording.grey import RAW_GREY

    channels = RAW_GREY[encoding].channels
    rng = np.random.default_rng(1)
    images = rng.integers(0, 256, (3, make.HEIGHT, make.WIDTH, channels), dtype=np.uint8)
    sent = [("/cam/info", "CameraInfo", 5, 5, make.calibration_fields())]
    for stamp, image in zip(make.stamps(3), images, strict=True):
        fields = make.raw_fields(image.reshape(make.HEIGHT, -1), encoding, padding=3) | {"width": make.WIDTH}
        sent.append(("/cam/image", "Image", stamp, stamp, fields))
    source = open_any(make.write_ros1(tmp_path / "in.mcap", sent), images=True)
    made, conversion = converted(source, tmp_path / "o.mcap")
    assert conversion.notes == ()
    same(source, made)
    found = messages(tmp_path / "o.mcap", "/camera/image", RawImage)
    assert [m.data for m in found] == [fields["data"] for *_, fields in sent[1:]]


# Videos


def pictures() -> list[np.ndarray]:
    """A smooth texture that moves."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (160, 200, 3), dtype=np.uint8), (0, 0), 4)
    return [np.ascontiguousarray(texture[k : k + 96, k : k + 128]) for k in range(10)]


def write_video(path: Path, codec: str = "libx264", *, b_frames: int = 0, **options: str) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options={"bf": str(b_frames), "g": "4", **options})
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        for picture in pictures():
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode(None))
    return path


X265 = {"x265-params": "bframes=0:keyint=4:log-level=none"}


@pytest.mark.parametrize(
    ("name", "codec", "options", "stored"),
    [
        ("v.mp4", "libx264", {}, "h264"),
        ("v.mkv", "libx264", {}, "h264"),
        ("v.mp4", "libx265", X265, "h265"),
        ("v.mp4", "libx264", {"color_range": "pc"}, "h264"),
    ],
)
def test_video_without_b_frames_is_copied(
    tmp_path: Path, name: str, codec: str, options: dict[str, str], stored: str
) -> None:
    """Packet by packet, as Annex B from which any decoder gets the pictures."""
    path = write_video(tmp_path / name, codec, **options)
    source = open_any(path)
    assert source.is_guessed
    made, conversion = converted(source, tmp_path / "o.mcap")
    assert (conversion.frames, conversion.losses, conversion.notes) == (10, (), ())
    same(source, made)
    found = messages(tmp_path / "o.mcap", "/camera/image", CompressedVideo)
    assert {m.format for m in found} == {stored}
    assert all(m.data.startswith(b"\0\0\0\1") for m in found)
    decoder = av.CodecContext.create("h264" if stored == "h264" else "hevc", "r")
    frames = [frame for m in found for frame in decoder.decode(av.Packet(m.data))] + decoder.decode(None)
    with av.open(str(path)) as container:
        for frame, true in zip(frames, container.decode(video=0), strict=True):
            np.testing.assert_array_equal(frame.to_ndarray(format="gray"), true.to_ndarray(format="gray"))
    topics = [channel.topic for _, channel in McapFile(tmp_path / "o.mcap").channels()]
    assert topics == ["/camera/image"], "a guess is no calibration"


@pytest.mark.parametrize(
    ("name", "codec", "b_frames", "options", "why"),
    [
        ("v.mp4", "libx264", 2, {}, "it has B-frames"),
        ("v.mp4", "mpeg4", 0, {}, "its codec is mpeg4"),
        ("v.avi", "libx264", 0, {}, "its container may lack parameter sets"),
        ("v.mp4", "libx264", 0, {"mirror": True}, "rotated, resampled, cropped or mirrored"),
    ],
)
def test_other_video_becomes_jpeg_and_it_is_told_why(
    tmp_path: Path, name: str, codec: str, b_frames: int, options: dict[str, Any], why: str
) -> None:
    source = open_any(write_video(tmp_path / name, codec, b_frames=b_frames), **options)
    made, conversion = converted(source, tmp_path / "o.mcap")
    (note,) = conversion.notes
    assert why in note
    same(source, made, levels=JPEG_LEVELS)
    first = messages(tmp_path / "o.mcap", "/camera/image", CompressedImage)[0]
    assert first.format == "jpeg"
    shown = cv2.imdecode(np.frombuffer(first.data, np.uint8), cv2.IMREAD_COLOR)
    true = pictures()[0][:, ::-1] if options else pictures()[0]
    assert np.abs(shown.astype(int) - true).mean() < 2 * JPEG_LEVELS, "colour is kept"


def test_a_calibrated_video_keeps_its_camera(tmp_path: Path) -> None:
    path = write_video(tmp_path / "v.mp4")
    (tmp_path / "v.toml").write_text(
        "fx = 120.0\nfy = 121.0\ncx = 60.0\ncy = 50.0\ndistortion = [0.1, 0, 0, 0]\n"
    )
    source = open_any(path)
    same(source, converted(source, tmp_path / "o.mcap")[0])


def test_video_in_messages_is_copied(tmp_path: Path) -> None:
    convert_recording(open_any(write_video(tmp_path / "v.mp4")), tmp_path / "a.mcap")
    again = open_any(tmp_path / "a.mcap")
    convert_recording(again, tmp_path / "b.mcap")
    first, second = (
        messages(tmp_path / name, "/camera/image", CompressedVideo) for name in ("a.mcap", "b.mcap")
    )
    assert first == second


def test_reading_a_video_looks_at_no_packets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from posetrack_cli.recording import video_copy

    monkeypatch.setattr(video_copy, "_annex_b", pytest.fail)
    assert len(list(open_any(write_video(tmp_path / "v.mp4")).frames())) == 10


# What is converted by default


def test_depth_comes_first_and_images_on_request(tmp_path: Path, make: SimpleNamespace) -> None:
    sent = [("/depth/info", "CameraInfo", 5, 5, make.calibration_fields())]
    sent += [("/color/info", "CameraInfo", 5, 5, make.calibration_fields())]
    for stamp, codes in zip(make.stamps(2), make.depth_codes(2), strict=True):
        sent.append(("/depth/image", "Image", stamp, stamp, make.raw_fields(codes, "16UC1")))
        grey = (codes >> 4).astype(np.uint8)
        sent.append(("/color/image", "Image", stamp, stamp, make.raw_fields(grey, "mono8")))
    path = make.write_foxglove(tmp_path / "in.mcap", sent)
    assert next(open_any(path).frames()).images[0].dtype == np.float32
    assert next(open_any(path, images=True).frames()).images[0].dtype == np.uint8
    assert next(open_any(path, cameras=["/color/image"]).frames()).images[0].dtype == np.uint8
    assert open_any(path, depth_unit_mm=0.5).pixels[0].unit_mm == 0.5


def test_depth_without_calibration_is_not_taken_for_images(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = make.write_folder(tmp_path / "r", make.depth_codes(2), camera=None)
    with pytest.raises(NotCalibratedError, match="no intrinsics"):
        open_any(folder)


def test_without_any_images_both_reasons_are_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="no images") as error:
        open_any(tmp_path / "empty")
    assert "\n" not in str(error.value)
    support.write_images(tmp_path / "r", support.grey_images(2))
    with pytest.raises(RecordingError, match=r"no stamps.*as depth: .*8-bit image given as depth"):
        open_any(tmp_path / "r")


def test_raw_depth_is_the_same_depth(tmp_path: Path, make: SimpleNamespace) -> None:
    source = open_any(make.write_folder(tmp_path / "r", make.depth_codes(3)))
    convert_recording(source, tmp_path / "o.mcap", raw=True)
    for frame, other in zip(source.frames(), open_recording(tmp_path / "o.mcap").frames(), strict=True):
        np.testing.assert_array_equal(frame.depth, other.depth)
    found = messages(tmp_path / "o.mcap", "/camera/depth/image", RawImage)
    assert {(m.encoding, m.step, m.width) for m in found} == {("16UC1", 2 * make.WIDTH, make.WIDTH)}


def test_equal_input_gives_equal_bytes_and_a_second_conversion_equal_messages(tmp_path: Path) -> None:
    images = {name: support.grey_images(3, seed=k) for k, name in enumerate(("left", "right"))}
    path = support.write_rig(tmp_path / "r", images)
    for name in ("a.mcap", "b.mcap"):
        convert_recording(open_any(path), tmp_path / name)
    assert filecmp.cmp(tmp_path / "a.mcap", tmp_path / "b.mcap", shallow=False)
    convert_recording(open_any(tmp_path / "a.mcap"), tmp_path / "c.mcap")
    first, second = (
        [(c.topic, m.log_time, m.data) for _, c, m in McapFile(tmp_path / name).messages()]
        for name in ("a.mcap", "c.mcap")
    )
    assert first == second


def test_a_damaged_image_is_not_passed_on(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "r", colours(), ".png")
    (folder / "000001.png").write_bytes((folder / "000001.png").read_bytes()[:-40])
    conversion = convert_recording(open_any(folder), tmp_path / "o.mcap")
    assert conversion.frames == 3
    (loss,) = conversion.losses
    assert loss.first == "frame 1, 000001.png"
