"""What a frame says about where the hand is: local fits, as approximations of the likelihood.

`LocalFitter` makes them for the filter, from several starts; `HandFits` for the smoother, with what all other
frames expect as their prior. A smoother's fit is weighed by its own residual (**[ours]**): the
filter, which has to try all poses by one measure, takes a pixel's noise from the sensor; here it is taken
from the fit's own union cost D, the mean absolute residual, so sigma = sqrt(pi / 2) D. Where a hand is seen
well, information is some ten times that of the filter's fits, and where half of it is hidden or cut off, a
tenth.
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
"""What a smoother's memory of a frame calls its inner numbers."""
FOREARM_CONFIDENCE = "forearm_confidence"
"""What it calls that of the filter's forearm; 0 without one."""
USUAL_STEP_S = 1.0 / 30.0
NOT_TOLD: FloatArray = np.empty((0, POSE_SIZE))
TOLD_PRECISION: FloatArray = 1.0 / np.square(np.repeat([20.0, 0.3, 0.4], [3, 3, 15]))
"""(21,) of a pose about what keypoints tell, 1 / mm^2 and 1 / rad^2."""
THUMB_SD = (0.25, 0.25, 0.15)  # rad; a thumb moves less than a finger (hand-findings.md)


class LocalFits(NamedTuple):
    """The fits of one frame.

    Attributes:
        modes: approximations of log p(y | x), the most probable first.
        cost: union cost D of the best, mm, with the smooth skin.
        renders: how many poses were drawn for it.
        inner: (6,) inner numbers of the best (``hand.fit.skeleton``).
    """

    modes: LikelihoodModes
    cost: float
    renders: int
    inner: FloatArray


class FrameReading(NamedTuple):
    """An observation as fits read it.

    Attributes:
        tile: the observation.
        depth_mm: of its target pixels, their median.
        share: how much of an independent reading a pixel is.
        height: log p that all target pixels cost together where nothing explains them.
    """

    tile: Tile
    depth_mm: float
    share: float
    height: float


_REFOLD_ITERATIONS = 3
"""From each fold of each finger, where the best fit is worse than usual."""
SHARPENING = 1.6
"""The likelihood is so much sharper than a fit's own residuals: the outline adds to it."""
ALTERNATIVE_MM, APART_MM, MOST_MODES = 1.0, 6.0, 4
"""Fits whose cost is so much above the best's are modes as well, if a joint lies so far from theirs."""
USUAL_MOTION = ComponentSettings(position_mm=12.0, rotation_rad=0.12, flexion_rad=0.33, abduction_rad=0.1)
"""Standard deviation of a usual frame's motion about the prediction, for the fits alone."""


def fit_terms(config: HandConfig) -> Terms:
    """Return the weights of residuals that a configuration's observations ask for."""
    return Terms(clamp_mm=config.observation.clamp_mm, unread_weight=config.observation.unread_weight)


