"""Poses and places of skin adjusted to observations: against dense algebra, scipy and finite differences."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import settings as examples
from hypothesis import strategies as st
from scipy.optimize import least_squares

from posetrack_cli.geometry.rotations import exponential, matrices_from_quaternions
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose
from posetrack_cli.head.skin.equations import (
    NOISE_PX,
    POINT_SD,
    POSE_SD,
    TAIL,
    Observations,
    SkinPrior,
    _solve,
    adjust_pose,
    adjust_skin,
    in_cameras,
    linearise,
    make_equations,
    move_points,
    observations,
)

F = np.array([1000.0, 990.0])
RIG = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None].repeat(2, axis=0)
RIG[1] = np.column_stack(
    [matrices_from_quaternions(exponential(np.array([0.05, 0.3, -0.1]))), [-200.0, 10.0, 30.0]]
)
"""A camera, and one that is turned and moved aside."""
MANY = 200
"""Steps after which nothing moves any more."""
CONVERGED = 1e-7
"""mm and rad, of steps that each leave a part of the one before."""
seeds = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator) -> HeadPose:
    """About 700 mm away, turned by some 15 degrees."""
    facing = HeadPose(np.array([0.0, 0.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    return facing.moved(np.array([20.0, 20.0, 30.0, 0.2, 0.3, 0.1]) * rng.normal(size=POSE_SIZE))


def random_skin(rng: np.random.Generator, count: int) -> np.ndarray:
    """Places on a face."""
    return rng.uniform([-50.0, -80.0, 0.0], [50.0, 40.0, 40.0], (count, 3))


def rays_of(pose: HeadPose, points: np.ndarray) -> np.ndarray:
    seen = pose.points(points)
    return seen[:, :2] / seen[:, 2:]


def apart(one: HeadPose, other: HeadPose) -> np.ndarray:
    """In standard deviations of what is told."""
    return one.difference(other) / POSE_SD


@dataclass(frozen=True, eq=False)
class Case:
    """What ``adjust_skin`` is given, and the truth; observations in any order."""

    views: np.ndarray
    of_points: np.ndarray
    rays: np.ndarray
    told: HeadPose
    surface: np.ndarray
    poses: HeadPose
    points: np.ndarray
    transforms: np.ndarray

    @property
    def observed(self) -> Observations:
        return observations(self.views, self.of_points, self.rays, len(self.points))

    def run(self, steps: int) -> tuple[HeadPose, np.ndarray]:
        return adjust_skin(self.observed, SkinPrior(self.told, self.surface), F, steps, None, self.transforms)

    def terms(self, poses: HeadPose, points: np.ndarray) -> np.ndarray:
        """Residuals of which half the sum of squares is E: Cauchy's loss as if it were a square."""
        pairs = zip(self.views, self.of_points, strict=True)
        views = in_cameras(poses, self.transforms)
        seen = np.array([rays_of(views.of_frame(a), points[b : b + 1])[0] for a, b in pairs])
        e = (self.rays - seen) * F / NOISE_PX
        squared = np.sum(e**2, axis=1)
        loss = TAIL**2 * np.log1p(squared / TAIL**2)
        e *= np.sqrt(loss / np.maximum(squared, 1e-300))[:, None]
        turns, shifts = apart(poses, self.told), (points - self.surface) / POINT_SD
        return np.concatenate([e.ravel(), turns.ravel(), shifts.ravel()])

    def cost(self, poses: HeadPose, points: np.ndarray) -> float:
        return 0.5 * float(np.sum(self.terms(poses, points) ** 2))

    def moved(self, poses: HeadPose, points: np.ndarray, by: np.ndarray) -> tuple[HeadPose, np.ndarray]:
        """All poses and points after one vector of all their changes."""
        size = POSE_SIZE * len(poses.position)
        return poses.moved(by[:size].reshape(-1, POSE_SIZE)), points + by[size:].reshape(-1, 3)

    @property
    def units(self) -> np.ndarray:
        """A standard deviation of each change."""
        views, points = len(self.told.position), len(self.surface)
        return np.concatenate([np.tile(POSE_SD, views), np.tile(POINT_SD, points)])


