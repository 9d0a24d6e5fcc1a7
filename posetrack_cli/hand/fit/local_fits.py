"""Local fits of a frame: Gaussian approximations of the likelihood around its modes.

`LocalFitter` fits from several starts, for the filter. `HandFits` fits for the smoother, with the smoothed
prediction as prior. The filter compares all poses by one noise level, that of the sensor. The smoother
weights each fit by its own residual **[ours]**: from the union cost D, the mean absolute residual, sigma =
sqrt(pi / 2) D. A clearly visible hand thus carries about ten times the information of the filter's fits, a
half hidden one a tenth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.modes import LikelihoodModes, scaled
from posetrack_cli.filtering.smoothing import Memory, StateGaussian
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.least_squares import eliminated
from posetrack_cli.hand.config import ComponentSettings, HandConfig
from posetrack_cli.hand.fit.fitter import HandFitter, PosePrior, fit_starts, refolds
from posetrack_cli.hand.fit.gauss_newton import FREE_THUMB, GIRTH_SD, SWING_SD, Fit, ThumbPrior
from posetrack_cli.hand.fit.likelihood import pixel_mixture, reading_share
from posetrack_cli.hand.fit.normal_equations import THUMB_PLACE, NormalEquations
from posetrack_cli.hand.fit.skeleton import NO_INNER, THUMB
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import POSE_SIZE, TANGENT_SIZE
from posetrack_cli.hand.model.hand import HandModel, tangent_vector
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.rendering.port import Window
from posetrack_cli.tracking.confidence import PROBABLY
from posetrack_cli.tracking.velocity import BodySpace

INNER = "inner"
"""Key of a frame's inner numbers in a smoother's memory."""
FOREARM_CONFIDENCE = "forearm_confidence"
"""Key of the filter's forearm confidence there; 0 without a forearm."""
USUAL_STEP_S = 1.0 / 30.0
NO_EXTRA_STARTS: FloatArray = np.empty((0, POSE_SIZE))
KEYPOINT_PRECISION: FloatArray = 1.0 / np.square(np.repeat([20.0, 0.3, 0.4], [3, 3, 15]))
"""(21,) precision of a fit around a pose from keypoints, 1 / mm^2 and 1 / rad^2."""
THUMB_SD = (0.25, 0.25, 0.15)  # rad; a thumb moves less than a finger


class LocalFits(NamedTuple):
    """Fits of one frame.

    Attributes:
        modes: approximations of log p(y | x), most probable first.
        cost: union cost D of the best, mm, with the smooth skin.
        renders: number of rendered poses.
        inner: (6,) inner numbers of the best (``hand.fit.skeleton``).
    """

    modes: LikelihoodModes
    cost: float
    renders: int
    inner: FloatArray


class FrameReading(NamedTuple):
    """An observation prepared for fits.

    Attributes:
        tile: the observation.
        depth_mm: median depth of its target pixels.
        share: effective share of independent readings per pixel.
        height: log p of all target pixels when none is explained.
    """

    tile: Tile
    depth_mm: float
    share: float
    height: float


_REFOLD_ITERATIONS = 3
_MOST_HIDDEN = 0.15
"""Share of a hand behind another from which its visible pixels do not tell its position."""
SHARPENING = 1.6
"""Ratio of the likelihood's information to that of the fit's residuals, which omit part of the outline."""
ALTERNATIVE_MM, APART_MM, MAX_MODES = 1.0, 6.0, 4
"""A fit is a separate mode if its cost is within ``ALTERNATIVE_MM`` of the best and some joint differs from
the other modes by more than ``APART_MM``."""
USUAL_MOTION = ComponentSettings(position_mm=12.0, rotation_rad=0.12, flexion_rad=0.33, abduction_rad=0.1)
"""Standard deviation of the motion around the prediction in one frame, for the fits alone."""


def fit_terms(config: HandConfig) -> Terms:
    """Return the residual weights of a configuration."""
    return Terms(clamp_mm=config.observation.clamp_mm, unread_weight=config.observation.unread_weight)


