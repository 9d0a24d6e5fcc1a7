"""The frames of a synthetic recording, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray, ImageArray
from posetrack_cli.hand.anatomy import (
    ANGLE_NAMES,
    ANGLES,
    JOINT_NAMES,
    JOINT_PARENTS,
    TANGENT_SIZE,
    HandAnatomy,
)
from posetrack_cli.hand.kinematics import joint_positions
from posetrack_cli.hand.model import HandModel
from posetrack_cli.rendering.devices import device_or_default
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.rendering.window import Window
from posetrack_cli.results import messages
from posetrack_cli.results.estimate import Estimate, Status, Subject
from posetrack_cli.synthesis.hand.motion import Motion, make_motion
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.scene import Scene, room_depth
from posetrack_cli.synthesis.hand.sensor import CAMERA, missing_beside_edges, noisy, quantised
from posetrack_cli.synthesis.hand.walk import WalkNoise
from posetrack_cli.synthesis.timeline import Timeline, make_timeline
from posetrack_cli.tracking.body_space import pose_rates

SUBJECT = Subject("hand", CAMERA.name, ANGLE_NAMES, JOINT_NAMES, JOINT_PARENTS)


@dataclass(frozen=True, eq=False)
class SyntheticHandFrame:
    """One frame, and the truth about it.

    Attributes:
        index: position among the frames that are there, from 0.
        instant: position among the instants, from 0, the dropped ones included.
        stamp_ns: when it was taken, integer nanoseconds; the truth is of the same time.
        depth: (424, 512) uint16, mm, 0 = no reading.
        pose: (22,) of the hand, camera axes.
        twist: (21,) velocity in the tangent space, per second; None for a motion that has none (A).
        joints: (21, 3) mm, camera axes, in the order of ``JOINT_NAMES``.
    """

    index: int
    instant: int
    stamp_ns: int
    depth: ImageArray
    pose: FloatArray
    twist: FloatArray | None
    joints: FloatArray

    def truth(self) -> Estimate:
        """The truth as an estimate; it has no velocity where the motion has none."""
        none = np.zeros(TANGENT_SIZE)
        return Estimate(
            frame_index=self.index,
            stamp_ns=self.stamp_ns,
            status=Status.TRACKING,
            confidence=1.0,
            position=self.pose[:3],
            quaternion=self.pose[3:7],
            shape=self.pose[ANGLES],
            pose_rate=None if self.twist is None else pose_rates(self.pose, self.twist),
            twist=self.twist,
            pose_variance=none,
            twist_variance=None if self.twist is None else none,
            points=self.joints,
            effective_sample_size=0.0,
            resampled=False,
        )

    def joint_states(self) -> messages.JointStates:
        """The angles of the fingers."""
        return messages.joint_states(self.truth(), SUBJECT)


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything about a synthetic recording but its images.

    Attributes:
        options: that it was made of.
        hand: bones and skin.
        timeline: its instants.
        motion: poses and velocities at every instant.
        rng: of the sensor's noise, unused yet.
    """

    options: SynthOptions
    hand: HandModel
    timeline: Timeline
    motion: Motion
    rng: np.random.Generator

    @property
    def anatomy(self) -> HandAnatomy:
        """The hand's bones."""
        return self.hand.anatomy

    @property
    def written(self) -> BoolArray:
        """(T,) which instants give a frame."""
        return ~self.timeline.dropped


def make_plan(options: SynthOptions, noise: WalkNoise | None = None) -> Plan:
    """Draw instants and motion of a recording; each has a random stream of its own, as has the sensor.

    So switches of the sensor change no pose, and the motion of a seed is the same with and without
    dropped frames.

    Args:
        options: of the recording.
        noise: of the random walks A and B.
    """
    timing, moving, sensing = np.random.default_rng(options.seed).spawn(3)
    switches = options.switches
    timeline = make_timeline(
        options.frames, options.fps, drops=switches.drops, late=switches.late, rng=timing
    )
    motion = make_motion(options, timeline.seconds, moving, noise)
    return Plan(options, options.hand(), timeline, motion, sensing)


def synthesise(
    options: SynthOptions, *, noise: WalkNoise | None = None, device: RenderingDevice | None = None
) -> Iterator[SyntheticHandFrame]:
    """Yield the frames of a synthetic recording; the camera is ``CAMERA``.

    Args:
        options: of the recording.
        noise: of the random walks A and B.
        device: draws the frames; by default one is opened, and closed at the end.

    Raises:
        RenderingError: nothing can be drawn here.
    """
    yield from render_plan(make_plan(options, noise), device=device)


def render_plan(plan: Plan, *, device: RenderingDevice | None = None) -> Iterator[SyntheticHandFrame]:
    """Yield the frames of a plan; as ``synthesise``."""
    with device_or_default(device) as drawing:
        yield from _frames(plan, drawing)


def _frames(plan: Plan, device: RenderingDevice) -> Iterator[SyntheticHandFrame]:
    sensor = _Sensor(plan, device)
    joints = joint_positions(plan.anatomy, plan.motion.poses)
    seconds, twists = plan.timeline.seconds, plan.motion.twists
    for index, instant in enumerate(np.flatnonzero(plan.written).tolist()):
        pose = plan.motion.poses[instant]
        yield SyntheticHandFrame(
            index=index,
            instant=instant,
            stamp_ns=int(plan.timeline.stamps_ns[instant]),
            depth=sensor.image(pose, float(seconds[instant])),
            pose=pose,
            twist=None if twists is None else twists[instant],
            joints=joints[instant],
        )


class _Sensor:
    """Draws the scene and reads it as a Kinect would."""

    def __init__(self, plan: Plan, device: RenderingDevice) -> None:
        self._switches, self._rng = plan.options.switches, plan.rng
        self._mirrored = plan.anatomy.is_left
        self._scene = Scene(plan.hand, self._switches)
        self._window = Window.whole(CAMERA)
        size = (CAMERA.width, CAMERA.height)
        self._renderer = device.depth_renderer(self._scene.mesh, size, most=1)
        room = room_depth(CAMERA)
        self._room = room[:, ::-1] if self._mirrored else room

    def image(self, pose: FloatArray, seconds: float) -> ImageArray:
        """The readings (height, width) uint16, mm."""
        depth = self._ideal(pose, seconds)
        readings = noisy(depth, CAMERA, self._rng) if self._switches.noise else depth.copy()
        if self._switches.edges:
            readings[missing_beside_edges(depth, self._rng, mirrored=self._mirrored)] = 0.0
        return quantised(readings)

    def _ideal(self, pose: FloatArray, seconds: float) -> Float32Array:
        """The depth (height, width) that a perfect sensor would see, mm, 0 where there is nothing."""
        transforms = self._scene.transforms(pose, seconds)
        drawn: Float32Array = self._renderer.depth(transforms, CAMERA, self._window)[0]
        if not self._switches.background:
            return drawn
        return np.where(drawn > 0.0, np.minimum(drawn, self._room), self._room)
