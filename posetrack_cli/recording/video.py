"""Videos as recordings of one grey camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.files import placed_path
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import CAMERA_FILE_NAME, StoredImage, UnreadableImageError
from posetrack_cli.recording.camera_file import Rig, camera_record, found_rig
from posetrack_cli.recording.camera_of import GUESSED, Guess
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.description import described_cameras, opened
from posetrack_cli.recording.grey import Grey, grey_like
from posetrack_cli.recording.identity import file_digest, identity_record, shown_name
from posetrack_cli.recording.orientation import Picture
from posetrack_cli.recording.pixels import Window
from posetrack_cli.recording.recording import CameraStream, ReadingOptions, Recording
from posetrack_cli.recording.stamps import VideoStamps, stamp_at_rate, stamps_at_rate
from posetrack_cli.recording.video_file import (
    MOST_FAILURES,
    OpenVideo,
    is_video,
    opened_video,
    orientation_of_frame,
    shown_image,
)
from posetrack_cli.units import NS_PER_S

if TYPE_CHECKING:
    from av.video.frame import VideoFrame

UNDECODABLE, MISSING = "video frame cannot be decoded", "video frame missing"


def open_video(path: Path, options: ReadingOptions, known: Rig | None = None) -> Recording:
    """Open a video as a recording of one camera, its frames made grey.

    Its calibration is the camera file given, or NAME.toml or camera.toml beside the video.

    Args:
        path: the file.
        options: how it is read.
        known: its camera where another file states it, in place of camera files.

    Raises:
        RecordingError: if it cannot be read, has no frame, or is not calibrated.
        UsageError: if an option has a value that cannot be used.
    """
    fps = options.get("fps")
    file = None if known else options.get("camera_file") or _beside(path)
    found = known or found_rig(path, file, [""], options.get("guess"))
    rig = _one_camera(found, options.get("cameras"))
    (name,) = rig.cameras
    shown, remarks = _shown(path, rig)
    video = VideoImages(path, fps, opened_video, shown, partial(_pixels, path, options))
    if fps is not None:
        stamps_at_rate(0, fps)  # refuses what is no rate
    window = rig.window(name, options.get("mirror"))
    sizes = {name: video.picture}
    (stored,) = rig.stored_cameras(sizes)
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

    return Recording(
        path,
        [stream],
        identity=identity,
        frame_count=video.count,
        is_guessed=rig.is_guessed,
        why=[GUESSED if rig.is_guessed else rig.path.name],
        remarks=remarks + rig.remarks(sizes),
    )


P = TypeVar("P", Depth, Grey)


def _shown(path: Path, rig: Rig) -> tuple[Callable[[VideoFrame], ImageArray], tuple[str, ...]]:
    """Return what makes images of a video's frames, and remarks where these differ from ordinary video.

    A guessed camera has square pixels; a camera file is of the pixels that are stored.
    """
    with opened_video(path) as video:
        aspect = video.pixel_aspect
        remarks = ("video is HDR (PQ): brightness is used as it is coded",) if video.is_pq else ()
    if aspect == 1.0:
        return shown_image, remarks
    shape = f"pixels are {aspect:.4g} times as wide as high"
    if not rig.is_guessed:
        return shown_image, (*remarks, f"{shape}: the camera file is taken to describe these")
    remark = f"{shape}: pictures are resampled to square ones"
    return partial(shown_image, pixel_aspect=aspect), (*remarks, remark)


class VideoImages(Generic[P]):
    """What a video tells of itself, and its images.

    Args:
        path: a file that FFmpeg can read.
        fps: frame rate, Hz, in place of the video's own stamps.
        opened: opens the stream of its images.
        stored: returns the image that a frame stores.
        pixels_of: tells from the first image what all hold.

    Attributes:
        count: the number of frames that it tells, None if it does not.
        picture: what its frames are like as they are shown.
        pixels: what its frames hold.
    """

    def __init__(
        self,
        path: Path,
        fps: float | None,
        opened: Callable[[Path], AbstractContextManager[OpenVideo]],
        stored: Callable[[VideoFrame], ImageArray],
        pixels_of: Callable[[ImageArray], P],
    ) -> None:
        self._path, self._fps, self._opened, self._stored = path, fps, opened, stored
        with opened(path) as video:
            self.count, rate = video.frame_count, video.rate_hz
            first, image = _first_image(video, path, stored)
            self.pixels: P = pixels_of(image)
        self.picture = Picture(self.pixels.width, self.pixels.height, orientation_of_frame(first))
        self._period_ns = NS_PER_S / rate if rate > 0 else 0.0  # 0 if it tells no rate

    def images(self, window: Window, losses: LossLog) -> Iterator[StoredImage | None]:
        """Yield the frames, decoded: a video cannot go back to one that was passed.

        Pixels of another format or size than the first frame's are found when an image is used. Behind frames
        that cannot be decoded those that can are looked for; where frames are numbered as they are stored,
        those are None.
        """
        index, failed, reached = 0, 0, -1.0
        stamps = VideoStamps(round(self._period_ns))
        with self._opened(self._path) as video:
            begin = video.stream.start_time or 0
            for frame in video.frames():
                if frame is None:
                    failed += 1
                    continue
                if failed:
                    losses.add(UNDECODABLE, f"frame {index}", failed)
                    if self.pixels.is_numbered_as_stored:
                        yield from repeat(None, failed)
                index, failed = index + failed, 0
                reached = max(reached, _told_ns(frame), _told_ns(frame, begin))
                stamp = stamps.stamp(_told_ns(frame, begin))
                if self._fps is not None:
                    stamp = stamp_at_rate(index, self._fps)
                yield StoredImage(stamp, f"video frame {index}", partial(self._decoded, frame, window))
                index += 1
        missing = self._end(index, reached) - index
        if missing > 0:
            losses.add(MISSING, f"frame {index} of {self.count}", missing)

    def _end(self, index: int, reached: float) -> int:
        """Return how many frames there should have been, where ``index`` of them came up to ``reached``, ns.

        Some videos tell a duration, which makes a number of frames at an even rate. So fewer that fill the
        duration are all there are.
        """
        if self.count is None:
            return index
        is_full = self._period_ns > 0 and reached + 1.5 * self._period_ns >= self.count * self._period_ns
        return index if is_full else self.count

    def _decoded(self, frame: VideoFrame, window: Window) -> ImageArray:
        return window.apply(self.pixels.from_stored(self._stored(frame)))


def _pixels(path: Path, options: ReadingOptions, first: ImageArray) -> Grey:
    return replace(grey_like(first, path), keeps_colour=bool(options.get("in_colour")))


def _told_ns(frame: VideoFrame, begin: int = 0) -> int:
    """The stamp that a video tells of a frame, from ``begin`` on, which is in its own unit; 0 for none."""
    if frame.pts is None or frame.time_base is None:
        return 0
    return round((frame.pts - begin) * frame.time_base * NS_PER_S)


def describe_video(path: Path) -> dict[str, Any]:
    """Describe a video: displayed size, rate, number of frames as it tells them, and its camera if known.

    Remarks are those of a run, which guesses the camera where there is none.

    Raises:
        RecordingError: it is none.
    """
    if not is_video(path):
        raise RecordingError(
            "is not a recording or result",
            where=path,
            expected="a folder of images, an MCAP file or a video",
        )
    with opened_video(path) as video:
        rate, frames = video.rate_hz, video.frame_count
        _, image = _first_image(video, path, partial(shown_image, pixel_aspect=video.pixel_aspect))
        height, width = image.shape[:2]
    recording, no_camera = opened(lambda: open_video(path, {}))
    read = recording or opened(lambda: open_video(path, {"guess": Guess()}))[0]
    return {
        "name": shown_name(placed_path(path)),
        "kind": "video",
        "bytes": path.stat().st_size,
        "image": {"width": width, "height": height},
        "frames": frames or 0,
        "rate_hz": rate,
        "cameras": described_cameras(recording),
        "no_camera": no_camera,
        "remarks": [] if read is None else list(read.remarks),
        "losses": [],
    }


def _first_image(
    video: OpenVideo, path: Path, stored: Callable[[VideoFrame], ImageArray]
) -> tuple[VideoFrame, ImageArray]:
    """Return the first frame that can be decoded, and the image that it stores."""
    for frame, _ in zip(video.frames(), range(MOST_FAILURES), strict=False):
        if frame is not None:
            with suppress(UnreadableImageError):
                return frame, stored(frame)
    raise RecordingError("video has no frame that can be decoded", where=path)


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