def random_case(
    seed: int, views: int = 4, points: int = 12, noise: float = 0.5, outliers: float = 0.0, cameras: int = 1
) -> Case:
    """Points that most views see, poses told a degree and a few mm aside, a surface some mm beside."""
    rng, transforms = np.random.default_rng(seed), RIG[:cameras]
    poses = HeadPose.stacked([random_pose(rng) for _ in range(views)])
    skin = random_skin(rng, points)
    i, j = np.nonzero(rng.uniform(size=(views * cameras, points)) < 0.8)
    pairs = zip(i, j, strict=True)
    own = in_cameras(poses, transforms)
    exact = np.array([rays_of(own.of_frame(a), skin[b : b + 1])[0] for a, b in pairs]).reshape(-1, 2)
    pixels = noise * rng.normal(size=exact.shape)
    pixels[rng.uniform(size=len(i)) < outliers] += 15.0
    told = poses.moved(POSE_SD / 6 * rng.normal(size=(views, POSE_SIZE)))
    surface = skin + 0.5 * POINT_SD * rng.normal(size=skin.shape)
    return Case(i, j, exact + pixels / F, told, surface, poses, skin, transforms)


def differences(case: Case, poses: HeadPose, points: np.ndarray, h: float = 3e-5) -> np.ndarray:
    """The gradient of E per standard deviation of each change, by central differences.

    Two cameras see so well that E changes a thousandfold per standard deviation of what is told: with a
    step of 1e-4 the third derivative adds 1e-5.
    """
    found = []
    for index, unit in enumerate(case.units):
        by = np.zeros(len(case.units))
        by[index] = h * unit
        ahead, behind = (case.cost(*case.moved(poses, points, sign * by)) for sign in (1.0, -1.0))
        found.append((ahead - behind) / (2 * h))
    return np.array(found)


# A pose alone


@given(seeds)
@examples(max_examples=15)
def test_from_exact_rays_comes_the_true_pose(seed: int) -> None:
    """If that is what the feature points tell, too; begun a few pixels beside it."""
    rng = np.random.default_rng(seed)
    true, points = random_pose(rng), random_skin(rng, 40)
    start = true.moved(np.array([1.0, 1.0, 3.0, 2e-3, 2e-3, 2e-3]) * rng.normal(size=POSE_SIZE))
    found = adjust_pose([(rays_of(true, points), points)], start, true, F, MANY)
    np.testing.assert_allclose(apart(found, true), 0.0, atol=CONVERGED)


def test_two_cameras_show_where_a_head_is() -> None:
    """From exact rays, whatever is told of its distance."""
    rng = np.random.default_rng(14)
    true, points = random_pose(rng), random_skin(rng, 40)
    own = in_cameras(HeadPose.stacked([true]), RIG)
    seen = [(rays_of(own.of_frame(c), points), points) for c in range(len(RIG))]
    told = true.moved(np.array([3.0, 3.0, 30.0, 0.0, 0.05, 0.0]))
    found = adjust_pose(seen, told, told, F, MANY, RIG, np.full(POSE_SIZE, 1e6))
    np.testing.assert_allclose(found.difference(true), 0.0, atol=1e-6)


def test_many_points_outweigh_what_is_told() -> None:
    """What is told counts as its share of all information, about one part in 500 with 60 points."""
    rng = np.random.default_rng(5)
    true, points = random_pose(rng), random_skin(rng, 60)
    told = true.moved(np.concatenate([np.zeros(3), np.radians([0.0, 3.0, 0.0])]))
    rays = rays_of(true, points)
    found = adjust_pose([(rays, points)], told, told, F, MANY)
    seen = linearised(true, points, rays)
    information = np.einsum("n,nki,nkj->ij", seen.weights, seen.by_pose, seen.by_pose)
    wanted = true.difference(told)
    wanted = np.linalg.solve(information + np.diag(POSE_SD**-2), wanted / POSE_SD**2)
    np.testing.assert_allclose(true.difference(found), wanted, atol=0.05 * np.linalg.norm(wanted))
    assert np.linalg.norm(found.difference(true)[3:]) < np.radians(3.0) / 20


class Linearised(NamedTuple):
    """Observations (N) of a pose, as the kernel has them."""

    residuals: np.ndarray
    weights: np.ndarray
    by_pose: np.ndarray
    by_point: np.ndarray


