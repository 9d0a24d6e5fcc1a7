"""The objective that the swarm minimises: how far a hand pose is from what is seen (BMVC 2011, section 2.3).

    E = D + lambda_k kc
    D = sum min(|o_d - r_d|, d_M) / (sum (o_s or r_m) + eps)
        + lambda (1 - 2 sum (o_s and r_m) / (sum (o_s and r_m) + sum (o_s or r_m)))

with o_d and r_d observed and rendered depth, o_s the observed hand, and r_m the rendered pixels whose depth
differs from the observed by less than d_m, or where none is observed. kc = sum over adjacent fingers of
-min(phi, 0), rad, with phi the difference of their abductions: below 0 they go through each other.

What is taken how: o_s comes from depth alone (the paper: skin colour), and there is no o_d outside of it. A
rendered pixel where the sensor has no reading counts as ``unread_weight`` of one beside the hand, as in every
cost of ours: o_s is not known there. lambda = 20 and lambda_k = 10 are printed without the unit that depth is
in: they are taken with millimetres, which tracked as well as or better than with centimetres (200, 100).
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.anatomy import ANGLE_NAMES, ANGLES, FINGERS, HandAnatomy
from posetrack_cli.hand.config import HandConfig, PsoSettings
from posetrack_cli.hand.kinematics import skinning_transforms
from posetrack_cli.hand.model import HandModel
from posetrack_cli.hand.observation import Observation
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.rendering.sums import TileSums

_ABDUCTIONS = [ANGLE_NAMES.index(f"{finger}_mcp_abduction") for finger in FINGERS[1:]]


class Objective(NamedTuple):
    """E of N poses and the part of it that is a distance in depth.

    Attributes:
        total: (N,) E, mm.
        depth: (N,) its first term, 0..d_M, mm: the same number as ``union_cost`` with c_max = d_M.
    """

    total: FloatArray
    depth: FloatArray


class SwarmObjective(Protocol):
    """What the swarm's tracker asks for."""

    def evaluate(self, poses: FloatArray, observation: Observation) -> Objective:
        """E of poses (N, 22)."""


def discrepancy(sums: TileSums, settings: PsoSettings, unread_weight: float) -> Objective:
    """D (N,), mm, of its sums over the pixels; both sums empty count as the largest discrepancy **[ours]**.

    Args:
        sums: with ``matched`` for d_m and ``error`` for d_M.
        settings: d_M and lambda.
        unread_weight: of a rendered pixel without a reading.
    """
    beside = sums.rendered_only + unread_weight * sums.unread  # in r_m, for nothing is observed there
    either = sums.observed + beside
    apart = sums.error + settings.clamp_mm * (sums.observed - sums.both + beside)
    seen = either > 0
    depth = np.divide(apart, either, out=np.full_like(apart, settings.clamp_mm), where=seen)
    agreeing = 2.0 * sums.matched
    share = np.divide(agreeing, sums.matched + either, out=np.zeros_like(apart), where=seen)
    return Objective(depth + settings.overlap_mm * (1.0 - share), depth)


def crossing(anatomy: HandAnatomy, poses: FloatArray) -> FloatArray:
    """kc (N,), rad, of poses (N, 22).

    phi is taken between the fingers' directions in the palm, fan of the rest pose included: it is 0 where
    neighbours are parallel. The three pairs leave out the thumb.
    """
    mirrored = -1.0 if anatomy.is_left else 1.0
    fan = mirrored * np.arctan2(anatomy.base_rotations[1:, 1, 0], anatomy.base_rotations[1:, 0, 0])
    directions = fan + poses[:, ANGLES][:, _ABDUCTIONS]
    apart = directions[:, :-1] - directions[:, 1:]
    return np.asarray(-np.minimum(apart, 0.0).sum(axis=1))


class RenderedObjective:
    """E of hand poses by rendering them: one draw for all poses of a call.

    Args:
        device: draws the poses.
        hand: its bones, and its lean skin, which is drawn.
        camera: pinhole intrinsics of the depth images.
        config: objective, size of a tile, size of the swarm.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera, config: HandConfig) -> None:
        self._anatomy, self._camera, self._settings = hand.anatomy, camera, config.pso
        self._unread_weight = config.observation.unread_weight
        tile = (config.observation.tile_px, config.observation.tile_px)
        self._renderer = device.depth_renderer(hand.lean, tile, config.pso.particles)

    def evaluate(self, poses: FloatArray, observation: Observation) -> Objective:
        """E of poses (N, 22)."""
        transforms, settings = skinning_transforms(self._anatomy, poses), self._settings
        sums = self._renderer.sums(
            transforms,
            self._camera,
            observation.window,
            observation.image,
            settings.clamp_mm,
            match_mm=settings.match_mm,
        )
        found = discrepancy(sums, settings, self._unread_weight)
        penalty = settings.crossing_mm_per_rad * crossing(self._anatomy, poses)
        return Objective(found.total + penalty, found.depth)
