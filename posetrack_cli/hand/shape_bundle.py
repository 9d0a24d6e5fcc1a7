"""Bundle adjustment of one hand shape and its poses in many frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.least_squares import back_substituted, bounded_step, eliminated, geman_mcclure
from posetrack_cli.hand.fit.gauss_newton import ABDUCTION_SD, IP_SD, MAX_THUMB
from posetrack_cli.hand.fit.skeleton import NO_THUMB, Skin, skin_of
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import TANGENT_SIZE, HandShape, ShapeSpace
from posetrack_cli.hand.model.hand import HandMaker, HandModel, inside_limits
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.rendering.raster import Drawing, draw, empty_drawing
from posetrack_cli.tracking.velocity import BodySpace

# Residuals of one frame and their derivatives by pose and shape
#
# The residuals are those of ``hand.fit.terms``. The skin here also moves with the shape, so derivatives are
# finite differences of posed meshes. Speed matters less: a calibration uses some dozens of frames.

FRAME_SIZE = TANGENT_SIZE + len(NO_THUMB)
"""Unknowns per frame: the tangent vector of its pose, and the thumb's inner angles."""
FRAME_STEPS: FloatArray = np.repeat([0.5, 0.005, 0.005], [3, 3, FRAME_SIZE - 6])
"""(23,) finite-difference steps of a frame's unknowns, mm and rad: about half a millimetre of the skin."""
_FRAME, _SHAPE = slice(0, FRAME_SIZE), slice(FRAME_SIZE, None)
"""Columns of the frame's and of the shape's unknowns."""
WRIST_PART, MIN_SHARE = 0.35, 0.05
"""Share of the palm's length, from the wrist, with reduced weight: models differ most mask, and the cut to
the forearm is uncertain."""
_SPACE = BodySpace()


@dataclass(frozen=True, eq=False)
class Rows:
    """Linearised residuals e(x + d) = e - J d for steps d of frame and shape unknowns.

    Attributes:
        jacobian: (N, 23 + S).
        residuals: (N) mm.
        weights: (N) 1 / mm^2, robust factors included.
    """

    jacobian: FloatArray
    residuals: FloatArray
    weights: FloatArray

    def normal(self, share: float) -> tuple[FloatArray, FloatArray]:
        """Return J^T W J and J^T W e, with the weights multiplied by ``share``."""
        weighted = self.jacobian * (share * self.weights)[:, None]
        return weighted.T @ self.jacobian, weighted.T @ self.residuals


