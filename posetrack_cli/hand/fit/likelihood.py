"""Likelihood of a pose given a depth image, and the available proposals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.filtering.model import LogLikelihood, Sampling
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import HandConfig, MixtureSettings, ObservationSettings
from posetrack_cli.hand.fit.skeleton import THUMB
from posetrack_cli.hand.model.forearm import forearm_window, transforms_with_forearm
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.rendering.pixel_model import PixelMixture
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums, Window

# Costs over image regions, and likelihoods

Cost = Callable[[TileSums, ObservationSettings], FloatArray]


def paper_cost(sums: TileSums, settings: ObservationSettings) -> FloatArray:
    """Return D of eq. (4): mean of min(|d - y|, c_max) over the rendered pixels of the window, mm.

    A rendered pixel without a reading counts c_max. A hand outside the window costs c_max **[fix]**: the mean
    over no pixels is undefined.

    Returns:
        (N,) costs in 0..c_max.
    """
    missed = sums.rendered_only + sums.unread
    rendered = sums.both + missed
    total = sums.error + settings.clamp_mm * missed
    return np.divide(total, rendered, out=np.full_like(total, settings.clamp_mm), where=rendered > 0)


def union_cost(sums: TileSums, settings: ObservationSettings) -> FloatArray:
    """Return D over the union of rendered pixels r and observed pixels o **[ours]**, mm.

        D = ( sum over r and o of min(|d - y|, c_max) + c_max (|r \\ o| + |o \\ r|) ) / |r or o|

    A rendered pixel without a reading counts as ``unread_weight`` pixels: most readings at a hand's edge are
    missing, and a missing reading is not background.

    Returns:
        (N,) costs in 0..c_max.
    """
    disagree = (
        sums.rendered_only
        - sums.occluded
        + settings.unread_weight * sums.unread
        + (sums.observed - sums.both)
    )
    union = sums.both + disagree
    total = sums.error + settings.clamp_mm * disagree
    return np.divide(total, union, out=np.full_like(total, settings.clamp_mm), where=union > 0)


COSTS: dict[str, Cost] = {"paper": paper_cost, "union": union_cost, "mixture": union_cost}


def log_gibbs(costs: FloatArray, settings: ObservationSettings) -> FloatArray:
    """Return log p(y | x) (N,) for costs D (N,), mm, up to a constant: -D^2 / (2 sigma^2) (47) or -D / sigma
    (3)."""
    scaled = costs / settings.sigma_mm
    return -0.5 * scaled**2 if settings.likelihood == "gaussian" else -scaled


def pixel_mixture(settings: MixtureSettings, unread_weight: float) -> PixelMixture:
    """Return the pixel model of a configuration."""
    return PixelMixture(
        near_sd_mm=settings.near_sd_mm,
        sd_mm_per_m2=settings.sd_mm_per_m2,
        occluded=settings.occluded_share,
        outlier=settings.outlier_share,
        outline_sd_mm=settings.outline_sd_mm,
        unread_weight=unread_weight,
    )


def union_misfit(sums: TileSums, model: PixelMixture, depth_mm: float) -> FloatArray:
    """Return the sum of misfits over the union of rendered r and observed o **[ours]**; 0 at full agreement.

        R = sum over r of rho(y, d) + m |o \\ r| - relief

    with m the misfit of an unexplained reading: a target pixel where no hand is rendered. The relief is the
    reduction for such pixels next to a rendered one.

    Args:
        sums: with misfits of ``model``.
        model: of a pixel.
        depth_mm: of the target.

    Returns:
        (N,) sums.
    """
    missed = sums.observed - sums.both
    total: FloatArray = sums.misfit + model.unexplained(np.array(depth_mm)) * missed - sums.relief
    return total


def reading_share(depth_mm: float, step: int, camera: Camera, correlation_mm: float) -> float:
    """Return the effective share of independent readings n_eff / n, at most 1 **[ours]**.

    A pixel covers a = z^2 step^2 / (fx fy) of the surface. Errors, mainly of the hand model, are correlated
    over patches of area A = correlation_mm^2, the integral of their correlation over the plane, so n pixels
    are worth n_eff = n a / A independent ones. Sampling an image twice as finely thus changes nothing.
    """
    pixel_mm2 = depth_mm**2 * step**2 / (camera.fx * camera.fy)
    return min(1.0, pixel_mm2 / correlation_mm**2)


class Scores(NamedTuple):
    """Scores of N rendered poses.

    Attributes:
        costs: (N,) D, mm.
        log_likelihood: (N,) log p(y | x), up to a constant.
    """

    costs: FloatArray
    log_likelihood: FloatArray


class PoseScorer(Protocol):
    """Likelihood as used by the tracker."""

    def costs(self, poses: FloatArray, observation: Observation) -> FloatArray:
        """Return costs D (N,), mm, of poses (N, 22)."""

    def log_likelihood(self, poses: FloatArray, observation: Observation) -> FloatArray:
        """Return log p(y | x) (N,) of poses (N, 22), up to a constant independent of the pose."""

    def forearm(self, pose: FloatArray, inner: FloatArray) -> tuple[Window, Float32Array]:
        """Return a window around the forearm of a pose (22,), and its depth (h, w), mm; 0 where hidden."""


class RenderedCosts:
    """Costs and likelihoods of hand poses by rendering.

    Args:
        device: renders the poses.
        hand: bones, and the lean skin, which is rendered.
        camera: pinhole intrinsics of the depth images.
        settings: cost and window.
        particles: largest number of poses per call.
    """

    def __init__(
        self,
        device: RenderingDevice,
        hand: HandModel,
        camera: Camera,
        settings: ObservationSettings,
        particles: int,
    ) -> None:
        tile = (settings.tile_px, settings.tile_px)
        self._anatomy, self._camera, self._settings = hand.anatomy, camera, settings
        self._cost = COSTS[settings.cost]
        self._model = (
            pixel_mixture(settings.mixture, settings.unread_weight) if settings.models_pixels else None
        )
        self._many = device.depth_renderer(hand.lean_with_arm, tile, particles)
        self._one = device.depth_renderer(hand.lean_with_arm, tile, 1)

    def costs(self, poses: FloatArray, observation: Observation) -> FloatArray:
        """Return costs D (N,), mm, of poses (N, 22)."""
        return self._cost(self._sums(poses, observation, None), self._settings)

    def log_likelihood(self, poses: FloatArray, observation: Observation) -> FloatArray:
        """Return log p(y | x) (N,) of poses (N, 22), up to a constant independent of the pose."""
        return self.scores(poses, observation).log_likelihood

    def scores(self, poses: FloatArray, observation: Observation) -> Scores:
        """Return costs and likelihoods of poses (N, 22), rendered once.

        The mixture's log-likelihood is -(n_eff / n) R with R of ``union_misfit`` and n_eff / n of
        ``reading_share``; other costs use ``log_gibbs``.
        """
        sums = self._sums(poses, observation, self._model)
        costs = self._cost(sums, self._settings)
        if self._model is None:
            return Scores(costs, log_gibbs(costs, self._settings))
        targets = observation.image[observation.image > 0]
        if not targets.size:
            return Scores(costs, np.zeros_like(costs))
        z = float(np.median(targets))
        misfit = union_misfit(sums, self._model, z)
        correlation = self._settings.mixture.correlation_mm
        return Scores(costs, -reading_share(z, observation.window.step, self._camera, correlation) * misfit)

    def forearm(self, pose: FloatArray, inner: FloatArray) -> tuple[Window, Float32Array]:
        """Return a window around the forearm of a pose (22,), and its depth (h, w), mm; 0 where hidden."""
        wrist = joint_positions(self._anatomy, pose[None], inner[THUMB])[0, 0]
        tile = self._settings.tile_px
        window = forearm_window(wrist, inner[:3], self._anatomy.scale, self._camera, tile)
        without = inner.copy()
        without[:3] = 0.0
        both, hand = (
            self._one.depth(
                transforms_with_forearm(self._anatomy, pose[None], numbers), self._camera, window
            )[0]
            for numbers in (inner, without)
        )
        return window, np.where(hand > 0.0, np.float32(0.0), both)

    def _sums(self, poses: FloatArray, observation: Observation, model: PixelMixture | None) -> TileSums:
        renderer = self._one if len(poses) == 1 else self._many
        transforms = transforms_with_forearm(self._anatomy, poses, observation.inner)
        clamp = self._settings.clamp_mm
        return renderer.sums(
            transforms, self._camera, observation.window, Comparison(observation.image, clamp, model)
        )


# Proposal distributions, by configuration name


class Proposal(NamedTuple):
    """A way to draw particles.

    Attributes:
        fits_frames: whether each frame is fitted locally, particles are drawn around the fits, and the whole
            image is searched for a lost hand; else the motion model alone proposes.
        sampling: used without fits.
    """

    fits_frames: bool
    sampling: Sampling


PROPOSALS: Mapping[str, Proposal] = MappingProxyType(
    {
        "guided": Proposal(fits_frames=True, sampling="marginal"),
        "marginal": Proposal(fits_frames=False, sampling="marginal"),
        "paper": Proposal(fits_frames=False, sampling="paper"),
    }
)


def fits_frames(config: HandConfig) -> bool:
    """Return whether a configuration's tracker fits every frame locally."""
    return config.filter.kind != "pso" and PROPOSALS[config.filter.proposal].fits_frames


class CountedLikelihood:
    """Log-likelihood that counts the evaluated poses."""

    def __init__(self, log_likelihood: LogLikelihood) -> None:
        self._log_likelihood, self.count = log_likelihood, 0

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Return log p (N,) of poses (N, 22)."""
        self.count += len(poses)
        return self._log_likelihood(poses)
