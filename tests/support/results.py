"""A small subject with made-up motion; as a program, a writer that kills itself in the middle of a run."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from posetrack_cli.geometry.camera import Camera
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import Checkpoint, Estimate, ResultWriter, Status, Subject

K, P = 3, 4
CAMERA = Camera(
    width=512, height=424, fx=365.0, fy=366.0, cx=255.5, cy=211.5, distortion=(0.1, 0.0, 0.0, 0.0)
)
RUN = {"seed": "1", "configuration": '{"particles":512}', "version": "0.1.0"}
SUMMARY = {"skipped": "0"}
SUBJECT = Subject(
    name="hand",
    camera_frame="kinect",
    shape_names=("index_mcp_x", "index_mcp_z", "index_pip_x"),
    point_names=("wrist", "index_mcp", "index_pip", "thumb_cmc"),
    point_parents=(-1, 0, 1, 0),
    triangles=np.array([[0, 1, 2], [2, 1, 3]]),
)


def make_estimate(index: int, *, k: int = K, p: int = P) -> Estimate:
    """Return the estimate of one frame; it depends on the index only."""
    rng = np.random.default_rng(index)
    quaternion = rng.normal(size=4)
    quaternion *= np.sign(quaternion[3]) / np.linalg.norm(quaternion)
    return Estimate(
        frame_index=index,
        stamp_ns=1_500_000_000_000_000_000 + index * 33_333_333,
        status=Status.LOST if index % 7 == 3 else Status.TRACKING,
        confidence=float(rng.uniform()),
        position=rng.normal(size=3) * 100.0 + [0.0, 0.0, 800.0],
        quaternion=quaternion,
        shape=rng.normal(size=k),
        pose_rate=rng.normal(size=7 + k),
        twist=rng.normal(size=6 + k) * 50.0,
        pose_variance=rng.uniform(0.1, 9.0, size=6 + k),
        twist_variance=rng.uniform(0.1, 9.0, size=6 + k),
        points=rng.normal(size=(p, 3)) * 100.0,
        effective_sample_size=float(rng.uniform(1.0, 512.0)),
        resampled=bool(index % 2),
        cost=None if index % 5 == 0 else float(rng.uniform()),
    )


def make_vertices(index: int, count: int = 4) -> np.ndarray:
    return np.random.default_rng(index + 1000).normal(size=(count, 3)) * 100.0


def make_truth(index: int) -> TruthMessage:
    return TruthMessage(
        topic="/truth/hand/pose",
        schema_name="custom.Pose",
        schema_encoding="jsonschema",
        schema_data=b'{"type":"object"}',
        message_encoding="json",
        log_time_ns=1_500_000_000_000_000_000 + index,
        data=b'{"i":%d}' % index,
        channel_metadata={"unit": "mm"},
    )


def all_messages(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, log time and bytes of every message, in file order."""
    return [(c.topic, m.log_time, m.data) for _, c, m in McapFile(path).messages(in_file_order=True)]


def checkpoint_at(writer: ResultWriter, index: int) -> Checkpoint:
    arrays = {"particles": np.full((3, 2), float(index))}
    state = {"bit_generator": {"state": 2**127 + index}}
    return Checkpoint(index, writer.frames_written, arrays, state)


def write_frames(writer: ResultWriter, start: int, end: int) -> None:
    """Write the frames as a run does: truth, estimate, mesh, a checkpoint after each flush."""
    for index in range(start, end):
        if index % 2 == 0 and index // 2 >= writer.truth_messages:
            writer.add_truth(make_truth(index))
        if writer.write(make_estimate(index), make_vertices(index) if index % 3 else None):
            writer.save_checkpoint(checkpoint_at(writer, index))


def begin(path: Path, run: Mapping[str, str] = RUN, **options: object) -> ResultWriter:
    """Return a writer that has saved the checkpoint of no frame and attached its model."""
    writer = ResultWriter(path, SUBJECT, CAMERA, run, **options)
    writer.save_checkpoint(checkpoint_at(writer, -1))
    writer.attach("model.txt", "text/plain", b"a model")
    return writer


def write_result(path: Path, frames: int = 26, **options: object) -> Path:
    with begin(path, **options) as writer:
        write_frames(writer, 0, frames)
        writer.finish(SUMMARY)
    return path


def resume_result(path: Path, frames: int = 26, kind: type[ResultWriter] = ResultWriter) -> Checkpoint:
    """Finish an interrupted ``write_result`` and return the checkpoint it went on from."""
    writer, checkpoint = kind.resume(path, SUBJECT, CAMERA, RUN)
    with writer:
        writer.attach("model.txt", "text/plain", b"a model")
        write_frames(writer, checkpoint.frame_index + 1, frames)
        writer.finish(SUMMARY)
    return checkpoint


def with_fields(estimate: Estimate, **fields: object) -> Estimate:
    return replace(estimate, **fields)


if __name__ == "__main__":
    target = begin(Path(sys.argv[1]))
    write_frames(target, 0, int(sys.argv[2]))
    os.kill(os.getpid(), signal.SIGKILL)
