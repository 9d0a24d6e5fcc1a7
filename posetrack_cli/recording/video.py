"""Videos as recordings of one grey camera."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import open_input, utf8_name
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import CAMERA_FILE_NAME, StoredImage
from posetrack_cli.recording.camera_file import Rig, camera_record, found_rig
from posetrack_cli.recording.description import described_cameras, opened
from posetrack_cli.recording.grey import grey_like
from posetrack_cli.recording.identity import file_digest, identity_record, shown_name
from posetrack_cli.recording.matching import NS_PER_MS
from posetrack_cli.recording.pixels import Window
from posetrack_cli.recording.recording import CameraStream, ReadingOptions, Recording
from posetrack_cli.recording.stamps import VideoStamps, stamp_at_rate, stamps_at_rate
from posetrack_cli.units import NS_PER_S

SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
QUIET = "-8"
BEGIN_BYTES = 189
CONTAINERS = (
    (4, (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")),  # MP4 and QuickTime
    (8, (b"AVI ",)),
    (
        0,
        (
            b"\x1a\x45\xdf\xa3",  # Matroska and WebM
            b"\x00\x00\x01\xba",  # MPEG program stream
            b"\x00\x00\x01\xb3",  # MPEG video alone
            b"\x30\x26\xb2\x75",  # ASF, of .wmv
            b"OggS",
            b"FLV\x01",
        ),
    ),
    (188, (b"G",)),  # MPEG transport stream: its second packet, as its first byte is no sign
)
"""How videos begin: from this byte on, one of these."""
CAPTURE_OPTIONS = (
    "protocol_whitelist;file|format_whitelist;mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,"
    "mpeg,mpegvideo,mpegts,asf,ogg,flv"
)
"""For FFmpeg, in OpenCV's notation."""
MOST_FAILURES = 300
"""Frames in a row that cannot be decoded; after more of them nothing that can be is looked for."""
UNDECODABLE, MISSING = "video frame cannot be decoded", "video frame missing"


def open_video(path: Path, options: ReadingOptions) -> Recording:
    """Open a video as a recording of one camera, its frames made grey.

    Its calibration is the camera file given, or NAME.toml or camera.toml beside the video.

    Raises:
        RecordingError: if it cannot be read, has no frame, or is not calibrated.
        UsageError: if an option has a value that cannot be used.
    """
    fps = options.get("fps")
    file = options.get("camera_file") or _beside(path)
    rig = _one_camera(found_rig(path, file, [""], options.get("guess")), options.get("cameras"))
    (name,) = rig.cameras
    video = _Video(path, fps)
    if fps is not None:
        stamps_at_rate(0, fps)  # refuses what is no rate
    window = rig.window(name, options.get("mirror"))
    (stored,) = rig.stored_cameras({name: (video.pixels.width, video.pixels.height)})
    stream = CameraStream(window.camera(stored), video.pixels, partial(video.images, window))

    def identity() -> Mapping[str, str]:
        return {
            **identity_record(path, "video", file_digest(path)),
            "frames": "" if video.count is None else str(video.count),
            "cameras": stream.camera.name,
            "stored": video.pixels.words,
            "mirror": str(window.mirror).lower(),
            **({} if fps is None else {"fps": str(fps)}),
            **camera_record(file),
        }

    return Recording(path, [stream], identity=identity, frame_count=video.count, is_guessed=rig.is_guessed)


class _Video:
    """What a video tells of itself, and its images.

    Args:
        path: a file that OpenCV can read.
        fps: frame rate, Hz, in place of the video's own stamps.

    Attributes:
        count: the number of frames that it tells, None if it does not.
        pixels: what its frames hold.
    """

    def __init__(self, path: Path, fps: float | None) -> None:
        self._path, self._fps = path, fps
        with open_capture(path) as video:
            self.count = max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0) or None
            rate = float(video.get(cv2.CAP_PROP_FPS))
            self.pixels = grey_like(_first_image(video, path), path)
        self._period_ns = NS_PER_S / rate if rate > 0 else 0.0  # 0 if it tells no rate

    def images(self, window: Window, losses: LossLog) -> Iterator[StoredImage]:
        """Yield the frames, decoded: a video cannot go back to one that was passed.

        Behind frames that cannot be decoded those that can are looked for.
        """
        index, failed, reached = 0, 0, -1.0
        stamps = VideoStamps(round(self._period_ns))
        with open_capture(self._path) as video:
            while failed <= self._failures_allowed(index):
                is_read, image = video.read()
                if not is_read:
                    failed += 1
                    continue
                for lost in range(index, index + failed):
                    losses.add(UNDECODABLE, f"frame {lost}")
                index, failed, reached = index + failed, 0, max(reached, self._reached_ns(video))
                stamp = stamps.stamp(_position_ns(video))
                if self._fps is not None:
                    stamp = stamp_at_rate(index, self._fps)
                yield StoredImage(stamp, f"video frame {index}", partial(self._grey, image, index, window))
                index += 1
        for lost in range(index, self._end(index, reached)):
            losses.add(MISSING, f"frame {lost} of {self.count}")

    def _failures_allowed(self, index: int) -> int:
        """A video that goes on behind the number of frames that it tells is read to its end."""
        return 0 if self.count is None else min(max(self.count - index, 0), MOST_FAILURES)

    def _end(self, index: int, reached: float) -> int:
        """Return how many frames there should have been, where ``index`` of them came up to ``reached``, ns.

        Some videos tell a duration, of which OpenCV makes a number of frames at an even rate. So fewer that
        fill the duration are all there are.
        """
        if self.count is None:
            return index
        is_full = self._period_ns > 0 and reached + 1.5 * self._period_ns >= self.count * self._period_ns
        return index if is_full else self.count

    def _reached_ns(self, video: cv2.VideoCapture) -> float:
        """How much of its duration a video has come through; what is before its first frame counts, too."""
        return max(_position_ns(video), video.get(cv2.CAP_PROP_PTS) * self._period_ns)

    def _grey(self, image: ImageArray, index: int, window: Window) -> ImageArray:
        return window.apply(self.pixels.from_stored(image, f"{self._path}, frame {index}"))


