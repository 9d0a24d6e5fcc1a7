"""Grey images of one or more cameras from an MCAP file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from posetrack_cli.arrays import ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.decoding import MessageDecoder, UndecodableMessageError, stamp_of
from posetrack_cli.mcap.stream import check_mcap, read_messages
from posetrack_cli.recording.base import TRUTH_PREFIX, TruthMessage
from posetrack_cli.recording.camera_file import NotCalibratedError
from posetrack_cli.recording.depth import Window
from posetrack_cli.recording.guess import Guess, check_one_camera
from posetrack_cli.recording.identity import file_digest, shown_name
from posetrack_cli.recording.matching import NS_PER_MS, StoredImage
from posetrack_cli.recording.mcap_cameras import (
    Source,
    cameras_of_messages,
    distinct_names,
    find_sources,
    sources_of_rig,
)
from posetrack_cli.recording.mcap_grey import grey_of_message
from posetrack_cli.recording.mcap_topics import Topic, scan_topics
from posetrack_cli.recording.mcap_truth import read_truth
from posetrack_cli.recording.rig_file import Rig, load_rig
from posetrack_cli.recording.several_cameras import DEFAULT_TOLERANCE_MS, SeveralCamerasRecording

FROM_FILE, FROM_MESSAGES, GUESSED = "camera file", "messages", "guessed"
"""Where cameras are from."""


class ImagesMcapRecording(SeveralCamerasRecording):
    """Grey images of topics of an MCAP file, Foxglove or ROS; a ``Recording``.

    Stamps are the messages' own, or log times where those are 0. A truncated or damaged file is read as far
    as it goes, which ends the frames with a loss, not an error. Every camera's images are read in a pass of
    its own over the file, so that memory does not grow where one ends early.

    Args:
        path: the file.
        cameras: topics, frame ids or parts of topics' names to use, the reference first; None for all.
        camera_file: replaces calibrations and transforms.
        mirror: flip left to right; replaces the camera file's value.
        tolerance_ms: largest difference of stamps within a frame.
        guess: of the only camera, where it is not calibrated.

    Raises:
        RecordingError: if the file is no MCAP, if no topic or no calibration fits, or nothing tells where the
            cameras are. A later image of another size raises it while it is read.
    """

    def __init__(
        self,
        path: Path,
        *,
        cameras: Sequence[str] | None = None,
        camera_file: Path | None = None,
        mirror: bool | None = None,
        tolerance_ms: float = DEFAULT_TOLERANCE_MS,
        guess: Guess | None = None,
    ) -> None:
        check_mcap(path)
        topics = scan_topics(path)
        self._truth = [name for name in topics if name.startswith(TRUTH_PREFIX)]
        rig = load_rig(camera_file) if camera_file is not None else None
        if rig is None:
            self._sources = distinct_names(find_sources(path, topics, cameras))
            stored, calibration = _cameras(path, topics, self._sources, guess)
        else:
            rig = rig if cameras is None else rig.chosen(cameras)
            self._sources = [_with_bits(s, rig) for s in sources_of_rig(path, topics, rig)]
            stored = list(rig.stored_cameras({source.name: source.size for source in self._sources}))
            calibration = FROM_FILE
            if guess is not None:
                check_one_camera(path, rig.cameras)
        self._calibration = calibration
        self._mirror = bool(rig and rig.mirror) if mirror is None else mirror
        self._windows = [
            rig.window(source.name, self._mirror) if rig else Window(None, self._mirror)
            for source in self._sources
        ]
        cameras_in_use, tolerance = _windowed(self._windows, stored), round(tolerance_ms * NS_PER_MS)
        super().__init__(path, cameras_in_use, tolerance, is_guessed=calibration == GUESSED)

    @property
    def frame_count(self) -> int | None:
        """The number of messages of each camera; None if they differ, so that some have dropped out."""
        counts = {source.topic.count for source in self._sources}
        return counts.pop() if len(counts) == 1 else None

    def identity(self) -> Mapping[str, str]:
        """Name, kind, size and SHA-256 of the file, the topics in use, and how it was read."""
        size, digest = file_digest(self._path)
        return {
            "name": shown_name(self._path.resolve()),
            "kind": "mcap",
            "bytes": str(size),
            "sha256": digest,
            "frames": "" if self.frame_count is None else str(self.frame_count),
            "cameras": ",".join(camera.name for camera in self._cameras),
            "topics": ",".join(source.topic.name for source in self._sources),
            "calibration": self._calibration,
            "stored": ", ".join(dict.fromkeys(source.kind.words for source in self._sources)),
            "mirror": str(self._mirror).lower(),
            "tolerance_ms": f"{self._tolerance_ns / NS_PER_MS:g}",
        }

    def truth(self) -> Iterator[TruthMessage]:
        """Yield the messages on ``/truth/...`` topics; nothing if images are mirrored, which truth is not."""
        return iter(()) if self._mirror else read_truth(self._path, self._truth)

    def _streams(self, losses: LossLog) -> Sequence[Iterator[StoredImage | None]]:
        return [self._stream(s, w, losses) for s, w in zip(self._sources, self._windows, strict=True)]

    def _stream(self, source: Source, window: Window, losses: LossLog) -> Iterator[StoredImage | None]:
        decoder, own, name = MessageDecoder(), LossLog(), source.topic.name
        try:
            for item in read_messages(self._path, own, [name]):
                try:
                    decoded = decoder.decode(*item)
                except UndecodableMessageError as error:
                    losses.add(f"message skipped, {error}", f"at {item[2].log_time} ns")
                    yield None
                    continue
                stamp = stamp_of(decoded, item[2])
                where = f"{name} at {stamp} ns"
                yield StoredImage(stamp, where, partial(_grey, decoded, source, window, where))
        finally:
            losses.include(own.losses)  # every camera's pass meets the same damage


def _cameras(
    path: Path, topics: Mapping[str, Topic], sources: Sequence[Source], guess: Guess | None
) -> tuple[list[Camera], str]:
    """Return the cameras of stored images, and where they are from."""
    if guess is not None:
        check_one_camera(path, [source.name for source in sources])
    try:
        return cameras_of_messages(path, topics, sources), FROM_MESSAGES
    except NotCalibratedError:
        if guess is None:
            raise
    return [guess.stored_camera(*source.size, source.name) for source in sources], GUESSED


def _grey(decoded: Any, source: Source, window: Window, where: str) -> ImageArray:
    return window.apply(grey_of_message(decoded, str(source.topic.kind), source.kind, where))


def _with_bits(source: Source, rig: Rig) -> Source:
    bits = rig.cameras[source.name].bits
    if bits is None or source.kind.bits == 8:
        return source
    return replace(source, kind=replace(source.kind, bits=bits))


def _windowed(windows: Sequence[Window], cameras: Sequence[Camera]) -> list[Camera]:
    return [window.camera(camera) for window, camera in zip(windows, cameras, strict=True)]
