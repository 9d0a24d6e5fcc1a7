"""Small recordings, and results of them whose estimates are the truth, moved as a test asks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli.evaluation.viewing.drawing import Shown
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import (
    ANGLE_NAMES,
    JOINT_NAMES,
    JOINT_PARENTS,
    HandAnatomy,
    make_anatomy,
)
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.run import RunOptions, run_record
from posetrack_cli.hand.start import rest_pose
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.results import Estimate, ResultWriter, Status, Subject, estimate_from_json
from posetrack_cli.synthesis.hand.frames import write_synthetic
from posetrack_cli.synthesis.hand.options import Switches, SynthOptions

KINECT = Camera(512, 424, 365.0, 365.0, 255.5, 211.5)
TRUTH_TOPIC = "/truth/hand/estimate"
Change = Callable[[Estimate], Estimate]


def make_recording(
    path: Path, frames: int = 6, *, side: str = "right", switches: Switches | None = None
) -> Path:
    """A recording of motion C with its truth; every instant has a frame."""
    on = replace(Switches.all_on(), drops=False, late=False) if switches is None else switches
    write_synthetic(SynthOptions(motion="C", frames=frames, seed=3, side=side, switches=on), path)
    return path


def truth_of(recording: Recording) -> list[Estimate]:
    """The true states of a recording's frames."""
    return [estimate_from_json(m.data) for m in recording.truth() if m.topic == TRUTH_TOPIC]


def make_result(
    path: Path,
    recording: Recording,
    change: Change = lambda estimate: estimate,
    *,
    side: str = "right",
    with_truth: bool = False,
    keep: Callable[[Estimate], bool] = lambda estimate: True,
    smoothed: Change | None = None,
) -> Path:
    """A result of a recording, with the run record that ``hand run`` writes."""
    camera = recording.cameras[0]
    config = HandConfig.model_validate({"hand": {"side": side}})
    record = run_record(recording, camera, config, RunOptions(path), "none")
    subject = Subject("hand", camera.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)
    with ResultWriter(path, subject, camera, record, overwrite=True) as writer:
        for message in recording.truth() if with_truth else ():
            writer.add_truth(message)
        for estimate in filter(keep, truth_of(recording)):
            writer.write(change(replace(estimate, confidence=0.75)))
        for estimate in filter(keep, truth_of(recording)) if smoothed else ():
            writer.write_smoothed((smoothed or change)(replace(estimate, confidence=0.75)))
        writer.finish({})
    return path


def moved(x: float, y: float = 0.0, z: float = 0.0) -> Change:
    """Every estimate moved, mm."""
    offset = np.array([x, y, z])
    return lambda e: replace(e, position=e.position + offset, points=e.points + offset)


def lost_from(index: int) -> Change:
    """Every estimate from a frame on is lost."""
    return lambda e: replace(e, status=Status.LOST) if e.frame_index >= index else e


def make_folder(path: Path, recording: Recording, *, camera: bool = True, mirror: bool = False) -> Path:
    """The same frames as a folder of images without stamps; ``mirror`` stores them flipped."""
    path.mkdir()
    for frame in recording.frames():
        image = frame.depth[:, ::-1] if mirror else frame.depth
        assert cv2.imwrite(str(path / f"{frame.index:06d}.png"), image.astype(np.uint16))
    if camera:
        write_camera(path / "camera.toml", recording.cameras[0])
    return path


def write_camera(path: Path, camera: Camera) -> Path:
    names = ("fx", "fy", "cx", "cy")
    path.write_text("".join(f"{name} = {getattr(camera, name)}\n" for name in names))
    return path


def frames_of(path: Path) -> list[Frame]:
    return list(open_recording(path).frames())


def shown_pose(pose: np.ndarray, anatomy: HandAnatomy | None = None) -> Shown:
    """A pose (22,) to draw, with its joints."""
    points = joint_positions(anatomy or make_anatomy(), pose[None])[0]
    return Shown(pose[:3], pose[3:7], pose[7:], points)


def open_hand(centre: Sequence[float] = (0.0, 0.0, 650.0), anatomy: HandAnatomy | None = None) -> np.ndarray:
    """The rest pose (22,) with its middle at a point, mm."""
    return rest_pose(anatomy or make_anatomy(), np.array(centre))


def pictures_of(path: Path) -> list[np.ndarray]:
    """The pictures of a video, as OpenCV plays it."""
    video, pictures = cv2.VideoCapture(str(path)), []
    while True:
        read, picture = video.read()
        if not read:
            return pictures
        pictures.append(picture)
