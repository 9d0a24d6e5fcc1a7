"""Bundle adjustment: the shape that all frames share, and the pose of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.anatomy import TANGENT_SIZE
from posetrack_cli.hand.calibration.residuals import FRAME_SIZE, FrameRows, vertex_moves
from posetrack_cli.hand.fitting.gauss_newton import ABDUCTION_SD, IP_SD, MOST_THUMB
from posetrack_cli.hand.fitting.terms import Terms, Tile
from posetrack_cli.hand.model import HandMaker, HandModel
from posetrack_cli.hand.shape import HandShape, ShapeSpace
from posetrack_cli.hand.space import inside_limits
from posetrack_cli.tracking.body_space import BodySpace

Observe = Callable[[int, FloatArray, FloatArray, HandModel], Tile]
"""Gives the tile of a frame (its place among the chosen ones) for a pose, a thumb (2,) and a hand."""

CORRELATED = 64.0
"""Residuals per independent one: neighbouring pixels err alike, as noise, skin and segmentation do."""
OVERCONFIDENCE = 3.0
"""How much less the images tell than the sum of their rows, in the covariance that is stated: what is wrong
in one frame, as where the forearm is cut, is wrong in all. From the errors on synthetic random hands."""
LEAST_RESIDUAL_MM = 0.5
CONVERGED = 0.05
MOST_SHAPE_STEP, MOST_FRAME_STEP = 0.75, np.repeat([15.0, 0.2, 0.3], [3, 3, FRAME_SIZE - 6])
_RELAXED_SD = np.append(np.repeat([np.inf, np.inf, 0.6], [3, 3, 15]), [IP_SD, ABDUCTION_SD])
_SPACE = BodySpace()


@dataclass(frozen=True, eq=False)
class Bundle:
    """What a bundle adjustment found.

    Attributes:
        shape: of the hand.
        poses: (F, 22).
        thumbs: (F, 2) their inner angles (``hand.inner``), rad.
        covariance: (S, S) of the numbers of the space that stand for the shape.
        residual_mm: weighted root mean square of the residuals.
        iterations: steps taken.
    """

    shape: HandShape
    poses: FloatArray
    thumbs: FloatArray
    covariance: FloatArray
    residual_mm: float
    iterations: int


def adjusted(
    maker: HandMaker,
    space: ShapeSpace,
    side: str,
    shape: HandShape,
    poses: FloatArray,
    thumbs: FloatArray,
    observe: Observe,
    tile_px: int,
    *,
    iterations: int = 12,
    terms: Terms | None = None,
) -> Bundle:
    """Minimise the residuals of all frames over shape and poses, by Gauss-Newton.

    The unknowns are theta, the numbers of the space that stand for the shape, and of each frame a tangent
    vector and the thumb's inner angles. The prior of theta is N(0, diag sd^2) with the space's standard
    deviations. With H_f the normal matrix of frame f in blocks of shape s and frame p, the frames are
    eliminated: S = sum_f (H_ss - H_sp H_pp^-1 H_ps) + prior (Schur complement), and theta's covariance is
    S^-1, the images' part of S by ``OVERCONFIDENCE`` less. Residuals are weighted by their own mean square,
    one in ``CORRELATED`` counting as independent. A step of theta stays within the space's bounds.

    Args:
        maker: makes the hand.
        space: what is unknown of it.
        side: ``right`` or ``left``.
        shape: start.
        poses, thumbs: (F, 22), (F, 2) start.
        observe: gives the observations.
        tile_px: their side.
        iterations: at most.
        terms: weights of the residuals.
    """
    terms = terms or Terms()
    rows, theta = FrameRows(terms, tile_px), space.theta(shape)
    covariance, residual, taken = np.diag(space.sd**2), 0.0, 0
    prior, most = np.diag(1.0 / space.sd**2), MOST_SHAPE_STEP * space.sd
    while taken < iterations:
        taken += 1
        hand, varied = _hands(maker, space, side, theta)
        moves = vertex_moves(poses, thumbs, hand, varied, space.steps)
        frames = [
            rows.rows(observe(f, pose, thumb, hand), pose, thumb, hand, move)
            for f, (pose, thumb, move) in enumerate(zip(poses, thumbs, moves, strict=True))
        ]
        residual = _root_mean_square([(frame.residuals, frame.weights) for frame in frames])
        share = (terms.sigma_mm / max(residual, LEAST_RESIDUAL_MM)) ** 2 / CORRELATED
        equations = [
            _with_frame_prior(*frame.normal(share), pose, thumb)
            for frame, pose, thumb in zip(frames, poses, thumbs, strict=True)
        ]
        matrix, vector = _reduced(equations, prior, theta)
        covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        step = np.clip(_bounded_step(matrix, vector, space.low - theta, space.high - theta), -most, most)
        turns = np.array([_frame_step(equation, step) for equation in equations])
        turns = np.clip(turns, -MOST_FRAME_STEP, MOST_FRAME_STEP)
        poses = inside_limits(_SPACE.retract(poses, turns[:, :TANGENT_SIZE]))
        thumbs = np.clip(thumbs + turns[:, TANGENT_SIZE:], -MOST_THUMB, MOST_THUMB)
        theta = np.clip(theta + step, space.low, space.high)  # rounding may leave by an ulp
        if np.abs(step / np.sqrt(np.diag(covariance))).max() < CONVERGED:
            break
    stated = np.linalg.inv((matrix - prior) / OVERCONFIDENCE + prior)
    return Bundle(space.shape(theta), poses, thumbs, np.asarray(stated), residual, taken)


def _hands(
    maker: HandMaker, space: ShapeSpace, side: str, theta: FloatArray
) -> tuple[HandModel, list[HandModel]]:
    """The hand, and the hand with each parameter a step larger."""
    steps = np.vstack([np.zeros(theta.size), np.diag(space.steps)])
    hand, *varied = (maker(side, space.shape(theta + step)) for step in steps)
    return hand, varied


def _with_frame_prior(
    matrix: FloatArray, vector: FloatArray, pose: FloatArray, thumb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Add a weak pull of the angles towards a relaxed hand: what no pixel tells keeps still."""
    precision = 1.0 / _RELAXED_SD**2
    matrix[range(FRAME_SIZE), range(FRAME_SIZE)] += precision + 1e-9
    vector[6:FRAME_SIZE] -= precision[6:] * np.append(pose[7:] - 0.2, thumb)
    return matrix, vector