class LocalFitter:
    """Fits a hand to frames from several starts.

    Args:
        config: parameters.
        hand: the model.
        camera: of the depth images.
        thumb: what is expected of its thumb.
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
        enough_mm: float = np.inf,
        told: FloatArray = NOT_TOLD,
    ) -> LocalFits:
        """Return the fits of one frame.

        Args:
            observation: with at least one target pixel.
            expected: (22,) prediction, the prior's mean but for its position.
            others: (M, 22) further starts.
            dt: time since the frame before, s.
            rng: of the starts' scatter.
            enough_mm: a best fit that costs more is tried with each finger folded otherwise.
            told: (K, 22) poses from elsewhere: starts of their own, whose prior is about themselves.
        """
        settings, fitter = self._settings, self.fitter
        reading = self.read(observation)
        tile = reading.tile
        starts = fitter.aligned(tile, fit_starts(expected, others, settings.starts, self._space, rng))
        prior = PosePrior(expected, motion_precision(dt))
        priors = [prior.about(start[:3]) for start in starts]
        priors += [PosePrior(pose, TOLD_PRECISION) for pose in told]
        fits = fitter.descend(tile, np.concatenate([starts, told]), priors, settings.iterations)
        anywhere = prior.anywhere
        tile = _with_inner(tile, self._best(tile, fits, anywhere).inner)
        best = fitter.swapped(tile, [fits], anywhere)[0]
        fits += fitter.descend(tile, best[None], [prior.about(best[:3])], settings.polish)
        renders = len(starts) * (settings.iterations + 2) + 5 * (len(starts) - 1) + settings.polish + 1
        renders += len(told) * (settings.iterations + 6)
        best_fit = self._best(tile, fits, anywhere)
        if _cost(best_fit) > enough_mm:
            refolded, more = self._refolded(tile, best_fit.pose, prior)
            fits, renders = fits + refolded, renders + more
            best_fit = self._best(tile, fits, anywhere)
        modes = self._likelihood(reading._replace(tile=_with_inner(tile, best_fit.inner)), fits)
        return LocalFits(modes, _cost(best_fit), renders + len(modes), best_fit.inner)

    def _refolded(self, tile: Tile, pose: FloatArray, prior: PosePrior) -> tuple[list[Fit], int]:
        """Fits from a pose (22,) with one finger at a time in another fold, and how many poses they drew."""
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
        """The most probable of fits."""
        return fits[int(np.argmin(self.fitter.objectives(tile, fits, prior)))]

    def _likelihood(self, reading: FrameReading, fits: Sequence[Fit]) -> LikelihoodModes:
        chosen = [self.fitter.assessed(reading.tile, fit.pose) for fit in self.likeliest(reading, fits)]
        noise_sd = float(self._mixture.noise_sd(np.array(reading.depth_mm)))
        scale = reading.share * SHARPENING * (self.sigma_mm / noise_sd) ** 2
        heights = self._log_heights(reading, chosen)
        return self.modes(chosen, np.full(len(chosen), scale), heights, reading.tile.expected[THUMB])

    def _log_heights(self, reading: FrameReading, fits: Sequence[Fit]) -> FloatArray:
        """log p(y | x) (K,) of fits, from what they cost and how plausible they are."""
        per_mm = reading.height / self._config.observation.clamp_mm
        poses = np.array([fit.pose for fit in fits])
        doubts: FloatArray = self.fitter.potentials(poses, reading.tile.inner)
        return -per_mm * np.array([_cost(fit) for fit in fits]) - doubts

    def read(self, observation: Observation) -> FrameReading:
        """Return an observation with at least one target pixel as fits read it."""
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
        """Return the likelihood about fits, its sharpness (K,) times theirs, with the anatomy's factor.

        Args:
            fits: K of them.
            scales: (K,).
            log_heights: (K,).
            thumb: (2,) what fits expected of its inner angles; by default what they found.
        """
        parts = [
            without_inner(fit, scale, self.fitter.anatomy(fit), fit.inner[THUMB] if thumb is None else thumb)
            for scale, fit in zip(scales, fits, strict=True)
        ]
        return LikelihoodModes(
            np.array([fit.pose for fit in fits]),
            np.array([gradient for gradient, _ in parts]),
            np.array([information for _, information in parts]),
            log_heights,
        )

    def likeliest(self, reading: FrameReading, fits: Sequence[Fit]) -> list[Fit]:
        """Return the most probable fits whose joints lie apart, of those that cost little more than the best.

        Of fingers that nothing shows all folds cost the same, and the anatomy tells which are likely.
        """
        limit = min(map(_cost, fits)) + ALTERNATIVE_MM
        near = [fit for fit in fits if _cost(fit) <= limit]
        order = np.argsort(-self._log_heights(reading, near), kind="stable")
        chosen: list[Fit] = []
        joints: list[FloatArray] = []
        for fit in (near[k] for k in order):
            if len(chosen) == MOST_MODES:
                break
            here = joint_positions(self._anatomy, fit.pose[None])[0]
            apart = [np.linalg.norm(here - there, axis=1).max() for there in joints]
            if min(apart, default=np.inf) > APART_MM:
                chosen.append(fit)
                joints.append(here)
        return chosen


THUMB_LEFT = 0.25
"""Share of its inner angles' standard deviations over which a thumb is integrated out: all particles have the
fitted ones, and proposals as wide as if each had its own are missed by most of them. On the own model, with
sds of 10 and 15 degrees, joints are 1.16 mm off with the whole of them, 1.11 with next to nothing; people's
backs, where thumbs are hidden, are better with more (3.6 and 3.9 for 4.0 and 4.1 mm)."""
LEFT_PRECISION: FloatArray = np.append(
    1.0 / np.square([SWING_SD, SWING_SD, GIRTH_SD]), FREE_THUMB.precision / THUMB_LEFT**2
)
"""(5,) of the unknowns that are integrated out."""


def without_inner(
    fit: Fit, scale: float, own: NormalEquations, thumb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Gradient (21,) and information (21, 21) of the pose alone: the inner numbers are integrated out.

    The forearm's prior is about where it was found. The thumb's pull to what is expected counts as much as
    the image's that it held out against: where a fit came to rest both are equal.

    Args:
        fit: of the image.
        scale: of its weights.
        own: the anatomy's.
        thumb: (2,) what the fit expected of its inner angles.
    """
    matrix, vector = scale * fit.data.matrix + own.matrix, scale * fit.data.vector + own.vector
    p, a = slice(0, TANGENT_SIZE), slice(TANGENT_SIZE, None)
    vector[THUMB_PLACE:] += scale * FREE_THUMB.precision * (thumb - fit.inner[THUMB])
    matrix[a, a] += np.diag(LEFT_PRECISION)
    information, gradient = eliminated(matrix, vector, p, a)
    return gradient, 0.5 * (information + information.T)


