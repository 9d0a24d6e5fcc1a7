"""Writing of synthetic head recordings with ground truth, as MCAP file or folder of images."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.mcap.sink import McapSink, serialised
from posetrack_cli.outputs import check_output, check_place, is_taken, part_path
from posetrack_cli.recording.base import CAMERA_FILE_NAME, TRUTH_FILE_NAME
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.message_cameras import calibration_message, camera_transforms
from posetrack_cli.recording.stamps import STAMPS_FILE_NAME
from posetrack_cli.synthesis.head.frames import NAMES, Plan, SyntheticHeadFrame, make_plan, render_plan
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.person import deforming_interval
from posetrack_cli.synthesis.recording import (
    Synthesis,
    TruthChannels,
    check_option,
    numbers_text,
    recording_file,
    reported,
    synth_record,
    write_all,
)

FORMATS = ("jpeg", "png", "raw")
SUFFIXES = {"jpeg": ".jpg", "png": ".png"}
JPEG_QUALITY = 95
PNG_LEVEL = 1
"""Noise hardly compresses: level 9 is ten times slower for a few per cent."""
TRANSFORMS_TOPIC = "/tf"
OWN_NAMES = {CAMERA_FILE_NAME, STAMPS_FILE_NAME, TRUTH_FILE_NAME, *NAMES, "camera"}

Report = Callable[[SyntheticHeadFrame], None]


def write_synthetic(
    options: HeadSynthOptions,
    out: Path,
    *,
    image_format: str = "jpeg",
    overwrite: bool = False,
    report: Report = lambda frame: None,
) -> Synthesis:
    """Write a synthetic recording; equal options give equal bytes on the same machine.

    If ``out`` ends in ``.mcap``, it is a file with images of camera NAME on ``/NAME/image``
    (foxglove.CompressedImage or RawImage), intrinsics on ``/NAME/calibration``, the other cameras' poses on
    ``/tf``, ground truth on ``/truth/head/...``, and the options in the metadata ``posetrack.synth``.
    Otherwise it is a folder with a subfolder of images per camera, ``camera.toml``, ``timestamps.csv`` and
    ``truth.mcap``.

    Args:
        options: options of the recording.
        out: output file or folder.
        image_format: ``jpeg``, ``png`` or, in a file, ``raw``.
        overwrite: whether ``out`` may be replaced.
        report: called with every written frame.

    Raises:
        UsageError: ``out`` exists and may not be replaced, or the format is not supported.
        ResultError: it cannot be written.
        RenderingError: no working GL.
    """
    is_file = out.suffix == ".mcap"
    formats = FORMATS if is_file else tuple(SUFFIXES)
    check_option("image-format", image_format, image_format in formats, " or ".join(formats))
    check = check_output if is_file else check_folder_output
    check(out, overwrite=overwrite)
    plan = make_plan(options)
    record, frames = synth_record(options, _facts(plan)), reported(render_plan(plan), report)
    if is_file:
        with recording_file(out) as sink:
            write_all(sink, record, frames, lambda sink: _Channels(sink, plan, image_format))
    else:
        with _whole_folder(out) as folder:
            _write_cameras(folder, plan, SUFFIXES[image_format])
            with McapSink(folder / TRUTH_FILE_NAME) as sink:
                write_all(sink, record, frames, lambda sink: _Folder(sink, plan, folder, image_format))
    return Synthesis(options.frames, int(plan.timeline.dropped.sum()), options.duration_s)


def _facts(plan: Plan) -> dict[str, str]:
    """Return further metadata entries: the person, and the times of events."""
    times = {
        "deforming_s": deforming_interval(plan.options),
        "turn_s": plan.movement.turn_interval,
        "occlusion_s": plan.occluder.interval if plan.occluder else None,
    }
    return {
        "neutral_shape_mm": numbers_text(plan.person.points),
        **{name: "" if interval is None else numbers_text(interval) for name, interval in times.items()},
        **{f"looks.{name}": str(value) for name, value in asdict(plan.identity.looks).items()},
    }


class _Channels:
    """Writer of images, calibration and truth to topics."""

    def __init__(self, sink: McapSink, plan: Plan, image_format: str) -> None:
        self._sink, self._plan, self._format = sink, plan, image_format
        self._calibrate(int(plan.timeline.stamps_ns[0]))
        kind = RawImage if image_format == "raw" else CompressedImage
        self._images = [sink.channel(f"/{camera.name}/image", kind) for camera in plan.cameras]
        self._truth = TruthChannels(sink, plan.subject, "expression")

    def write(self, frame: SyntheticHeadFrame) -> None:
        """Write one frame and its ground truth."""
        for channel, camera, image in zip(self._images, self._plan.cameras, frame.images, strict=True):
            if image is not None:
                message = image_message(image, self._format, camera.name, frame.stamp_ns)
                self._sink.write(channel, frame.stamp_ns, serialised(message))
        self._truth.write(frame)

    def _calibrate(self, stamp_ns: int) -> None:
        cameras = self._plan.cameras
        static = {f"/{c.name}/calibration": calibration_message(c, stamp_ns, c.name) for c in cameras}
        if len(cameras) > 1:
            static[TRANSFORMS_TOPIC] = camera_transforms(cameras, cameras[0].name, stamp_ns)
        for topic, message in static.items():
            self._sink.write(self._sink.channel(topic, type(message)), stamp_ns, serialised(message))


def image_message(image: ImageArray, image_format: str, frame_id: str, stamp_ns: int) -> Any:
    """Return an image as a foxglove message, mono8 or compressed."""
    if image_format == "raw":
        height, width = image.shape
        content = {"width": width, "height": height, "encoding": "mono8", "step": width}
        message = RawImage(frame_id=frame_id, data=image.tobytes(), **content)
    else:
        data = encoded(image, image_format)
        message = CompressedImage(frame_id=frame_id, format=image_format, data=data)
    message.timestamp.FromNanoseconds(stamp_ns)
    return message


def encoded(image: ImageArray, image_format: str) -> bytes:
    """Return an image (height, width) uint8 as JPEG or PNG."""
    options = {
        "jpeg": [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY],
        "png": [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL],
    }
    _, data = cv2.imencode(SUFFIXES[image_format], image, options[image_format])
    return data.tobytes()


# Folders, laid out like those of camera software


class _Folder:
    """Writer of images to the cameras' folders and of truth to topics."""

    def __init__(self, sink: McapSink, plan: Plan, folder: Path, image_format: str) -> None:
        self._places = [folder / camera.name for camera in plan.cameras]
        self._format = image_format
        self._truth = TruthChannels(sink, plan.subject, "expression")

    def write(self, frame: SyntheticHeadFrame) -> None:
        """Write one frame and its ground truth."""
        for place, image in zip(self._places, frame.images, strict=True):
            if image is not None:
                path = place / f"{frame.index:06d}{SUFFIXES[self._format]}"
                path.write_bytes(encoded(image, self._format))
        self._truth.write(frame)


