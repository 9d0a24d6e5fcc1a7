"""Gauss-Newton on a hand's pose: draw, compare, solve, step; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.geometry.kernels import quaternion_product
from posetrack_cli.hand.anatomy import POSE_SIZE, TANGENT_SIZE
from posetrack_cli.hand.fitting.anatomy_terms import SPHERES, Plausibility, add_anatomy
from posetrack_cli.hand.fitting.normal_equations import NormalEquations, clear, copy, empty_equations, gather
from posetrack_cli.hand.fitting.raster import Drawing, Skin, View, draw, empty_drawing
from posetrack_cli.hand.fitting.skeleton import Posed, Skeleton, empty_posed, pose_bones
from posetrack_cli.hand.fitting.terms import TermBuffers, Terms, Tile, add_terms, empty_buffers, union_cost

WIDENING = 1.3  # factor on the robust scales per iteration left


class Hand(NamedTuple):
    """A hand as the kernels read it."""

    skeleton: Skeleton
    skin: Skin
    plausibility: Plausibility


class Steps(NamedTuple):
    """How far one iteration goes at most: mm, rad of the rotation, rad of an angle."""

    translation_mm: float = 30.0
    rotation_rad: float = 0.4
    angle_rad: float = 0.5


class Workspace(NamedTuple):
    """What one fit at a time writes to."""

    posed: Posed
    drawing: Drawing
    buffers: TermBuffers
    spheres: FloatArray
    data: NormalEquations
    whole: NormalEquations


class Fit(NamedTuple):
    """The best pose of one descent; written by ``descend``.

    Attributes:
        pose: (22,).
        data: of the image's residuals at the pose.
        cost: (1,) union cost D, mm.
    """

    pose: FloatArray
    data: NormalEquations
    cost: FloatArray


def make_workspace(hand: Hand, height: int, width: int) -> Workspace:
    """Return the workspace of fits to images of one size."""
    return Workspace(
        empty_posed(),
        empty_drawing(hand.skin, height, width),
        empty_buffers(hand.skin, height, width),
        np.zeros((5, SPHERES, 3)),
        empty_equations(),
        empty_equations(),
    )


def empty_fit() -> Fit:
    """Return a fit to be filled in."""
    return Fit(np.zeros(POSE_SIZE), empty_equations(), np.zeros(1))


@kernel
def _difference(mean: FloatArray, pose: FloatArray, out: FloatArray) -> None:
    """Write mean (-) pose (21,), in the pose's body frame."""
    for i in range(3):
        out[i] = mean[i] - pose[i]
    x, y, z, w = quaternion_product(-pose[3], -pose[4], -pose[5], pose[6], mean[3], mean[4], mean[5], mean[6])
    if w < 0.0:
        x, y, z, w = -x, -y, -z, -w
    sine = np.sqrt(x * x + y * y + z * z)
    factor = 2.0 if sine < 1e-12 else 2.0 * np.arctan2(sine, w) / sine
    out[3], out[4], out[5] = factor * x, factor * y, factor * z
    for i in range(15):
        out[6 + i] = mean[7 + i] - pose[7 + i]


@kernel
def _step(pose: FloatArray, delta: FloatArray, most: Steps) -> None:
    """Move a pose by a tangent vector, no farther than ``most``."""
    length = np.sqrt(delta[0] ** 2 + delta[1] ** 2 + delta[2] ** 2)
    shrink = min(1.0, most.translation_mm / (length + 1e-30))
    for i in range(3):
        pose[i] += shrink * delta[i]
    angle = np.sqrt(delta[3] ** 2 + delta[4] ** 2 + delta[5] ** 2)
    half = 0.5 * min(angle, most.rotation_rad)
    factor = 0.5 if angle < 1e-12 else np.sin(half) / angle
    bx, by, bz, bw = factor * delta[3], factor * delta[4], factor * delta[5], np.cos(half)
    x, y, z, w = quaternion_product(pose[3], pose[4], pose[5], pose[6], bx, by, bz, bw)
    scale = 1.0 / np.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        scale = -scale
    pose[3], pose[4], pose[5], pose[6] = scale * x, scale * y, scale * z, scale * w
    for i in range(15):
        pose[7 + i] += min(max(delta[6 + i], -most.angle_rad), most.angle_rad)


@kernel
def _solve(
    hand: Hand,
    pose: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    workspace: Workspace,
    delta: FloatArray,
) -> None:
    """Write the Gauss-Newton step (21,) for image, prior N(mean, 1 / precision) and anatomy."""
    whole = workspace.whole
    copy(workspace.data, whole)
    _difference(mean, pose, delta)
    for i in range(TANGENT_SIZE):
        whole.matrix[i, i] += precision[i]
        whole.vector[i] += precision[i] * delta[i]
    add_anatomy(hand.plausibility, pose, workspace.posed, workspace.spheres, whole)
    step = np.linalg.solve(whole.matrix, whole.vector)
    for i in range(TANGENT_SIZE):
        delta[i] = step[i]


