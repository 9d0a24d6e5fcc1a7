"""Recordings of two rendered people in one picture, with exact truth for each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli.geometry.camera import Camera, in_camera_axes
from posetrack_cli.head.dense.numbers import TRUE_NUMBERS
from posetrack_cli.mcap.sink import McapSink
from posetrack_cli.recording.base import TRUTH_FILE_NAME
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.results.estimate_json import ESTIMATE_SCHEMA_NAME, estimate_schema, estimate_to_json
from posetrack_cli.synthesis.head.frames import SyntheticHeadFrame, make_plan, render_plan
from posetrack_cli.synthesis.head.movement import Movement
from posetrack_cli.synthesis.head.options import HeadSynthOptions

HEAD_MM = np.array([88.0, 135.0])
"""Half axes of the part of a picture that shows a head, and its middle below the eyes."""
BELOW_MM = 15.0
Path_ = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Walk(Movement):
    """A movement along a path, in addition to its own."""

    along: Path_ = lambda times: np.zeros((len(times), 3))

    def poses(self, times: np.ndarray) -> np.ndarray:
        poses = super().poses(times)
        poses[:, :3] += self.along(times)
        return poses


@dataclass(frozen=True)
class Walker:
    """A person, the first place (x and depth, mm) and the last."""

    identity: int
    start: tuple[float, float]
    end: tuple[float, float]
    seed: int = 0


def frames_of(walker: Walker, options: HeadSynthOptions) -> tuple[Sequence[Camera], list[SyntheticHeadFrame]]:
    own = replace(options, identity=walker.identity, seed=walker.seed)
    plan = make_plan(own)
    (x, z), (end_x, end_z) = walker.start, walker.end

    def along(times: np.ndarray) -> np.ndarray:
        share = np.clip(times / own.duration_s, 0.0, 1.0)[:, None]
        start, end = np.array([x, 0.0, z - own.distance_mm]), np.array([end_x, 0.0, end_z - own.distance_mm])
        return start + share * (end - start)

    own_motion = {field.name: getattr(plan.movement, field.name) for field in fields(plan.movement)}
    walk = Walk(**own_motion, along=along)
    return plan.cameras, list(render_plan(replace(plan, movement=walk)))


def together(camera: Camera, number: int, seen: Sequence[SyntheticHeadFrame]) -> np.ndarray:
    """The pictures of a camera in one: the head nearest to the camera is in front."""
    below = np.array([0.0, BELOW_MM, 0.0])
    places = [in_camera_axes(camera, frame.pose.position + below) for frame in seen]
    picture: np.ndarray | None = None
    for k in sorted(range(len(seen)), key=lambda k: -places[k][2]):
        image = seen[k].images[number]
        assert image is not None
        if picture is None:
            picture = image.copy()
            continue
        x, y, z = places[k]
        middle = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        axes = camera.fx * HEAD_MM / z
        shown = np.zeros(picture.shape, np.uint8)
        cv2.ellipse(shown, tuple(map(round, middle)), tuple(map(round, axes)), 0.0, 0.0, 360.0, 255, -1)
        soft = cv2.GaussianBlur(shown, (0, 0), 1.5)[..., None].squeeze() / 255.0
        picture = np.rint(soft * image + (1.0 - soft) * picture).astype(np.uint8)
    assert picture is not None
    return picture


def make_recording(folder: Path, walkers: Sequence[Walker], options: HeadSynthOptions) -> Path:
    """Write a folder of images, or one of each camera, with the truth of each person, labelled 1, 2, ..."""
    made = [frames_of(walker, options) for walker in walkers]
    cameras = made[0][0]
    folders = [folder / camera.name if len(cameras) > 1 else folder for camera in cameras]
    for one in folders:
        one.mkdir(parents=True)
    with McapSink(folder / TRUTH_FILE_NAME) as sink:
        channels = [
            sink.json_channel(
                f"/truth/head/{k + 1}/estimate", ESTIMATE_SCHEMA_NAME, estimate_schema(TRUE_NUMBERS)
            )
            for k in range(len(walkers))
        ]
        for instant in zip(*(frames for _, frames in made), strict=True):
            for number, camera in enumerate(cameras):
                cv2.imwrite(
                    str(folders[number] / f"{instant[0].index:05d}.png"), together(camera, number, instant)
                )
            for channel, frame in zip(channels, instant, strict=True):
                stamp_ns = frame.stamp_ns - made[0][1][0].stamp_ns  # folders begin at 0
                sink.write(
                    channel,
                    stamp_ns,
                    estimate_to_json(replace(frame.truth(), stamp_ns=stamp_ns), TRUE_NUMBERS),
                )
        sink.finish()
    (folder / "camera.toml").write_text(camera_file_text(cameras))
    return folder
