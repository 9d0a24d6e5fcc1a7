"""Open or describe a recording: the registry of all supported kinds of files and folders."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Unpack

from posetrack_cli.bags.message_file import container_of
from posetrack_cli.errors import PosetrackError, RecordingError, UsageError, damage_reported
from posetrack_cli.files import hint_of_missing
from posetrack_cli.recording.base import NotCalibratedError
from posetrack_cli.recording.camera_file import camera_path
from posetrack_cli.recording.camera_of import Guess
from posetrack_cli.recording.datasets.biwi import describe_biwi, is_biwi, open_biwi_colour, open_biwi_depth
from posetrack_cli.recording.datasets.nyu import describe_nyu, is_nyu, open_nyu_depth
from posetrack_cli.recording.datasets.record3d import (
    describe_record3d,
    is_record3d,
    open_record3d_colour,
    open_record3d_depth,
)
from posetrack_cli.recording.datasets.stray_scanner import (
    describe_stray,
    is_stray_scanner,
    open_stray_depth,
    open_stray_video,
)
from posetrack_cli.recording.describing import describe_folder, describe_messages
from posetrack_cli.recording.folder import open_depth_folder, open_grey_folder
from posetrack_cli.recording.kinect import describe_kinect, open_kinect
from posetrack_cli.recording.message_source import open_depth_messages, open_grey_messages
from posetrack_cli.recording.pixels import PixelKind
from posetrack_cli.recording.recording import ReadingOptions, Recording
from posetrack_cli.recording.video import open_video

MANY_RECORDINGS = "for several recordings use posetrack batch with a pattern"
ANY = frozenset({"camera_file", "mirror"})  # options of every source
UNIT = frozenset({"depth_unit_mm", "missing"})  # options of every depth source
CAMERAS = ANY | {"cameras", "guess", "in_colour"}  # options of every grey source


@dataclass(frozen=True)
class Opener:
    """How a source is opened for one kind of pixels.

    Attributes:
        open: returns the recording, given its path and options.
        options: names of the options that apply.
        excluded: options mapped to the ones they exclude.
    """

    open: Callable[[Path, ReadingOptions], Recording]
    options: frozenset[str]
    excluded: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """A kind of file or folder that holds recordings.

    Attributes:
        words: its name in messages.
        holds: returns True if an existing path is of this kind, unless an earlier source matches.
        openers: openers by kind of pixels.
        describe: returns a description in plain values: name, kind, bytes, losses, and kind-specific keys.
    """

    words: str
    holds: Callable[[Path], bool]
    openers: Mapping[PixelKind, Opener]
    describe: Callable[[Path], dict[str, Any]]


def _holds_messages(path: Path, *, mcap: bool) -> bool:
    container = container_of(path)
    return container is not None and (container.kind == "mcap") == mcap


# Openers of messages, for every container.
MESSAGES: Mapping[PixelKind, Opener] = {
    "depth": Opener(
        open_depth_messages, ANY | {"topic", "camera_topic"} | UNIT, {"camera_file": "camera_topic"}
    ),
    "grey": Opener(open_grey_messages, CAMERAS | {"tolerance_ms"}),
}

# Ordered: the first source that holds a path is used.
SOURCES = (
    Source("an MCAP file", partial(_holds_messages, mcap=True), MESSAGES, describe_messages),
    Source("a ROS bag", partial(_holds_messages, mcap=False), MESSAGES, describe_messages),
    Source(
        "a Stray Scanner recording",
        is_stray_scanner,
        {"depth": Opener(open_stray_depth, ANY | UNIT), "grey": Opener(open_stray_video, CAMERAS | {"fps"})},
        describe_stray,
    ),
    Source(
        "a Record3D recording",
        is_record3d,
        {"depth": Opener(open_record3d_depth, ANY | UNIT), "grey": Opener(open_record3d_colour, CAMERAS)},
        describe_record3d,
    ),
    Source(
        "a Biwi Kinect head pose sequence",
        is_biwi,
        {
            "depth": Opener(open_biwi_depth, ANY | UNIT | {"fps"}),
            "grey": Opener(open_biwi_colour, CAMERAS | {"fps"}),
        },
        describe_biwi,
    ),
    Source(
        "an NYU hand pose folder",
        is_nyu,
        {
            "depth": Opener(open_nyu_depth, ANY | UNIT | {"fps"}),
            "grey": Opener(open_grey_folder, CAMERAS | {"fps", "tolerance_ms"}),
        },
        describe_nyu,
    ),
    Source(
        "a folder of images",
        Path.is_dir,
        {
            "depth": Opener(open_depth_folder, ANY | UNIT | {"fps"}),
            "grey": Opener(open_grey_folder, CAMERAS | {"fps", "tolerance_ms"}),
        },
        describe_folder,
    ),
    Source(
        "a video",
        lambda path: True,  # any other file; opening it reports what is not a video
        {"grey": Opener(open_video, CAMERAS | {"fps"}), "depth": Opener(open_kinect, ANY | UNIT)},
        describe_kinect,
    ),
)


def open_recording(path: Path, pixels: PixelKind = "depth", **options: Unpack[ReadingOptions]) -> Recording:
    """Open a folder of images, a file or folder of messages, or a video.

    Depth has one camera. Grey recordings may have several: ``cameras`` lists the reference first,
    extrinsics are relative to it, and frames have None for a camera without an image at that instant.

    Args:
        path: folder or file.
        pixels: kind of pixels in the frames.
        options: reading options.

    Raises:
        RecordingError: the recording cannot be read, or its cameras are not calibrated.
        UsageError: an option does not apply to this kind of recording, or its value is invalid.
    """
    source = _source_of(path)
    opener = source.openers[pixels]
    _check_options(source.words, opener, options)
    file = options.get("camera_file")
    if file is not None:
        options["camera_file"] = camera_path(file)
    with damage_reported(lambda: path):
        return opener.open(path, options)


def open_any(path: Path, *, images: bool = False, **options: Unpack[ReadingOptions]) -> Recording:
    """Open the depth of a recording or, if it has none, its images; a single camera may be uncalibrated.

    Args:
        path: folder or file.
        images: open images even if there is depth.
        options: reading options; those of only one kind of pixels select it.

    Raises:
        RecordingError, UsageError: see ``open_recording``.
    """
    given = {name for name, value in options.items() if value is not None}
    kinds: tuple[PixelKind, ...] = ("grey",) if images else ("depth", "grey")
    usable = [kind for kind in kinds if given <= options_for(path, kind)]
    if usable != ["depth", "grey"]:
        return _open_of_kind(path, (usable or kinds)[0], options)
    try:
        return open_recording(path, "depth", **options)
    except NotCalibratedError:
        raise
    except RecordingError as no_depth:
        try:
            return _open_of_kind(path, "grey", options)
        except RecordingError as error:
            reason = str(no_depth).removeprefix(f"{path}: ")
            both = str(error) if reason in str(error) else f"{error}; as depth: {reason}"
            raise RecordingError(both) from error


def _open_of_kind(path: Path, pixels: PixelKind, options: ReadingOptions) -> Recording:
    try:
        return open_recording(path, pixels, **options)
    except RecordingError as error:
        if pixels == "depth":
            raise
        guessed: ReadingOptions = {**options, "guess": Guess()}
        try:
            return open_recording(path, pixels, **guessed)
        except PosetrackError as further:
            # A single camera needs no calibration: it is something else that is missing.
            is_single = isinstance(error, NotCalibratedError) and not isinstance(further, UsageError)
            raise (further if is_single else error) from None


def options_for(path: Path, pixels: PixelKind) -> frozenset[str]:
    """Return the names of the reading options that apply to a path."""
    return _source_of(path).openers[pixels].options


def describe(path: Path) -> dict[str, Any]:
    """Describe a recording or result (image folder, video, file of messages) in plain values.

    Reads every message of a file, but only the first image of a depth folder. Keys: ``name``, ``kind``
    (``folder`` of depth, ``images`` of one or more cameras, ``dataset`` of another tool, ``video``, or a
    container of messages: ``mcap``, ``bag``, ``db3``, ``ros2``), ``bytes``, ``losses`` (unreadable data)
    and kind-specific keys.

    Raises:
        RecordingError: the path holds nothing that can be described.
    """
    source = _source_of(path)
    with damage_reported(lambda: path):
        return source.describe(path)


def _source_of(path: Path) -> Source:
    if not path.exists():
        raise RecordingError(
            "no such file or folder", where=path, hint=hint_of_missing(path, MANY_RECORDINGS)
        )
    return next(source for source in SOURCES if source.holds(path))


def _check_options(words: str, opener: Opener, options: Mapping[str, object]) -> None:
    given = {name: value for name, value in options.items() if value is not None}
    for name, value in given.items():
        if name not in opener.options:
            raise _does_not_apply(name, words, value)
    for name, excluded in opener.excluded.items():
        if name in given and excluded in given:
            raise _does_not_apply(excluded, "a recording together with --camera", given[excluded])


def _does_not_apply(name: str, what: str, value: object) -> UsageError:
    return UsageError(f"--{name.replace('_', '-')} does not apply to {what}", found=f"'{value}'")
