"""The particle filter over pose and deformation of a head (thesis, 3.3).

Particles are held as deviations from one pose and one deformation: moving the head that they stand for, by
its velocity or to where a refinement found it, changes these two and leaves all particles alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.partitioned import Motion, local_mean, partitioned_step
from posetrack_cli.filtering.weights import effective_count
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import ParticleSettings
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.face.shape_model import ShapeModel
from posetrack_cli.head.particles.kernels import recentre
from posetrack_cli.head.particles.motion import FRAME_S, deformation_diffusion, pose_diffusion
from posetrack_cli.head.particles.scores import ParticleScores, PatchObservation

LEAST_DEVIATION_MM = 1e-3
"""mu of a deformation that hardly takes place: nothing is divided by less."""


@dataclass(frozen=True, eq=False)
class HeadParticles:
    """Weighted hypotheses of pose and deformation.

    Attributes:
        pose: reference pose.
        coefficients: (B,) reference deformation of the model, mm.
        deviations: (N, 6 + B) tangent vectors from the reference pose (see ``HeadPose``), then what a
            particle's coefficients have beyond the reference's.
        weights: (N,), sum 1.
        model: whose deformation coefficients these are.
    """

    pose: HeadPose
    coefficients: FloatArray
    deviations: FloatArray
    weights: FloatArray
    model: ShapeModel

    def variance(self) -> FloatArray:
        """Return the variances (6 + B,) of the weighted particles: of tangent vectors and coefficients."""
        away = self.deviations - self.weights @ self.deviations
        spread: FloatArray = self.weights @ np.square(away)
        return spread

    def moved_to(self, pose: HeadPose, coefficients: FloatArray) -> HeadParticles:
        """Return the particles shifted as a whole: the reference goes to this pose and deformation."""
        return replace(self, pose=pose, coefficients=coefficients)

    def with_model(self, model: ShapeModel) -> HeadParticles:
        """Return the particles with the shapes nearest to theirs that another model has.

        a' = V'^T (M(a) - Mbar') for a model with orthonormal directions V'; a model that has learnt since
        has others, perhaps more of them.
        """
        if model is self.model:
            return self
        onto = _flat(model).T
        coefficients = onto @ (self.model.shapes(self.coefficients) - model.mean).ravel()
        deformation = self.deviations[:, POSE_SIZE:] @ (onto @ _flat(self.model)).T
        deviations = np.hstack([self.deviations[:, :POSE_SIZE], deformation])
        return replace(self, coefficients=coefficients, deviations=deviations, model=model)

    def about(self, mean: FloatArray) -> HeadParticles:
        """Return the same particles as deviations from one of them, or from their mean (6 + B,)."""
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


@dataclass(frozen=True, eq=False)
class Filtered:
    """What the filter says of one frame.

    Attributes:
        particles: to go on with; their reference is the estimate.
        effective_sample_size: of the weights.
    """

    particles: HeadParticles
    effective_sample_size: float

    @property
    def pose(self) -> HeadPose:
        """The estimated pose, (3.30)."""
        return self.particles.pose

    @property
    def coefficients(self) -> FloatArray:
        """The estimated deformation (B,), mm, (3.30)."""
        return self.particles.coefficients


class HeadFilter:
    """Follows a head by particles: predict, weigh, resample, in halves, then a robust mean."""

    def __init__(self, settings: ParticleSettings, cameras: Sequence[Camera]) -> None:
        self._settings = settings
        self._scores = ParticleScores(cameras, settings.lookup == "bilinear")

    def start(self, pose: HeadPose, model: ShapeModel, rng: np.random.Generator) -> HeadParticles:
        """Return particles about a pose and the mean shape, spread like the diffusion of a head at rest."""
        sd = self._diffusion(np.zeros(POSE_SIZE), FRAME_S, model)
        deviations = sd * rng.standard_normal((self._settings.count, sd.size))
        weights = np.full(len(deviations), 1.0 / len(deviations))
        return HeadParticles(pose, np.zeros(model.size), deviations, weights, model)

    def step(
        self,
        particles: HeadParticles,
        predicted: HeadPose,
        velocity: FloatArray,
        dt: float,
        observation: PatchObservation,
        model: ShapeModel,
        rng: np.random.Generator,
    ) -> Filtered:
        """Advance the particles by one frame.

        Args:
            particles: of the frame before, shifted to its final estimate (``HeadParticles.moved_to``).
            predicted: that estimate moved on by its velocity; templates are warped to it.
            velocity: (6,) per second, whose size the diffusion grows with.
            dt: s since the frame before.
            observation: images, templates, visibility.
            model: of the face now.
            rng: source of randomness.

        Raises:
            FilterError: dt is not > 0.
        """
        before = particles.with_model(model)
        sd = self._diffusion(velocity, dt, model)
        drift = np.zeros(sd.size)
        if self._settings.sampling == "printed":  # there the drift belongs to one half of the particles
            drift[:POSE_SIZE] = before.pose.difference(predicted)
        else:
            before = before.moved_to(predicted, before.coefficients)
        self._scores.observe(observation, before.pose, before.coefficients, model)
        moved = partitioned_step(
            before.deviations,
            before.weights,
            Motion(drift, sd, POSE_SIZE),
            partial(self._log_weights, before),
            self._settings.sampling,
            self._settings.resampling,
            rng,
        )
        return self._summarised(replace(before, deviations=moved.points, weights=moved.weighing.weights), sd)

    def _summarised(self, particles: HeadParticles, sd: FloatArray) -> Filtered:
        """Return the local mean, and the particles about it."""
        weights = particles.weights
        scale = np.maximum(sd, LEAST_DEVIATION_MM * self._settings.kappa)
        mean = local_mean(particles.deviations, weights, scale, self._settings.local_radius)
        return Filtered(particles.about(mean), effective_count(weights))

    def _diffusion(self, velocity: FloatArray, dt: float, model: ShapeModel) -> FloatArray:
        """Return the standard deviations (6 + B,) of omega."""
        pose = pose_diffusion(velocity, dt, self._settings)
        return np.concatenate([pose, deformation_diffusion(model.deviations, dt, self._settings)])

    def _log_weights(self, particles: HeadParticles, deviations: FloatArray) -> FloatArray:
        """Return log pi (N,) of deviations (N, 6 + B), (3.27).

        -(2K - c)^2 / (2 sigma^2) - 1/2 sum_b (a_b / mu_b)^2. What is missing, 2K - c, is the sum of
        visibility (1 - correlation): the same where all is visible; a point or camera that is not seen
        says nothing **[ours]**.

        **[ours]** -(2K - c) / s^2 in place of the first term: patches of zero mean and unit norm with white
        noise, as |p - q|^2 = 2 (1 - correlation); s is larger than that noise, since what makes patches
        differ is common to their pixels. The square tells a good match hardly from a fair one, and of a face
        half covered lets a single particle survive.
        """
        missing = self._scores.missing(deviations)
        mu = np.maximum(particles.model.deviations, LEAST_DEVIATION_MM)
        whitened = (particles.coefficients + deviations[:, POSE_SIZE:]) / mu
        prior = np.einsum("nb,nb->n", whitened, whitened)
        if self._settings.weighting == "printed":
            missing = 0.5 * np.square(missing / self._settings.sigma)
        else:
            missing = missing / self._settings.patch_noise**2
        log_weights: FloatArray = -missing - 0.5 * prior
        return log_weights


def _flat(model: ShapeModel) -> FloatArray:
    """The directions as a matrix (3K, B)."""
    return model.basis.reshape(model.mean.size, -1)