class FrameRows:
    """Linearises frames for hands with the same triangles.

    Args:
        terms: weights of the residuals.
        tile_px: side of the observations.
    """

    def __init__(self, terms: Terms, tile_px: int) -> None:
        self._terms, self._tile_px = terms, tile_px
        self._skin: Skin | None = None
        self._of: HandModel | None = None
        self._drawing: Drawing | None = None

    def rows(
        self, tile: Tile, pose: FloatArray, thumb: FloatArray, hand: HandModel, moves: FloatArray
    ) -> Rows:
        """Return the rows of one frame.

        Args:
            tile: the observation.
            pose: (22,).
            thumb: (2,) its inner angles.
            hand: the hand in its current shape.
            moves: (V, 23 + S, 3) of the frame, from ``vertex_moves``.
        """
        drawing = self._drawn(tile, pose, thumb, hand)
        if drawing is None:
            return Rows(np.zeros((0, moves.shape[1])), np.zeros(0), np.zeros(0))
        parts = [self._surface(tile, drawing, hand, moves), self._silhouette(tile, drawing, hand, moves)]
        parts.append(self._unexplained(tile, drawing, pose, hand, moves))
        return Rows(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _drawn(self, tile: Tile, pose: FloatArray, thumb: FloatArray, hand: HandModel) -> Drawing | None:
        if self._of is not hand:
            self._skin, self._of = skin_of(hand.smooth), hand
            self._drawing = empty_drawing(self._skin.mesh, self._tile_px, self._tile_px)
        assert self._skin is not None and self._drawing is not None
        bones = skinning_transforms(hand.anatomy, pose[None], thumb)[0].astype(np.float64)
        return self._drawing if draw(self._skin.mesh, bones, tile.projection, self._drawing) else None

    def _surface(
        self, tile: Tile, drawing: Drawing, hand: HandModel, moves: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Projective point to plane: n . (observed - drawn) where both exist and are close."""
        terms, z = self._terms, _depth(drawing)
        distance = tile.image - z
        mask = (drawing.inverse > 0) & (tile.image > 0) & (np.abs(distance) < terms.gate_mm)
        faces, points = drawing.triangle[mask], _points(tile, mask, z)
        normals = drawing.normals[faces]
        residuals = distance[mask] * np.einsum("nk,nk->n", normals, points / points[:, 2:])
        weights = geman_mcclure((residuals / terms.surface_tau_mm) ** 2) / terms.sigma_mm**2
        weights *= wrist_shares(hand)[hand.smooth.triangles[faces]].mean(axis=1)
        return _along(hand, drawing, moves, faces, points, normals), residuals, weights

    def _silhouette(
        self, tile: Tile, drawing: Drawing, hand: HandModel, moves: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Rendered in front of a farther reading: distance in the image plane to the nearest hand pixel."""
        terms, z, view = self._terms, _depth(drawing), tile.projection
        mask = (drawing.inverse > 0) & (tile.image < 0) & (-tile.image > z - terms.explained_mm)
        rows, columns = np.nonzero(mask)
        across = (tile.nearest[0][mask] - columns) / view.a * z[mask]
        down = (tile.nearest[1][mask] - rows) / view.c * z[mask]
        residuals = np.hypot(across, down)
        points = _points(tile, mask, z)
        safe = np.maximum(residuals, 1e-9)
        directions = np.stack([across / safe, down / safe, np.zeros_like(safe)], axis=1)
        # orthogonal to the ray: motion along it does not change the pixel
        directions[:, 2] = -np.einsum("nk,nk->n", directions, points / points[:, 2:])
        faces = drawing.triangle[mask]
        weights = geman_mcclure((residuals / terms.silhouette_tau_mm) ** 2) / terms.sigma_mm**2
        weights *= wrist_shares(hand)[hand.smooth.triangles[faces]].mean(axis=1)
        return _along(hand, drawing, moves, faces, points, directions), residuals, weights

    def _unexplained(
        self, tile: Tile, drawing: Drawing, pose: FloatArray, hand: HandModel, moves: FloatArray
    ) -> tuple[FloatArray, ...]:
        """Observed without a rendered surface nearby: distance to the nearest visible vertex.

        Pixels behind the wrist are ignored: they belong to the forearm, and a hand that covers them would
        grow.
        """
        from scipy.spatial import cKDTree

        terms, z = self._terms, _depth(drawing)
        far = np.abs(tile.image - z) > terms.explained_mm
        mask = (tile.image > 0) & ((drawing.inverse == 0) | far)
        facing = np.flatnonzero(drawing.facing)
        if not facing.size or not mask.any():
            return np.zeros((0, moves.shape[1])), np.zeros(0), np.zeros(0)
        points = _points(tile, mask, tile.image)
        behind = (points - pose[:3]) @ rotations.matrices_from_quaternions(pose[3:7])[:, 1]
        points = points[behind < -WRIST_PART * _palm_length(hand)]
        residuals, nearest = cKDTree(drawing.vertices[facing]).query(points)
        vertices = facing[nearest]
        directions = (points - drawing.vertices[vertices]) / np.maximum(residuals, 1e-9)[:, None]
        weights = geman_mcclure((residuals / terms.closest_tau_mm) ** 2) / terms.closest_mm**2
        weights *= wrist_shares(hand)[vertices]
        return np.einsum("nkc,nc->nk", moves[vertices], directions), residuals, weights


def vertex_moves(
    poses: FloatArray, thumbs: FloatArray, hand: HandModel, varied: Sequence[HandModel], steps: FloatArray
) -> Iterator[FloatArray]:
    """Yield for each frame the derivatives of the posed vertices: (V, 23 + S, 3).

    Args:
        poses: (F, 22) of the frames.
        thumbs: (F, 2) inner angles.
        hand: the hand in its current shape.
        varied: the hand with each of S shape parameters increased by a step.
        steps: (S,) in the parameters' units; derivatives are with respect to these.
    """
    others = [_posed(other, poses, thumbs) for other in varied]
    moves = np.vstack([np.zeros(FRAME_SIZE), np.diag(FRAME_STEPS)])
    for f, (pose, thumb) in enumerate(zip(poses, thumbs, strict=True)):
        moved = _SPACE.retract(np.tile(pose, (FRAME_SIZE + 1, 1)), moves[:, :TANGENT_SIZE])
        base, *shifted = _posed(hand, moved, thumb + moves[:, TANGENT_SIZE:])
        by_pose = (np.array(shifted) - base) / FRAME_STEPS[:, None, None]
        shape_moves = [(other[f] - base) / step for other, step in zip(others, steps, strict=True)]
        by_shape = np.array(shape_moves).reshape(-1, *base.shape)
        yield np.moveaxis(np.concatenate([by_pose, by_shape]), 0, 1)


def wrist_shares(hand: HandModel) -> FloatArray:
    """Return the weight of each vertex (V,): small at the wrist, 1 from ``WRIST_PART`` of the palm on."""
    along = -hand.smooth.vertices[:, 1] / _palm_length(hand)
    palm = hand.smooth.weights[:, 0] > 0.5
    return np.where(palm, np.clip(along / WRIST_PART, MIN_SHARE, 1.0), 1.0)


def _palm_length(hand: HandModel) -> float:
    """Return the distance from wrist to knuckles, mm."""
    return -float(hand.anatomy.base_positions[1:, 1].mean())


def _posed(hand: HandModel, poses: FloatArray, thumbs: FloatArray) -> FloatArray:
    return hand.smooth.posed(skinning_transforms(hand.anatomy, poses, thumbs).astype(np.float64))


def _along(
    hand: HandModel,
    drawing: Drawing,
    moves: FloatArray,
    faces: IntArray,
    points: FloatArray,
    directions: FloatArray,
) -> FloatArray:
    """Return the derivatives (N, 23 + S) of points (N, 3) on triangles (N) along unit vectors (N, 3)."""
    corners = hand.smooth.triangles[faces]
    # barycentric coordinates; solvable, as no visible triangle is coplanar with the camera centre
    matrix = np.swapaxes(drawing.vertices[corners], 1, 2)
    shares = np.linalg.solve(matrix, points[..., None])[..., 0]
    return np.asarray(np.einsum("ni,nikc,nc->nk", shares, moves[corners], directions, optimize=True))


def _depth(drawing: Drawing) -> FloatArray:
    return 1.0 / np.maximum(drawing.inverse, 1e-12)


def _points(tile: Tile, mask: BoolArray, depth: FloatArray) -> FloatArray:
    """Return points (N, 3) of pixels at the depths of an image, mm."""
    rows, columns = np.nonzero(mask)
    view, z = tile.projection, depth[mask]
    return np.stack([(columns + 0.5 - view.b) / view.a * z, (rows + 0.5 - view.d) / view.c * z, z], axis=1)


# Bundle adjustment

Observe = Callable[[int, FloatArray, FloatArray, HandModel], Tile]
"""Returns the tile of a frame, by index, for a pose, thumb angles (2,) and a hand."""

CORRELATED = 64.0
"""Number of residuals per independent one: errors of neighbouring pixels are correlated."""
OVERCONFIDENCE = 3.0
"""Factor by which the stated covariance reduces the information of the images: some errors, such as the cut
to the forearm, are the same in all frames. Calibrated on synthetic random hands."""
MIN_RESIDUAL_MM = 0.5
CONVERGED = 0.05
MAX_SHAPE_STEP, MAX_FRAME_STEP = 0.75, np.repeat([15.0, 0.2, 0.3], [3, 3, FRAME_SIZE - 6])
_RELAXED_SD = np.append(np.repeat([np.inf, np.inf, 0.6], [3, 3, 15]), [IP_SD, ABDUCTION_SD])


@dataclass(frozen=True, eq=False)
class Bundle:
    """Result of a bundle adjustment.

    Attributes:
        shape: of the hand.
        poses: (F, 22).
        thumbs: (F, 2) their inner angles (``hand.fit.skeleton``), rad.
        covariance: (S, S) of the shape's parameters.
        residual_mm: weighted root mean square of the residuals.
        iterations: number of steps.
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
    """Minimise the residuals of all frames over shape and poses by Gauss-Newton.

    The unknowns are the shape's parameters theta, and for each frame a tangent vector and the thumb's inner
    angles. The prior of theta is N(0, diag sd^2) with the space's standard deviations. With H_f the normal
    matrix of frame f in blocks of shape s and frame p, the frames are eliminated (Schur complement): S =
    sum_f (H_ss - H_sp H_pp^-1 H_ps) + prior. The covariance of theta is S^-1, with the images' part of S
    divided by ``OVERCONFIDENCE``. Residuals are weighted by their mean square, and one in ``CORRELATED``
    counts as independent. Steps of theta stay within the space's bounds.

    Args:
        maker: makes the hand.
        space: the shape's parameters.
        side: ``right`` or ``left``.
        shape: start.
        poses, thumbs: (F, 22), (F, 2) start.
        observe: returns the observations.
        tile_px: their side.
        iterations: limit.
        terms: weights of the residuals.
    """
    terms = terms or Terms()
    rows, theta = FrameRows(terms, tile_px), space.theta(shape)
    covariance, residual, taken = np.diag(space.sd**2), 0.0, 0
    prior, most = np.diag(1.0 / space.sd**2), MAX_SHAPE_STEP * space.sd
    while taken < iterations:
        taken += 1
        hand, varied = _hands(maker, space, side, theta)
        moves = vertex_moves(poses, thumbs, hand, varied, space.steps)
        frames = [
            rows.rows(observe(f, pose, thumb, hand), pose, thumb, hand, move)
            for f, (pose, thumb, move) in enumerate(zip(poses, thumbs, moves, strict=True))
        ]
        residual = _root_mean_square([(frame.residuals, frame.weights) for frame in frames])
        share = (terms.sigma_mm / max(residual, MIN_RESIDUAL_MM)) ** 2 / CORRELATED
        equations = [
            _with_frame_prior(*frame.normal(share), pose, thumb)
            for frame, pose, thumb in zip(frames, poses, thumbs, strict=True)
        ]
        matrix, vector = _shape_equations(equations, prior, theta)
        covariance = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        step = np.clip(bounded_step(matrix, vector, space.low - theta, space.high - theta), -most, most)
        turns = np.array([back_substituted(*equation, _SHAPE, _FRAME, step) for equation in equations])
        turns = np.clip(turns, -MAX_FRAME_STEP, MAX_FRAME_STEP)
        poses = inside_limits(_SPACE.retract(poses, turns[:, :TANGENT_SIZE]))
        thumbs = np.clip(thumbs + turns[:, TANGENT_SIZE:], -MAX_THUMB, MAX_THUMB)
        theta = np.clip(theta + step, space.low, space.high)  # rounding may exceed a bound by an ulp
        if np.abs(step / np.sqrt(np.diag(covariance))).max() < CONVERGED:
            break
    stated = np.linalg.inv((matrix - prior) / OVERCONFIDENCE + prior)
    return Bundle(space.shape(theta), poses, thumbs, np.asarray(stated), residual, taken)


def _hands(
    maker: HandMaker, space: ShapeSpace, side: str, theta: FloatArray
) -> tuple[HandModel, list[HandModel]]:
    """Return the hand, and the hand with each parameter increased by a step."""
    steps = np.vstack([np.zeros(theta.size), np.diag(space.steps)])
    hand, *varied = (maker(side, space.shape(theta + step)) for step in steps)
    return hand, varied


def _with_frame_prior(
    matrix: FloatArray, vector: FloatArray, pose: FloatArray, thumb: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Add a weak prior around relaxed angles, so that unobserved fingers stay still."""
    precision = 1.0 / _RELAXED_SD**2
    matrix[range(FRAME_SIZE), range(FRAME_SIZE)] += precision + 1e-9
    vector[6:FRAME_SIZE] -= precision[6:] * np.append(pose[7:] - 0.2, thumb)
    return matrix, vector


def _shape_equations(
    equations: Sequence[tuple[FloatArray, FloatArray]], prior: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of the shape alone, with its prior."""
    matrix, vector = prior.copy(), -prior @ theta
    for equation in equations:
        of_matrix, of_vector = eliminated(*equation, _SHAPE, _FRAME)
        matrix += of_matrix
        vector += of_vector
    return matrix, vector


def _root_mean_square(parts: list[tuple[FloatArray, FloatArray]]) -> float:
    total = sum(float((weights * residuals**2).sum()) for residuals, weights in parts)
    weight = sum(float(weights.sum()) for _, weights in parts)
    return float(np.sqrt(total / weight)) if weight else 0.0