class LocalFitter:
    """Fits a hand to frames from several starts.

    Args:
        config: parameters.
        hand: the model.
        camera: of the depth images.
        thumb: prior of its thumb.
    """

    def __init__(
        self, config: HandConfig, hand: HandModel, camera: Camera, thumb: ThumbPrior = FREE_THUMB
    ) -> None:
        self._config, self._settings, self._camera = config, config.fit, camera
        self._anatomy, self._space = hand.anatomy, BodySpace()
        terms = fit_terms(config)
        self.sigma_mm = terms.sigma_mm
        self.fitter = HandFitter(hand, camera, config.observation.tile_px, terms, thumb=thumb)
        self._mixture = pixel_mixture(config.observation.mixture, config.observation.unread_weight)

    def fit(
        self,
        observation: Observation,
        expected: FloatArray,
        others: FloatArray,
        dt: float,
        rng: np.random.Generator,
        refold_above_mm: float = np.inf,
        extra: FloatArray = NO_EXTRA_STARTS,
    ) -> LocalFits:
        """Return the fits of one frame.

        Args:
            observation: with at least one target pixel.
            expected: (22,) prediction: the prior's mean apart from its position.
            others: (M, 22) further starts.
            dt: time since the previous frame, s.
            rng: for the random starts.
            refold_above_mm: above this cost, the best fit is retried with each finger in other folds.
            extra: (K, 22) further starts, each with a prior around itself.
        """
        settings, fitter = self._settings, self.fitter
        reading = self.read(observation)
        tile = reading.tile
        starts = fit_starts(expected, others, settings.starts, self._space, rng)
        prior = PosePrior(expected, motion_precision(dt))
        priors, anywhere = [prior] * len(starts), prior
        shows_place = observation.hidden < _MOST_HIDDEN
        if shows_place:  # of a hidden hand, the visible pixels are only some part
            starts = fitter.aligned(tile, starts)
            priors, anywhere = [prior.about(start[:3]) for start in starts], prior.anywhere
        priors += [PosePrior(pose, KEYPOINT_PRECISION) for pose in extra]
        fits = fitter.descend(tile, np.concatenate([starts, extra]), priors, settings.iterations)
        tile = _with_inner(tile, self._best(tile, fits, anywhere).inner)
        best = fitter.swapped(tile, [fits], anywhere)[0]
        last = prior.about(best[:3]) if shows_place else prior
        fits += fitter.descend(tile, best[None], [last], settings.polish)
        renders = len(starts) * (settings.iterations + 2) + 5 * (len(starts) - 1) + settings.polish + 1
        renders += len(extra) * (settings.iterations + 6)
        best_fit = self._best(tile, fits, anywhere)
        if _cost(best_fit) > refold_above_mm:
            refolded, more = self._refolded(tile, best_fit.pose, prior)
            fits, renders = fits + refolded, renders + more
            best_fit = self._best(tile, fits, anywhere)
        modes = self._likelihood(reading._replace(tile=_with_inner(tile, best_fit.inner)), fits)
        return LocalFits(modes, _cost(best_fit), renders + len(modes), best_fit.inner)

    def _refolded(self, tile: Tile, pose: FloatArray, prior: PosePrior) -> tuple[list[Fit], int]:
        """Fit a pose (22,) with one finger at a time in another fold; also return the number of renders."""
        settings, fitter = self._settings, self.fitter
        starts = refolds(pose)
        priors = [PosePrior(start, prior.precision) for start in starts]
        fits = fitter.descend(tile, starts, priors, _REFOLD_ITERATIONS)
        anywhere = prior.anywhere
        order = np.argsort(fitter.objectives(tile, fits, anywhere), kind="stable")
        likeliest = [fits[k] for k in order[: settings.starts]]
        best = fitter.swapped(tile, [likeliest], anywhere)[0]
        fits += fitter.descend(tile, best[None], [PosePrior(best, prior.precision)], settings.iterations)
        drawn = len(starts) * (_REFOLD_ITERATIONS + 1) + 5 * (len(likeliest) - 1)
        return fits, drawn + settings.iterations + 1

    def _best(self, tile: Tile, fits: Sequence[Fit], prior: PosePrior) -> Fit:
        return fits[int(np.argmin(self.fitter.objectives(tile, fits, prior)))]

    def _likelihood(self, reading: FrameReading, fits: Sequence[Fit]) -> LikelihoodModes:
        chosen = [self.fitter.assessed(reading.tile, fit.pose) for fit in self.likeliest(reading, fits)]
        noise_sd = float(self._mixture.noise_sd(np.array(reading.depth_mm)))
        scale = reading.share * SHARPENING * (self.sigma_mm / noise_sd) ** 2
        heights = self._log_heights(reading, chosen)
        return self.modes(chosen, np.full(len(chosen), scale), heights, reading.tile.expected[THUMB])

    def _log_heights(self, reading: FrameReading, fits: Sequence[Fit]) -> FloatArray:
        """Return log p(y | x) (K,) of fits from their costs and the anatomical potential."""
        per_mm = reading.height / self._config.observation.clamp_mm
        poses = np.array([fit.pose for fit in fits])
        doubts: FloatArray = self.fitter.potentials(poses, reading.tile.inner)
        return -per_mm * np.array([_cost(fit) for fit in fits]) - doubts

    def read(self, observation: Observation) -> FrameReading:
        """Prepare an observation with at least one target pixel for fits."""
        tile, depth = (
            self.fitter.tile(observation),
            float(np.median(observation.image[observation.image > 0])),
        )
        correlation = self._config.observation.mixture.correlation_mm
        share = reading_share(depth, observation.window.step, self._camera, correlation)
        height = share * tile.observed * float(self._mixture.unexplained(np.array(depth)))
        tile = tile._replace(mm_per_nat=self._config.observation.clamp_mm / height)
        return FrameReading(tile, depth, share, height)

    def modes(
        self,
        fits: Sequence[Fit],
        scales: FloatArray,
        log_heights: FloatArray,
        thumb: FloatArray | None = None,
    ) -> LikelihoodModes:
        """Return the likelihood around fits, including the anatomical factor.

        Args:
            fits: K fits.
            scales: (K,) factors on their information.
            log_heights: (K,).
            thumb: (2,) prior mean of the thumb's inner angles; by default the fitted ones.
        """
        parts = [
            marginalise_inner(
                fit, scale, self.fitter.anatomy(fit), fit.inner[THUMB] if thumb is None else thumb
            )
            for scale, fit in zip(scales, fits, strict=True)
        ]
        return LikelihoodModes(
            np.array([fit.pose for fit in fits]),
            np.array([gradient for gradient, _ in parts]),
            np.array([information for _, information in parts]),
            log_heights,
        )

    def likeliest(self, reading: FrameReading, fits: Sequence[Fit]) -> list[Fit]:
        """Return the most probable fits with distinct joints, among those that cost little more than the
        best.

        All folds of a hidden finger cost the same; the anatomical potential ranks them.
        """
        limit = min(map(_cost, fits)) + ALTERNATIVE_MM
        near = [fit for fit in fits if _cost(fit) <= limit]
        order = np.argsort(-self._log_heights(reading, near), kind="stable")
        chosen: list[Fit] = []
        joints: list[FloatArray] = []
        for fit in (near[k] for k in order):
            if len(chosen) == MAX_MODES:
                break
            here = joint_positions(self._anatomy, fit.pose[None])[0]
            apart = [np.linalg.norm(here - other, axis=1).max() for other in joints]
            if min(apart, default=np.inf) > APART_MM:
                chosen.append(fit)
                joints.append(here)
        return chosen


