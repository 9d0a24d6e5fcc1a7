"""Recordings as long as one likes: a few synthetic frames to and fro, so that motion stays continuous."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import CAMERA_FILE_NAME
from posetrack_cli.recording.image_files import GREY_SUFFIXES, list_images
from posetrack_cli.recording.message_cameras import calibration_message
from posetrack_cli.synthesis.hand.frames import CAMERA
from stepping import FRAME_NS


def there_and_back(count: int, length: int) -> Iterator[int]:
    """Indices 0, 1, ..., count - 1, count - 2, ..., 1, 0, 1, ... of a length."""
    period = [*range(count), *range(count - 2, 0, -1)]
    return (period[index % len(period)] for index in range(length))


def write_hand_recording(path: Path, depths: Sequence[Any], frames: int) -> None:
    """An MCAP file of these depth images, mm, as PNG."""
    import cv2
    from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    coded = [cv2.imencode(".png", depth.astype(np.uint16))[1].tobytes() for depth in depths]
    with McapSink(path, compression="none") as sink:
        calibration = sink.channel("/camera/depth/calibration", CameraCalibration)
        images = sink.channel("/camera/depth/image", CompressedImage)
        message = calibration_message(CAMERA, 0, "camera")
        sink.write(calibration, 0, message.SerializeToString(deterministic=True))
        for index, shown in enumerate(there_and_back(len(coded), frames)):
            image = CompressedImage(data=coded[shown], format="png", frame_id="camera")
            image.timestamp.FromNanoseconds((index + 1) * FRAME_NS)
            sink.write(images, (index + 1) * FRAME_NS, image.SerializeToString(deterministic=True))
            if index % 50 == 49:
                sink.flush()
        sink.finish()


def link_recording(path: Path, folder: Path, frames: int) -> None:
    """A folder whose images are those of another one; it has no stamps but needs ``--fps``.

    Args:
        path: the folder to make.
        folder: of images, or of a folder of images per camera, with a camera file.
        frames: how many.
    """
    path.mkdir()
    shutil.copy(folder / CAMERA_FILE_NAME, path)
    for camera in sorted(child for child in folder.iterdir() if child.is_dir()) or [folder]:
        images = list_images(camera, GREY_SUFFIXES)
        into = path / camera.relative_to(folder)
        into.mkdir(exist_ok=True)
        for index, shown in enumerate(there_and_back(len(images), frames)):
            (into / f"{index:06d}{images[shown].suffix}").symlink_to(images[shown].path.resolve())
