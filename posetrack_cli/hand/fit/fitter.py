"""Fits of a hand's pose to one observation from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.compiled import thread_count
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.fit.anatomy_terms import add_anatomy, plausibility_of, potentials
from posetrack_cli.hand.fit.gauss_newton import (
    FREE_THUMB,
    Fit,
    Hand,
    Steps,
    ThumbPrior,
    Workspace,
    align_each,
    descend_each,
    empty_fits,
    make_workspace,
    swap_fingers_each,
    unstack_fits,
    write_costs,
)
from posetrack_cli.hand.fit.normal_equations import NormalEquations, empty_equations
from posetrack_cli.hand.fit.skeleton import pose_bones, skeleton_of, skin_of
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import POSE_SIZE, TANGENT_SIZE
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.rendering.mesh import SkinnedMesh
from posetrack_cli.rendering.raster import View
from posetrack_cli.tracking.velocity import BodySpace

# MCP and PIP flexion, rad, of a straight, curled, half-bent, hooked and flat-bent finger.
_FOLDS = np.array([(0.0, 0.0), (1.2, 1.5), (0.6, 0.8), (0.1, 1.2), (1.2, 0.1)])
# CMC flexion, MCP flexion and CMC abduction, rad, of a thumb held out and before the palm.
_THUMB_FOLDS = np.array(
    [
        (-0.2, 0.2, 0.35),
        (-0.2, 0.2, -0.35),
        (0.4, 0.45, 0.35),
        (0.4, 0.45, -0.35),
        (0.85, 0.5, 0.3),
        (0.85, 0.5, -0.3),
    ]
)
_REFOLDED = 0.5  # probability that a finger of a scattered start takes another fold
_FINGER_SD = (0.3, 0.08, 0.36)  # MCP flexion, abduction, PIP flexion, rad
SCATTER: FloatArray = np.array([8.0] * 3 + [0.15] * 3 + [0.3, 0.3, 0.08] + list(_FINGER_SD) * 4)
"""(21,) standard deviations of a random start, mm and rad."""


def fit_starts(
    expected: FloatArray,
    others: FloatArray,
    count: int,
    space: BodySpace,
    rng: np.random.Generator,
    *,
    ahead: bool = False,
) -> FloatArray:
    """Return start poses (count, 22): the prediction, others, then random ones around all of these.

    After a fast motion a finger is usually found from another fold, not from a nearby angle. In every second
    random pose all four fingers take one fold, as in a fist: seen from the back, a slightly open fist with
    its palm towards the elbow is a separate minimum that no single finger's fold leads out of.

    Args:
        expected: (22,) the prediction.
        others: (M, 22) further poses to try.
        count: number of starts.
        space: of poses.
        rng: for the random starts.
        ahead: draw the abduction of a refolded finger around straight ahead instead of around the given one.
            In a search it comes from a fit, which may have placed the finger on its neighbour.
    """
    given = np.concatenate([expected[None], others])[:count]
    more = count - len(given)
    if more <= 0:
        return given
    about = given[np.arange(more) % len(given)]
    scattered = space.retract(about, SCATTER * rng.standard_normal((more, TANGENT_SIZE)))
    which = rng.integers(len(_FOLDS), size=(more, 4))
    refolded = rng.random((more, 4)) < _REFOLDED
    which[::2], refolded[::2] = which[::2, :1], True
    fold = _FOLDS[which]
    for finger in range(1, 5):
        rows = refolded[:, finger - 1]
        scattered[rows, 7 + 3 * finger] = fold[rows, finger - 1, 0]
        scattered[rows, 9 + 3 * finger] = fold[rows, finger - 1, 1]
        if ahead:
            scattered[rows, 8 + 3 * finger] -= about[rows, 8 + 3 * finger]
    thumbs = rng.random(more) < _REFOLDED
    scattered[thumbs, FINGER_ANGLES[0]] = _THUMB_FOLDS[
        rng.integers(len(_THUMB_FOLDS), size=int(thumbs.sum()))
    ]
    return np.concatenate([given, scattered])


def refolds(pose: FloatArray) -> FloatArray:
    """Return a pose (22,) with one finger at a time in each fold: (26, 22)."""
    count = 4 * len(_FOLDS)
    poses = np.tile(pose, (count + len(_THUMB_FOLDS), 1))
    for row, (finger, fold) in enumerate(product(range(1, 5), _FOLDS)):
        poses[row, [7 + 3 * finger, 9 + 3 * finger]] = fold
    poses[count:, FINGER_ANGLES[0]] = _THUMB_FOLDS
    return poses


FINGER_ANGLES = tuple(slice(7 + 3 * f, 10 + 3 * f) for f in range(5))  # of a pose


@dataclass(frozen=True, eq=False)
class PosePrior:
    """Prior N(mean, diag 1 / precision) in the tangent space.

    Attributes:
        mean: (22,) pose.
        precision: (21,) 1 / mm^2 or 1 / rad^2.
    """

    mean: FloatArray
    precision: FloatArray

    def about(self, position: FloatArray) -> PosePrior:
        """Return the prior moved to another position (3,)."""
        return PosePrior(np.concatenate([position, self.mean[3:]]), self.precision)

    @property
    def anywhere(self) -> PosePrior:
        """Return the prior without a position."""
        return PosePrior(self.mean, np.concatenate([np.zeros(3), self.precision[3:]]))


# zero precision everywhere
FLAT_PRIOR = PosePrior(np.concatenate([np.zeros(6), [1.0], np.zeros(15)]), np.zeros(TANGENT_SIZE))


class HandFitter:
    """Fits one hand model to observations of one size.

    Args:
        model: the hand.
        camera: pinhole intrinsics.
        tile_px: side of the observations.
        terms: weights of the residuals.
        steps: step limits.
        skin: of hand and forearm, by default the smooth one.
        thumb: prior of its thumb.
    """

    def __init__(
        self,
        model: HandModel,
        camera: Camera,
        tile_px: int,
        terms: Terms | None = None,
        steps: Steps | None = None,
        skin: SkinnedMesh | None = None,
        thumb: ThumbPrior = FREE_THUMB,
    ) -> None:
        anatomy, skin = model.anatomy, skin or model.smooth_with_arm
        potential = plausibility_of(anatomy)
        potential = potential if thumb.rests else potential._replace(resting_odds=-np.inf)
        self.hand = Hand(skeleton_of(anatomy), skin_of(skin), potential, thumb.precision)
        self._camera, self._terms, self._steps = camera, terms or Terms(), steps or Steps()
        self._space = BodySpace()
        self._free = [make_workspace(self.hand, tile_px, tile_px) for _ in range(thread_count())]
        self._threads = ThreadPoolExecutor(len(self._free))

    def tile(self, observation: Observation) -> Tile:
        """Return an observation as the kernels read it."""
        return tile_of(observation, self._camera)

    def aligned(self, tile: Tile, poses: FloatArray) -> FloatArray:
        """Return poses (K, 22) shifted so that the rendered hand has the observed hand's centroid."""
        out = np.array(poses, order="C")

        def align_some(first: int, stride: int, workspace: Workspace) -> None:
            align_each(self.hand, tile, out, first, stride, workspace)

        self._share_out(len(out), align_some)
        return out

    def descend(
        self, tile: Tile, starts: FloatArray, priors: Sequence[PosePrior], iterations: int
    ) -> list[Fit]:
        """Return a fit from each start (K, 22), with its own prior."""
        if not priors:
            return []
        fits, starts = empty_fits(len(priors)), np.ascontiguousarray(starts)
        means = np.array([prior.mean for prior in priors])
        precisions = np.array([prior.precision for prior in priors])

        def descend_some(first: int, stride: int, workspace: Workspace) -> None:
            descend_each(
                self.hand,
                tile,
                starts,
                means,
                precisions,
                first,
                stride,
                self._terms,
                self._steps,
                iterations,
                workspace,
                fits,
            )

        self._share_out(len(priors), descend_some)
        return unstack_fits(fits)

    def objectives(self, tile: Tile, fits: Sequence[Fit], prior: PosePrior = FLAT_PRIOR) -> FloatArray:
        """Return the objectives (N,), mm, of fits: costs plus prior and anatomical potential.

        As in ``gauss_newton.descend_each``, but with one prior and the tile's inner numbers for all.

        Args:
            tile: the observation.
            fits: N of them.
            prior: of all of them.
        """
        costs = np.array([float(fit.cost[0]) for fit in fits])
        if tile.mm_per_nat == 0.0 or not fits:
            return costs
        poses = np.array([fit.pose for fit in fits])
        off = self._space.local(prior.mean[None], poses)
        doubts = self.potentials(poses, tile.inner) + 0.5 * np.square(off) @ prior.precision
        objectives: FloatArray = costs + tile.mm_per_nat * doubts
        return objectives

    def swapped(
        self, tile: Tile, groups: Sequence[Sequence[Fit]], prior: PosePrior = FLAT_PRIOR
    ) -> FloatArray:
        """Return for each group the best fit's pose, with each finger from the fit where it fits best.

        Args:
            tile: the observation.
            groups: G groups with the same number of fits, at least one.
            prior: of all poses.

        Returns:
            (G, 22).
        """
        values = np.array([self.objectives(tile, group, prior) for group in groups])
        order = np.argsort(values, axis=1, kind="stable")
        poses = np.array([[group[k].pose for k in row] for group, row in zip(groups, order, strict=True)])
        least, mean, precision = values.min(axis=1), prior.mean, prior.precision
        out = np.empty((len(poses), POSE_SIZE))

        def swap_some(first: int, stride: int, workspace: Workspace) -> None:
            swap_fingers_each(
                self.hand,
                tile,
                poses,
                least,
                mean,
                precision,
                first,
                stride,
                self._terms,
                workspace,
                out,
            )

        self._share_out(len(poses), swap_some)
        return out

    def assessed(self, tile: Tile, pose: FloatArray) -> Fit:
        """Return the fit of a pose without a step."""
        return self.descend(tile, pose[None], [FLAT_PRIOR], 0)[0]

    def anatomy(self, fit: Fit) -> NormalEquations:
        """Return gradient and information of exp(-U) at a fit, with U the anatomical potential."""
        equations, workspace = empty_equations(), self._free[0]
        pose_bones(self.hand.skeleton, fit.pose, fit.inner, workspace.posed)
        add_anatomy(self.hand.plausibility, fit.pose, workspace.posed, workspace.spheres, equations)
        return equations

    def costs(self, tile: Tile, poses: FloatArray) -> FloatArray:
        """Return union costs (N,), mm, of poses (N, 22)."""
        costs, poses = np.empty(len(poses)), np.ascontiguousarray(poses)

        def write_some(first: int, stride: int, workspace: Workspace) -> None:
            write_costs(self.hand, tile, poses, first, stride, self._terms, workspace, costs)

        self._share_out(len(poses), write_some)
        return costs

    def potentials(self, poses: FloatArray, inner: FloatArray) -> FloatArray:
        """Return the anatomical potential U (N,); exp(-U) is a factor of the likelihood.

        Args:
            poses: (N, 22).
            inner: (6,) inner numbers of all.
        """
        out, hand = np.empty(len(poses)), self.hand

        def write_some(first: int, stride: int, workspace: Workspace) -> None:
            posed, spheres, equations = workspace.posed, workspace.spheres, workspace.whole
            potentials(
                hand.plausibility,
                hand.skeleton,
                poses,
                inner,
                first,
                stride,
                posed,
                spheres,
                equations,
                out,
            )

        self._share_out(len(poses), write_some)
        return out

    def _share_out(self, count: int, some: Callable[[int, int, Workspace], None]) -> None:
        """Run compiled work on ``count`` items in all threads, including this one.

        Args:
            count: number of items.
            some: processes every n-th item from a first one, with the thread's own workspace.
        """
        # passing hand and tile to compiled code costs a third of a rendering: once per thread, not per item
        threads = min(len(self._free), count)
        others = [self._threads.submit(some, k, threads, self._free[k]) for k in range(1, threads)]
        if threads:
            some(0, threads, self._free[0])
        for other in others:
            other.result()


def tile_of(observation: Observation, camera: Camera) -> Tile:
    """Return a camera's observation as the kernels read it."""
    image = observation.image.astype(np.float64)
    view = View(*observation.window.tile_projection(camera))
    nearest, inner = nearest_pixels(image > 0), observation.inner
    return Tile(image, nearest, observation.target_pixels, view, inner, inner)


def nearest_pixels(mask: BoolArray) -> FloatArray:
    """Return column and row (2, h, w) of the nearest mask pixel; of the pixel itself for an empty mask."""
    height, width = mask.shape
    rows, columns = np.mgrid[:height, :width]
    if not mask.any():  # same memory layout as below, or kernels would be compiled a second time
        return np.stack([columns, rows], axis=-1).astype(np.float64).transpose(2, 0, 1)
    _, labels = cv2.distanceTransformWithLabels(
        (~mask).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    at = np.zeros((2, int(labels.max()) + 1))
    at[:, labels[mask]] = columns[mask], rows[mask]
    nearest: FloatArray = at[:, labels]
    return nearest
