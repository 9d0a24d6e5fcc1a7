"""The motion of a synthetic recording: poses at its instants, and velocities where there are any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import ANGLES
from posetrack_cli.hand.kinematics import mirrored_poses
from posetrack_cli.synthesis.hand.natural import natural_motion
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.shapes import SHAPES
from posetrack_cli.synthesis.hand.walk import WalkNoise, pose_walk, start_pose, velocity_walk, walk_region

_MIRRORED_TWIST = np.r_[-1.0, 1.0, 1.0, 1.0, -1.0, -1.0, np.ones(15)]


@dataclass(frozen=True)
class Motion:
    """How a hand moves.

    Attributes:
        poses: (T, 22).
        twists: (T, 21) velocities in the tangent space, per second; None for a walk that has none.
    """

    poses: FloatArray
    twists: FloatArray | None

    def mirrored(self) -> Motion:
        """The motion of the other hand, seen in a mirror x -> -x.

        A rotation vector is axial: its component along the mirror's normal stays, the others turn.
        """
        twists = None if self.twists is None else self.twists * _MIRRORED_TWIST
        return Motion(mirrored_poses(self.poses), twists)


def make_motion(
    options: SynthOptions, seconds: FloatArray, rng: np.random.Generator, noise: WalkNoise | None = None
) -> Motion:
    """Return the motion that the options ask for, at instants (T,) since the first frame.

    Args:
        options: motion, speed, side and scale are read.
        seconds: (T,) increasing, the first is 0.
        rng: of the motion only.
        noise: of the walks A and B.
    """
    motion = _right_motion(options, seconds, rng, noise or WalkNoise())
    return motion.mirrored() if options.side == "left" else motion


def _right_motion(
    options: SynthOptions, seconds: FloatArray, rng: np.random.Generator, noise: WalkNoise
) -> Motion:
    if options.motion == "C":
        times = options.speed * seconds
        script = natural_motion(float(times[-1]), options.scale, rng)
        return Motion(script.poses(times), options.speed * script.twists(times))
    start, region = _walk_start(options.scale), walk_region(options.scale)
    if options.motion == "A":
        density = options.speed * noise.walk.vector()
        return Motion(pose_walk(start, seconds, density, region, rng), None)
    densities = (options.speed * noise.pose.vector(), options.speed * noise.velocity.vector())
    return Motion(*velocity_walk(start, seconds, *densities, region, rng))


def _walk_start(scale: float) -> FloatArray:
    pose = start_pose(scale)
    pose[ANGLES] = SHAPES["open"]
    return pose
