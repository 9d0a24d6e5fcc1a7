"""Folders as other tools write them: stamps in names, lists of TUM and EuRoC, images one level below."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from posetrack_cli.cli.info import info
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.opening import describe, open_recording
from posetrack_cli.recording.recording import Recording
from support import images as support

START_US = 1_305_031_102_160_407
PERIOD_US = 33_333
LATE_US = 4_100
"""How long after the left camera the right one takes an image: within the tolerance of 10 ms."""


LEFT, RIGHT = support.grey_images(24), support.grey_images(24, seed=1)


def seconds(index: int, offset_us: int = 0) -> str:
    us = START_US + index * PERIOD_US + offset_us
    return f"{us // 10**6}.{us % 10**6:06d}"


def stamp_ns(index: int, offset_us: int = 0) -> int:
    return (START_US + index * PERIOD_US + offset_us) * 1000


def write(folder: Path, names: Sequence[str], images: Sequence[np.ndarray], suffix: str = ".png") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in zip(names, images, strict=True):
        (folder / f"{name}{suffix}").write_bytes(cv2.imencode(suffix, image)[1].tobytes())
    return folder


def read(recording: Recording) -> tuple[list[int], list[np.ndarray]]:
    frames = list(recording.frames())
    return [frame.stamp_ns for frame in frames], [frame.depth for frame in frames]


def check(recording: Recording, stamps: Sequence[int], images: Sequence[np.ndarray]) -> None:
    found, depths = read(recording)
    assert found == list(stamps)
    for depth, image in zip(depths, images, strict=True):
        np.testing.assert_array_equal(depth, image)
    assert recording.losses == ()


# Order


def test_images_are_in_the_order_of_their_numbers(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(12)
    folder = write(tmp_path / "r", [f"depth_{i + 1}" for i in range(12)], images)
    (folder / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(folder, fps=30)
    check(recording, [round(i * 1e9 / 30) for i in range(12)], images)
    assert recording.remarks == (
        "images are sorted by the numbers in their names: depth_9.png before depth_10.png",
    )
    assert list(recording.remarks) == describe(folder)["remarks"]


def test_frames_missing_in_a_numbered_sequence_are_a_gap(tmp_path: Path, make: SimpleNamespace) -> None:
    numbers = [i for i in range(14) if i not in (5, 9, 10)]
    images = make.depth_codes(len(numbers))
    folder = write(tmp_path / "r", [f"{100 + i:06d}" for i in numbers], images)
    (folder / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(folder, fps=30)
    check(recording, [round(i * 1e9 / 30) for i in numbers], images)
    assert recording.remarks == ("numbers 105, 109 to 110 missing: assuming 3 lost frames",)


# Stamps in names


@pytest.fixture
def tum(tmp_path: Path, make: SimpleNamespace) -> SimpleNamespace:
    """A sequence in TUM's layout that lacks frames 5 to 7, with the camera file beside."""
    kept = [i for i in range(16) if i not in (5, 6, 7)]
    codes = make.depth_codes(len(kept))
    seq = tmp_path / "seq"
    write(seq / "depth", [seconds(i) for i in kept], codes)
    colours = [np.full((make.HEIGHT, make.WIDTH, 3), 10 * i, np.uint8) for i in range(len(kept))]
    write(seq / "rgb", [seconds(i, -12_000) for i in kept], colours)
    depth = [f"{seconds(i)} depth/{seconds(i)}.png" for i in kept]
    rgb = [f"{seconds(i, -12_000)} rgb/{seconds(i, -12_000)}.png" for i in kept]
    (seq / "depth.txt").write_text("\n".join(["# depth maps", "# timestamp filename", *depth]) + "\n")
    (seq / "rgb.txt").write_text("\n".join(["# color images", *rgb]) + "\n")
    camera = tmp_path / "camera.toml"
    camera.write_text(make.CAMERA_TOML)
    return SimpleNamespace(
        seq=seq, camera=camera, kept=kept, codes=codes, colours=colours, depth=depth, rgb=rgb
    )


STAMPS = "in s: 13 frames, 0.5 s, largest gap 0.133 s"


