"""Particle filter over pose and deformation of a head (thesis, 3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.partitioned import Motion, local_mean, partitioned_step
from posetrack_cli.filtering.resampling import effective_count
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.config import ParticleSettings
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose, ShapeModel
from posetrack_cli.head.particles.particles import FRAME_S, HeadMotion, HeadParticles
from posetrack_cli.head.particles.scores import ParticleScores, PatchObservation

LEAST_DEVIATION_MM = 1e-3
"""Minimum mu, to avoid division by deformations that hardly occur."""
PATCH_NOISE = 0.35
"""s: of patches with zero mean and unit norm; larger than their white noise, see ``_log_weights``."""
LOCAL_RADIUS = 6.0
"""d of (3.29), in standard deviations of the diffusion; the thesis states none."""


@dataclass(frozen=True, eq=False)
class Filtered:
    """Filter estimate of one frame.

    Attributes:
        particles: their reference is the estimate.
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
    """Particle filter of a head: partitioned prediction, weighting and resampling, then a local mean."""

    def __init__(self, settings: ParticleSettings, cameras: Sequence[Camera]) -> None:
        self._settings = settings
        self._scores = ParticleScores(cameras, settings.lookup == "bilinear")

    def start(self, pose: HeadPose, model: ShapeModel, rng: np.random.Generator) -> HeadParticles:
        """Return particles around a pose and the mean shape, with the diffusion of a head at rest."""
        sd = _diffusion(HeadMotion(np.zeros(POSE_SIZE), FRAME_S, self._settings), model)
        deviations = sd * rng.standard_normal((self._settings.count, sd.size))
        weights = np.full(len(deviations), 1.0 / len(deviations))
        return HeadParticles(pose, np.zeros(model.size), deviations, weights, model)

    def step(
        self,
        particles: HeadParticles,
        motion: HeadMotion,
        observation: PatchObservation,
        rng: np.random.Generator,
    ) -> Filtered:
        """Advance the particles by one frame.

        Args:
            particles: of the previous frame, shifted to its final estimate (``HeadParticles.moved_to``), with
                coefficients of the current face model.
            motion: since then; templates are warped to its prediction.
            observation: images, templates, visibility.
            rng: source of randomness.
        """
        before, predicted = particles, motion.predicted(particles.pose)
        sd = _diffusion(motion, before.model)
        drift = np.zeros(sd.size)
        if self._settings.sampling == "printed":  # as printed, the drift applies to one partition only
            drift[:POSE_SIZE] = before.pose.difference(predicted)
        else:
            before = before.moved_to(predicted, before.coefficients)
        self._scores.observe(observation, before)
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
        """Return the local mean, with the particles relative to it."""
        weights = particles.weights
        # a deformation that hardly occurs has no diffusion, but distances are divided by it
        scale = np.maximum(sd, LEAST_DEVIATION_MM * self._settings.kappa)
        mean = local_mean(particles.deviations, weights, scale, LOCAL_RADIUS)
        return Filtered(particles.about(mean), effective_count(weights))

    def _log_weights(self, particles: HeadParticles, deviations: FloatArray) -> FloatArray:
        """Return log pi (N,) of deviations (N, 6 + B), (3.27).

        -(2K - c)^2 / (2 sigma^2) - 1/2 sum_b (a_b / mu_b)^2. 2K - c is the sum of visibility (1 -
        correlation): the same if everything is visible; invisible points and missing cameras do not
        contribute **[ours]**.

        **[ours]** -(2K - c) / s^2 replaces the first term: the likelihood of patches of zero mean and unit
        norm with white noise, since |p - q|^2 = 2 (1 - correlation). s exceeds that noise because errors are
        correlated between pixels. The square barely separates good matches from fair ones, and lets a single
        particle survive if half of the face is covered.
        """
        missing = self._scores.missing(deviations)
        mu = np.maximum(particles.model.deviations, LEAST_DEVIATION_MM)
        whitened = (particles.coefficients + deviations[:, POSE_SIZE:]) / mu
        prior = np.einsum("nb,nb->n", whitened, whitened)
        if self._settings.weighting == "printed":
            missing = 0.5 * np.square(missing / self._settings.sigma)
        else:
            missing = missing / PATCH_NOISE**2
        log_weights: FloatArray = -missing - 0.5 * prior
        return log_weights


def _diffusion(motion: HeadMotion, model: ShapeModel) -> FloatArray:
    """Return the standard deviations (6 + B,) of omega."""
    return np.concatenate([motion.pose_diffusion, motion.deformation_diffusion(model.deviations)])