def check_folder_output(out: Path, *, overwrite: bool) -> None:
    """Check that a folder can be written and replaces nothing it must not.

    Raises:
        UsageError: the path exists: without ``overwrite`` in any case, with it if it is not a synthetic
            recording.
        ResultError: the parent folder does not exist.
    """
    if out.suffix:
        raise UsageError("invalid output", where=out, expected="NAME.mcap, or a folder name without suffix")
    check_place(out)
    if not is_taken(out):
        return
    if not overwrite:
        raise UsageError("already exists", where=out, hint="use --overwrite to replace it")
    if not _is_synthetic(out):
        raise UsageError("not created by posetrack synth; refusing to overwrite", where=out)


@contextmanager
def _whole_folder(out: Path) -> Iterator[Path]:
    """Yield the new folder NAME.part; rename it to ``out`` on success, delete it on failure.

    Raises:
        ResultError: it cannot be written.
    """
    part = part_path(out)
    try:
        if part.exists():
            shutil.rmtree(part)
        part.mkdir()
        yield part
        if out.exists():
            shutil.rmtree(out)
        part.replace(out)
    except OSError as error:
        raise ResultError("cannot be written", where=out, found=error.strerror or error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write_cameras(folder: Path, plan: Plan, suffix: str) -> None:
    """Write the stamps of all frames with any image, the camera file, and a folder per camera."""
    taken = np.flatnonzero((~plan.timeline.dropped).any(axis=0)).tolist()
    rows = [f"{index:06d}{suffix},{int(plan.timeline.stamps_ns[index])}\n" for index in taken]
    (folder / STAMPS_FILE_NAME).write_text("".join(["filename,stamp_ns\n", *rows]), encoding="utf-8")
    comments = ["Cameras of a synthetic recording; the truth is in truth.mcap."]
    (folder / CAMERA_FILE_NAME).write_text(camera_file_text(plan.cameras, comments), encoding="utf-8")
    for camera in plan.cameras:
        (folder / camera.name).mkdir()


def _is_synthetic(out: Path) -> bool:
    """Return whether a folder has only files written here."""
    if out.is_symlink() or not out.is_dir():
        return False
    names = {entry.name for entry in out.iterdir()}
    return not names or (TRUTH_FILE_NAME in names and names <= OWN_NAMES)