def test_names_that_are_stamps_give_the_times(tum: SimpleNamespace) -> None:
    recording = open_recording(tum.seq / "depth", camera_file=tum.camera)
    check(recording, [stamp_ns(i) for i in tum.kept], tum.codes)
    assert recording.remarks == (f"stamps from file names, {STAMPS}",)
    values = describe(tum.seq / "depth")
    assert values["remarks"] == list(recording.remarks)
    assert values["stamps"]["largest_gap_s"] == pytest.approx(4 * PERIOD_US / 1e6)


def test_a_rate_that_contradicts_the_names_is_not_used(tum: SimpleNamespace) -> None:
    recording = open_recording(tum.seq / "depth", camera_file=tum.camera, fps=30)
    check(recording, [stamp_ns(i) for i in tum.kept], tum.codes)
    assert recording.remarks == (
        f"stamps from file names, {STAMPS}",
        "30 frames/s is ignored, the stamps contradict it; "
        "to override them, add a timestamps.csv and omit --fps",
    )
    with pytest.raises(UsageError, match="--fps -1"):
        open_recording(tum.seq / "depth", camera_file=tum.camera, fps=-1)


def test_a_rate_that_fits_the_names_is_used_as_before(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(9)
    folder = write(tmp_path / "r", [seconds(i) for i in range(9)], images)
    (folder / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(folder, fps=30)
    check(recording, [round(i * 1e9 / 30) for i in range(9)], images)
    assert recording.remarks == ()


def test_timestamps_csv_replaces_the_stamps_of_names(tum: SimpleNamespace) -> None:
    lines = ["stamp_ns", *(str(7 + i) for i in range(13))]
    (tum.seq / "depth" / "timestamps.csv").write_text("\n".join(lines))
    recording = open_recording(tum.seq / "depth", camera_file=tum.camera)
    check(recording, [7 + i for i in range(13)], tum.codes)
    assert recording.remarks == ()


def test_numbers_whose_rate_contradicts_the_given_one_are_refused(
    tmp_path: Path, make: SimpleNamespace
) -> None:
    names = [f"{i * 100 / 3:.0f}" for i in range(12) if i != 4]
    folder = write(tmp_path / "r", names, make.depth_codes(11))
    (folder / "camera.toml").write_text(make.CAMERA_TOML)
    with pytest.raises(
        RecordingError,
        match=r"that contradict --fps, found in ms: 11 frames, .* 29.97 frames/s, expected 1 frames/s;",
    ):
        open_recording(folder, fps=1)
    assert "stamps from file names" in open_recording(folder, fps=30).remarks[-2]
    assert "stamps from file names" in open_recording(folder).remarks[-1]


def test_numbers_that_may_be_times_or_counts_are_refused(tmp_path: Path, make: SimpleNamespace) -> None:
    folder = write(tmp_path / "r", [f"{20 * i:06d}" for i in range(1, 9)], make.depth_codes(8))
    (folder / "camera.toml").write_text(make.CAMERA_TOML)
    with pytest.raises(
        RecordingError, match=r"no stamps, found numbers 20 to 160, either times or counts; pass --fps"
    ):
        open_recording(folder)
    assert open_recording(folder, fps=50).remarks == ()


# TUM and EuRoC


def test_depth_txt_lists_the_depth_images(tum: SimpleNamespace) -> None:
    for options in ({}, {"fps": 30.0}):
        recording = open_recording(tum.seq, camera_file=tum.camera, **options)
        check(recording, [stamp_ns(i) for i in tum.kept], tum.codes)
        assert recording.remarks[0] == f"stamps from depth.txt, {STAMPS}"
    first = recording.identity()
    (tum.seq / "depth.txt").write_text("\n".join(tum.depth))
    assert open_recording(tum.seq, camera_file=tum.camera).identity()["sha256"] != first["sha256"]


def test_rgb_txt_lists_the_images_of_one_camera(tum: SimpleNamespace) -> None:
    recording = open_recording(tum.seq, "grey", camera_file=tum.camera)
    check(recording, [stamp_ns(i, -12_000) for i in tum.kept], [image[..., 0] for image in tum.colours])
    assert recording.remarks == (f"stamps from rgb.txt, {STAMPS}",)


def test_both_are_described(tum: SimpleNamespace) -> None:
    lines = CliRunner().invoke(info, [str(tum.seq)], catch_exceptions=False).stdout.splitlines()
    assert lines[0].startswith("seq: folder of 13 images")
    assert f"stamps from depth.txt, {STAMPS}" in lines
    assert any(line.startswith("images rgb: 13") for line in lines)
    assert f"stamps from rgb.txt, {STAMPS}" in lines


def test_a_camera_file_of_depth_above_is_not_that_of_colour(tum: SimpleNamespace) -> None:
    tum.camera.write_text(tum.camera.read_text() + "depth_unit_mm = 0.2\n")
    for path in (tum.seq, tum.seq / "rgb"):
        with pytest.raises(RecordingError, match="cameras are not calibrated"):
            open_recording(path, "grey")


@pytest.mark.parametrize("turned", [False, True])
def test_associations_list_both(tum: SimpleNamespace, turned: bool) -> None:
    pairs = zip(tum.depth, tum.rgb, strict=True)
    lines = [f"{b} {a}" if turned else f"{a} {b}" for a, b in pairs]
    (tum.seq / "depth.txt").unlink()
    (tum.seq / "rgb.txt").unlink()
    (tum.seq / "associations.txt").write_text("\n".join(lines[3:]))
    depth = open_recording(tum.seq, camera_file=tum.camera)
    check(depth, [stamp_ns(i) for i in tum.kept[3:]], tum.codes[3:])
    assert depth.remarks[0] == "skipped 3 images not listed in associations.txt"
    grey = open_recording(tum.seq, "grey", camera_file=tum.camera)
    check(grey, [stamp_ns(i, -12_000) for i in tum.kept[3:]], [c[..., 0] for c in tum.colours[3:]])


def test_a_list_that_numbers_images_needs_a_rate(tum: SimpleNamespace) -> None:
    for k, i in enumerate(tum.kept):
        (tum.seq / "depth" / f"{seconds(i)}.png").rename(tum.seq / "depth" / f"{k}.png")
    (tum.seq / "depth.txt").write_text("\n".join(f"{k} depth/{k}.png" for k in range(13)))
    with pytest.raises(RecordingError, match="no stamps"):
        open_recording(tum.seq, camera_file=tum.camera)
    recording = open_recording(tum.seq, camera_file=tum.camera, fps=10)
    check(recording, [k * 10**8 for k in range(13)], tum.codes)


def test_images_that_a_list_lacks_or_that_are_missing_are_reported(tum: SimpleNamespace) -> None:
    (tum.seq / "depth" / f"{seconds(2)}.png").unlink()
    recording = open_recording(tum.seq, camera_file=tum.camera)
    assert recording.frame_count == 12
    assert recording.remarks[0] == (f"1 of 13 images in depth.txt are missing, first depth/{seconds(2)}.png")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no listed image exists, found no lines"),
        ("1.0 ../../etc/passwd\n1.5 /etc/passwd\n", "no listed image exists"),
        (
            "0.5 depth/x.png\nabc depth/y.png\n",
            "line 2: not an entry of an image list, found 'abc depth/y.png'",
        ),
        ("0.5\n", "line 1: not an entry of an image list"),
        ("9" * 30 + " depth/x.png\n0.5 a\n0.6\n", "line 3: not an entry of an image list"),
    ],
)
def test_lists_that_cannot_be_used(tum: SimpleNamespace, text: str, says: str) -> None:
    (tum.seq / "depth.txt").write_text(text)
    with pytest.raises(RecordingError, match=r"depth\.txt") as caught:
        open_recording(tum.seq, camera_file=tum.camera)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("stamp", ["inf", "1e999", "-1", "x"])
