"""Frames looked at again by the smoother: local fits with what all other frames expect as their prior.

What a fit is worth is told by what it leaves (**[ours]**): the filter, which has to try all poses by one
measure, takes a pixel's noise from the sensor; here it is taken from the fit's own union cost D, the mean
absolute residual, so sigma = sqrt(pi / 2) D. Where a hand is seen well, information is some ten times that of
the filter's fits, and where half of it is hidden or cut off, a tenth.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.gaussian_smoothing import StateGaussian
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.smoothing import Memory
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import POSE_SIZE
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fitting.fitter import HandFitter
from posetrack_cli.hand.fitting.terms import Terms, Tile
from posetrack_cli.hand.likelihood import pixel_mixture, reading_share
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.observation import Observation
from posetrack_cli.hand.space import HandSpace
from posetrack_cli.rendering.window import Window

LEAST_COST_MM = 0.5
"""The readings' own steps: no fit leaves less."""
SD_PER_COST = float(np.sqrt(np.pi / 2.0))
"""Standard deviation over mean absolute value of a normal distribution."""
STEP = np.concatenate([np.full(3, 30.0), np.full(3, 0.4), np.full(15, 0.5)])
"""(21,) as far as one iteration goes, mm and rad."""


class Seen(NamedTuple):
    """A frame as fits read it.

    Attributes:
        tile: the observation.
        share: how much of an independent reading a pixel is.
        height: of log p per mm of cost.
    """

    tile: Tile
    share: float
    height: float


class HandFits:
    """The local fits of frames, made from what is kept of them (`filtering.fit_smoothing.FrameFits`).

    Args:
        config: parameters.
        hand: the model.
        camera: of the depth images.
    """

    def __init__(self, config: HandConfig, hand: HandModel, camera: Camera) -> None:
        self._camera, self._space = camera, HandSpace()
        self._settings, self._observing = config.smoothing, config.observation
        self._most, self._size = config.fit.most_modes, config.observation.tile_px
        terms = Terms(clamp_mm=config.observation.clamp_mm, unread_weight=config.observation.unread_weight)
        self._terms_sd = terms.sigma_mm
        self._fitter = HandFitter(hand, camera, self._size, terms)
        self._mixture = pixel_mixture(config.observation.mixture, config.observation.unread_weight)

    def keep(self, observation: Observation | None, modes: LikelihoodModes | None) -> dict[str, Any]:
        """Return what is kept of a frame: its window and where the filter's fits are."""
        poses, count = np.zeros((self._most, POSE_SIZE)), 0
        image, place = np.zeros((self._size, self._size), dtype=np.float32), np.zeros(3, dtype=np.int64)
        if observation is not None and modes is not None:
            count = len(modes)
            poses[:count], image = modes.poses, observation.image
            place[:] = observation.window.left, observation.window.top, observation.window.step
        return {"image": image, "place": place, "fits": poses, "count": count}

    def known(self, frame: Memory) -> LikelihoodModes | None:
        """Return the filter's fits, assessed anew; None where it had none."""
        if not frame["count"]:
            return None
        return self._assessed(self._seen(frame), frame["fits"][: int(frame["count"])])

    def more(self, frame: Memory, known: LikelihoodModes, belief: StateGaussian) -> LikelihoodModes:
        """Return these and one more, fitted from a belief's mean with the belief as its prior."""
        if not self._settings.refit_iterations:
            return known
        found = self._refitted(self._seen(frame), belief)
        return LikelihoodModes(
            np.concatenate([known.poses, found.poses]),
            np.concatenate([known.gradients, found.gradients]),
            np.concatenate([known.information, found.information]),
            np.concatenate([known.log_heights, found.log_heights]),
        )

    def _refitted(self, seen: Seen, belief: StateGaussian) -> LikelihoodModes:
        """The likelihood about the best pose on the way from a belief's mean to the posterior's maximum.

        Gauss-Newton: (1 + C H)^-1 (C g + off), C the belief's covariance, off from the pose to its mean.
        """
        size = belief.velocity.size
        C = belief.covariance[:size, :size]
        precision = np.linalg.pinv(C, hermitian=True)  # what is known for sure may not vary at all
        pose = belief.pose
        best = here = self._assessed(seen, pose[None])
        highest = float(here.log_heights[0])
        for _ in range(self._settings.refit_iterations):
            off = self._space.local(pose, belief.pose)
            step = np.linalg.solve(np.eye(size) + C @ here.information[0], C @ here.gradients[0] + off)
            pose = self._space.retract(pose[None], np.clip(step, -STEP, STEP)[None])[0]
            here, off = self._assessed(seen, pose[None]), self._space.local(pose, belief.pose)
            height = float(here.log_heights[0] - 0.5 * off @ precision @ off)
            if height > highest:
                best, highest = here, height
        return best

    def _assessed(self, seen: Seen, poses: FloatArray) -> LikelihoodModes:
        """The likelihood about poses (K, 22), noise taken from what each leaves, and the anatomy's factor."""
        fits = [self._fitter.assessed(seen.tile, pose) for pose in poses]
        own = [self._fitter.anatomy(pose) for pose in poses]
        cost = np.array([fit.cost[0] for fit in fits])
        noise_sd = SD_PER_COST * np.maximum(cost, LEAST_COST_MM)
        scale = seen.share * self._settings.sharpening * (self._terms_sd / noise_sd) ** 2
        return LikelihoodModes(
            poses,
            np.array([s * fit.data.vector + o.vector for s, fit, o in zip(scale, fits, own, strict=True)]),
            np.array([s * fit.data.matrix + o.matrix for s, fit, o in zip(scale, fits, own, strict=True)]),
            -seen.height * cost - self._fitter.potentials(poses),
        )

    def _seen(self, frame: Memory) -> Seen:
        image = np.asarray(frame["image"])
        left, top, step = (int(value) for value in frame["place"])
        window = Window(left, top, step, self._size, self._size)
        readings = image[image > 0]
        tile = self._fitter.tile(Observation(window, image, readings.size))
        z = float(np.median(readings))
        share = reading_share(z, step, self._camera, self._observing.mixture.correlation_mm)
        pixels = share * readings.size * float(self._mixture.unexplained(np.array(z)))
        return Seen(tile, share, self._settings.height_share * pixels / self._observing.clamp_mm)