MARGINAL_THUMB_SHARE = 0.25
"""Share of the prior standard deviation over which a thumb's inner angles are marginalised.

All particles share the fitted angles. With the full deviation the proposal is too wide and most particles
miss; with none, hidden thumbs are too certain.
"""
MARGINAL_PRECISION: FloatArray = np.append(
    1.0 / np.square([SWING_SD, SWING_SD, GIRTH_SD]), FREE_THUMB.precision / MARGINAL_THUMB_SHARE**2
)
"""(5,) prior precision of the marginalised unknowns."""


def marginalise_inner(
    fit: Fit, scale: float, own: NormalEquations, thumb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return gradient (21,) and information (21, 21) of the pose with the inner numbers marginalised.

    The forearm's prior is centred on the fit. The thumb's prior is scaled like the image's information: at
    the fit both forces are in balance.

    Args:
        fit: of the image.
        scale: factor on its weights.
        own: normal equations of the anatomical potential.
        thumb: (2,) prior mean of its inner angles.
    """
    matrix, vector = scale * fit.data.matrix + own.matrix, scale * fit.data.vector + own.vector
    p, a = slice(0, TANGENT_SIZE), slice(TANGENT_SIZE, None)
    vector[THUMB_PLACE:] += scale * FREE_THUMB.precision * (thumb - fit.inner[THUMB])
    matrix[a, a] += np.diag(MARGINAL_PRECISION)
    information, gradient = eliminated(matrix, vector, p, a)
    return gradient, 0.5 * (information + information.T)


def _with_inner(tile: Tile, inner: FloatArray) -> Tile:
    """Return a tile with fitted inner numbers (6,).

    The prior of the forearm moves to the fit, which is more accurate than the segmentation; that of the thumb
    stays.
    """
    expected = inner.copy()
    expected[THUMB] = tile.expected[THUMB]
    return tile._replace(inner=inner, expected=expected)


def _cost(fit: Fit) -> float:
    return float(fit.cost[0])


def motion_precision(dt: float) -> FloatArray:
    """Return 1 / variance (21,) of a pose dt seconds after its prediction, for the fits alone."""
    sd = tangent_vector(USUAL_MOTION)
    sd[6:9] = np.minimum(sd[6:9], THUMB_SD)
    precision: FloatArray = USUAL_STEP_S / dt / np.square(sd)
    return precision


TRUSTED_BELOW_MM = 2.0
"""Above this cost of the fits, the filter's estimate is smoothed instead."""
_REFIT_ITERATIONS = 4
_RESIDUAL_SHARPENING = 3.5
"""Like ``SHARPENING``, for noise estimated from the fit's residual."""
_HEIGHT_SHARE = 0.3
"""Weight of the cost between several fits of a frame, against the smoothed prediction."""
MIN_COST_MM = 0.5
"""Lower bound on the residual: the quantisation of the readings."""
SD_PER_COST = float(np.sqrt(np.pi / 2.0))
"""Ratio of standard deviation to mean absolute value of a normal distribution."""
STEP = np.concatenate([np.full(3, 30.0), np.full(3, 0.4), np.full(15, 0.5)])
"""(21,) step limit of one iteration, mm and rad."""


class HandFits:
    """Local fits of frames from what the smoother's memory keeps of them
    (`filtering.fit_smoothing.FrameFits`).

    Args:
        config: parameters.
        hand: the model.
        camera: of the depth images.
    """

    def __init__(self, config: HandConfig, hand: HandModel, camera: Camera) -> None:
        self._local, self._space = LocalFitter(config, hand, camera), BodySpace()
        self._clamp_mm, self._size = config.observation.clamp_mm, config.observation.tile_px
        self._is_calibrated = config.observation.models_pixels

    def keep(
        self,
        observation: Observation | None,
        modes: LikelihoodModes | None,
        pose: FloatArray,
        confidence: float,
    ) -> dict[str, Any]:
        """Return the memory of a frame: its window, the filter's fits and its estimate.

        Args:
            observation, modes: None without an observation.
            pose: (22,) the filter's estimate.
            confidence: of the estimate.
        """
        poses, count = np.zeros((MAX_MODES, POSE_SIZE)), 0
        image, place = np.zeros((self._size, self._size), dtype=np.float32), np.zeros(3, dtype=np.int64)
        inner = NO_INNER
        if observation is not None and modes is not None:
            count, inner = len(modes), observation.inner
            poses[:count], image = modes.poses, observation.image
            place[:] = observation.window.left, observation.window.top, observation.window.step
        kept = {"image": image, "place": place, "fits": poses, "count": count, INNER: inner}
        return kept | {"estimate": pose, "trust": self._trust(confidence)}

    def known(self, frame: Memory) -> LikelihoodModes | None:
        """Return the filter's fits, reassessed, or its estimate where they fit poorly; None without fits.

        With a model of another shape, the cheapest pose is not the true one, and fits weighted by their costs
        are worse than the filter's estimate.
        """
        if not frame["count"]:
            return None
        reading = self._reading(frame)
        fits = self._fits_at(reading, frame["fits"][: int(frame["count"])])
        if self._are_trusted(fits):
            return scaled(self._assessed(reading, fits), float(frame["trust"]))
        estimate = self._assessed(reading, self._fits_at(reading, frame["estimate"][None]))
        at_rest = replace(estimate, gradients=np.zeros_like(estimate.gradients))
        return scaled(at_rest, float(frame["trust"]))

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return the fits and one more, fitted from a belief's mean with the belief as its prior.

        Nothing is added where the filter's estimate replaces the fits (no gradient) or is not trusted.
        """
        if float(frame["trust"]) < 1.0 or not known.gradients.any():
            return known
        found = self._refitted(self._reading(frame), belief)
        return LikelihoodModes(
            np.concatenate([known.poses, found.poses]),
            np.concatenate([known.gradients, found.gradients]),
            np.concatenate([known.information, found.information]),
            np.concatenate([known.log_heights, found.log_heights]),
        )

    def _are_trusted(self, fits: Sequence[Fit]) -> bool:
        """Return whether the residuals are small enough for the model to be the hand's."""
        return min(_cost(fit) for fit in fits) <= TRUSTED_BELOW_MM

    def _trust(self, confidence: float) -> float:
        """Return the weight of an estimate's information: 1 if it is probably right, else (p / (1 - p))^2.

        A hand that is probably elsewhere gets almost no weight, and neighbouring frames bridge the gap.
        """
        if not self._is_calibrated or confidence >= PROBABLY:
            return 1.0
        return (confidence / (1.0 - confidence)) ** 2

    def _refitted(self, reading: FrameReading, belief: StateGaussian) -> LikelihoodModes:
        """Return the likelihood around the best pose on the way from a belief's mean to the posterior mode.

        Gauss-Newton: (1 + C H)^-1 (C g + off), with C the belief's covariance and off the vector from the
        pose to its mean.
        """
        size = belief.velocity.size
        C = belief.covariance[:size, :size]
        precision = np.linalg.pinv(C, hermitian=True)  # C is singular along known components
        pose = belief.pose
        best = here = self._assessed(reading, self._fits_at(reading, pose[None]))
        highest = float(here.log_heights[0])
        for _ in range(_REFIT_ITERATIONS):
            off = self._space.local(pose, belief.pose)
            step = np.linalg.solve(np.eye(size) + C @ here.information[0], C @ here.gradients[0] + off)
            pose = self._space.retract(pose[None], np.clip(step, -STEP, STEP)[None])[0]
            here = self._assessed(reading, self._fits_at(reading, pose[None]))
            off = self._space.local(pose, belief.pose)
            height = float(here.log_heights[0] - 0.5 * off @ precision @ off)
            if height > highest:
                best, highest = here, height
        return best

    def _fits_at(self, reading: FrameReading, poses: FloatArray) -> list[Fit]:
        """Evaluate poses (K, 22) without a step."""
        return [self._local.fitter.assessed(reading.tile, pose) for pose in poses]

    def _assessed(self, reading: FrameReading, fits: Sequence[Fit]) -> LikelihoodModes:
        """Return the likelihood around fits, with noise from each fit's residual."""
        fitter, poses = self._local.fitter, np.array([fit.pose for fit in fits])
        cost = np.array([_cost(fit) for fit in fits])
        noise_sd = SD_PER_COST * np.maximum(cost, MIN_COST_MM)
        scales = reading.share * _RESIDUAL_SHARPENING * (self._local.sigma_mm / noise_sd) ** 2
        height = _HEIGHT_SHARE * reading.height / self._clamp_mm
        return self._local.modes(fits, scales, -height * cost - fitter.potentials(poses, reading.tile.inner))

    def _reading(self, frame: Memory) -> FrameReading:
        image = np.asarray(frame["image"])
        left, top, step = (int(value) for value in frame["place"])
        window = Window(left, top, step, self._size, self._size)
        return self._local.read(
            Observation(window, image, int(np.count_nonzero(image > 0)), np.asarray(frame[INNER]))
        )
