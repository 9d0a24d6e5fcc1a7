"""Gauss-Newton on a hand's pose: render, compare, solve, step; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import borrowing, inlined, kernel
from posetrack_cli.geometry.kernels import quaternion_product
from posetrack_cli.geometry.least_squares import solve_positive
from posetrack_cli.hand.fit.anatomy_terms import SPHERES, Plausibility, add_anatomy
from posetrack_cli.hand.fit.normal_equations import (
    ARM_PLACE,
    THUMB_PLACE,
    UNKNOWNS,
    NormalEquations,
    clear,
    copy,
    empty_equations,
    gather,
)
from posetrack_cli.hand.fit.skeleton import (
    ARM,
    INNER_SIZE,
    IP_OFFSET,
    Posed,
    Skeleton,
    Skin,
    empty_posed,
    pose_bones,
)
from posetrack_cli.hand.fit.terms import TermBuffers, Terms, Tile, add_terms, empty_buffers, union_cost
from posetrack_cli.hand.model.anatomy import POSE_SIZE, TANGENT_SIZE
from posetrack_cli.hand.observe.observation import IGNORED
from posetrack_cli.rendering.raster import Drawing, View, draw, draw_depth, empty_drawing

STRIDE_FROM_AFAR, LAST_STEPS = 2, 2  # only the last steps use all surface pixels
WIDENING = 1.3  # factor on the robust scales per remaining iteration
SWING_SD, GIRTH_SD = 0.25, 0.1
"""Of the forearm around its prediction, rad, and of the logarithm of its girth."""
IP_SD, ABDUCTION_SD = np.deg2rad(8.0), np.deg2rad(8.0)
"""Of the thumb's inner angles around their prediction, rad."""
MAX_GIRTH, MAX_THUMB = 0.5, np.deg2rad(40.0)
FREE_BEND, STIFF_BEND = np.deg2rad(60.0), 30.0
"""Wrist flexion up to which there is no potential, rad, and its weight beyond, 1 / rad^2."""


class ThumbPrior(NamedTuple):
    """Prior of a thumb.

    Attributes:
        precision: (2,) of its inner angles around their prediction, 1 / rad^2.
        rests: whether it probably rests.
    """

    precision: FloatArray
    rests: bool


FREE_THUMB = ThumbPrior(1.0 / np.square([IP_SD, ABDUCTION_SD]), rests=True)
STIFF_THUMB = ThumbPrior(np.full(2, 1e9), rests=False)
"""Priors of a tracked thumb, and of one without inner angles, which is not expected to rest."""


class Hand(NamedTuple):
    """A hand as the kernels read it.

    Attributes:
        skeleton, skin, plausibility: its parts.
        thumb: (2,) precision of the thumb's inner angles around their prediction, 1 / rad^2.
    """

    skeleton: Skeleton
    skin: Skin
    plausibility: Plausibility
    thumb: FloatArray


class Steps(NamedTuple):
    """Step limits of one iteration: mm, rad of the rotation, rad of an angle."""

    translation_mm: float = 30.0
    rotation_rad: float = 0.4
    angle_rad: float = 0.5


class Workspace(NamedTuple):
    """Buffers of one fit at a time."""

    posed: Posed
    drawing: Drawing
    buffers: TermBuffers
    spheres: FloatArray
    data: NormalEquations
    whole: NormalEquations
    pose: FloatArray
    inner: FloatArray
    step: FloatArray


class Fit(NamedTuple):
    """Best pose of a descent; written by ``descend_each``.

    Attributes:
        pose: (22,).
        inner: (6,) inner numbers (``hand.fit.skeleton``).
        data: normal equations of the image's residuals at the pose.
        cost: (1,) union cost D, mm.
    """

    pose: FloatArray
    inner: FloatArray
    data: NormalEquations
    cost: FloatArray


def make_workspace(hand: Hand, height: int, width: int) -> Workspace:
    """Return the buffers of fits to images of one size."""
    return Workspace(
        empty_posed(),
        empty_drawing(hand.skin.mesh, height, width),
        empty_buffers(hand.skin, height, width),
        np.zeros((5, SPHERES, 3)),
        empty_equations(),
        empty_equations(),
        np.zeros(POSE_SIZE),
        np.zeros(INNER_SIZE),
        np.zeros(UNKNOWNS),
    )


def empty_fit() -> Fit:
    """Return an empty fit."""
    return Fit(np.zeros(POSE_SIZE), np.zeros(INNER_SIZE), empty_equations(), np.zeros(1))


def empty_fits(count: int) -> Fit:
    """Return ``count`` empty fits, stacked along a first axis."""
    one = empty_fit()
    data = NormalEquations(*(np.zeros((count, *array.shape)) for array in one.data))
    shapes = one.pose.shape, one.inner.shape, one.cost.shape
    pose, inner, cost = (np.zeros((count, *shape)) for shape in shapes)
    return Fit(pose, inner, data, cost)