def test_stamps_of_associations_are_checked(tum: SimpleNamespace, stamp: str) -> None:
    (tum.seq / "depth.txt").unlink()
    line = f"{tum.rgb[0]} {stamp} depth/{seconds(0)}.png"
    (tum.seq / "associations.txt").write_text(line)
    with pytest.raises(RecordingError, match=rf"associations.txt: stamp is not a number, found '{stamp}'"):
        open_recording(tum.seq, camera_file=tum.camera)


def write_euroc(mav: Path, ns: Sequence[int]) -> None:
    """Both cameras of EuRoC; the right one lacks the third image."""
    for camera, seed in (("cam0", 0), ("cam1", 1)):
        kept = [i for i in range(len(ns)) if camera == "cam0" or i != 2]
        images = support.grey_images(len(ns), seed)
        write(mav / camera / "data", [str(ns[i]) for i in kept], [images[i] for i in kept])
        rows = ["#timestamp [ns],filename", *(f"{ns[i]},{ns[i]}.png" for i in kept)]
        (mav / camera / "data.csv").write_text("\n".join(rows) + "\n")
    (mav / "imu0").mkdir()
    (mav / "imu0" / "data.csv").write_text("#timestamp [ns],w\n1403636579758555392,0.1\n")
    (mav / "camera.toml").write_text(camera_file_text(support.rig(["cam0", "cam1"])))