def describe_video(path: Path) -> dict[str, Any]:
    """Describe a video: size, rate, number of frames as it tells them, and its camera if there is one.

    Raises:
        RecordingError: it is none.
    """
    if not is_video(path):
        raise RecordingError(
            "is not a recording or result",
            where=path,
            expected="a folder of images, an MCAP file or a video",
        )
    with open_capture(path) as video:
        image = {
            "width": int(video.get(cv2.CAP_PROP_FRAME_WIDTH)),
            "height": int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        }
        rate, frames = float(video.get(cv2.CAP_PROP_FPS)), int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    recording, no_camera = opened(lambda: open_video(path, {}))
    return {
        "name": shown_name(path.resolve()),
        "kind": "video",
        "bytes": path.stat().st_size,
        "image": image,
        "frames": frames,
        "rate_hz": rate,
        "cameras": described_cameras(recording),
        "no_camera": no_camera,
        "losses": [],
    }


def _position_ns(video: cv2.VideoCapture) -> int:
    """The stamp of the frame that was read last, as the video tells it."""
    return round(video.get(cv2.CAP_PROP_POS_MSEC) * NS_PER_MS)


def _first_image(video: cv2.VideoCapture, path: Path) -> ImageArray:
    for _ in range(MOST_FAILURES):
        is_read, image = video.read()
        if is_read:
            return image
    raise RecordingError("video has no frame that can be decoded", where=path)


def is_video(path: Path) -> bool:
    """Whether a file is named as a video or begins as one."""
    return path.suffix.lower() in SUFFIXES or _begins_as_video(path)


def _begins_as_video(path: Path) -> bool:
    with open_input(path) as file:
        begin = file.read(BEGIN_BYTES)
    return any(begin.startswith(sign, at) for at, signs in CONTAINERS for sign in signs)


def _capture(path: Path) -> cv2.VideoCapture | None:
    """Return an open video; None for what is none.

    FFmpeg also takes text for a video, which names other files, or hosts, to read. So it is asked only for
    files that begin as videos do, and told which kinds to take them for.
    """
    if not _begins_as_video(path):
        return None
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", QUIET)  # an error is told in one line, by us
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = CAPTURE_OPTIONS
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    try:
        with utf8_name(path) as name:
            video = cv2.VideoCapture(name, cv2.CAP_FFMPEG)  # others take numbered images for videos
    finally:
        cv2.utils.logging.setLogLevel(level)
    if not video.isOpened():
        video.release()
        return None
    return video


@contextmanager
def open_capture(path: Path) -> Iterator[cv2.VideoCapture]:
    """Yield an open video.

    Raises:
        RecordingError: if OpenCV cannot open it.
    """
    try:
        video = _capture(path)
    except OSError as error:
        raise RecordingError("cannot be read", where=path, found=error.strerror or error) from error
    if video is None:
        found = "an MP4 file that ends before its index" if _lacks_index(path) else ""
        raise RecordingError("is no video that can be read", where=path, found=found)
    try:
        width, height = (int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if width * height > limits.IMAGE_PIXELS:
            raise RecordingError(
                "video is larger than any that is read",
                where=path,
                found=f"{width}x{height}",
                expected=f"at most {limits.IMAGE_PIXELS} pixels",
            )
        yield video
    finally:
        video.release()


def _lacks_index(path: Path) -> bool:
    """Whether a file is MP4 (ISO/IEC 14496-12) but for ``moov``, which recorders write last."""
    kinds = []
    with open_input(path) as file:
        while len(header := file.read(8)) == 8:
            size, kind = struct.unpack(">I4s", header)
            kinds.append(kind)
            if size == 1 and len(longer := file.read(8)) == 8:
                size = struct.unpack(">Q", longer)[0] - 8
            if size < 8:
                break
            file.seek(size - 8, os.SEEK_CUR)
    return kinds[:1] == [b"ftyp"] and b"moov" not in kinds


def _beside(path: Path) -> Path | None:
    """The camera file that lies beside a video: NAME.toml, or camera.toml; None for none."""
    files = path.with_suffix(".toml"), path.parent / CAMERA_FILE_NAME
    return next((file for file in files if file.exists()), None)


def _one_camera(rig: Rig, cameras: Sequence[str] | None) -> Rig:
    chosen = rig if cameras is None else rig.chosen(cameras)
    if len(chosen.cameras) != 1:
        raise UsageError(
            "a video is of one camera",
            where=rig.path,
            found=", ".join(chosen.cameras),
            hint="choose one with --cameras",
        )
    return chosen
