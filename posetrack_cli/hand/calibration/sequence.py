"""A hand tracked through a recording by local fits alone: the poses that a calibration starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.anatomy import POSE_SIZE
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.space import HandSpace, inside_limits
from posetrack_cli.recording.base import Frame

_KEPT_VELOCITY = 0.8
_LOST_COST_SHARE = 0.45
"""Share of the clamp: a hand that fits no better is searched for again."""
_SEARCHED_EVERY = 8
"""Frames between searches of the whole image for a hand that fits badly."""
_SPACE = HandSpace()


@dataclass(frozen=True, eq=False)
class SequenceFit:
    """Poses of a hand in frames.

    Attributes:
        poses: (F, 22).
        costs: (F,) union costs, mm; infinite where no hand was found.
    """

    poses: FloatArray
    costs: FloatArray


class SequenceFitter:
    """Fits one hand model to frame after frame.

    Args:
        config: of window, segmentation, detection and fits.
        hand: the model.
        camera: of the depth images.
    """

    def __init__(self, config: HandConfig, hand: HandModel, camera: Camera) -> None:
        self._config = config
        self._finder = Acquisition(config, hand, camera)
        self._observer, self._local_fitter = self._finder.observer, self._finder.local_fitter

    def fit(self, frames: Sequence[Frame], rng: np.random.Generator) -> SequenceFit:
        """Return the hand's poses; where it is lost the whole image is searched."""
        poses, costs = np.zeros((len(frames), POSE_SIZE)), np.full(len(frames), np.inf)
        poses[:, 6] = 1.0
        worst = _LOST_COST_SHARE * self._config.observation.clamp_mm
        for k, frame in enumerate(frames):
            known = k > 0 and costs[k - 1] < worst
            before = poses[k - 2] if k > 1 and costs[k - 2] < worst else poses[k - 1]
            found = self._next(frame, poses[k - 1], before, rng) if known else self._first(frame)
            if known and found is not None and k % _SEARCHED_EVERY == 0:
                found = self._unless_elsewhere(frame, found)
            if found is not None:
                poses[k], costs[k] = found
        return SequenceFit(poses, costs)

    def _next(
        self, frame: Frame, last: FloatArray, before: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, float] | None:
        moved = _KEPT_VELOCITY * _SPACE.local(before[None], last[None])
        expected = inside_limits(_SPACE.retract(last[None], moved))[0]
        observation = self._observer.observe(frame.depth, expected)
        if observation.target_pixels == 0:
            return None
        fits = self._local_fitter.fit(observation, expected, last[None], 1.0 / 30.0, rng)
        return inside_limits(fits.modes.poses[:1])[0], fits.cost

    def _unless_elsewhere(self, frame: Frame, here: tuple[FloatArray, float]) -> tuple[FloatArray, float]:
        """A fit, or that of a new search where it is far better: a track may be upside down."""
        settings = self._config.status
        if here[1] <= settings.sure_mm:
            return here
        there = self._first(frame)
        return here if there is None or there[1] > here[1] - settings.better_mm else there

    def _first(self, frame: Frame) -> tuple[FloatArray, float] | None:
        """The hand in the image, wherever it is."""
        found = self._finder.search(frame.depth)
        return None if found is None else (inside_limits(found.pose[None])[0], found.cost)