def test_euroc_s_folders_are_cameras(tmp_path: Path) -> None:
    ns = [1_403_636_579_763_555_584 + 50_000_000 * i for i in range(6)]
    mav = tmp_path / "seq" / "mav0"
    write_euroc(mav, ns)
    for path in (mav, tmp_path / "seq"):
        recording = open_recording(path, "grey")
        frames = list(recording.frames())
        assert [frame.stamp_ns for frame in frames] == ns
        assert [frame.images[1] is None for frame in frames] == [i == 2 for i in range(6)]
        assert (
            "stamps from data.csv of cam0, in ns: 6 frames, 0.25 s, largest gap 0.05 s" in recording.remarks
        )
    one = open_recording(mav / "cam0", "grey")
    assert [frame.stamp_ns for frame in one.frames()] == ns
    assert one.remarks == ("stamps from data.csv, in ns: 6 frames, 0.25 s, largest gap 0.05 s",)


KITTI = {
    "odometry": [f"{0.1037 * i:.6e}" for i in range(9)],
    "raw": [f"2011-09-26 13:02:{25 + 0.1037 * i:012.9f}" for i in range(9)],
    "ns": [f"{1_317_042_145_000_000_000 + 103_700_000 * i}" for i in range(9)],
}


@pytest.mark.parametrize("kind", KITTI)
def test_kitti_s_times_are_one_a_line(tmp_path: Path, kind: str) -> None:
    for seed, camera in enumerate(("image_0", "image_1")):
        write(tmp_path / camera, [f"{i:06d}" for i in range(9)], support.grey_images(9, seed))
    (tmp_path / "camera.toml").write_text(camera_file_text(support.rig(["image_0", "image_1"])))
    (tmp_path / "times.txt").write_text("\n".join(KITTI[kind]) + "\n")
    recording = open_recording(tmp_path, "grey")
    found = [frame.stamp_ns for frame in recording.frames()]
    np.testing.assert_array_equal(np.diff(found), np.full(8, 103_700_000))
    assert recording.remarks[0].startswith("stamps from times.txt, in ")
    assert open_recording(tmp_path, "grey", fps=10).remarks == ()
    (tmp_path / "times.txt").write_text("\n".join(KITTI[kind][1:]))
    with pytest.raises(
        RecordingError, match=r"times.txt: numbers of stamps and images differ, found 8 lines"
    ):
        open_recording(tmp_path, "grey")
    (tmp_path / "times.txt").write_text("\n".join(map(str, range(9))))
    with pytest.raises(RecordingError, match="lines may be times or image numbers, found 0 to 8; pass --fps"):
        open_recording(tmp_path, "grey")


# One level below