def linearised(pose: HeadPose, points: np.ndarray, rays: np.ndarray) -> Linearised:
    residuals, J = np.empty((len(rays), 2)), np.empty((len(rays), 2, 9))
    weights = [
        linearise(ray, pose.rotation, pose.position, point, F, residual, rows)
        for ray, point, residual, rows in zip(rays, points, residuals, J, strict=True)
    ]
    return Linearised(residuals, np.array(weights), J[:, :, :POSE_SIZE], J[:, :, POSE_SIZE:])


def test_without_points_it_is_what_is_told() -> None:
    rng = np.random.default_rng(6)
    start, told = random_pose(rng), random_pose(rng)
    found = adjust_pose([(np.zeros((0, 2)), np.zeros((0, 3)))], start, told, F, 3)
    np.testing.assert_allclose(apart(found, told), 0.0, atol=1e-12)


@pytest.mark.parametrize("px", [5.0, 40.0, 1000.0])
def test_one_outlier_among_many_hardly_moves_a_pose(px: float) -> None:
    """The loss rises by TAIL / 2 a deviation at most, which moves what is seen of a point by h TAIL / 2 sigma
    at most: h is the part that the outlier's own residual would have there, as the hat matrix says."""
    rng = np.random.default_rng(7)
    true, points = random_pose(rng), random_skin(rng, 100)
    rays = rays_of(true, points)
    seen = linearised(true, points, rays)
    information = np.einsum("n,nki,nkj->ij", seen.weights, seen.by_pose, seen.by_pose)
    information += np.diag(POSE_SD**-2)
    hat = np.einsum("nki,ij,lj->nkl", seen.by_pose, np.linalg.inv(information), seen.by_pose[0])
    most = np.linalg.norm(hat, axis=(1, 2)) / NOISE_PX**2 * TAIL / 2 * NOISE_PX
    rays[0] += px / F * [0.6, 0.8]
    found = adjust_pose([(rays, points)], true, true, F, MANY)
    moved = np.linalg.norm((rays_of(found, points) - rays_of(true, points)) * F, axis=1)
    assert np.all(moved <= 1.05 * most) and most.max() < 0.2  # 1.05: others count a little less, then


# What observations say


def test_derivatives_are_those_of_what_is_seen() -> None:
    """By central differences, whose error is h^2 of derivatives of order f / z^2."""
    rng = np.random.default_rng(8)
    pose, points, h = random_pose(rng), random_skin(rng, 5), 1e-4
    rays = rays_of(pose, points)
    seen = linearised(pose, points, rays)
    for index in range(POSE_SIZE):
        by = h * np.eye(POSE_SIZE)[index]
        slope = (rays_of(pose.moved(by), points) - rays_of(pose.moved(-by), points)) * F / (2 * h)
        np.testing.assert_allclose(seen.by_pose[:, :, index], slope, atol=1e-5)
    for index in range(3):
        by = h * np.eye(3)[index]
        slope = (rays_of(pose, points + by) - rays_of(pose, points - by)) * F / (2 * h)
        np.testing.assert_allclose(seen.by_point[:, :, index], slope, atol=1e-6)