def _with_inner(tile: Tile, inner: FloatArray) -> Tile:
    """A tile with inner numbers (6,) that were fitted to it.

    A forearm is from then on expected where it was found, not where the hand's pixels were told from its;
    what is expected of a thumb no frame tells.
    """
    expected = inner.copy()
    expected[THUMB] = tile.expected[THUMB]
    return tile._replace(inner=inner, expected=expected)


def _cost(fit: Fit) -> float:
    return float(fit.cost[0])


def motion_precision(dt: float) -> FloatArray:
    """1 / variance (21,) of a pose after dt seconds about its prediction, for the fits alone."""
    sd = tangent_vector(USUAL_MOTION)
    sd[6:9] = np.minimum(sd[6:9], THUMB_SD)
    precision: FloatArray = USUAL_STEP_S / dt / np.square(sd)
    return precision


BELIEVED_MM = 2.0
"""Where fits leave more, the filter's estimate is smoothed instead."""
_REFIT_ITERATIONS = 4
"""Of a frame's fit from what all other frames expect."""
_LEFT_SHARPENING = 3.5
"""The likelihood is so much sharper than the residuals that a fit leaves."""
_HEIGHT_SHARE = 0.3
"""How much the cost counts where a frame has several fits, against the others' say."""
LEAST_COST_MM = 0.5
"""The readings' own steps: no fit leaves less."""
SD_PER_COST = float(np.sqrt(np.pi / 2.0))
"""Standard deviation over mean absolute value of a normal distribution."""
STEP = np.concatenate([np.full(3, 30.0), np.full(3, 0.4), np.full(15, 0.5)])
"""(21,) as far as one iteration goes, mm and rad."""


