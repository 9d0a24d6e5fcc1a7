"""Files of messages as recordings: depth on one topic, or grey images of one or more cameras.

Stamps are the messages' own, or log times if those are 0. Truncation or damage ends the frames with a loss,
not an error.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Metadata

from posetrack_cli.arrays import ImageArray
from posetrack_cli.bags.message_file import MessageFile, message_file, required_container
from posetrack_cli.bags.ros2 import parts_of
from posetrack_cli.errors import PosetrackError, RecordingError, ResultError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import relative_to
from posetrack_cli.losses import LossLog
from posetrack_cli.mcap.decoding import (
    CALIBRATION,
    DISPARITY_IMAGE,
    VIDEO_IMAGE,
    MessageDecoder,
    UndecodableMessageError,
    frame_id_of,
    own_stamp_of,
)
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import (
    TRUTH_PREFIX,
    Encoded,
    NotCalibratedError,
    StoredImage,
    TruthMessage,
    UnreadableImageError,
    not_encoded,
    truth_message,
)
from posetrack_cli.recording.camera_file import (
    DepthCamera,
    Rig,
    camera_record,
    depth_storage,
    image_camera,
    load_depth_camera,
    load_rig,
    nominal_hint,
    used_window,
)
from posetrack_cli.recording.camera_of import (
    GUESSED,
    CurrentCamera,
    Guess,
    ImageCamera,
    Resampling,
    is_same_frame,
    pair_with_calibration,
    require_single_camera,
)
from posetrack_cli.recording.camera_record import CAMERAS_RECORD, cameras_from_record
from posetrack_cli.recording.depth import (
    DISPARITY,
    MM_PER_M,
    Depth,
    DepthContent,
    DepthEncoding,
    UnitDecision,
    content_of,
    decide_unit,
    early,
    stored_depth,
)
from posetrack_cli.recording.disparity import disparity_px_m
from posetrack_cli.recording.grey import PLAIN_BITS, stored_grey, with_bits_of
from posetrack_cli.recording.identity import file_digest, files_digest, identity_record
from posetrack_cli.recording.kinect import depth_unit_mm
from posetrack_cli.recording.matching import NS_PER_MS
from posetrack_cli.recording.message_cameras import (
    CameraTopic,
    GreyTopic,
    camera_by,
    camera_of_topic,
    cameras_of_messages,
    choose_calibration,
    distinct_names,
    find_sources,
    sources_of_rig,
)
from posetrack_cli.recording.message_topics import FileTopics, Topic, scan_topics
from posetrack_cli.recording.message_video import decoded_video, encoded_video
from posetrack_cli.recording.pixels import Pixels, Window
from posetrack_cli.recording.recording import CameraStream, ReadingOptions, Recording, no_truth, tolerance_ns
from posetrack_cli.recording.timeline import Clock, Shifts, Timed

FROM_FILE, FROM_MESSAGES = "camera file", "messages"  # values of "calibration" in a run record
# Significant bits come from every third of the first 31 messages: exposure settles within a second.
BITS_OF_FIRST, BITS_EVERY = 31, 3


def open_depth_messages(path: Path, options: ReadingOptions) -> Recording:
    """Open the depth frames of one topic; calibration is from a camera file or another topic.

    Raises:
        RecordingError: no unique topic or calibration fits, or the calibration has another image size. A
            later image of another size or encoding raises it during reading.
        UsageError: an option is invalid, or a calibration topic is given together with a camera file.
    """
    topics = scan_topics(path)
    settings = _camera_file(options)
    stated_mm, missing = depth_storage(settings, options)
    topic = topics.depth_topic(options.get("topic"))
    source = _depth_topic(topics, topic, is_depth=stated_mm is not None)
    name, frame_id = source.topic.name, source.topic.frame_id
    wanted = options.get("camera_topic")
    nominal = nominal_hint(*source.size)
    known = topics.calibration_frames
    calibration = "" if settings else choose_calibration(name, frame_id, known, wanted, nominal)
    file = options.get("camera_file")
    if settings is None or file is None:
        found = camera_of_topic(topics, source, calibration)
    else:
        found = image_camera(settings, file, source.size, source.name)
    window = used_window(settings.crop if settings else None, settings, options)
    sensor_mm = depth_unit_mm(topics, topic) if stated_mm is None else None
    decision = (
        decide_unit(_early_content(topics, source, found.camera, missing), stated_mm)
        if sensor_mm is None
        else UnitDecision(sensor_mm)
    )
    source = replace(source, pixels=_with_unit(source, decision.unit_mm, missing))

    def identity() -> Mapping[str, str]:
        is_usual = sensor_mm is not None or decision.unit_mm == _usual_unit_mm(source)
        return {
            **_identity(path),
            "topic": source.topic.name,
            "camera_topic": calibration,
            "frames": str(source.topic.count),
            **({} if is_usual else {"depth_unit_mm": str(decision.unit_mm)}),
            **({"missing": str(missing)} if missing else {}),
            "mirror": str(window.mirror).lower(),
            **camera_record(options.get("camera_file")),
        }

    return Recording(
        path,
        [_TopicImages(path, source, window, calibration, found.frame).stream(found.camera)],
        identity=identity,
        frame_count=source.topic.count,
        truth=_truth(topics, mirror=window.mirror),
        why=[found.why],
        remarks=(
            *_choice_remark("depth", source, topics.depth_topics, "--topic"),
            *_disparity_remark(source),
            *found.remarks,
            *decision.remarks,
        ),
    )


def open_grey_messages(path: Path, options: ReadingOptions) -> Recording:
    """Open the grey images of one or more cameras.

    Each camera reads the file in its own pass, so memory stays bounded if one camera ends early.

    Raises:
        RecordingError: no topic or calibration fits, or the extrinsics are unknown. A later image of
            another size raises it during reading.
    """
    topics, tolerance = scan_topics(path), tolerance_ns(options)
    rig, sources, found, calibration, remarks = _grey_cameras(topics, options)
    bits = {name: camera.bits for name, camera in rig.cameras.items()} if rig is not None else {}
    sources = [_with_bits(topics, source, bits.get(source.name)) for source in sources]
    if options.get("in_colour"):
        sources = [replace(source, pixels=replace(source.pixels, keeps_colour=True)) for source in sources]
    windows = [used_window(rig.cameras[s.name].crop if rig else None, rig, options) for s in sources]
    shifts = Shifts()
    streams = [
        _TopicImages(path, source, window, each.calibration, each.frame, shifts).stream(each.camera)
        for source, window, each in zip(sources, windows, found, strict=True)
    ]
    counts = {source.topic.count for source in sources}
    count = counts.pop() if len(counts) == 1 else None  # different counts mean dropped images

    def identity() -> Mapping[str, str]:
        return {
            **_identity(path),
            "frames": "" if count is None else str(count),
            "cameras": ",".join(stream.camera.name for stream in streams),
            "topics": ",".join(source.topic.name for source in sources),
            "calibration": calibration,
            "stored": ", ".join(dict.fromkeys(source.pixels.words for source in sources)),
            "mirror": str(windows[0].mirror).lower(),
            "tolerance_ms": f"{tolerance / NS_PER_MS:g}",
            **camera_record(options.get("camera_file")),
        }

    return Recording(
        path,
        streams,
        identity=identity,
        frame_count=count,
        truth=_truth(topics, mirror=windows[0].mirror),
        tolerance_ns=tolerance,
        is_guessed=calibration == GUESSED,
        why=[each.why for each in found],
        remarks=remarks + tuple(dict.fromkeys(remark for each in found for remark in each.remarks)),
    )


def _identity(path: Path) -> dict[str, str]:
    """Return the identity of a file of messages, or of all files of a folder of them."""
    kind = required_container(path).kind
    parts = [(part.name, part) for part in parts_of(path)] if path.is_dir() else []
    return identity_record(path, kind, files_digest(parts) if parts else file_digest(path))


def _depth_topic(topics: FileTopics, topic: Topic, *, is_depth: bool) -> CameraTopic[Depth]:
    """Return the depth (or disparity) camera of a topic, named by its frame id.

    Args:
        topics: topics of the file.
        topic: topic of the images.
        is_depth: True if the user states that they are depth, whatever the topic's name.
    """
    image = topic.image
    if image is None or image.depth is None:
        raise TypeError(f"{topic.name} holds no depth")
    is_disparity = topic.other_content == DISPARITY and topic.kind != DISPARITY_IMAGE and not is_depth
    pixels = Depth(
        image.width,
        image.height,
        image.depth,
        stored=image.encoding,
        disparity_px_m=disparity_px_m(topics, topic) if is_disparity else None,
    )
    return CameraTopic(topic, topic.frame_id or "camera", pixels)


def _usual_unit_mm(source: CameraTopic[Depth]) -> float:
    """Return millimetres per stored unit by ROS convention."""
    return MM_PER_M if source.pixels.encoding == "32FC1" else 1.0


def _with_unit(source: CameraTopic[Depth], unit_mm: float, missing: int) -> Depth:
    is_whole = unit_mm == 1.0 and source.pixels.encoding == "16UC1"
    encoding: DepthEncoding = "16UC1" if is_whole else "32FC1"
    return replace(source.pixels, encoding=encoding, unit_mm=unit_mm, missing=missing)


def _early_content(
    topics: FileTopics, source: CameraTopic[Depth], camera: Camera, missing: int
) -> DepthContent:
    """Return statistics of early images, skipping those that cannot be decoded."""
    decoder, decoded = MessageDecoder(), []
    for item in early(topics.file.messages([source.topic.name])):
        with suppress(UndecodableMessageError, UnreadableImageError, RecordingError):
            message, kind = decoder.decode(*item), str(source.topic.kind)
            decoded.append(stored_depth(message, kind, source.topic.name, source.pixels.disparity_px_m))
    return content_of(decoded, camera, missing)


def _disparity_remark(source: CameraTopic[Depth]) -> tuple[str, ...]:
    if source.topic.kind != DISPARITY_IMAGE and source.pixels.disparity_px_m is None:
        return ()
    return (f"{source.topic.name} holds disparity d: depth is computed as z = f B / d",)


def _camera_file(options: ReadingOptions) -> DepthCamera | None:
    path = options.get("camera_file")
    return None if path is None else load_depth_camera(path)


def _grey_cameras(
    topics: FileTopics, options: ReadingOptions
) -> tuple[Rig | None, list[GreyTopic], Sequence[ImageCamera], str, tuple[str, ...]]:
    """Return rig (None without camera file), topics, cameras, their source, and remarks."""
    file, wanted, guess = options.get("camera_file"), options.get("cameras"), options.get("guess")
    if file is None:
        every = distinct_names(find_sources(topics, wanted))
        sources = _only_colour(every) if guess is not None else every
        words = _choice_remark("colour", sources[0], [source.topic for source in every], "--cameras")
        said = words if len(sources) == 1 else ()
        if guess is not None:
            require_single_camera(topics.path, [source.name for source in sources])
        found = _recorded_cameras(topics, sources, in_order=wanted is None)
        return None, *(found or (sources, *_cameras(topics, sources, guess))), said
    rig = load_rig(file)
    rig = rig if wanted is None else rig.subset(wanted)
    sources = sources_of_rig(topics, rig)
    sizes = {source.name: source.size for source in sources}
    cameras = [ImageCamera(camera, file.name) for camera in rig.stored_cameras(sizes)]
    if guess is not None:
        require_single_camera(topics.path, rig.cameras)
    return rig, sources, cameras, FROM_FILE, rig.remarks(sizes)


def _cameras(
    topics: FileTopics, sources: Sequence[GreyTopic], guess: Guess | None
) -> tuple[list[ImageCamera], str]:
    """Return the cameras of stored images, and where they are from."""
    try:
        return cameras_of_messages(topics, sources), FROM_MESSAGES
    except NotCalibratedError:
        if guess is None:
            raise
    guessed = [guess.stored_camera(*source.size, source.name) for source in sources]
    return [ImageCamera(camera, GUESSED) for camera in guessed], GUESSED


def _recorded_cameras(
    topics: FileTopics, sources: list[GreyTopic], *, in_order: bool
) -> tuple[list[GreyTopic], list[ImageCamera], str] | None:
    """Return topics and cameras as a conversion recorded them, without rounding; None if it did not.

    Args:
        topics: topics of the file.
        sources: topics of the images.
        in_order: sort them as recorded, the reference first.

    Raises:
        RecordingError: the record is invalid.
    """
    extras = topics.file.extras() if isinstance(topics.file, McapFile) else iter(())
    records = [r.metadata for r in extras if isinstance(r, Metadata) and r.name == CAMERAS_RECORD]
    try:
        cameras = {camera.name: camera for record in records for camera in cameras_from_record(record)}
    except ResultError as error:
        raise RecordingError(str(error), where=topics.path) from error
    if not all(s.name in cameras and _size_of(cameras[s.name]) == s.size for s in sources):
        return None
    if in_order:
        sources = sorted(sources, key=lambda source: list(cameras).index(source.name))
    first = cameras[sources[0].name]
    placed = relative_to(first, [cameras[source.name] for source in sources])
    return sources, [ImageCamera(camera, f"metadata {CAMERAS_RECORD}") for camera in placed], FROM_MESSAGES


def _size_of(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height


def _only_colour(sources: list[GreyTopic]) -> list[GreyTopic]:
    """Return the only colour topic if there is one: depth cameras also publish infrared images."""
    colour = [source for source in sources if source.pixels.colour]
    return colour if len(colour) == 1 else sources


def _with_bits(topics: FileTopics, source: GreyTopic, bits: int | None) -> GreyTopic:
    """Return the source with the given significant bits, or those of several early images."""
    if source.pixels.bits == PLAIN_BITS:
        return source
    if bits is not None:
        return replace(source, pixels=replace(source.pixels, bits=bits))
    decoder, images = MessageDecoder(), []
    every = islice(topics.file.messages([source.topic.name]), 0, BITS_OF_FIRST, BITS_EVERY)
    for item in every:
        with suppress(UndecodableMessageError, UnreadableImageError):
            images.append(stored_grey(decoder.decode(*item), str(source.topic.kind)))
    return replace(source, pixels=with_bits_of(source.pixels, images))


def _choice_remark(
    what: str, source: CameraTopic[Pixels], several: Sequence[Topic], option: str
) -> tuple[str, ...]:
    """Return a remark if other topics could have been chosen."""
    others = ", ".join(topic.name for topic in several if topic.name != source.topic.name)
    return (
        (f"{what} read from {source.topic.name}; choose another with {option}: {others}",) if others else ()
    )


@dataclass(frozen=True, eq=False)
class _TopicImages:
    """The images of one topic.

    Attributes:
        path: the file.
        source: the topic.
        window: used part of the images.
        calibration: topic of a calibration applied frame by frame; empty for none.
        frame: frame id of this camera's calibration messages.
        shifts: clock shifts shared by the cameras of the recording.
    """

    path: Path
    source: CameraTopic[Pixels]
    window: Window
    calibration: str = ""
    frame: str = ""
    shifts: Shifts = field(default_factory=Shifts)

    def stream(self, stored: Camera) -> CameraStream:
        """Return the stream, given the camera of the stored images."""
        return CameraStream(self.window.camera(stored), self.source.pixels, partial(self._images, stored))

    def _images(self, stored: Camera, losses: LossLog) -> Iterator[StoredImage | None]:
        is_alone = self.source.pixels.is_numbered_as_stored
        file = message_file(self.path, losses if is_alone else None)
        clock = Clock[StoredImage | None](self.source.topic.name, losses, self.shifts)
        try:
            for image, stamp in clock.stamped(self._timed(stored, file, losses)):
                yield None if image is None else replace(image, stamp_ns=stamp)
        finally:
            if not is_alone:
                losses.include(file.losses.losses)  # each camera's pass sees the same damage: count it once

    def _timed(
        self, stored: Camera, file: MessageFile, losses: LossLog
    ) -> Iterator[Timed[StoredImage | None]]:
        """Yield the images with their times; None for an unusable image that keeps its index."""
        current = CurrentCamera(stored, self._camera_by)
        for number, (image, calibration) in enumerate(self._pictures(file)):
            at = f"at {image.log_time} ns"
            where = f"frame {number} {at}" if self.source.pixels.is_numbered_as_stored else at
            usable: StoredImage | None = None
            try:
                fault = self._fault(image)
                resampling = None if fault else current.resampling(calibration)
            except PosetrackError as error:
                fault = f"image skipped, {error}"
            if fault:
                losses.add(fault, where)
            else:
                usable = self._image(image, resampling)
            if usable is not None and resampling is not None:
                losses.note(f"{self.calibration} changes: images are resampled to the first calibration")
            yield Timed(usable, image.own_ns if usable is not None else -1, image.log_time)

    def _pictures(self, file: MessageFile) -> Iterator[tuple[_Decoded, Any]]:
        """Yield images with their calibrations; video is decoded in order."""
        pairs = pair_with_calibration(self._messages(file))
        if self.source.topic.kind != VIDEO_IMAGE:
            yield from pairs
            return
        own = (((image, other), None if self._fault(image) else image.decoded) for image, other in pairs)
        for (image, calibration), picture in decoded_video(own):
            if not self._fault(image):
                lacking = UndecodableMessageError("video picture cannot be decoded")
                decoded = lacking if picture is None else picture
                image = image._replace(decoded=decoded, video=image.decoded)
            yield image, calibration

    def _fault(self, image: _Decoded) -> str:
        """Return why an image is unusable; empty if it is usable."""
        if isinstance(image.decoded, np.ndarray):
            return ""
        if isinstance(image.decoded, UndecodableMessageError):
            return f"message skipped, {image.decoded}"
        frame, own = frame_id_of(image.decoded), self.source.topic.frame_id
        if frame and own and not is_same_frame(frame, own):
            other = f"topic also carries images of frame '{frame}'"
            return f"image skipped, {other}"
        return ""

    def _messages(self, file: MessageFile) -> Iterator[tuple[bool, int, Any]]:
        """Yield images and decodable calibrations in the form that ``pair_with_calibration`` takes."""
        decoder, topic = MessageDecoder(), self.source.topic
        names = [topic.name, self.calibration] if self.calibration else [topic.name]
        for item in file.messages(names):
            is_image = item[1].topic == topic.name
            try:
                decoded: Any = decoder.decode(*item, topic.kind if is_image else CALIBRATION)
                own = own_stamp_of(decoded)
            except UndecodableMessageError as error:
                if not is_image:
                    continue
                decoded, own = error, -1
            if not is_image and not is_same_frame(frame_id_of(decoded), self.frame):
                continue
            stamp = own if own > 0 else item[2].log_time
            yield not is_image, stamp, _Decoded(decoded, own, item[2].log_time) if is_image else decoded

    def _camera_by(self, calibration: Any) -> Camera:
        return camera_by(calibration, self.path, self.source, self.calibration).camera

    def _image(self, image: _Decoded, resampling: Resampling | None) -> StoredImage:
        pixels, kind = self.source.pixels, str(self.source.topic.kind)
        stamp = image.own_ns or image.log_time
        where = f"{self.source.topic.name} at {stamp} ns"

        def decode() -> ImageArray:
            if isinstance(image.decoded, np.ndarray):
                values = pixels.from_stored(image.decoded)
            else:
                values = pixels.from_message(image.decoded, kind, f"{self.path}, {where}")
            return self.window.apply(values if resampling is None else resampling.apply(values))

        encoded: Callable[[], Encoded | None] = not_encoded
        if self.window.keeps_pixels and resampling is None:
            own = partial(pixels.encoded_message, image.decoded, kind)
            encoded = own if image.video is None else partial(encoded_video, image.video)
        return StoredImage(stamp, where, decode, encoded)


class _Decoded(NamedTuple):
    """A decoded message or video picture, or the decoding error; its times; and a picture's message."""

    decoded: Any
    own_ns: int
    log_time: int
    video: Any = None


def _truth(topics: FileTopics, *, mirror: bool) -> Callable[[], Iterator[TruthMessage]]:
    """Return the iterator over truth messages; empty if mirrored, which truth does not describe."""
    names = [name for name in topics.by_name if name.startswith(TRUTH_PREFIX)]
    if mirror or not names:
        return no_truth
    return lambda: (truth_message(item) for item in topics.file.messages(names))
