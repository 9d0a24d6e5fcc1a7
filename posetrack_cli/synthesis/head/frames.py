"""The frames of a synthetic recording of a head, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.pose import HeadPose
from posetrack_cli.rendering.devices import device_or_default
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.head.drops import dropped_images
from posetrack_cli.synthesis.head.expression_script import ExpressionScript, make_script
from posetrack_cli.synthesis.head.identity import Identity, identity_of_seed
from posetrack_cli.synthesis.head.illumination import Illumination, make_illumination
from posetrack_cli.synthesis.head.movement import Movement, make_movement
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.passing import Passing, make_passing
from posetrack_cli.synthesis.head.person import Person, make_person
from posetrack_cli.synthesis.head.rig import make_cameras
from posetrack_cli.synthesis.head.sensor import Sensor
from posetrack_cli.synthesis.head.skin_grid import SkinGrid, skin_grid
from posetrack_cli.synthesis.head.stage import Stage

START_NS = 1_000_000_000
"""Stamp of the first frame: not 0, which some readers take for "no stamp"."""


@dataclass(frozen=True, eq=False)
class SyntheticHeadFrame:
    """One frame, and the truth about it.

    Attributes:
        index: from 0.
        stamp_ns: when it was taken, integer nanoseconds.
        images: one a camera, (height, width) uint8; None where a camera missed it.
        pose: of the head, ``camera_T_head`` of the reference camera.
        twist: (6,) velocity: mm/s in camera axes, rad/s in the head's frame.
        strengths: (J,) of ``EXPRESSIONS``.
        shape: (K, 3) the feature points, mm, head's frame.
    """

    index: int
    stamp_ns: int
    images: tuple[ImageArray | None, ...]
    pose: HeadPose
    twist: FloatArray
    strengths: FloatArray
    shape: FloatArray


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything about a synthetic recording but its images.

    Attributes:
        cameras: the reference camera first.
        identity, person, grid: who is seen.
        stamps_ns: (T,) of the frames.
        dropped: (C, T) which images are missing.
        movement, script, passing, illumination: what happens.
        scenery: random stream of the surroundings, unused yet.
        noise_seed: of the sensors' noise.
    """

    cameras: tuple[Camera, ...]
    identity: Identity
    person: Person
    grid: SkinGrid
    stamps_ns: IntArray
    dropped: BoolArray
    movement: Movement
    script: ExpressionScript
    passing: Passing | None
    illumination: Illumination
    scenery: np.random.Generator
    noise_seed: int

    @property
    def seconds(self) -> FloatArray:
        """(T,) time since the first frame, s."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) * 1e-9, dtype=np.float64)


def make_plan(options: HeadSynthOptions) -> Plan:
    """Draw everything that happens; each part has a random stream of its own.

    So motion, expressions and light of a seed are the same for every person and with one camera or two.
    """
    streams = np.random.default_rng(options.seed).spawn(7)
    moving, speaking, passing, lighting, scenery, sensing, missing = streams
    cameras, identity, grid = make_cameras(options), identity_of_seed(options.identity), skin_grid()
    stamps = START_NS + np.rint(np.arange(options.frames) * (1e9 / options.fps)).astype(np.int64)
    dropped = dropped_images(len(cameras), options.frames, missing)
    return Plan(
        cameras=cameras,
        identity=identity,
        person=make_person(identity, grid),
        grid=grid,
        stamps_ns=stamps,
        dropped=dropped & options.drops,
        movement=make_movement(options, moving),
        script=make_script(options, speaking),
        passing=make_passing(options, passing),
        illumination=make_illumination(options, lighting),
        scenery=scenery,
        noise_seed=int(sensing.integers(2**32)),
    )


def synthesise(
    options: HeadSynthOptions, *, device: RenderingDevice | None = None
) -> Iterator[SyntheticHeadFrame]:
    """Yield the frames of a synthetic recording; its cameras are ``make_cameras(options)``.

    Args:
        options: of the recording.
        device: draws the frames; by default one is opened, and closed at the end.

    Raises:
        RenderingError: nothing can be drawn here.
    """
    yield from render_plan(make_plan(options), options, device=device)


def render_plan(
    plan: Plan, options: HeadSynthOptions, *, device: RenderingDevice | None = None
) -> Iterator[SyntheticHeadFrame]:
    """Yield the frames of a plan that ``make_plan`` made of the same options; as ``synthesise``."""
    with device_or_default(device) as drawing:
        yield from _frames(plan, options, drawing)


def _frames(plan: Plan, options: HeadSynthOptions, device: RenderingDevice) -> Iterator[SyntheticHeadFrame]:
    sensors = [Sensor(camera, options.noise) for camera in plan.cameras]
    size = (sensors[0].drawn.width, sensors[0].drawn.height)
    origin, looks = plan.movement.origin, plan.identity.looks
    stage = Stage(device, plan.person, looks, plan.grid, size, origin, plan.scenery)
    poses, twists = plan.movement.poses(plan.seconds), plan.movement.twists(plan.seconds)
    strengths = plan.script.strengths(plan.seconds)
    try:
        for index, seconds in enumerate(plan.seconds.tolist()):
            pose = HeadPose(poses[index, :3], poses[index, 3:])
            thing = None if plan.passing is None else plan.passing.place(seconds, pose.position)
            stage.set(pose, strengths[index], thing)
            yield SyntheticHeadFrame(
                index=index,
                stamp_ns=int(plan.stamps_ns[index]),
                images=_images(stage, sensors, plan, index),
                pose=pose,
                twist=twists[index],
                strengths=strengths[index],
                shape=plan.person.shape(strengths[index]),
            )
    finally:
        stage.release()


def _images(stage: Stage, sensors: list[Sensor], plan: Plan, index: int) -> tuple[ImageArray | None, ...]:
    lighting = plan.illumination.at(float(plan.seconds[index]))
    streams = [np.random.default_rng([plan.noise_seed, number, index]) for number in range(len(sensors))]
    return tuple(
        None if dropped else sensor.image(stage.seen(sensor.drawn, lighting), rng)
        for sensor, rng, dropped in zip(sensors, streams, plan.dropped[:, index].tolist(), strict=True)
    )
