"""The frames of a synthetic recording of a head, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rotations import quaternion_rate
from posetrack_cli.head.face.pose import HeadPose
from posetrack_cli.head.subject import head_subject
from posetrack_cli.rendering.devices import device_or_default
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.synthesis.head.expression_script import ExpressionScript, make_script
from posetrack_cli.synthesis.head.expressions import EXPRESSIONS
from posetrack_cli.synthesis.head.identity import Identity, identity_of_seed
from posetrack_cli.synthesis.head.illumination import Illumination, make_illumination
from posetrack_cli.synthesis.head.movement import Movement, Occluder, make_movement, make_occluder
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.person import Person, make_person
from posetrack_cli.synthesis.head.scene import Scene
from posetrack_cli.synthesis.head.sensor import Sensor, make_cameras
from posetrack_cli.synthesis.head.skin_grid import SkinGrid, skin_grid
from posetrack_cli.synthesis.timeline import Timeline, dropped_images, nominal_stamps

COMPONENTS = 0
"""A model's deformation coefficients are its own: the truth has none. Its points tell the deformation."""


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

    def truth(self) -> Estimate:
        """The truth as an estimate; its points are the ten true ones in the reference camera's axes."""
        none = np.zeros(6)
        turning = quaternion_rate(self.pose.quaternion, self.twist[3:])
        return Estimate(
            frame_index=self.index,
            stamp_ns=self.stamp_ns,
            status=Status.TRACKING,
            confidence=1.0,
            position=self.pose.position,
            quaternion=self.pose.quaternion,
            shape=np.zeros(COMPONENTS),
            pose_rate=np.concatenate([self.twist[:3], turning]),
            twist=self.twist,
            pose_variance=none,
            twist_variance=none,
            points=self.pose.points(self.shape),
            effective_sample_size=None,
            resampled=False,
        )

    def joint_states(self) -> messages.JointStates:
        """The strengths of the expressions, which no result has."""
        message = messages.JointStates()
        message.timestamp.FromNanoseconds(self.stamp_ns)
        for name, value in zip(EXPRESSIONS, self.strengths.tolist(), strict=True):
            message.joints.add(name=name, position=value)
        return message


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything about a synthetic recording but its images.

    Attributes:
        options: that it was made of.
        cameras: the reference camera first.
        identity, person, grid: who is seen.
        timeline: its instants, and which images are missing.
        movement, script, occluder, illumination: what happens.
        scenery: random stream of the surroundings, unused yet.
        noise_seed: of the sensors' noise.
    """

    options: HeadSynthOptions
    cameras: tuple[Camera, ...]
    identity: Identity
    person: Person
    grid: SkinGrid
    timeline: Timeline
    movement: Movement
    script: ExpressionScript
    occluder: Occluder | None
    illumination: Illumination
    scenery: np.random.Generator
    noise_seed: int

    @property
    def subject(self) -> Subject:
        """Whose truth it is, in the reference camera."""
        return head_subject(self.cameras[0].name, COMPONENTS)


def make_plan(options: HeadSynthOptions) -> Plan:
    """Draw everything that happens; each part has a random stream of its own.

    So motion, expressions and light of a seed are the same for every person and with one camera or two.
    """
    streams = np.random.default_rng(options.seed).spawn(7)
    moving, speaking, occluding, lighting, scenery, sensing, missing = streams
    cameras, identity, grid = make_cameras(options), identity_of_seed(options.identity), skin_grid()
    dropped = dropped_images(len(cameras), options.frames, missing) & options.drops
    return Plan(
        options=options,
        cameras=cameras,
        identity=identity,
        person=make_person(identity, grid),
        grid=grid,
        timeline=Timeline(nominal_stamps(options.frames, options.fps), dropped),
        movement=make_movement(options, moving),
        script=make_script(options, speaking),
        occluder=make_occluder(options, occluding),
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
    yield from render_plan(make_plan(options), device=device)


def render_plan(plan: Plan, *, device: RenderingDevice | None = None) -> Iterator[SyntheticHeadFrame]:
    """Yield the frames of a plan; as ``synthesise``."""
    with device_or_default(device) as drawing:
        sensors = [Sensor(camera, plan.options.noise) for camera in plan.cameras]
        size = (sensors[0].drawn.width, sensors[0].drawn.height)
        origin, looks, times = plan.movement.origin, plan.identity.looks, plan.timeline.seconds
        scene = Scene(drawing, plan.person, looks, plan.grid, size, origin, plan.scenery)
        poses, twists = plan.movement.poses(times), plan.movement.twists(times)
        strengths = plan.script.strengths(times)
        try:
            for index, seconds in enumerate(times.tolist()):
                pose = HeadPose(poses[index, :3], poses[index, 3:])
                occluder = None if plan.occluder is None else plan.occluder.place(seconds, pose.position)
                scene.set(pose, strengths[index], occluder)
                yield SyntheticHeadFrame(
                    index=index,
                    stamp_ns=int(plan.timeline.stamps_ns[index]),
                    images=_images(scene, sensors, plan, index),
                    pose=pose,
                    twist=twists[index],
                    strengths=strengths[index],
                    shape=plan.person.shape(strengths[index]),
                )
        finally:
            scene.release()


def _images(scene: Scene, sensors: list[Sensor], plan: Plan, index: int) -> tuple[ImageArray | None, ...]:
    lighting = plan.illumination.at(float(plan.timeline.seconds[index]))
    streams = [np.random.default_rng([plan.noise_seed, number, index]) for number in range(len(sensors))]
    return tuple(
        None if dropped else sensor.image(scene.renderer.image(sensor.drawn, lighting), rng)
        for sensor, rng, dropped in zip(
            sensors, streams, plan.timeline.dropped[:, index].tolist(), strict=True
        )
    )
