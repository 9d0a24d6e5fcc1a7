"""Recordings and results of any length, from a few synthetic frames or from synthetic motion."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarking.stepping import FRAME_NS
from posetrack_cli import results
from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, ANGLES, JOINT_NAMES, JOINT_PARENTS, make_anatomy
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import CAMERA_FILE_NAME, TruthMessage
from posetrack_cli.recording.image_files import GREY_SUFFIXES, list_images
from posetrack_cli.recording.message_cameras import calibration_message
from posetrack_cli.synthesis.hand.frames import CAMERA
from posetrack_cli.synthesis.hand.motion import natural_motion
from posetrack_cli.tracking.velocity import BodySpace, pose_rates


def there_and_back(count: int, length: int) -> Iterator[int]:
    """Yield ``length`` indices 0, 1, ..., count - 1, count - 2, ..., 0, 1, ...; keeps motion continuous."""
    period = [*range(count), *range(count - 2, 0, -1)]
    return (period[index % len(period)] for index in range(length))


def write_hand_recording(path: Path, depths: Sequence[Any], frames: int) -> None:
    """Write depth images (mm) as PNG to an MCAP file, repeated forwards and backwards."""
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
    """Link the images of a folder repeatedly into a longer one; it has no timestamps and needs ``--fps``.

    The source has images, or one image folder per camera, and a camera file.
    """
    path.mkdir()
    shutil.copy(folder / CAMERA_FILE_NAME, path)
    for camera in sorted(child for child in folder.iterdir() if child.is_dir()) or [folder]:
        images = list_images(camera, GREY_SUFFIXES)
        into = path / camera.relative_to(folder)
        into.mkdir(exist_ok=True)
        for index, shown in enumerate(there_and_back(len(images), frames)):
            (into / f"{index:06d}{images[shown].suffix}").symlink_to(images[shown].path.resolve())


# A result with ground truth: natural motion, and estimates with known noise

# Standard deviations of the errors, mm and rad; also stated as covariance
SD = np.r_[np.full(3, 5.0), np.full(3, 0.06), np.full(15, 0.12)]
SCRIPT_S = 300.0
LOST_EVERY, LOST_FOR = 1000, 10


def write_long_result(path: Path, frames: int) -> None:
    """Write a hand result; ten of every thousand frames are lost."""
    rng, seconds = np.random.default_rng(0), 1e-9 * FRAME_NS
    times: FloatArray = np.mod(seconds * np.arange(frames), SCRIPT_S, dtype=np.float64)
    script = natural_motion(min(SCRIPT_S, frames * seconds), 1.0, rng)
    anatomy, schema = make_anatomy(), json.dumps(results.ESTIMATE_SCHEMA).encode()
    run = {"tracker": "hand", "configuration": json.dumps(HandConfig().model_dump(mode="json"))}
    subject = results.Subject("hand", CAMERA.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
    with results.ResultWriter(path, subject, CAMERA, run) as writer:
        for block in np.array_split(np.arange(frames), max(1, frames // 1000)):
            true, twists = script.poses(times[block]), script.twists(times[block])
            poses = BodySpace().retract(true, SD * rng.standard_normal((len(block), len(SD))))
            poses[:, 3:7] = rotations.canonical(poses[:, 3:7])
            joints = joint_positions(anatomy, np.concatenate([poses, true])).reshape(2, len(block), -1, 3)
            for row, index in enumerate(block.tolist()):
                truth = results.estimate_to_json(_estimate(index, true[row], twists[row], joints[1, row]))
                how = ("/truth/hand/estimate", results.ESTIMATE_SCHEMA_NAME, "jsonschema", schema, "json")
                writer.add_truth(TruthMessage(*how, (index + 1) * FRAME_NS, truth))
                lost = index % LOST_EVERY < LOST_FOR
                writer.write(_estimate(index, poses[row], twists[row], joints[0, row], lost=lost))
        writer.finish({})


def _estimate(
    index: int, pose: FloatArray, twist: FloatArray, joints: FloatArray, *, lost: bool = False
) -> results.Estimate:
    return results.Estimate(
        frame_index=index,
        stamp_ns=(index + 1) * FRAME_NS,
        status=results.Status.LOST if lost else results.Status.TRACKING,
        confidence=0.2 if lost else 0.8,
        position=pose[:3],
        quaternion=pose[3:7],
        shape=pose[ANGLES],
        pose_rate=pose_rates(pose, twist),
        twist=twist,
        pose_variance=SD**2,
        twist_variance=SD**2,
        points=joints,
        effective_sample_size=100.0,
        resampled=True,
        cost=10.0,
        milliseconds=30.0,
    )
