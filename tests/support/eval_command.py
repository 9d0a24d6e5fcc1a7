"""Results of made-up hands, small and quickly written; as a program, a run that kills itself midway."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.model.anatomy import ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS
from posetrack_cli.outputs import part_path
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import (
    ESTIMATE_SCHEMA_NAME,
    Estimate,
    ResultWriter,
    Status,
    Subject,
    estimate_to_json,
)
from support.tracks import hand_track

CAMERA = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
SUBJECT = Subject("hand", "camera", ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
CONFIGURATION = '{"filter": {"kind": "rbpf", "particles": 64}, "hand": {"side": "right"}}'


def estimate(track: Track, row: int, status: Status = Status.TRACKING, confidence: float = 0.8) -> Estimate:
    return Estimate(
        frame_index=row,
        stamp_ns=int(track.stamp_ns[row]),
        status=status,
        confidence=confidence,
        position=track.position[row],
        quaternion=track.quaternion[row],
        shape=track.shape[row],
        pose_rate=np.zeros(7 + len(ANGLE_NAMES)),
        twist=track.twist[row],
        pose_variance=track.pose_variance[row],
        twist_variance=track.twist_variance[row],
        points=track.points[row],
        effective_sample_size=20.0,
        resampled=True,
        cost=5.0,
    )


def truth_message(topic: str, true: Estimate) -> TruthMessage:
    data = estimate_to_json(true)
    return TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json", true.stamp_ns, data)


def begin(path: Path, recording: str = "aa", seed: int = 0) -> ResultWriter:
    run = {"tracker": "hand", "seed": str(seed), "configuration": CONFIGURATION, "renderer": "none"}
    return ResultWriter(path, SUBJECT, CAMERA, {**run, "input.sha256": recording}, flush_frames=10)


def write_frames(
    writer: ResultWriter,
    frames: int,
    error_mm: float = 5.0,
    *,
    truth: bool = True,
    lost: Collection[int] = (),
    seed: int = 1,
    knows: bool = False,
) -> None:
    """Write estimates and their truth; one that ``knows`` states how probably its position is right."""
    track, true = hand_track("made up", frames, error_mm, seed), hand_track("truth", frames, 0.0)
    for row in range(frames):
        if truth:
            writer.add_truth(truth_message("/truth/hand/estimate", estimate(true, row)))
        status = Status.LOST if row in lost else Status.TRACKING
        away = float(np.linalg.norm(track.position[row] - true.position[row]))
        confidence = 1.0 / (1.0 + (away / 20.0) ** 4) if knows else 0.8
        writer.write(estimate(track, row, status, confidence))


def write_result(path: Path, frames: int = 90, error_mm: float = 5.0, recording: str = "aa", **more) -> Path:
    """A finished result whose wrist is off by noise of ``error_mm`` in each direction."""
    smoothed_mm = more.pop("smoothed_mm", None)
    with begin(path, recording, more.get("seed", 0)) as writer:
        write_frames(writer, frames, error_mm, **more)
        if smoothed_mm is not None:
            write_smoothed_frames(writer, frames, smoothed_mm)
        writer.finish({})
    return path


def write_smoothed_frames(writer: ResultWriter, frames: int, error_mm: float) -> None:
    """As a backward pass does it: the last frame first."""
    track = hand_track("smoothed", frames, error_mm, seed=3)
    for row in reversed(range(frames)):
        writer.write_smoothed(estimate(track, row))


def killed_run(path: Path, frames: int) -> Path:
    """What a killed run left of a result: of its frames the flushed tens."""
    done = subprocess.run(
        [sys.executable, "-m", "support.eval_command", str(path), str(frames)],
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[1],
    )
    assert done.returncode == -9, done.stderr
    return part_path(path)


def damaged(path: Path) -> Path:
    """A result of nine chunks with one byte of the fifth changed."""
    whole = bytearray(write_result(path).read_bytes())
    place, chunks = 8, []
    while place < len(whole):
        length = int.from_bytes(whole[place + 1 : place + 9], "little")
        if whole[place] == Opcode.CHUNK:
            chunks.append(place + 9 + length // 2)
        if whole[place] == Opcode.FOOTER:
            break
        place += 9 + length
    whole[chunks[4]] ^= 0xFF
    path.write_bytes(whole)
    return path


if __name__ == "__main__":
    target = begin(Path(sys.argv[1]))
    write_frames(target, int(sys.argv[2]))
    if sys.argv[3:] == ["wait"]:
        print("written", flush=True)
        sys.stdin.read()
    os.kill(os.getpid(), signal.SIGKILL)
