"""Drawn hands for the tests of fits: what a perfect sensor sees of the fitted skin."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.fitter import HandFitter
from posetrack_cli.hand.fit.skeleton import NO_INNER, THUMB, Skeleton, Skin, empty_posed, pose_bones
from posetrack_cli.hand.model.anatomy import TANGENT_SIZE
from posetrack_cli.hand.model.hand import HandModel, average_hand
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation, window_around
from posetrack_cli.rendering.raster import View, draw, empty_drawing
from support.hand import KINECT

TILE_PX = 64
WALL_MM = 1500.0
RIGHT, LEFT = average_hand(), average_hand("left")
HANDS = {"right": RIGHT, "left": LEFT}


def drawn_depth(
    skeleton: Skeleton,
    skin: Skin,
    pose: FloatArray,
    view: View,
    size: int = TILE_PX,
    inner: FloatArray = NO_INNER,
) -> FloatArray:
    """Depth (size, size), mm, of a pose (22,) with inner numbers (6,), infinite where nothing is drawn."""
    posed, drawing = empty_posed(), empty_drawing(skin.mesh, size, size)
    pose_bones(skeleton, pose, inner, posed)
    assert draw(skin.mesh, posed.bones, view, drawing)
    return np.divide(1.0, drawing.inverse, out=np.full((size, size), np.inf), where=drawing.inverse > 0)


def observed(
    hand: HandModel,
    fitter: HandFitter,
    pose: FloatArray,
    wall: float = WALL_MM,
    inner: FloatArray = NO_INNER,
) -> Observation:
    """What a perfect sensor sees of a hand before a wall, in the window around the hand.

    Inner numbers (6,) are those that it is drawn with; what it is expected to have is 0.
    """
    joints = joint_positions(hand.anatomy, pose[None], inner[THUMB])[0]
    window = window_around(joints, KINECT, ObservationSettings())
    view = View(*window.tile_projection(KINECT))
    depth = drawn_depth(fitter.hand.skeleton, fitter.hand.skin, pose, view, inner=inner)
    image = np.where(np.isfinite(depth), depth, -wall).astype(np.float32)
    return Observation(window, image, int(np.count_nonzero(image > 0)))


def numerical_gradient(function, size: int = TANGENT_SIZE, step: float = 1e-5) -> FloatArray:  # type: ignore[no-untyped-def]
    """Central differences at 0 of a function of a vector (size,)."""
    return np.array([(function(d) - function(-d)) / (2.0 * step) for d in step * np.eye(size)])