def _reduced(
    equations: Sequence[tuple[FloatArray, FloatArray]], prior: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The normal equations of the shape alone, its prior included."""
    p, s = slice(0, FRAME_SIZE), slice(FRAME_SIZE, None)
    matrix = prior.copy()
    vector = -prior @ theta
    for h, g in equations:
        carried = np.linalg.solve(h[p, p], np.column_stack([h[p, s], g[p]]))
        matrix += h[s, s] - h[s, p] @ carried[:, :-1]
        vector += g[s] - h[s, p] @ carried[:, -1]
    return matrix, vector


def _bounded_step(matrix: FloatArray, vector: FloatArray, least: FloatArray, most: FloatArray) -> FloatArray:
    """The x between two bounds (S,) for which x^T matrix x / 2 - vector^T x is least.

    A number that has come to its bound is as if it were not unknown: all others, the poses among them, are
    the likeliest for it there, not for where it would have gone.
    """
    from scipy.optimize import lsq_linear

    root = np.linalg.cholesky(matrix).T
    found = lsq_linear(root, np.linalg.solve(root.T, vector), bounds=(least, most), method="bvls")
    return np.asarray(found.x, dtype=np.float64)


def _frame_step(equation: tuple[FloatArray, FloatArray], step: FloatArray) -> FloatArray:
    """The step (23,) of one frame's unknowns once the shape's is known."""
    h, g = equation
    p, s = slice(0, FRAME_SIZE), slice(FRAME_SIZE, None)
    return np.asarray(np.linalg.solve(h[p, p], g[p] - h[p, s] @ step))


def _root_mean_square(parts: list[tuple[FloatArray, FloatArray]]) -> float:
    total = sum(float((weights * residuals**2).sum()) for residuals, weights in parts)
    weight = sum(float(weights.sum()) for _, weights in parts)
    return float(np.sqrt(total / weight)) if weight else 0.0
