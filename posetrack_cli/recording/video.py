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
from posetrack_cli.recording.base import CAMERA_FILE_NAME, Encoded, StoredImage, UnreadableImageError
from posetrack_cli.recording.camera_file import Rig, camera_record, load_or_guess_rig
from posetrack_cli.recording.camera_of import GUESSED, Guess
from posetrack_cli.recording.depth import Depth
from posetrack_cli.recording.description import described_cameras, try_open
from posetrack_cli.recording.exif import ratio_of_35_mm
from posetrack_cli.recording.grey import Grey, grey_like
from posetrack_cli.recording.identity import file_digest, identity_record, shown_name
from posetrack_cli.recording.image_files import encode_jpeg, encoded_file
from posetrack_cli.recording.orientation import UPRIGHT, Picture
from posetrack_cli.recording.pixels import Window
from posetrack_cli.recording.recording import CameraStream, ReadingOptions, Recording
from posetrack_cli.recording.stamps import VideoStamps, stamp_at_rate, stamps_at_rate
from posetrack_cli.recording.video_copy import VideoCopy
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
REENCODED = "video is stored as JPEG images, which differ slightly from its frames"


def open_video(path: Path, options: ReadingOptions, known: Rig | None = None) -> Recording:
    """Open a video as a recording of one camera, converted to grey.

    Its calibration is the given camera file, or NAME.toml or camera.toml next to the video.

    Args:
        path: the file.
        options: reading options.
        known: the camera if stated elsewhere, instead of camera files.

    Raises:
        RecordingError: the video cannot be read, has no frames, or is not calibrated.
        UsageError: an option is invalid.
    """
    fps = options.get("fps")
    file = None if known else options.get("camera_file") or _sidecar_camera_file(path)
    found = known or load_or_guess_rig(path, file, [""], options.get("guess"))
    rig = _one_camera(found, options.get("cameras"))
    (name,) = rig.cameras
    shown, remarks = _shown(path, rig)
    video = VideoImages(path, fps, opened_video, shown, partial(_pixels, path, options))
    if fps is not None:
        stamps_at_rate(0, fps)  # validates the rate
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
        stated_focal=ratio_of_35_mm(video.focal_35_mm, *video.picture[:2]) if rig.is_guessed else None,
        why=[GUESSED if rig.is_guessed else rig.path.name],
        remarks=remarks + rig.remarks(sizes),
    )


P = TypeVar("P", Depth, Grey)


def _shown(path: Path, rig: Rig) -> tuple[Callable[[VideoFrame], ImageArray], tuple[str, ...]]:
    """Return the conversion of a video's frames to images, and remarks on unusual video.

    A guessed camera assumes square pixels; a camera file describes the stored pixels.
    """
    with opened_video(path) as video:
        aspect = video.pixel_aspect
        remarks = ("video is HDR (PQ): coded brightness is used without tone mapping",) if video.is_pq else ()
    if aspect == 1.0:
        return shown_image, remarks
    shape = f"pixel aspect ratio is {aspect:.4g}"
    if not rig.is_guessed:
        return shown_image, (*remarks, f"{shape}: intrinsics are taken to describe the stored pixels")
    remark = f"{shape}: frames are resampled to square pixels"
    return partial(shown_image, pixel_aspect=aspect), (*remarks, remark)