def unstack_fits(fits: Fit) -> list[Fit]:
    """Return views of the single fits."""
    data = [NormalEquations(*arrays) for arrays in zip(*fits.data, strict=True)]
    return [Fit(*parts) for parts in zip(fits.pose, fits.inner, data, fits.cost, strict=True)]


@inlined
def _fit_at(fits: Fit, k: int) -> Fit:
    data = fits.data
    one = NormalEquations(data.matrix[k], data.vector[k], data.blocks[k], data.thumb[k])
    return Fit(fits.pose[k], fits.inner[k], one, fits.cost[k])


@borrowing
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


@borrowing
def step_pose(pose: FloatArray, delta: FloatArray, most: Steps) -> None:
    """Move a pose by a tangent vector, within the limits of ``most``."""
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


@borrowing
def add_inner_prior(
    expected: FloatArray, inner: FloatArray, thumb: FloatArray, posed: Posed, equations: NormalEquations
) -> None:
    """Add the priors of the inner numbers (6,) and of the wrist's range."""
    for k in range(2):
        i, precision = THUMB_PLACE + k, thumb[k]
        equations.matrix[i, i] += precision
        equations.vector[i] += precision * (expected[IP_OFFSET + k] - inner[IP_OFFSET + k])
    _add_arm_prior(expected, inner, posed, equations)


@kernel
def _add_arm_prior(expected: FloatArray, arm: FloatArray, posed: Posed, equations: NormalEquations) -> None:
    """Add the priors of the forearm and of the wrist's range."""
    H, g, axes = equations.matrix, equations.vector, posed.axes
    swing, girth = 1.0 / (SWING_SD * SWING_SD), 1.0 / (GIRTH_SD * GIRTH_SD)
    x = arm[1] * expected[2] - arm[2] * expected[1]
    y = arm[2] * expected[0] - arm[0] * expected[2]
    z = arm[0] * expected[1] - arm[1] * expected[0]
    for k in range(2):
        off = x * axes[ARM, k, 0] + y * axes[ARM, k, 1] + z * axes[ARM, k, 2]
        H[ARM_PLACE + k, ARM_PLACE + k] += swing
        g[ARM_PLACE + k] += swing * off
    H[ARM_PLACE + 2, ARM_PLACE + 2] += girth
    g[ARM_PLACE + 2] += girth * (expected[3] - arm[3])
    palm = posed.bones[0]  # its y points towards the elbow where the wrist is straight
    x = palm[1, 1] * arm[2] - palm[2, 1] * arm[1]
    y = palm[2, 1] * arm[0] - palm[0, 1] * arm[2]
    z = palm[0, 1] * arm[1] - palm[1, 1] * arm[0]
    sine = np.sqrt(x * x + y * y + z * z)
    cosine = palm[0, 1] * arm[0] + palm[1, 1] * arm[1] + palm[2, 1] * arm[2]
    excess = np.arctan2(sine, cosine) - FREE_BEND
    if excess <= 0.0 or sine < 1e-9:
        return
    row = np.zeros(UNKNOWNS)
    for k in range(3):
        row[3 + k] = (x * palm[0, k] + y * palm[1, k] + z * palm[2, k]) / sine
    for k in range(2):
        row[ARM_PLACE + k] = -(x * axes[ARM, k, 0] + y * axes[ARM, k, 1] + z * axes[ARM, k, 2]) / sine
    for i in range(UNKNOWNS):
        g[i] += STIFF_BEND * excess * row[i]
        for j in range(UNKNOWNS):
            H[i, j] += STIFF_BEND * row[i] * row[j]


@borrowing
def _move_inner(inner: FloatArray, delta: FloatArray, posed: Posed, most: Steps) -> None:
    """Move the inner numbers by the last part of a step (26,): thumb angles, forearm swing and girth."""
    for k in range(2):
        angle = inner[IP_OFFSET + k] + min(max(delta[THUMB_PLACE + k], -most.angle_rad), most.angle_rad)
        inner[IP_OFFSET + k] = min(max(angle, -MAX_THUMB), MAX_THUMB)
    _move_arm(inner, delta[ARM_PLACE:THUMB_PLACE], posed, most)


