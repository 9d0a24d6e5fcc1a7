"""Evidence of the skin for focal lengths **[ours]**.

The places of some hundred skin corners in views of a turning face determine the focal length: structure from
motion with self-calibration. For each focal length, poses and points are adjusted again, starting from its
neighbour. Their priors are so wide that the known shape of the face has no influence except on the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.skin.equations import SkinPrior, adjust_skin, skin_cost
from posetrack_cli.head.skin.map import MatchedSkin

POSE_SD = np.array([60.0, 60.0, 250.0, *np.radians([30.0, 30.0, 30.0])])
"""(6,) mm and rad about the poses of the feature points."""
POINT_SD = np.array([3.0, 3.0, 10.0])
"""(3,) mm about the surface."""
STEPS = 4
"""Gauss-Newton steps per focal length."""
INDEPENDENT = 400
"""Number of independent observations: expressions and sliding matches err alike in many of them."""


class Change(NamedTuple):
    """Another camera.

    Attributes:
        log_focal: logarithm of a factor on the focal lengths.
        centre: (2,) shift of the principal point, over the focal lengths before.
    """

    log_focal: float
    centre: FloatArray


def log_likelihoods(skin: MatchedSkin, camera: Camera, changes: Sequence[Change]) -> FloatArray:
    """Return the log-likelihood, up to a constant, of other cameras.

    Args:
        skin: matched with a camera.
        camera: that camera.
        changes: (n,) of it, each near its neighbours.
    """
    costs = np.empty(len(changes))
    first = int(np.argmin([abs(one.log_focal) + np.abs(one.centre).sum() for one in changes]))
    # outwards from the camera of the matches
    for order in (range(first, len(changes)), range(first, -1, -1)):
        now, start = NO_CHANGE, (skin.map.poses, skin.map.points)
        for k in order:
            start = _seen_alike(start[0], now, changes[k]), start[1]
            now = changes[k]
            costs[k], start = _adjusted(skin, camera, now, start)
    if not np.isfinite(costs).all():  # a degenerate set of views is no evidence
        return np.zeros(len(changes))
    return -costs * min(1.0, INDEPENDENT / len(skin.observed.views))


def _adjusted(
    skin: MatchedSkin, camera: Camera, change: Change, start: tuple[HeadPose, FloatArray]
) -> tuple[float, tuple[HeadPose, FloatArray]]:
    """Return the least cost with another camera, and the poses and points there."""
    factor = float(np.exp(change.log_focal))
    f = factor * np.array([camera.fx, camera.fy])
    observed = skin.observed._replace(rays=(skin.observed.rays - change.centre) / factor)
    poses = _seen_alike(skin.prior.poses, NO_CHANGE, change)
    prior = SkinPrior(poses, skin.prior.surface, POSE_SD, POINT_SD)
    found = adjust_skin(observed, prior, f, STEPS, start)
    return skin_cost(observed, *found, prior, f), found


def _seen_alike(poses: HeadPose, now: Change, then: Change) -> HeadPose:
    """Return the poses that another camera sees at the same places and of the same size."""
    farther = float(np.exp(then.log_focal - now.log_focal))
    places = poses.position[:, :2] / poses.position[:, 2:] * np.exp(now.log_focal) + now.centre
    depths = farther * poses.position[:, 2:]
    rays = (places - then.centre) / np.exp(then.log_focal)
    return HeadPose(np.hstack([rays * depths, depths]), poses.quaternion)


NO_CHANGE = Change(0.0, np.zeros(2))