def test_an_observation_counts_half_at_the_tail() -> None:
    rng = np.random.default_rng(9)
    pose, points = random_pose(rng), random_skin(rng, 3)
    rays = rays_of(pose, points) + np.array([0.0, 1.0, 1e4])[:, None] * TAIL * NOISE_PX / F * [0.6, 0.8]
    seen = linearised(pose, points, rays)
    lengths = np.linalg.norm(seen.residuals, axis=1) / (TAIL * NOISE_PX)
    np.testing.assert_allclose(lengths, [0.0, 1.0, 1e4], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(seen.weights * NOISE_PX**2, [1.0, 0.5, 1e-8], rtol=1e-6)


# All poses and points


def dense(case: Case, poses: HeadPose, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The normal equations with every number in its place."""
    n, m = len(poses.position), len(points)
    size = POSE_SIZE * n + 3 * m
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    for a, b, ray in zip(case.views, case.of_points, case.rays, strict=True):
        seen = linearised(poses.of_frame(a), points[b : b + 1], ray[None])
        J = np.zeros((2, size))
        J[:, POSE_SIZE * a : POSE_SIZE * (a + 1)] = seen.by_pose[0]
        J[:, POSE_SIZE * n + 3 * b : POSE_SIZE * n + 3 * (b + 1)] = seen.by_point[0]
        matrix += seen.weights[0] * J.T @ J
        vector += seen.weights[0] * J.T @ seen.residuals[0]
    matrix += np.diag(case.units**-2)
    prior = np.concatenate([poses.difference(case.told).ravel(), (case.surface - points).ravel()])
    return matrix, vector + prior / case.units**2


@given(seeds, st.integers(1, 5), st.integers(1, 12))
@examples(max_examples=15)
def test_a_step_solves_the_dense_normal_equations(seed: int, views: int, points: int) -> None:
    """Anywhere: at poses and points that are neither told nor found. A view or a point may see nothing."""
    case, rng = random_case(seed, views, points, outliers=0.1), np.random.default_rng(seed)
    assume(len(case.rays))
    poses, skin = case.moved(case.told, case.surface, 0.2 * case.units * rng.normal(size=len(case.units)))
    equations, moves = make_equations(views, case.observed), np.empty_like(skin)
    turns = _solve(case.observed, poses, skin, SkinPrior(case.told, case.surface), F, equations)
    move_points(case.observed, equations, turns, moves)
    wanted = np.linalg.solve(*dense(case, poses, skin)) / case.units
    found = np.concatenate([turns.ravel(), moves.ravel()]) / case.units
    np.testing.assert_allclose(found, wanted, atol=1e-7 * (1.0 + np.abs(wanted).max()))


@pytest.mark.parametrize("outliers", [0.0, 0.1])
@pytest.mark.parametrize(("seed", "cameras"), [(0, 1), (1, 1), (2, 1), (0, 2), (1, 2)])
def test_it_ends_where_the_cost_falls_no_further(seed: int, outliers: float, cameras: int) -> None:
    """Its gradient is zero, to what differences of a cost of order 100 can tell: 1e-16 100 / 3e-5."""
    case = random_case(seed, outliers=outliers, cameras=cameras)
    begun = np.abs(differences(case, case.told, case.surface)).max()
    found = case.run(MANY)
    assert case.cost(*found) < case.cost(case.told, case.surface)
    assert np.abs(differences(case, *found)).max() < 1e-7 * max(begun, 100.0)


@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_scipy_comes_to_the_same(outliers: float) -> None:
    """E is half the sum of squares of ``terms``; about its minimum it grows by |du|^2 / 2 at least, with u in
    standard deviations of what is told."""
    case = random_case(11, outliers=outliers)
    mine = case.run(MANY)

    def function(u: np.ndarray) -> np.ndarray:
        return case.terms(*case.moved(case.told, case.surface, u * case.units))

    theirs = least_squares(function, np.zeros(len(case.units)), ftol=1e-15, xtol=1e-15, gtol=1e-10)
    assert case.cost(*mine) == pytest.approx(theirs.cost, rel=1e-9)
    poses, points = case.moved(case.told, case.surface, theirs.x * case.units)
    np.testing.assert_allclose(apart(mine[0], poses), 0.0, atol=1e-4)
    np.testing.assert_allclose((mine[1] - points) / POINT_SD, 0.0, atol=1e-4)


def test_what_is_told_exactly_and_seen_exactly_stays() -> None:
    case = random_case(12, noise=0.0)
    case = replace(case, told=case.poses, surface=case.points)
    poses, points = case.run(5)
    np.testing.assert_allclose(apart(poses, case.poses), 0.0, atol=1e-9)
    np.testing.assert_allclose(points, case.points, atol=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_poses_come_nearer_to_each_other_than_they_are_told(seed: int) -> None:
    """Seen to half a pixel by 80 points, rotations between views are found to a tenth of a degree, where what
    is told errs by one. How all of them are turned together nothing tells."""
    case = random_case(seed, views=8, points=80)
    poses, _ = case.run(MANY)
    errors = []
    for found in (case.told, poses):
        turns = found.difference(case.poses)[:, 3:]
        errors.append(np.degrees(np.sqrt(np.mean((turns - turns.mean(axis=0)) ** 2))))
    assert errors[0] > 0.5 and errors[1] < 0.5 * errors[0]


def test_equal_runs_give_equal_bits() -> None:
    (one, first), (two, second) = random_case(13).run(5), random_case(13).run(5)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(one.quaternion, two.quaternion)
    np.testing.assert_array_equal(one.position, two.position)
