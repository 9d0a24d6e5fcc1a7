"""Videos of one camera: pixels, stamps, camera file, what cannot be read."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from posetrack_cli import limits
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.opening import describe, open_recording
from posetrack_cli.recording.video_file import CODECS, DECODERS, opened_container, opened_video, shown_image

COUNT, RATE = 12, 25.0
CAMERA = "fx = 70.0\nfy = 71.0\ncx = 31.0\ncy = 24.0\n"
CODEC_LEVELS = 6.0
"""Mean error that motion JPEG makes of smooth frames."""


def pictures() -> list[np.ndarray]:
    """Smooth colour gradients that move."""
    v, u = np.mgrid[0:48, 0:64]
    return [
        np.stack([3 * u % 250, 4 * v % 250, (2 * u + 10 * i) % 250], axis=-1).astype(np.uint8)
        for i in range(COUNT)
    ]


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "face.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), RATE, (64, 48))
    for picture in pictures():
        writer.write(picture)
    writer.release()
    (tmp_path / "face.toml").write_text(CAMERA)
    return path


def test_frames_are_grey_with_the_video_s_stamps(video: Path) -> None:
    recording = open_recording(video, "grey")
    frames = list(recording.frames())
    assert (len(frames), recording.frame_count, recording.losses) == (COUNT, COUNT, ())
    assert [frame.stamp_ns for frame in frames] == [40_000_000 * i for i in range(COUNT)]
    for frame, picture in zip(frames, pictures(), strict=True):
        (image,) = frame.images
        assert (image.dtype, image.shape) == (np.uint8, (48, 64))
        grey = picture @ [0.114, 0.587, 0.299]
        assert np.abs(image - grey).mean() < CODEC_LEVELS


def test_frames_are_freed_without_the_garbage_collector(video: Path) -> None:
    """It runs so rarely that thousands of frames would wait for it."""
    with opened_video(video) as opened:
        frame = next(frame for frame in opened.frames() if frame is not None)
        before = sys.getrefcount(frame)
        shown_image(frame)
        assert sys.getrefcount(frame) == before


def test_range_rate_and_mirror(video: Path) -> None:
    plain = list(open_recording(video, "grey").frames())
    frames = list(open_recording(video, "grey", fps=10, mirror=True).frames(start=2, end=9, stride=3))
    assert [frame.index for frame in frames] == [2, 5, 8]
    assert [frame.stamp_ns for frame in frames] == [200_000_000, 500_000_000, 800_000_000]
    np.testing.assert_array_equal(frames[1].images[0], plain[5].images[0][:, ::-1])


def test_the_camera_is_beside_the_video_or_given(video: Path, tmp_path: Path) -> None:
    assert open_recording(video, "grey").cameras[0].fx == 70.0
    (tmp_path / "face.toml").rename(tmp_path / "camera.toml")
    assert open_recording(video, "grey").cameras[0].cx == 31.0
    (tmp_path / "camera.toml").rename(tmp_path / "other.toml")
    assert open_recording(video, "grey", camera_file=tmp_path / "other.toml").cameras[0].fy == 71.0
    with pytest.raises(
        RecordingError, match=r"face.avi: cameras are not calibrated.*posetrack calibrate stereo"
    ):
        open_recording(video, "grey")


def test_one_camera_of_a_file_of_several(video: Path, tmp_path: Path) -> None:
    place = "rotation = [1, 0, 0, 0, 1, 0, 0, 0, 1]\ntranslation_mm = [-100, 0, 0]\n"
    (tmp_path / "face.toml").write_text(f"[cameras.left]\n{CAMERA}[cameras.right]\n{CAMERA}{place}")
    with pytest.raises(
        UsageError, match="several cameras for one video, found left, right; choose one with --cameras"
    ):
        open_recording(video, "grey")
    (camera,) = open_recording(video, "grey", cameras=["right"]).cameras
    assert camera.name == "right"
    np.testing.assert_array_equal(camera.camera_T_reference, np.eye(3, 4))


def test_a_camera_file_of_another_size_is_named_once(video: Path, tmp_path: Path) -> None:
    (tmp_path / "face.toml").write_text(f"{CAMERA}width = 640\nheight = 640\n")
    told = rf"^{tmp_path / 'face.toml'}: camera file and images differ in size, found images of 64x48"
    with pytest.raises(RecordingError, match=told):
        open_recording(video, "grey")
    place = "width = 640\nheight = 640\n"
    (tmp_path / "face.toml").write_text(f"[cameras.left]\n{CAMERA}{place}")
    with pytest.raises(RecordingError, match=rf"^{tmp_path / 'face.toml'}, camera 'left': camera file and"):
        open_recording(video, "grey")


def test_a_video_that_is_cut_ends_with_a_loss(video: Path) -> None:
    data = video.read_bytes()
    video.write_bytes(data[: len(data) * 2 // 3])
    recording = open_recording(video, "grey")
    frames = list(recording.frames())
    assert 0 < len(frames) < COUNT
    (loss,) = recording.losses
    assert (loss.what, loss.count) == ("video frame missing", COUNT - len(frames))
    assert loss.first == f"frame {len(frames)} of {COUNT}"


# Videos that are written packet by packet

UNEVEN = (0, 1, 2, 5, 6, 10, 11, 12, 20, 21)
"""When frames are taken, periods."""
OF_MATROSKA_NS = 500_000
"""It tells whole milliseconds."""


def write_packets(path: Path, packets: list[bytes], times: Sequence[int]) -> Path:
    """Motion JPEG of given stamps, periods of 1 / RATE."""
    raw = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    four = cv2.VideoWriter_fourcc(*"MJPG")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, four, RATE, (64, 48), raw)
    assert writer.isOpened()
    for packet, time in zip(packets, times, strict=True):
        writer.set(cv2.VIDEOWRITER_PROP_PTS, time)
        writer.write(np.frombuffer(packet, np.uint8)[None])
    writer.release()
    path.with_suffix(".toml").write_text(CAMERA)
    return path


def packets(count: int = COUNT) -> list[bytes]:
    return [cv2.imencode(".jpg", picture)[1].tobytes() for picture in pictures()[:count]]


@pytest.mark.parametrize(("suffix", "error_ns"), [(".mp4", 1), (".mkv", OF_MATROSKA_NS)])
def test_stamps_of_a_video_of_variable_rate_are_its_own(tmp_path: Path, suffix: str, error_ns: int) -> None:
    recording = open_recording(write_packets(tmp_path / f"v{suffix}", packets(len(UNEVEN)), UNEVEN), "grey")
    frames = list(recording.frames())
    true = [round(time * 1e9 / RATE) for time in UNEVEN]
    assert np.abs(np.subtract([frame.stamp_ns for frame in frames], true)).max() <= error_ns
    assert recording.losses == ()  # Matroska tells a duration, which OpenCV takes for 22 frames
    for frame, picture in zip(frames, pictures(), strict=False):
        assert np.abs(frame.images[0] - picture @ [0.114, 0.587, 0.299]).mean() < CODEC_LEVELS


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_frames_that_cannot_be_decoded_are_passed_and_counted(tmp_path: Path, suffix: str) -> None:
    found = packets()
    found[0] = found[5] = found[6] = b"no JPEG"
    recording = open_recording(write_packets(tmp_path / f"v{suffix}", found, range(COUNT)), "grey")
    stamps = [frame.stamp_ns for frame in recording.frames()]
    left = [k for k in range(COUNT) if k not in (0, 5, 6)]
    assert np.abs(np.subtract(stamps, [40_000_000 * k for k in left])).max() <= OF_MATROSKA_NS
    (loss,) = recording.losses
    assert (loss.what, loss.count, loss.first) == ("video frame cannot be decoded", 3, "frame 0")


def test_a_frame_out_of_place_is_dropped(tmp_path: Path) -> None:
    """Its neighbours keep their stamps. In Matroska, times may go back, as behind a damaged part."""
    times = [0, 1, 2, 20, 21, 5, 22, 23]
    recording = open_recording(write_packets(tmp_path / "v.mkv", packets(len(times)), times), "grey")
    stamps = [frame.stamp_ns for frame in recording.frames()]
    left = [time for time in times if time != 5]
    assert np.abs(np.subtract(stamps, [40_000_000 * time for time in left])).max() <= OF_MATROSKA_NS
    (loss,) = recording.losses
    assert (loss.what, loss.count) == ("frame dropped, stamp not later than the previous frame's", 1)


def test_what_is_before_the_first_frame_is_not_missing(tmp_path: Path) -> None:
    """A Matroska video that begins late tells the duration from 0 on."""
    times = [20 + k for k in range(COUNT)]
    recording = open_recording(write_packets(tmp_path / "v.mkv", packets(), times), "grey")
    assert len(list(recording.frames())) == COUNT
    assert recording.losses == ()


def test_a_video_is_read_on_behind_the_number_of_frames_that_it_tells(tmp_path: Path) -> None:
    """Two MPEG transport streams in one file tell the duration of one."""
    path = tmp_path / "v.ts"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"mp4v"), RATE, (64, 48))
    for picture in pictures():
        writer.write(picture)
    writer.release()
    path.write_bytes(2 * path.read_bytes())
    path.with_suffix(".toml").write_text(CAMERA)
    recording = open_recording(path, "grey")
    frames = list(recording.frames())
    assert recording.frame_count is not None and recording.frame_count < len(frames) == 2 * COUNT
    assert [frame.stamp_ns for frame in frames] == [40_000_000 * k for k in range(2 * COUNT)]


def test_a_video_of_nothing_that_can_be_decoded(tmp_path: Path) -> None:
    path = write_packets(tmp_path / "v.mp4", [b"no JPEG"] * 3, range(3))
    with pytest.raises(RecordingError, match=r"v\.mp4: no video frame can be decoded"):
        open_recording(path, "grey")


def test_a_video_whose_index_is_cut_off_cannot_be_opened(tmp_path: Path) -> None:
    path = write_packets(tmp_path / "v.mp4", packets(), range(COUNT))
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"moov")])
    with pytest.raises(
        RecordingError, match=r"v\.mp4: not a readable video, found an MP4 file without its index"
    ):
        open_recording(path, "grey")


@pytest.mark.parametrize("content", [b"", b"no video at all" * 20])
def test_what_is_no_video(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "face.mp4"
    path.write_bytes(content)
    (tmp_path / "face.toml").write_text(CAMERA)
    with pytest.raises(RecordingError, match=r"face.mp4: not a readable video"):
        open_recording(path, "grey")
    # a process of its own, where no video was written before: the libraries say nothing of their own
    command = [sys.executable, "-m", "posetrack_cli.cli.main", "info", str(path)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert process.returncode == 1
    assert process.stderr == f"posetrack: {path}: not a readable video\n"


def test_options_that_do_not_apply(video: Path) -> None:
    with pytest.raises(UsageError, match="--tolerance-ms does not apply to a video"):
        open_recording(video, "grey", tolerance_ms=3)
    with pytest.raises(UsageError, match="--fps 0"):
        open_recording(video, "grey", fps=0)


def test_identity(video: Path) -> None:
    identity = open_recording(video, "grey", fps=20).identity()
    assert (identity["kind"], identity["frames"], identity["fps"]) == ("video", str(COUNT), "20")
    assert identity["stored"] == "8-bit colour"


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nother.avi\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile other.avi\n",
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n",
    ],
)
@pytest.mark.parametrize("disguise", ["", "#xxx"])
def test_a_list_of_other_files_is_no_video(tmp_path: Path, text: str, disguise: str) -> None:
    """FFmpeg would read the files, or listen to the hosts, that it names."""
    writer = cv2.VideoWriter(
        str(tmp_path / "other.avi"), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48)
    )
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    with opened_video(tmp_path / "other.avi"):
        pass
    path = tmp_path / "list.mp4"
    path.write_text(f"{disguise}ftyp\n{text}" if disguise else text)
    with pytest.raises(RecordingError, match="not a readable video"), opened_video(path):
        pass


def test_a_video_larger_than_any_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    monkeypatch.setattr(limits, "IMAGE_PIXELS", 64 * 48 - 1)
    expected = "video frames are too large, found 64x48"
    with pytest.raises(RecordingError, match=expected), opened_video(path):
        pass


# Videos as phones and recorders make them: H.264 with pictures out of order, uneven stamps, a turned camera

IDENTITY, QUARTER = (0x10000, 0, 0, 0, 0x10000, 0), (0, 0x10000, 0, -0x10000, 0, 0)
"""The two upper rows of MP4's matrix, (a, b, u, c, d, v): as stored, and turned clockwise to be shown."""
H264_LEVELS = 8.0