@borrowing
def _move_arm(arm: FloatArray, delta: FloatArray, posed: Posed, most: Steps) -> None:
    """Swing the forearm by two angles about its axes, and scale its girth by the third of ``delta``."""
    axes, x, y, z = posed.axes, arm[0], arm[1], arm[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        return
    a = min(max(delta[0], -most.rotation_rad), most.rotation_rad)
    b = min(max(delta[1], -most.rotation_rad), most.rotation_rad)
    u = a * axes[ARM, 0, 0] + b * axes[ARM, 1, 0]
    v = a * axes[ARM, 0, 1] + b * axes[ARM, 1, 1]
    w = a * axes[ARM, 0, 2] + b * axes[ARM, 1, 2]
    arm[0], arm[1], arm[2] = x + v * z - w * y, y + w * x - u * z, z + u * y - v * x
    share = 1.0 / np.sqrt(arm[0] * arm[0] + arm[1] * arm[1] + arm[2] * arm[2])
    for i in range(3):
        arm[i] *= share
    arm[3] = min(max(arm[3] + delta[2], -MAX_GIRTH), MAX_GIRTH)


@borrowing
def _keep(pose: FloatArray, inner: FloatArray, data: NormalEquations, cost: float, out: Fit) -> None:
    out.cost[0] = cost
    for i in range(INNER_SIZE):
        out.inner[i] = inner[i]
    for i in range(POSE_SIZE):
        out.pose[i] = pose[i]
    copy(data, out.data)


@borrowing
def _add_prior_terms(
    hand: Hand,
    pose: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    workspace: Workspace,
    off: FloatArray,
) -> float:
    """Add prior (mean, precision) and anatomy at the current pose to ``whole``; return their potential, nats.

    Writes the mean's difference from the pose (21,) to ``off``.
    """
    whole = workspace.whole
    _difference(mean, pose, off)
    for i in range(TANGENT_SIZE):
        whole.matrix[i, i] += precision[i]
        whole.vector[i] += precision[i] * off[i]
    potential = add_anatomy(hand.plausibility, pose, workspace.posed, workspace.spheres, whole)
    for i in range(TANGENT_SIZE):
        potential += 0.5 * precision[i] * off[i] * off[i]
    return potential


@borrowing
def descend_each(
    hand: Hand,
    tile: Tile,
    starts: FloatArray,
    means: FloatArray,
    precisions: FloatArray,
    first: int,
    stride: int,
    terms: Terms,
    most: Steps,
    iterations: int,
    workspace: Workspace,
    out: Fit,
) -> None:
    """Descend from every ``stride``-th start pose, and keep the best pose of each.

    The objective is that of the steps, D + u (U + e^T P e / 2), with D the union cost, U the anatomical
    potential, e the pose's difference from the prior's mean, P its precision and u the tile's ``mm_per_nat``.
    D alone would select the pose that happens to fit the noise: a hidden finger could be anywhere for a tenth
    of a millimetre.

    Args:
        hand: the model.
        tile: the observation.
        starts: (K, 22).
        means, precisions: (K, 22), (K, 21) prior of each pose, in the tangent space.
        first, stride: which starts.
        terms, most: weights, step limits.
        iterations: Gauss-Newton steps; one more pose is rendered.
        workspace: overwritten.
        out: K fits. Their cost is c_max if the hand cannot be rendered.
    """
    pose, inner, delta = workspace.pose, workspace.inner, workspace.step
    for n in range(first, len(starts), stride):
        for i in range(POSE_SIZE):  # element by element: assigning slices takes seconds to compile
            pose[i] = starts[n, i]
        for i in range(INNER_SIZE):
            inner[i] = tile.inner[i]
        fit, least = _fit_at(out, n), np.inf
        _keep(pose, inner, workspace.data, np.inf, fit)
        for k in range(iterations + 1):
            chequered = k < iterations - LAST_STEPS
            cost = _add_image_terms(
                hand, tile, pose, inner, terms, WIDENING ** (iterations - k), chequered, workspace
            )
            copy(workspace.data, workspace.whole)
            doubts = _add_prior_terms(hand, pose, means[n], precisions[n], workspace, delta)
            objective = cost + tile.mm_per_nat * doubts
            if objective < least:
                least = objective
                _keep(pose, inner, workspace.data, cost, fit)
            if k < iterations:
                add_inner_prior(tile.expected, inner, hand.thumb, workspace.posed, workspace.whole)
                solve_positive(workspace.whole.matrix, workspace.whole.vector, delta)
                step_pose(pose, delta, most)
                _move_inner(inner, delta, workspace.posed, most)


@inlined
def _add_image_terms(
    hand: Hand,
    tile: Tile,
    pose: FloatArray,
    inner: FloatArray,
    terms: Terms,
    widening: float,
    chequered: bool,
    workspace: Workspace,
) -> float:
    """Write the residuals of a pose to ``data``; return its union cost D, mm."""
    pose_bones(hand.skeleton, pose, inner, workspace.posed)
    clear(workspace.data)
    if not draw(hand.skin.mesh, workspace.posed.bones, tile.projection, workspace.drawing):
        return terms.clamp_mm
    cost = add_terms(
        tile,
        workspace.posed,
        hand.skin,
        workspace.drawing,
        terms,
        widening,
        STRIDE_FROM_AFAR if chequered else 1,
        workspace.buffers,
        workspace.data,
    )
    gather(workspace.data)
    return cost


@borrowing
def write_costs(
    hand: Hand,
    tile: Tile,
    poses: FloatArray,
    first: int,
    stride: int,
    terms: Terms,
    workspace: Workspace,
    out: FloatArray,
) -> None:
    """Write ``cost_of`` of every ``stride``-th of poses (N, 22) to (N,)."""
    for n in range(first, len(poses), stride):
        out[n] = cost_of(hand, tile, poses[n], terms, workspace)


@kernel
def swap_fingers_each(
    hand: Hand,
    tile: Tile,
    poses: FloatArray,
    objectives: FloatArray,
    mean: FloatArray,
    precision: FloatArray,
    first: int,
    stride: int,
    terms: Terms,
    workspace: Workspace,
    out: FloatArray,
) -> None:
    """Write each group's best pose (G, 22) with every finger from the pose where it fits best.

    Greedy: one finger after the other, thumb first.

    Args:
        hand, tile, terms, workspace: as in ``cost_of``.
        poses: (G, K, 22), the best of each group first.
        objectives: (G,) of these, as in ``descend_each``.
        mean, precision: (22,), (21,) prior of all.
        first, stride: which groups.
        out: overwritten.
    """
    trial, off = np.empty(POSE_SIZE), np.empty(TANGENT_SIZE)
    for g in range(first, len(poses), stride):
        best, least = out[g], objectives[g]
        # element by element: assigning slices takes seconds to compile
        for i in range(POSE_SIZE):
            best[i] = poses[g, 0, i]
        for f in range(5):
            place, chosen = 7 + 3 * f, 0
            for i in range(POSE_SIZE):
                trial[i] = best[i]
            for k in range(1, poses.shape[1]):
                for i in range(place, place + 3):
                    trial[i] = poses[g, k, i]
                other = cost_of(hand, tile, trial, terms, workspace)
                if tile.mm_per_nat > 0.0:
                    clear(workspace.whole)
                    other += tile.mm_per_nat * _add_prior_terms(hand, trial, mean, precision, workspace, off)
                if other < least:
                    chosen, least = k, other
            for i in range(place, place + 3):
                best[i] = poses[g, chosen, i]


@borrowing
def cost_of(hand: Hand, tile: Tile, pose: FloatArray, terms: Terms, workspace: Workspace) -> float:
    """Return the union cost D, mm, of a pose (22,)."""
    pose_bones(hand.skeleton, pose, tile.inner, workspace.posed)
    if not draw_depth(hand.skin.mesh, workspace.posed.bones, tile.projection, workspace.drawing):
        return terms.clamp_mm
    return union_cost(tile, workspace.drawing, terms)


@kernel
def align_each(
    hand: Hand, tile: Tile, poses: FloatArray, first: int, stride: int, workspace: Workspace
) -> None:
    """Shift every ``stride``-th of poses (N, 22) so that rendered and observed hand have the same centroid.

    The centroids are means of column, row and depth. Poses stay where either is empty.
    """
    bones, drawing, drawn, target = workspace.posed.bones, workspace.drawing, np.empty(3), np.empty(3)
    for n in range(first, len(poses), stride):
        pose = poses[n]
        pose_bones(hand.skeleton, pose, tile.inner, workspace.posed)
        if tile.observed == 0 or not draw_depth(hand.skin.mesh, bones, tile.projection, drawing):
            continue
        count = _add_middle(drawing.inverse, tile.image, True, drawn)
        if count == 0:
            continue
        _place_middle(drawn, count, tile.projection)
        _place_middle(target, _add_middle(tile.image, tile.image, False, target), tile.projection)
        for i in range(3):
            pose[i] += target[i] - drawn[i]


@borrowing
def _add_middle(image: FloatArray, seen: FloatArray, inverted: bool, total: FloatArray) -> int:
    """Sum column, row and depth of positive pixels where ``seen`` is not ignored; return their number."""
    count, total[:] = 0, 0.0
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            value = image[j, i]
            if value > 0.0 and seen[j, i] != IGNORED:
                count += 1
                total[0] += i + 0.5
                total[1] += j + 0.5
                total[2] += 1.0 / value if inverted else value
    return count


@borrowing
def _place_middle(total: FloatArray, count: int, view: View) -> None:
    """Convert sums over pixels to the 3-D point, mm, of their mean."""
    z = total[2] / count
    total[0] = (total[0] / count - view.b) / view.a * z
    total[1] = (total[1] / count - view.d) / view.c * z
    total[2] = z
