"""How well a depth image fits a hand pose: costs over image regions, and their Gibbs likelihoods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.mesh import hand_mesh
from posetrack_cli.hand.observation import Observation
from posetrack_cli.rendering.sums import TileSums
from posetrack_cli.rendering.tiled import TiledDepthRenderer

Cost = Callable[[TileSums, ObservationSettings], FloatArray]


def paper_cost(sums: TileSums, settings: ObservationSettings) -> FloatArray:
    """D of eq. (4): mean of min(|d - y|, c_max) over the rendered pixels of the window, mm.

    A rendered pixel without a reading counts c_max; a hand that falls on no pixel at all costs c_max
    too **[fix]** (the mean over nothing is not defined).

    Returns:
        (N,) costs in 0..c_max.
    """
    missed = sums.rendered_only + sums.unread
    rendered = sums.both + missed
    total = sums.error + settings.clamp_mm * missed
    return np.divide(total, rendered, out=np.full_like(total, settings.clamp_mm), where=rendered > 0)


def union_cost(sums: TileSums, settings: ObservationSettings) -> FloatArray:
    """D over the union of rendered r and observed o **[ours]**, mm; disagreeing regions count c_max.

        D = ( sum over r and o of min(|d - y|, c_max) + c_max (|r \\ o| + |o \\ r|) ) / |r or o|

    A rendered pixel that the sensor has no reading of counts as ``unread_weight`` of a pixel: at a hand's
    edge most readings are missing, and a missing reading is not background.

    Returns:
        (N,) costs in 0..c_max.
    """
    disagree = sums.rendered_only + settings.unread_weight * sums.unread + (sums.observed - sums.both)
    union = sums.both + disagree
    total = sums.error + settings.clamp_mm * disagree
    return np.divide(total, union, out=np.full_like(total, settings.clamp_mm), where=union > 0)


COSTS: dict[str, Cost] = {"paper": paper_cost, "union": union_cost}


def log_gibbs(costs: FloatArray, settings: ObservationSettings) -> FloatArray:
    """log p(y | x) (N,) of costs D (N,), mm, up to a constant: -D^2 / (2 sigma^2) (47) or -D / sigma (3)."""
    scaled = costs / settings.sigma_mm
    return -0.5 * scaled**2 if settings.likelihood == "gaussian" else -scaled


class PoseScorer(Protocol):
    """What the tracker asks of a likelihood."""

    def costs(self, poses: FloatArray, observation: Observation) -> FloatArray:
        """Costs D (N,), mm, of poses (N, 22)."""


class RenderedCosts:
    """Costs of hand poses by rendering them.

    Args:
        context: GL context.
        anatomy: the hand.
        camera: pinhole intrinsics of the depth images.
        settings: cost and window.
        particles: how many poses a call has at most.
    """

    def __init__(
        self,
        context: Any,
        anatomy: HandAnatomy,
        camera: Camera,
        settings: ObservationSettings,
        particles: int,
    ) -> None:
        mesh = hand_mesh(anatomy, "lean")
        tile = (settings.tile_px, settings.tile_px)
        self._anatomy, self._camera, self._settings = anatomy, camera, settings
        self._cost = COSTS[settings.cost]
        self._many = TiledDepthRenderer(context, mesh, tile, particles)
        self._one = TiledDepthRenderer(context, mesh, tile, 1)

    def costs(self, poses: FloatArray, observation: Observation) -> FloatArray:
        """Costs D (N,), mm, of poses (N, 22)."""
        renderer = self._one if len(poses) == 1 else self._many
        transforms = skinning_transforms(self._anatomy, poses)
        sums = renderer.sums(
            transforms, self._camera, observation.window, observation.image, self._settings.clamp_mm
        )
        return self._cost(sums, self._settings)