def write_h264(path: Path, times: Sequence[int]) -> Path:
    """Pictures of given stamps, periods of 1 / RATE, stored in the order in which B-frames need them."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=int(RATE), options={"bf": "2", "crf": "10"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.time_base = Fraction(1, int(RATE))
        for picture, time in zip(pictures(), times, strict=False):
            frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
            frame.pts, frame.time_base = time, Fraction(1, int(RATE))
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    path.with_suffix(".toml").write_text(CAMERA)
    return path


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_frames_of_h264_come_in_order_with_their_own_stamps(tmp_path: Path, suffix: str) -> None:
    recording = open_recording(write_h264(tmp_path / f"v{suffix}", UNEVEN), "grey")
    frames = list(recording.frames())
    true = [round(time * 1e9 / RATE) for time in UNEVEN]
    assert np.abs(np.subtract([frame.stamp_ns for frame in frames], true)).max() <= OF_MATROSKA_NS
    assert recording.losses == ()
    for frame, picture in zip(frames, pictures(), strict=False):
        assert np.abs(frame.images[0] - picture @ [0.114, 0.587, 0.299]).mean() < H264_LEVELS


def test_a_video_is_turned_as_its_container_says(tmp_path: Path) -> None:
    path = write_h264(tmp_path / "v.mp4", range(COUNT))
    (plain,) = next(iter(open_recording(path, "grey").frames())).images
    matrices = [struct.pack(">3i", *rows[:3]) + struct.pack(">3i", *rows[3:]) for rows in (IDENTITY, QUARTER)]
    at = path.read_bytes().index(b"tkhd")
    data = path.read_bytes()
    path.write_bytes(data[:at] + data[at:].replace(matrices[0], matrices[1], 1))
    (turned,) = next(iter(open_recording(path, "grey").frames())).images
    np.testing.assert_array_equal(turned, np.rot90(plain, -1))
    assert describe(path)["image"] == {"width": 48, "height": 64}
    shown = cv2.VideoCapture(str(path)).read()[1]
    assert np.abs(cv2.cvtColor(shown, cv2.COLOR_BGR2GRAY).astype(int) - turned).mean() < 1


def test_frames_that_a_video_only_claims_cost_nothing(video: Path) -> None:
    """An AVI that says of itself to have two thousand million frames."""
    data = bytearray(video.read_bytes())
    for name, at in ((b"avih", 24), (b"strh", 40)):
        struct.pack_into("<I", data, data.index(name) + at, 2**31 - 1)
    video.write_bytes(data)
    recording = open_recording(video, "grey")
    assert len(list(recording.frames())) == COUNT
    assert all(loss.what == "video frame missing" for loss in recording.losses)


@pytest.mark.parametrize("codec", ["magicyuv", "huffyuv", "snow", "flashsv", "cinepak", "utvideo"])
def test_codecs_that_no_recording_uses_are_refused_by_name(
    tmp_path: Path, codec: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """Before their decoders are opened: FFmpeg would open one to find out what the pixels are."""
    path = tmp_path / "v.avi"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=10, options={"strict": "experimental"})
        stream.width, stream.height = 64, 48
        stream.pix_fmt = stream.codec.video_formats[0].name
        for _ in range(3):
            image = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 90, np.uint8), format="rgb24")
            container.mux(stream.encode(image.reformat(format=stream.pix_fmt)))
        container.mux(stream.encode(None))
    for read in (describe, lambda path: open_recording(path, "grey", guess=Guess())):
        with pytest.raises(
            RecordingError, match=rf"v\.avi: unsupported video codec, found {codec}, expected h264"
        ):
            read(path)
    with opened_container(path) as container:
        (stream,) = container.streams.video
        assert stream.codec_context.is_open is False and stream.pix_fmt is None
    with av.open(str(path)) as container:  # what FFmpeg finds out where it may decode
        assert container.streams.video[0].pix_fmt is not None


def test_every_codec_of_the_list_has_a_decoder() -> None:
    """As FFmpeg finds it by the number of the codec, which is how a container names it."""
    for name in CODECS:
        decoder = av.Codec(name, "r")
        assert decoder.canonical_name == name and decoder.type == "video"
        assert decoder.name in DECODERS.split(",")
    assert {av.Codec(name, "r").canonical_name for name in DECODERS.split(",")} == set(CODECS)


def test_a_video_that_grows_within_is_not_decoded_beyond_the_bound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = cv2.imencode(".jpg", np.zeros((480, 640, 3), np.uint8))[1].tobytes()
    path = write_packets(tmp_path / "v.mp4", [*packets(3), large, *packets(2)], range(6))
    monkeypatch.setattr(limits, "IMAGE_PIXELS", 640 * 480 - 1)
    recording = open_recording(path, "grey")
    assert len(list(recording.frames())) == 5
    (loss,) = recording.losses
    assert (loss.what, loss.count, loss.first) == ("video frame cannot be decoded", 1, "frame 3")


def test_colour_to_draw_on_is_kept(video: Path) -> None:
    for frame, picture in zip(
        open_recording(video, "grey", in_colour=True).frames(), pictures(), strict=True
    ):
        (image,) = frame.images
        assert image.shape == picture.shape
        assert np.abs(image.astype(int) - picture).mean() < 2 * CODEC_LEVELS  # colour is halved