@kernel
def _keep(pose: FloatArray, data: NormalEquations, cost: float, out: Fit) -> None:
    out.cost[0] = cost
    for i in range(POSE_SIZE):
        out.pose[i] = pose[i]
    copy(data, out.data)


@kernel
def descend(
    hand: Hand,
    tile: Tile,
    start: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    terms: Terms,
    most: Steps,
    iterations: int,
    workspace: Workspace,
    out: Fit,
) -> None:
    """Descend from a start pose and keep the pose of least union cost on the way.

    Args:
        hand: the model.
        tile: the observation.
        start: (22,).
        mean, precision: (22,), (21,) prior of the pose, in the tangent space.
        terms, most: weights, step sizes.
        iterations: Gauss-Newton steps; one more pose is drawn.
        workspace: is written to.
        out: the fit. Its cost is c_max if the hand cannot be drawn.
    """
    pose, delta = start.copy(), np.empty(TANGENT_SIZE)
    _keep(pose, workspace.data, np.inf, out)
    for k in range(iterations + 1):
        pose_bones(hand.skeleton, pose, workspace.posed)
        clear(workspace.data)
        cost = terms.clamp_mm
        if draw(hand.skin, workspace.posed.bones, tile.projection, workspace.drawing):
            widening = WIDENING ** (iterations - k)
            cost = add_terms(
                tile,
                workspace.posed,
                hand.skin,
                workspace.drawing,
                terms,
                widening,
                workspace.buffers,
                workspace.data,
            )
            gather(workspace.data)
        if cost < out.cost[0]:
            _keep(pose, workspace.data, cost, out)
        if k < iterations:
            _solve(hand, pose, mean, precision, workspace, delta)
            _step(pose, delta, most)


@kernel
def cost_of(hand: Hand, tile: Tile, pose: FloatArray, terms: Terms, workspace: Workspace) -> float:
    """The union cost D, mm, of a pose (22,)."""
    pose_bones(hand.skeleton, pose, workspace.posed)
    if not draw(hand.skin, workspace.posed.bones, tile.projection, workspace.drawing):
        return terms.clamp_mm
    return union_cost(tile, workspace.drawing, terms)


@kernel
def assess(hand: Hand, tile: Tile, pose: FloatArray, terms: Terms, workspace: Workspace, out: Fit) -> None:
    """Make the fit of a pose as it is, without a step."""
    pose_bones(hand.skeleton, pose, workspace.posed)
    clear(workspace.data)
    cost = terms.clamp_mm
    if draw(hand.skin, workspace.posed.bones, tile.projection, workspace.drawing):
        cost = add_terms(
            tile, workspace.posed, hand.skin, workspace.drawing, terms, 1.0, workspace.buffers, workspace.data
        )
        gather(workspace.data)
    _keep(pose, workspace.data, cost, out)


@kernel
def align(hand: Hand, tile: Tile, pose: FloatArray, workspace: Workspace) -> bool:
    """Shift a pose (22,) so that the middle of what is drawn meets the middle of the hand's pixels.

    The middles are means of column, row and depth. False, and nothing moved, if either shows nothing.
    """
    pose_bones(hand.skeleton, pose, workspace.posed)
    if tile.observed == 0 or not draw(hand.skin, workspace.posed.bones, tile.projection, workspace.drawing):
        return False
    drawn, target = np.zeros(3), np.zeros(3)
    count = _add_middle(workspace.drawing.inverse, True, drawn)
    if count == 0:
        return False
    _place_middle(drawn, count, tile.projection)
    _place_middle(target, _add_middle(tile.image, False, target), tile.projection)
    for i in range(3):
        pose[i] += target[i] - drawn[i]
    return True


@kernel
def _add_middle(image: FloatArray, inverted: bool, total: FloatArray) -> int:
    """Add up column, row and depth of the pixels above 0, and count them."""
    count = 0
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            value = image[j, i]
            if value > 0.0:
                count += 1
                total[0] += i + 0.5
                total[1] += j + 0.5
                total[2] += 1.0 / value if inverted else value
    return count


@kernel
def _place_middle(total: FloatArray, count: int, view: View) -> None:
    """Turn sums over pixels into the point, mm, on which their mean falls."""
    z = total[2] / count
    total[0] = (total[0] / count - view.b) / view.a * z
    total[1] = (total[1] / count - view.d) / view.c * z
    total[2] = z