class VideoImages(Generic[P]):
    """Properties and images of a video.

    Args:
        path: a file that FFmpeg can read.
        fps: frame rate, Hz; replaces the video's own stamps.
        opened: opens the image stream.
        stored: returns the stored image of a frame.
        pixels_of: returns the pixel format, given the first image.

    Attributes:
        count: number of frames according to the container, None if unknown.
        picture: size and orientation of shown frames.
        focal_35_mm: stored focal length; see ``OpenVideo``.
        pixels: pixel format of the frames.
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
            self.count, rate, self.focal_35_mm = video.frame_count, video.rate_hz, video.focal_35_mm
            first, image = _first_image(video, path, stored)
            self.pixels: P = pixels_of(image)
        self.picture = Picture(self.pixels.width, self.pixels.height, orientation_of_frame(first))
        is_upright = self.picture.orientation == UPRIGHT
        self._shows_packets = is_upright and image.shape[:2] == (first.height, first.width)
        self._period_ns = NS_PER_S / rate if rate > 0 else 0.0  # 0 for an unknown rate

    def images(self, window: Window, losses: LossLog) -> Iterator[StoredImage | None]:
        """Yield the frames, decoded on the fly, as a video cannot seek back cheaply.

        Frames whose format or size differs from the first are detected on use. Undecodable frames are
        skipped; if frames are numbered as stored they are None.
        """
        index, failed, reached = 0, 0, -1.0
        stamps = VideoStamps(round(self._period_ns))
        encoded = partial(self._encoded, window, self._copy(window), losses)
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
                reached = max(reached, _pts_ns(frame), _pts_ns(frame, begin))
                stamp = stamps.stamp(_pts_ns(frame, begin))
                if self._fps is not None:
                    stamp = stamp_at_rate(index, self._fps)
                decoded = partial(self._decoded, frame, window)
                yield StoredImage(stamp, f"video frame {index}", decoded, partial(encoded, frame))
                index += 1
        missing = self._end(index, reached) - index
        if missing > 0:
            losses.add(MISSING, f"frame {index} of {self.count}", missing)

    def _end(self, index: int, reached: float) -> int:
        """Return the expected number of frames, given ``index`` frames up to ``reached``, ns.

        Some containers only state a duration, from which a constant rate gives a count. If fewer frames
        fill the duration, none are missing.
        """
        if self.count is None:
            return index
        is_full = self._period_ns > 0 and reached + 1.5 * self._period_ns >= self.count * self._period_ns
        return index if is_full else self.count

    def _decoded(self, frame: VideoFrame, window: Window) -> ImageArray:
        return window.apply(self.pixels.from_stored(self._stored(frame)))

    def _copy(self, window: Window) -> VideoCopy:
        is_kept = self._shows_packets and window.keeps_pixels
        fault = "" if is_kept else "its pictures are rotated, resampled, cropped or mirrored"
        return VideoCopy(partial(self._opened, self._path), fault)

    def _encoded(self, window: Window, copy: VideoCopy, losses: LossLog, frame: VideoFrame) -> Encoded | None:
        """Return the message content of a frame: its packet, or a JPEG in colour; None for depth."""
        if isinstance(self.pixels, Depth):
            return None
        found = copy.encoded(frame)
        if found is None:
            losses.note(f"{REENCODED}, as {copy.fault}")
            found = encoded_file(encode_jpeg(window.apply(self._stored(frame))))
        return found


def _pixels(path: Path, options: ReadingOptions, first: ImageArray) -> Grey:
    return replace(grey_like(first, path), keeps_colour=bool(options.get("in_colour")))


def _pts_ns(frame: VideoFrame, begin: int = 0) -> int:
    """Return a frame's presentation time, ns, relative to ``begin`` in its time base; 0 if unknown."""
    if frame.pts is None or frame.time_base is None:
        return 0
    return round((frame.pts - begin) * frame.time_base * NS_PER_S)


def describe_video(path: Path) -> dict[str, Any]:
    """Describe a video: displayed size, rate, stated number of frames, and its camera if known.

    Remarks are those of a run, which guesses the camera if it is unknown.

    Raises:
        RecordingError: the file is not a video.
    """
    if not is_video(path):
        raise RecordingError(
            "not a recording or result",
            where=path,
            expected="a folder of images, an MCAP file, a ROS bag or a video",
        )
    with opened_video(path) as video:
        rate, frames = video.rate_hz, video.frame_count
        _, image = _first_image(video, path, partial(shown_image, pixel_aspect=video.pixel_aspect))
        height, width = image.shape[:2]
    recording, no_camera = try_open(lambda: open_video(path, {}))
    read = recording or try_open(lambda: open_video(path, {"guess": Guess()}))[0]
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
    """Return the first decodable frame and its stored image."""
    for frame, _ in zip(video.frames(), range(MOST_FAILURES), strict=False):
        if frame is not None:
            with suppress(UnreadableImageError):
                return frame, stored(frame)
    raise RecordingError("no video frame can be decoded", where=path)


def _sidecar_camera_file(path: Path) -> Path | None:
    """Return the camera file next to a video: NAME.toml or camera.toml; None without."""
    files = path.with_suffix(".toml"), path.parent / CAMERA_FILE_NAME
    return next((file for file in files if file.exists()), None)


def _one_camera(rig: Rig, cameras: Sequence[str] | None) -> Rig:
    chosen = rig if cameras is None else rig.subset(cameras)
    if len(chosen.cameras) != 1:
        raise UsageError(
            "several cameras for one video",
            where=rig.path,
            found=", ".join(chosen.cameras),
            hint="choose one with --cameras",
        )
    return chosen
