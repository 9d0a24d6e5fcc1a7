"""Folders of grey images of one or more cameras: pixels, instants, cameras, and what goes wrong with them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.recording.opening import open_recording
from support import images as support

LEFT, RIGHT = support.grey_images(5), support.grey_images(5, seed=1)


@pytest.fixture
def stereo(tmp_path: Path) -> Path:
    return support.write_rig(tmp_path / "r", {"left": LEFT, "right": RIGHT})


def test_frames_have_an_image_of_each_camera(stereo: Path) -> None:
    recording = open_recording(stereo, "grey")
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == support.stamps(5)
    assert [frame.index for frame in frames] == list(range(5))
    for frame, left, right in zip(frames, LEFT, RIGHT, strict=True):
        np.testing.assert_array_equal(frame.images[0], left)
        np.testing.assert_array_equal(frame.images[1], right)
        assert frame.images[0].dtype == np.uint8
    assert [camera.name for camera in recording.cameras] == ["left", "right"]
    np.testing.assert_allclose(recording.cameras[1].camera_T_reference, support.rig()[1].camera_T_reference)
    assert (recording.losses, recording.frame_count) == ((), 5)
    assert list(recording.truth()) == []


def test_a_range_keeps_the_indices_and_a_second_pass_begins_anew(stereo: Path) -> None:
    recording = open_recording(stereo, "grey")
    assert [frame.index for frame in recording.frames(start=1, end=4, stride=2)] == [1, 3]
    assert len(list(recording.frames())) == 5


def test_a_camera_that_drops_out_keeps_its_place(tmp_path: Path) -> None:
    right = [RIGHT[0], None, RIGHT[2], None, RIGHT[4]]
    recording = open_recording(support.write_rig(tmp_path / "r", {"left": LEFT, "right": right}), "grey")
    frames = list(recording.frames())
    assert [frame.images[1] is None for frame in frames] == [False, True, False, True, False]
    np.testing.assert_array_equal(frames[2].images[1], RIGHT[2])
    assert all(frame.images[0] is not None for frame in frames)
    (loss,) = recording.losses
    assert (loss.what, loss.count, loss.first) == ("no image of camera 'right'", 2, "frame 1")


def test_the_reference_may_drop_out_too(tmp_path: Path) -> None:
    left = [None, *LEFT[1:]]
    recording = open_recording(support.write_rig(tmp_path / "r", {"left": left, "right": RIGHT}), "grey")
    frames = list(recording.frames())
    assert frames[0].images[0] is None
    assert frames[0].stamp_ns == support.stamps(1)[0]
    with pytest.raises(RecordingError, match="frame 0"):
        _ = frames[0].depth


def test_a_camera_that_ends_early_is_a_loss(tmp_path: Path) -> None:
    recording = open_recording(support.write_rig(tmp_path / "r", {"left": LEFT, "right": RIGHT[:2]}), "grey")
    assert len(list(recording.frames())) == 5
    assert [(loss.count, loss.first) for loss in recording.losses] == [(3, "frame 2")]


def test_names_with_the_same_number_belong_together(tmp_path: Path) -> None:
    support.write_images(tmp_path / "left", LEFT, [f"left_{i}" for i in range(8, 13)], ".jpg")
    support.write_images(tmp_path / "right", RIGHT[1:], [f"right_{i}" for i in range(9, 13)], ".bmp")
    (tmp_path / "camera.toml").write_text(support.camera_file_text(support.rig()))
    frames = list(open_recording(tmp_path, "grey", fps=30).frames())
    assert frames[0].images[1] is None
    for frame, right in zip(frames[1:], RIGHT[1:], strict=True):
        np.testing.assert_array_equal(frame.images[1], right)
    assert [frame.stamp_ns for frame in frames[:4]] == [0, 33333333, 66666667, 100000000]


def test_names_without_anything_in_common_belong_together_by_position_if_there_are_as_many(
    tmp_path: Path,
) -> None:
    support.write_images(tmp_path / "left", LEFT, list("abcde"))
    support.write_images(tmp_path / "right", RIGHT, list("vwxyz"))
    (tmp_path / "camera.toml").write_text(support.camera_file_text(support.rig()))
    assert [frame.images[1] is not None for frame in open_recording(tmp_path, "grey", fps=30).frames()] == [
        True
    ] * 5
    (tmp_path / "right" / "v.png").unlink()
    with pytest.raises(RecordingError, match="cannot be matched, found 5 in left, 4 in right"):
        open_recording(tmp_path, "grey", fps=30)


def test_each_camera_s_own_stamps_are_matched_with_a_tolerance(tmp_path: Path) -> None:
    support.write_images(tmp_path / "left", LEFT)
    support.write_images(tmp_path / "right", RIGHT[:4], list("wxyz"))
    (tmp_path / "camera.toml").write_text(support.camera_file_text(support.rig()))
    support.write_stamps(tmp_path / "left", support.stamps(5))
    late = [stamp for i, stamp in enumerate(support.stamps(5, 4_000_000)) if i != 2]
    support.write_stamps(tmp_path / "right", late, [f"{name}.png" for name in "wxyz"])
    recording = open_recording(tmp_path, "grey")
    frames = list(recording.frames())
    assert [frame.stamp_ns for frame in frames] == support.stamps(5)
    assert [frame.images[1] is None for frame in frames] == [False, False, True, False, False]
    np.testing.assert_array_equal(frames[3].images[1], RIGHT[2])
    with pytest.raises(
        RecordingError,
        match=r"no matching stamps for cameras left, right, found at least 4 ms apart.*--tolerance",
    ):
        open_recording(tmp_path, "grey", tolerance_ms=3)


def test_the_recording_s_stamps_by_file_name(tmp_path: Path, stereo: Path) -> None:
    names = [f"{i:06d}.png" for i in range(5)]
    support.write_stamps(stereo, support.stamps(5)[::-1], names)
    frames = list(open_recording(stereo, "grey").frames())
    assert len(frames) == 1, "stamps that go back are dropped"
    (stereo / "timestamps.csv").write_text("stamp_ns\n0\n1\n")
    with pytest.raises(RecordingError, match="2 stamps, expected 5"):
        open_recording(stereo, "grey")
    (stereo / "timestamps.csv").unlink()
    with pytest.raises(RecordingError, match="no stamps; pass --fps"):
        open_recording(stereo, "grey")


def test_one_folder_of_one_camera(tmp_path: Path) -> None:
    support.write_images(tmp_path, LEFT)
    (tmp_path / "camera.toml").write_text("fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n")
    recording = open_recording(tmp_path, "grey", fps=25)
    assert [len(frame.images) for frame in recording.frames()] == [1] * 5
    assert recording.cameras[0].fx == 40.0


def test_one_camera_of_several(stereo: Path) -> None:
    for recording in (
        open_recording(stereo, "grey", cameras=["right"]),
        open_recording(stereo / "right", "grey", fps=30),
    ):
        (camera,) = recording.cameras
        assert camera.name == "right"
        np.testing.assert_array_equal(camera.camera_T_reference, np.eye(3, 4))
        frames = list(recording.frames())
        assert len(frames) == 5
        np.testing.assert_array_equal(frames[4].images[0], RIGHT[4])


def test_the_reference_comes_first(stereo: Path) -> None:
    file = stereo / "camera.toml"
    file.write_text(file.read_text().replace('reference = "left"', 'reference = "right"'))
    recording = open_recording(stereo, "grey")
    assert [camera.name for camera in recording.cameras] == ["right", "left"]
    np.testing.assert_array_equal(next(iter(recording.frames())).images[0], RIGHT[0])


def test_three_cameras(tmp_path: Path) -> None:
    images = {name: support.grey_images(3, seed) for seed, name in enumerate("abc")}
    recording = open_recording(support.write_rig(tmp_path / "r", images), "grey")
    frame = list(recording.frames())[2]
    for image, name in zip(frame.images, "abc", strict=True):
        np.testing.assert_array_equal(image, images[name][2])


def test_colour_becomes_grey(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    colour = rng.integers(0, 256, (support.HEIGHT, support.WIDTH, 3), dtype=np.uint8)
    recording = open_recording(
        support.write_rig(tmp_path / "r", {"left": [colour], "right": RIGHT[:1]}), "grey"
    )
    (frame,) = recording.frames()
    expected = colour @ [0.114, 0.587, 0.299]
    np.testing.assert_allclose(frame.images[0], expected, atol=1.1, err_msg="luma of B G R, cut to integers")
    assert recording.identity()["stored"] == "8-bit colour, 8-bit grey"


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_of_more_bits_the_upper_eight_are_kept(tmp_path: Path, bits: int) -> None:
    codes = np.random.default_rng(3).integers(0, 1 << bits, (support.HEIGHT, support.WIDTH)).astype(np.uint16)
    codes[0, 0] = (1 << bits) - 1
    folder = support.write_rig(tmp_path / "r", {"left": [codes, codes >> 4], "right": RIGHT[:2]})
    recording = open_recording(folder, "grey")
    first, second = recording.frames()
    np.testing.assert_array_equal(first.images[0], codes >> (bits - 8))
    np.testing.assert_array_equal(second.images[0], codes >> 4 >> (bits - 8), "the same for all images")
    assert recording.identity()["stored"] == f"{bits}-bit grey, 8-bit grey"


def test_the_camera_file_tells_the_bits(tmp_path: Path) -> None:
    dark = np.full((support.HEIGHT, support.WIDTH), 900, np.uint16)
    folder = support.write_rig(tmp_path / "r", {"left": [dark], "right": RIGHT[:1]})
    file = folder / "camera.toml"
    file.write_text(file.read_text().replace("[cameras.left]\n", "[cameras.left]\nbits = 12\n"))
    (frame,) = open_recording(folder, "grey").frames()
    assert (frame.images[0] == 900 >> 4).all()


def test_mirror_flips_images_and_scene(stereo: Path) -> None:
    recording = open_recording(stereo, "grey", mirror=True)
    frame = next(iter(recording.frames()))
    np.testing.assert_array_equal(frame.images[1], RIGHT[0][:, ::-1])
    expected = [camera.mirrored() for camera in support.rig()]
    for camera, mirrored in zip(recording.cameras, expected, strict=True):
        assert camera.values() == mirrored.values()
        np.testing.assert_allclose(camera.camera_T_reference, mirrored.camera_T_reference, atol=1e-12)


def test_crop_of_one_camera(stereo: Path) -> None:
    file = stereo / "camera.toml"
    file.write_text(file.read_text().replace("[cameras.right]\n", "[cameras.right]\ncrop = [3, 2, 20, 18]\n"))
    recording = open_recording(stereo, "grey")
    np.testing.assert_array_equal(next(iter(recording.frames())).images[1], RIGHT[0][2:20, 3:23])
    assert (recording.cameras[1].cx, recording.cameras[1].width) == (12.0, 20)


def test_images_that_cannot_be_decoded_are_left_out_and_counted(stereo: Path) -> None:
    image = stereo / "right" / "000001.png"
    image.write_bytes(image.read_bytes()[:60])
    for camera in ("left", "right"):
        (stereo / camera / "000003.png").write_bytes(b"")
    recording = open_recording(stereo, "grey")
    frames = list(recording.frames())
    assert [frame.index for frame in frames] == [0, 1, 2, 4], "without any image there is no frame"
    assert frames[1].images[1] is None
    assert [(loss.what, loss.count, loss.first) for loss in recording.losses] == [
        ("image skipped, image is incomplete", 1, "frame 1, right/000001.png"),
        ("image skipped, file is empty", 2, "frame 3, left/000003.png"),
    ]


def test_a_cut_jpeg_is_not_filled_up_with_grey(tmp_path: Path) -> None:
    support.write_images(tmp_path, LEFT[:3], suffix=".jpg")
    (tmp_path / "camera.toml").write_text("fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n")
    image = tmp_path / "000001.jpg"
    image.write_bytes(image.read_bytes()[:-150])
    recording = open_recording(tmp_path, "grey", fps=30)
    assert [frame.index for frame in recording.frames()] == [0, 2]


def test_an_image_of_another_size_is_left_out_and_counted(stereo: Path) -> None:
    (stereo / "left" / "000002.png").write_bytes(cv2.imencode(".png", LEFT[0][:10])[1].tobytes())
    recording = open_recording(stereo, "grey")
    frames = list(recording.frames())
    assert [frame.index for frame in frames if frame.images[0] is None] == [2]
    (loss,) = recording.losses
    assert loss.what == "image skipped, size is 32x10, not 32x24 like the first"


def test_bits_are_those_of_several_images(tmp_path: Path) -> None:
    """The first image was taken before the exposure had settled: it has 9 bits, the others 16."""
    values = [(image.astype(np.uint16) * 257) for image in LEFT[:5]]
    support.write_images(tmp_path, [values[0] >> 7, *values[1:]])
    (tmp_path / "camera.toml").write_text("fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n")
    recording = open_recording(tmp_path, "grey", fps=30)
    assert recording.identity()["stored"] == "16-bit grey"
    for frame, image in zip(recording.frames(), LEFT, strict=False):
        if frame.index:
            np.testing.assert_array_equal(frame.images[0], image)


def test_values_that_are_no_grey_are_refused(tmp_path: Path) -> None:
    support.write_images(tmp_path, [LEFT[0].astype(np.float32)], suffix=".tiff")
    (tmp_path / "camera.toml").write_text("fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n")
    with pytest.raises(RecordingError, match="unsupported image, found float32, expected 8 or 16 bits"):
        open_recording(tmp_path, "grey", fps=30)


def without(path: Path, file: str) -> None:
    (path / file).unlink()


def rewrite(path: Path, old: str, new: str) -> None:
    file = path / "camera.toml"
    file.write_text(file.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda p: without(p, "camera.toml"), "cameras are not calibrated, expected camera.toml"),
        (lambda p: rewrite(p, "cameras.right", "cameras.rigth"), "camera 'right' is not calibrated"),
        (lambda p: rewrite(p, "width = 32", "width = 30"), "found images of 32x24, expected 30x24"),
        (
            lambda p: (p / "camera.toml").write_text("fx = 4\nfy = 4\ncx = 1\ncy = 1\n"),
            "the calibration of one",
        ),
        (lambda p: (p / "right").rename(p / "other"), "camera 'other' is not calibrated"),
        (lambda p: [f.unlink() for f in (p / "right").iterdir()], "no images of camera 'right', found left"),
        (lambda p: [f.write_bytes(b"x") for f in (p / "right").glob("*.png")], "no image can be decoded"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_line(stereo: Path, spoil, message: str) -> None:  # type: ignore[no-untyped-def]
    spoil(stereo)
    with pytest.raises(RecordingError) as caught:
        open_recording(stereo, "grey")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_that_cannot_be_used(stereo: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--tolerance-ms out of range, found -1"):
        open_recording(stereo, "grey", tolerance_ms=-1)
    with pytest.raises(UsageError, match="--fps 0"):
        open_recording(stereo, "grey", fps=0)
    with pytest.raises(RecordingError, match="no camera 'rigth'; did you mean 'right'"):
        open_recording(stereo, "grey", cameras=["rigth"])
    with pytest.raises(RecordingError, match="no such file or folder"):
        open_recording(tmp_path / "nothing", "grey")
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="no images"):
        open_recording(tmp_path / "empty", "grey")


def test_identity_depends_on_every_byte_that_is_read(stereo: Path) -> None:
    first = open_recording(stereo, "grey").identity()
    assert first == open_recording(stereo, "grey").identity()
    assert (first["kind"], first["cameras"], first["frames"]) == ("folder", "left,right", "5")
    assert open_recording(stereo, "grey", fps=30).identity()["fps"] == "30"
    for file in ("right/000004.png", "camera.toml", "timestamps.csv"):
        data = (stereo / file).read_bytes()
        (stereo / file).write_bytes(data + b"\n")
        assert open_recording(stereo, "grey").identity()["sha256"] != first["sha256"], file
        (stereo / file).write_bytes(data)