class HandFits:
    """The local fits of frames, made from what is kept of them (`filtering.fit_smoothing.FrameFits`).

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
        """Return what is kept of a frame: its window, where the filter's fits are, and what it made of them.

        Args:
            observation, modes: None where there was nothing to compare with.
            pose: (22,) the filter's estimate.
            confidence: of it.
        """
        poses, count = np.zeros((MOST_MODES, POSE_SIZE)), 0
        image, place = np.zeros((self._size, self._size), dtype=np.float32), np.zeros(3, dtype=np.int64)
        inner = NO_INNER
        if observation is not None and modes is not None:
            count, inner = len(modes), observation.inner
            poses[:count], image = modes.poses, observation.image
            place[:] = observation.window.left, observation.window.top, observation.window.step
        kept = {"image": image, "place": place, "fits": poses, "count": count, INNER: inner}
        return kept | {"estimate": pose, "trust": self._trust(confidence)}

    def known(self, frame: Memory) -> LikelihoodModes | None:
        """Return the filter's fits, assessed again, or its estimate where they leave much; None without any.

        Where the hand is not the model's, the cheapest pose is not the true one, and fits that are weighed by
        their costs alone are worse than what the filter made of them.
        """
        if not frame["count"]:
            return None
        reading = self._reading(frame)
        fits = self._fits_at(reading, frame["fits"][: int(frame["count"])])
        if self._are_believed(fits):
            return scaled(self._assessed(reading, fits), float(frame["trust"]))
        estimate = self._assessed(reading, self._fits_at(reading, frame["estimate"][None]))
        at_rest = replace(estimate, gradients=np.zeros_like(estimate.gradients))
        return scaled(at_rest, float(frame["trust"]))

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return these and one more, fitted from a belief's mean with the belief as its prior.

        Not where the filter's estimate stands in for fits, which has no gradient, nor where it is doubted.
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

    def _are_believed(self, fits: Sequence[Fit]) -> bool:
        """Whether what fits leave is so little that the model must be the hand's."""
        return min(_cost(fit) for fit in fits) <= BELIEVED_MM

    def _trust(self, confidence: float) -> float:
        """How much an estimate's information counts: all of what is more probably right than wrong.

        (p / (1 - p))^2 where it is less: of a hand that is most probably elsewhere next to nothing, and the
        frames before and after it bridge the gap.
        """
        if not self._is_calibrated or confidence >= PROBABLY:
            return 1.0
        return (confidence / (1.0 - confidence)) ** 2

    def _refitted(self, reading: FrameReading, belief: StateGaussian) -> LikelihoodModes:
        """The likelihood about the best pose on the way from a belief's mean to the posterior's maximum.

        Gauss-Newton: (1 + C H)^-1 (C g + off), C the belief's covariance, off from the pose to its mean.
        """
        size = belief.velocity.size
        C = belief.covariance[:size, :size]
        precision = np.linalg.pinv(C, hermitian=True)  # what is known for sure may not vary at all
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
        """What poses (K, 22) leave, as they are."""
        return [self._local.fitter.assessed(reading.tile, pose) for pose in poses]

    def _assessed(self, reading: FrameReading, fits: Sequence[Fit]) -> LikelihoodModes:
        """The likelihood about fits, noise taken from what each leaves, and the anatomy's factor."""
        fitter, poses = self._local.fitter, np.array([fit.pose for fit in fits])
        cost = np.array([_cost(fit) for fit in fits])
        noise_sd = SD_PER_COST * np.maximum(cost, LEAST_COST_MM)
        scales = reading.share * _LEFT_SHARPENING * (self._local.sigma_mm / noise_sd) ** 2
        height = _HEIGHT_SHARE * reading.height / self._clamp_mm
        return self._local.modes(fits, scales, -height * cost - fitter.potentials(poses, reading.tile.inner))

    def _reading(self, frame: Memory) -> FrameReading:
        image = np.asarray(frame["image"])
        left, top, step = (int(value) for value in frame["place"])
        window = Window(left, top, step, self._size, self._size)
        return self._local.read(
            Observation(window, image, int(np.count_nonzero(image > 0)), np.asarray(frame[INNER]))
        )