def test_the_only_folder_of_depth_below_is_taken(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(4)
    (tmp_path / "r").mkdir()
    make.write_folder(tmp_path / "r" / "depth", images)
    write(tmp_path / "r" / "colour", ["a"], [np.zeros((6, 8, 3), np.uint8)])
    recording = open_recording(tmp_path / "r")
    check(recording, make.stamps(4), images)
    assert recording.remarks == ("depth is read from depth/",)
    make.write_folder(tmp_path / "r" / "other", images)
    check(open_recording(tmp_path / "r"), make.stamps(4), images)
    (tmp_path / "r" / "depth").rename(tmp_path / "r" / "second")
    with pytest.raises(
        RecordingError, match=r"several folders of 16-bit images, found other, second; pass .*/other"
    ):
        open_recording(tmp_path / "r")


def test_depth_and_colour_below_are_described(tmp_path: Path, make: SimpleNamespace) -> None:
    make.write_folder(tmp_path / "r" / "depth", make.depth_codes(4))
    values = describe(tmp_path / "r")
    assert (values["kind"], values["images"]) == ("folder", 4)
    assert values["stamps"]["messages"] == 4
    assert values["cameras"][0]["fx"] == 30.0
    assert "colour" not in values
    write(tmp_path / "r" / "rgb", list("abc"), support.grey_images(3))
    both = describe(tmp_path / "r")
    assert both["images"] == 4
    assert [folder["name"] for folder in both["colour"]["folders"]] == ["rgb"]


def test_folders_without_depth_are_named(tmp_path: Path) -> None:
    write(tmp_path / "r" / "rgb", ["a"], [np.zeros((6, 8, 3), np.uint8)])
    with pytest.raises(
        RecordingError, match="no depth images, found folders rgb, expected 16-bit single-channel images"
    ):
        open_recording(tmp_path / "r")


def test_depth_beside_colour_is_not_a_camera_of_heads(tmp_path: Path, make: SimpleNamespace) -> None:
    write(tmp_path / "depth", list("abc"), make.depth_codes(3))
    write(tmp_path / "rgb", list("abc"), support.grey_images(3))
    (tmp_path / "camera.toml").write_text("fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n")
    recording = open_recording(tmp_path, "grey", fps=30)
    for frame, image in zip(recording.frames(), support.grey_images(3), strict=True):
        np.testing.assert_array_equal(frame.images[0], image)
    assert recording.remarks == ("folders not read: depth",)


@pytest.mark.parametrize("pixels", ["depth", "grey"])
def test_several_kinds_of_images_in_one_folder(tmp_path: Path, make: SimpleNamespace, pixels: str) -> None:
    """The layout of 7-Scenes."""
    depth = make.depth_codes(12)
    colour = [np.full((make.HEIGHT, make.WIDTH, 3), 10 * i, np.uint8) for i in range(12)]
    write(tmp_path, [f"frame-{i}.depth" for i in range(12)], depth)
    write(tmp_path, [f"frame-{i}.color" for i in range(12)], colour)
    (tmp_path / "camera.toml").write_text(make.CAMERA_TOML)
    recording = open_recording(tmp_path, pixels, fps=30)
    images = depth if pixels == "depth" else [image[..., 0] for image in colour]
    check(recording, [round(i * 1e9 / 30) for i in range(12)], images)
    name = "depth" if pixels == "depth" else "color"
    assert recording.remarks[0] == f"read 12 of 24 images, named like frame-0.{name}.png"


def test_two_cameras_in_one_folder_are_refused(tmp_path: Path) -> None:
    for side, images in (("left", LEFT), ("right", RIGHT)):
        write(tmp_path, [f"{side}_{i:04d}" for i in range(24)], images)
    (tmp_path / "camera.toml").write_text("fx = 40.0\nfy = 41.0\ncx = 15.0\ncy = 12.0\n")
    with pytest.raises(
        RecordingError, match=r"several kinds of images in one folder, found left_0000.png, right_0000.png;"
    ):
        open_recording(tmp_path, "grey", fps=30)


def test_a_nominal_rate_is_for_images_without_stamps(tum: SimpleNamespace, tmp_path: Path) -> None:
    tum.camera.write_text(tum.camera.read_text() + "fps = 30.0\n")
    recording = open_recording(tum.seq / "depth", camera_file=tum.camera)
    check(recording, [stamp_ns(i) for i in tum.kept], tum.codes)
    assert recording.remarks == (f"stamps from file names, {STAMPS}",)
    assert "fps" not in recording.identity()


# Pairs


def write_pairs(path: Path, name: object, left: Sequence[int], right: Sequence[int]) -> Path:
    """Images of two cameras, named by ``name(index, offset)``."""
    assert callable(name)
    write(path / "left", [name(i, 0) for i in left], [LEFT[i] for i in left])
    write(path / "right", [name(i, LATE_US) for i in right], [RIGHT[i] for i in right])
    (path / "camera.toml").write_text(camera_file_text(support.rig()))
    return path


LOST_LEFT, LOST_RIGHT = 4, 19
KEPT_LEFT, KEPT_RIGHT = ([i for i in range(24) if i != lost] for lost in (LOST_LEFT, LOST_RIGHT))
STAMP_NAMES = {
    "s": lambda i, offset: seconds(i, offset),
    "ms": lambda i, offset: f"img_{(START_US + i * PERIOD_US + offset) // 1000}",
    "us": lambda i, offset: f"{START_US + i * PERIOD_US + offset}",
    "ns": lambda i, offset: f"{stamp_ns(i, offset)}",
    "after counters": lambda i, offset: f"{i % 3}{i:05d}-{seconds(i, offset)}",
    "from zero": lambda i, offset: f"{i * PERIOD_US + offset}",
}


@pytest.mark.parametrize("kind", STAMP_NAMES)
@pytest.mark.parametrize("fps", [None, 30.0])
def test_cameras_are_paired_by_the_stamps_of_names(tmp_path: Path, kind: str, fps: float | None) -> None:
    path = write_pairs(tmp_path / "r", STAMP_NAMES[kind], KEPT_LEFT, KEPT_RIGHT)
    recording = open_recording(path, "grey", fps=fps)
    frames = list(recording.frames())
    assert len(frames) == 24
    for index, (frame, left, right) in enumerate(zip(frames, LEFT, RIGHT, strict=True)):
        for image, expected, lost in zip(frame.images, (left, right), (LOST_LEFT, LOST_RIGHT), strict=True):
            if index == lost:
                assert image is None
            else:
                np.testing.assert_array_equal(image, expected)
    start = 0 if kind == "from zero" else stamp_ns(0)
    stamps = [start + i * PERIOD_US * 1000 for i in range(24)]
    stamps[LOST_LEFT] += LATE_US * 1000
    np.testing.assert_allclose([f.stamp_ns - start for f in frames], [s - start for s in stamps], atol=10**6)
    assert any("30 frames/s is ignored" in remark for remark in recording.remarks) == (fps is not None)


def test_numbers_that_do_not_fit_are_not_paired_by_position(tmp_path: Path) -> None:
    """Both counters are as long, yet each camera lost another frame: every pair between would be wrong."""
    write(tmp_path / "left", [f"l{i}" for i in KEPT_LEFT], [LEFT[i] for i in KEPT_LEFT])
    write(tmp_path / "right", [f"r{i + 500}" for i in KEPT_RIGHT], [RIGHT[i] for i in KEPT_RIGHT])
    (tmp_path / "camera.toml").write_text(camera_file_text(support.rig()))
    with pytest.raises(
        RecordingError,
        match=r"cannot be matched, found 23 in left, 23 in right named l0.png to l23.png and",
    ):
        open_recording(tmp_path, "grey", fps=30)


def test_numbers_in_equal_steps_are_paired_by_position(tmp_path: Path) -> None:
    write(tmp_path / "left", [f"l{i}" for i in range(12)], LEFT[:12])
    write(tmp_path / "right", [f"r{i + 500}" for i in range(12)], RIGHT[:12])
    (tmp_path / "camera.toml").write_text(camera_file_text(support.rig()))
    for frame, right in zip(open_recording(tmp_path, "grey", fps=30).frames(), RIGHT, strict=False):
        np.testing.assert_array_equal(frame.images[1], right)


def test_a_number_of_the_camera_behind_that_of_the_frame_is_no_obstacle(tmp_path: Path) -> None:
    write(tmp_path / "left", [f"{i}_cam0" for i in KEPT_LEFT], [LEFT[i] for i in KEPT_LEFT])
    write(tmp_path / "right", [f"{i}_cam1" for i in KEPT_RIGHT], [RIGHT[i] for i in KEPT_RIGHT])
    (tmp_path / "camera.toml").write_text(camera_file_text(support.rig()))
    frames = list(open_recording(tmp_path, "grey", fps=30).frames())
    assert len(frames) == 24
    np.testing.assert_array_equal(frames[20].images[0], LEFT[20])
    np.testing.assert_array_equal(frames[20].images[1], RIGHT[20])
