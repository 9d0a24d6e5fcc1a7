"""Grey images of one camera from a video file."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import cv2

from posetrack_cli import limits
from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import open_input, utf8_name
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.camera_file import CAMERA_FILE_NAME
from posetrack_cli.recording.grey import check_size, grey_of, kind_of_image
from posetrack_cli.recording.guess import Guess
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.matching import NS_PER_MS, StoredImage
from posetrack_cli.recording.rig_file import Rig, found_rig
from posetrack_cli.recording.several_cameras import SeveralCamerasRecording
from posetrack_cli.recording.stamps import stamp_at_rate, stamps_at_rate
from posetrack_cli.recording.video_stamps import VideoStamps
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


class ImagesVideoRecording(SeveralCamerasRecording):
    """The frames of a video, made grey; a ``Recording`` of one camera.

    Args:
        path: a file that OpenCV can read.
        cameras: the camera's name in a camera file of several.
        camera_file: its calibration; None for NAME.toml or camera.toml beside the video.
        fps: frame rate, Hz, in place of the video's own stamps.
        mirror: flip left to right; replaces the camera file's value.
        guess: of the camera, where it is not calibrated.

    Raises:
        RecordingError: if it cannot be read, has no frame, or is not calibrated.
    """

    def __init__(
        self,
        path: Path,
        *,
        cameras: Sequence[str] | None = None,
        camera_file: Path | None = None,
        fps: float | None = None,
        mirror: bool | None = None,
        guess: Guess | None = None,
    ) -> None:
        rig = _one_camera(found_rig(path, camera_file or _beside(path), [""], guess), cameras)
        (self._name,) = rig.cameras
        self._rig_path = rig.path
        with opened(path) as video:
            self._count = max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0) or None
            self._rate = float(video.get(cv2.CAP_PROP_FPS))
            self._kind = kind_of_image(_first_image(video, path), path)
        self._fps = fps
        if fps is not None:
            stamps_at_rate(0, fps)  # refuses what is no rate
        self._mirror = rig.mirror if mirror is None else mirror
        self._window = rig.window(self._name, self._mirror)
        (stored,) = rig.stored_cameras({self._name: (self._kind.width, self._kind.height)})
        super().__init__(path, [self._window.camera(stored)], 0, is_guessed=rig.is_guessed)

    @property
    def frame_count(self) -> int | None:
        """The number of frames that the video tells, None if it does not."""
        return self._count

    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 of the file, and how it was read."""
        size, digest = file_digest(self._path)
        return {
            "name": shown_name(self._path.resolve()),
            "kind": "video",
            "bytes": str(size),
            "sha256": digest,
            "frames": "" if self._count is None else str(self._count),
            "cameras": self._cameras[0].name,
            "stored": self._kind.words,
            "mirror": str(self._mirror).lower(),
            **({} if self._fps is None else {"fps": str(self._fps)}),
        }

    def _streams(self, losses: LossLog) -> Sequence[Iterator[StoredImage | None]]:
        return [self._stream(losses)]

    def _stream(self, losses: LossLog) -> Iterator[StoredImage | None]:
        """Yield the frames, decoded: a video cannot go back to one that was passed.

        Behind frames that cannot be decoded those that can are looked for.
        """
        index, failed, reached = 0, 0, -1.0
        stamps = VideoStamps(round(self._period_ns))
        with opened(self._path) as video:
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
                yield StoredImage(stamp, f"video frame {index}", partial(self._grey, image, index))
                index += 1
        for lost in range(index, self._end(index, reached)):
            losses.add(MISSING, f"frame {lost} of {self._count}")

    def _failures_allowed(self, index: int) -> int:
        """A video that goes on behind the number of frames that it tells is read to its end."""
        return 0 if self._count is None else min(max(self._count - index, 0), MOST_FAILURES)

    def _end(self, index: int, reached: float) -> int:
        """Return how many frames there should have been, where ``index`` of them came up to ``reached``, ns.

        Some videos tell a duration, of which OpenCV makes a number of frames at an even rate. So fewer that
        fill the duration are all there are.
        """
        if self._count is None:
            return index
        period_ns = self._period_ns
        is_full = period_ns > 0 and reached + 1.5 * period_ns >= self._count * period_ns
        return index if is_full else self._count

    @property
    def _period_ns(self) -> float:
        """Time between frames at the video's rate, 0 if it tells none."""
        return NS_PER_S / self._rate if self._rate > 0 else 0.0

    def _reached_ns(self, video: cv2.VideoCapture) -> float:
        """How much of its duration a video has come through; what is before its first frame counts, too."""
        return max(_position_ns(video), video.get(cv2.CAP_PROP_PTS) * self._period_ns)

    def _grey(self, image: ImageArray, index: int) -> ImageArray:
        check_size(image, self._kind, f"{self._path}, frame {index}")
        return self._window.apply(grey_of(image, self._kind.bits))


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
def opened(path: Path) -> Iterator[cv2.VideoCapture]:
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
