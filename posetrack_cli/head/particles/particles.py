"""Particles of a head's pose and deformation, and their motion between two frames (thesis, 3.3.1).

    s_t = s_{t-1} + tau v_{t-1} + omega                                                           (3.26)
    sd(omega) = max(FLOOR, GAIN |v| tau0) sqrt(tau / tau0),    tau0 = 1/30 s

In the thesis the diffusion increases with the velocity (Oka et al. 2005), without constants; FLOOR and GAIN
are ours. Noise is a density: one step of 2 tau diffuses like two of tau **[ours]**.

Particles are stored as deviations from a reference pose and deformation. Shifting them all, by the velocity
or to a refined pose, changes only the reference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.errors import check_time_step
from posetrack_cli.head.config import ParticleSettings
from posetrack_cli.head.face.points import COEFFICIENTS, POSE_SIZE, HeadPose, ShapeModel
from posetrack_cli.head.particles.score_maps import recentre
from posetrack_cli.results.columns import Layout, LayoutError, floats
from posetrack_cli.tracking.state_codec import Codec, Fields, parts_of

FRAME_S = 1.0 / 30.0
"""tau0, the thesis's frame interval, to which FLOOR and GAIN refer."""
FLOOR = np.array([0.8, 0.8, 1.5, 0.008, 0.010, 0.006])
"""(6,) minimum diffusion: mm along camera x, y, z; rad about them (pitch, yaw, roll)."""
GAIN = 0.4
"""Diffusion relative to the predicted displacement, if larger."""
SPEED_LIMITS = np.repeat([2000.0, 12.0], 3)
"""(6,) mm/s and rad/s: limits of the predicted velocity, so that a single outlier is not followed."""


@dataclass(frozen=True, eq=False)
class HeadParticles:
    """Weighted particles of pose and deformation.

    Attributes:
        pose: reference pose.
        coefficients: reference deformation, mm.
        deviations: (N, 6 + B) tangent vectors from the reference pose (see ``HeadPose``), then differences
            from the reference's coefficients.
        weights: of the particles.
        model: shape model of the coefficients.
    """

    pose: HeadPose
    coefficients: Annotated[FloatArray, floats(COEFFICIENTS)]
    deviations: Annotated[FloatArray, floats("particles", "state components")]
    weights: Annotated[FloatArray, Layout("float64", ("particles",), least=0.0, most=1.0, shares=True)]
    model: ShapeModel

    def variance(self) -> FloatArray:
        """Return the variances (6 + B,) of the weighted tangent vectors and coefficients."""
        away = self.deviations - self.weights @ self.deviations
        spread: FloatArray = self.weights @ np.square(away)
        return spread

    def moved_to(self, pose: HeadPose, coefficients: FloatArray) -> HeadParticles:
        """Shift all particles by moving the reference to a pose and deformation."""
        return replace(self, pose=pose, coefficients=coefficients)

    def with_model(self, model: ShapeModel) -> HeadParticles:
        """Convert the particles to the nearest shapes of another model.

        a' = V'^T (M(a) - Mbar') for orthonormal directions V'; the other model may have more of them.
        """
        if model is self.model:  # usual: a learned model changes only with new samples
            return self
        onto = _flat(model).T
        coefficients = onto @ (self.model.shapes(self.coefficients) - model.mean).ravel()
        deformation = self.deviations[:, POSE_SIZE:] @ (onto @ _flat(self.model)).T
        deviations = np.hstack([self.deviations[:, :POSE_SIZE], deformation])
        return replace(self, coefficients=coefficients, deviations=deviations, model=model)

    def about(self, mean: FloatArray) -> HeadParticles:
        """Return the particles as deviations from one of them, or from their mean (6 + B,)."""
        away = self.deviations.copy()
        recentre(away, mean)
        away[:, POSE_SIZE:] -= mean[POSE_SIZE:]
        return HeadParticles(
            self.pose.moved(mean[:POSE_SIZE]),
            self.coefficients + mean[POSE_SIZE:],
            away,
            self.weights,
            self.model,
        )


def _checked(deviations: FloatArray, coefficients: FloatArray, **parts: Any) -> HeadParticles:
    wanted = POSE_SIZE + len(coefficients)
    if deviations.shape[1] != wanted:
        raise LayoutError(f"'particles.deviations' has {deviations.shape[1]} components, expected {wanted}")
    return HeadParticles(deviations=deviations, coefficients=coefficients, **parts)


PARTICLES: Codec[HeadParticles] = Fields(_checked, **parts_of(HeadParticles))


def _flat(model: ShapeModel) -> FloatArray:
    """Return the directions as a matrix (3K, B)."""
    return model.basis.reshape(model.mean.size, -1)


class HeadMotion:
    """Motion until the next frame: constant velocity with diffusion.

    Args:
        velocity: (6,) tangent vector per second, camera axes; clipped to ``SPEED_LIMITS`` **[ours]**.
        dt: s until that frame; clipped to the longest gap.
        settings: longest gap, and diffusion of the deformation.

    Raises:
        FilterError: dt is not > 0.
    """

    def __init__(self, velocity: FloatArray, dt: float, settings: ParticleSettings) -> None:
        check_time_step(dt)
        self._velocity = np.clip(velocity, -SPEED_LIMITS, SPEED_LIMITS)
        self._seconds, self._settings = min(dt, settings.gap_max_s), settings

    def predicted(self, pose: HeadPose) -> HeadPose:
        """Return the pose predicted with constant velocity."""
        return pose.moved(self._velocity * self._seconds)

    @property
    def pose_diffusion(self) -> FloatArray:
        """(6,) standard deviations of omega's pose part, mm and rad."""
        frame: FloatArray = np.maximum(FLOOR, GAIN * FRAME_S * np.abs(self._velocity))
        return frame * math.sqrt(self._seconds / FRAME_S)

    def deformation_diffusion(self, deviations: FloatArray) -> FloatArray:
        """Return kappa mu (B,), mm, of deviations mu (B,)."""
        return self._settings.kappa * math.sqrt(self._seconds / FRAME_S) * deviations


def velocity_between(before: HeadPose, after: HeadPose, dt: float) -> FloatArray:
    """Return v = (x_t - x_{t-1}) / tau, (6,), mm/s and rad/s in camera axes; (3.31).

    Raises:
        FilterError: dt is not > 0.
    """
    check_time_step(dt)
    return before.difference(after) / dt
