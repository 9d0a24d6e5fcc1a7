"""Fits against drawn hands: from several starts, in any order, and where there is nothing to fit."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.config import AcquisitionSettings
from posetrack_cli.hand.fit.anatomy_terms import RELAXED
from posetrack_cli.hand.fit.fitter import FINGER_ANGLES, SCATTER, HandFitter, PosePrior, fit_starts, refolds
from posetrack_cli.hand.fit.gauss_newton import Fit, Steps
from posetrack_cli.hand.fit.terms import Terms, Tile
from posetrack_cli.hand.model.anatomy import ANGLES, POSE_SIZE, TANGENT_SIZE
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.search import ITERATIONS, MAX_SWAPPED
from posetrack_cli.tracking.velocity import BodySpace
from support.fitting import HANDS, RIGHT, TILE_PX, observed
from support.hand import KINECT

SPACE = BodySpace()
CLAMP_MM = Terms().clamp_mm
FREE = 1.0 / np.square(np.repeat([40.0, 0.6, 0.6], [3, 3, 15]))
"""Precision of a prior that hardly holds."""
FOLDS = {(0.0, 0.0), (1.2, 1.5), (0.6, 0.8), (0.1, 1.2), (1.2, 0.1)}
"""MCP and PIP flexion, rad."""
SIDEWAYS = [8 + 3 * finger for finger in range(1, 5)]
"""Where a pose has the abductions of the four fingers."""
FOUND_MM = 1.0
"""Mean error of the joints: the relaxed hand pulls by tenths of a millimetre at what is hidden."""


@pytest.fixture(scope="module")
def fitters() -> dict[str, HandFitter]:
    return {name: HandFitter(hand, KINECT, TILE_PX) for name, hand in HANDS.items()}


def open_hand(name: str = "right", position: tuple[float, float, float] = (30.0, 80.0, 650.0)) -> FloatArray:
    """A relaxed hand that shows its palm, a little turned."""
    pose = np.zeros(POSE_SIZE)
    pose[:3] = position
    pose[3:7] = rotations.canonical(rotations.exponential(np.array([0.15, -0.2, 0.1])))
    pose[ANGLES] = RELAXED
    return pose


def moved(pose: FloatArray, seed: int, share: float = 1.0) -> FloatArray:
    """The pose some 10 mm, 6 degrees and 9 degrees of every bend farther."""
    sd = share * np.repeat([6.0, 0.1, 0.15], [3, 3, 15])
    return SPACE.retract(pose[None], sd * np.random.default_rng(seed).standard_normal((1, TANGENT_SIZE)))[0]


def error(name: str, found: FloatArray, truth: FloatArray) -> float:
    joints = joint_positions(HANDS[name].anatomy, np.stack([found, truth]))
    return float(np.linalg.norm(joints[0] - joints[1], axis=1).mean())


def free(start: FloatArray) -> PosePrior:
    return PosePrior(start, FREE)


def best_of(fits: list[Fit]) -> Fit:
    return min(fits, key=lambda fit: float(fit.cost[0]))


def descended(fitter: HandFitter, tile: Tile, starts: FloatArray, iterations: int = 10) -> list[Fit]:
    return fitter.descend(tile, starts, [free(start) for start in starts], iterations)


@pytest.mark.parametrize("name", list(HANDS))
@pytest.mark.parametrize("seed", range(4))
def test_a_drawn_hand_is_found(fitters: dict[str, HandFitter], name: str, seed: int) -> None:
    fitter, truth = fitters[name], open_hand(name)
    tile = fitter.tile(observed(HANDS[name], fitter, truth))
    starts = fitter.aligned(tile, np.stack([moved(truth, 10 * seed + k) for k in range(5)]))
    fits = descended(fitter, tile, starts)
    before = fitter.costs(tile, starts)
    assert all(fit.cost[0] <= cost for fit, cost in zip(fits, before, strict=True))
    best = best_of(fits)
    assert min(error(name, start, truth) for start in starts) > 4.0
    assert error(name, best.pose, truth) < FOUND_MM
    assert best.cost[0] < 0.2 * before.min()


def test_a_fit_says_what_its_pose_costs(fitters: dict[str, HandFitter]) -> None:
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    for fit in descended(fitter, tile, np.stack([moved(truth, k) for k in range(3)])):
        there = tile._replace(inner=fit.inner)
        again = fitter.assessed(there, fit.pose)
        assert again.cost[0] == fit.cost[0] == fitter.costs(there, fit.pose[None])[0]
        np.testing.assert_array_equal(again.pose, fit.pose)
        assert np.linalg.norm(fit.pose[3:7]) == pytest.approx(1.0, abs=1e-12)
        assert fit.pose[6] >= 0.0
        assert (np.diag(fit.data.matrix) >= 0.0).all()


def test_more_iterations_are_never_worse_at_the_same_width(fitters: dict[str, HandFitter]) -> None:
    """A descent keeps the best pose on its way, the start among them."""
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    start = moved(truth, 5)
    (still,) = descended(fitter, tile, start[None], iterations=0)
    np.testing.assert_array_equal(still.pose, start)
    for iterations in (1, 3, 6):
        (fit,) = descended(fitter, tile, start[None], iterations)
        assert fit.cost[0] <= still.cost[0]


@pytest.mark.parametrize("mm_per_nat", [0.0, 0.03, 10.0])
def test_fits_are_compared_by_cost_anatomy_and_prior(
    fitters: dict[str, HandFitter], mm_per_nat: float
) -> None:
    """D + u (U + e^T P e / 2), each part by itself."""
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))._replace(mm_per_nat=mm_per_nat)
    poses = np.stack([moved(truth, k) for k in range(3)])
    fits = [fitter.assessed(tile, pose) for pose in poses]
    prior = PosePrior(moved(truth, 9), FREE)
    off = np.stack([SPACE.local(prior.mean, pose) for pose in poses])
    doubts = fitter.potentials(poses, tile.inner) + 0.5 * np.square(off) @ FREE
    expected = fitter.costs(tile, poses) + mm_per_nat * doubts
    np.testing.assert_allclose(fitter.objectives(tile, fits, prior), expected, rtol=1e-12)
    elsewhere = PosePrior(np.concatenate([prior.mean[:3] + 500.0, prior.mean[3:]]), FREE)
    np.testing.assert_allclose(
        fitter.objectives(tile, fits, elsewhere.anywhere), fitter.objectives(tile, fits, prior.anywhere)
    )


def test_a_descent_keeps_the_most_probable_pose_on_its_way(fitters: dict[str, HandFitter]) -> None:
    """Where a nat weighs a metre, what the image gains is worth nothing, and no pose is kept for it."""
    fitter, start = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, moved(start, 5)))
    heavy = tile._replace(mm_per_nat=1000.0)
    prior = PosePrior(start, 4.0 * FREE)

    def objective(fit: Fit) -> float:
        return float(fitter.objectives(heavy._replace(inner=fit.inner), [fit], prior)[0])

    still = fitter.assessed(heavy, start)
    (by_cost,) = fitter.descend(tile, start[None], [prior], 6)
    (probable,) = fitter.descend(heavy, start[None], [prior], 6)
    assert by_cost.cost[0] < 0.5 * still.cost[0]
    assert objective(by_cost) > objective(still)
    assert objective(probable) <= objective(still)


def test_a_firm_prior_holds_the_pose(fitters: dict[str, HandFitter]) -> None:
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    start = moved(truth, 1)
    (fit,) = fitter.descend(tile, start[None], [PosePrior(start, np.full(TANGENT_SIZE, 1e12))], 6)
    np.testing.assert_allclose(fit.pose, start, atol=1e-6)


def test_the_prior_s_mean_draws_what_nothing_shows(fitters: dict[str, HandFitter]) -> None:
    """With one pixel of 4096 seen, a step goes to the prior's mean: N(mean, 1 / precision) is exact."""
    fitter, truth = fitters["right"], open_hand()
    observation = observed(RIGHT, fitter, truth)
    image = np.zeros_like(observation.image)
    row, column = np.argwhere(observation.image > 0)[200]
    image[row, column] = observation.image[row, column]
    tile = fitter.tile(Observation(observation.window, image, 1))
    start, mean = moved(truth, 2, 0.3), truth
    firm = np.full(TANGENT_SIZE, 1e6)
    # a first step to the mean lowers the cost: there the pixel is explained
    (fit,) = fitter.descend(tile, start[None], [PosePrior(mean, firm)], 1)
    assert fit.cost[0] < fitter.costs(tile, start[None])[0]
    assert error("right", fit.pose, mean) < 0.2 < error("right", start, mean)


def test_no_step_is_longer_than_allowed() -> None:
    most = Steps(translation_mm=2.0, rotation_rad=0.01, angle_rad=0.02)
    fitter, truth = HandFitter(RIGHT, KINECT, TILE_PX, steps=most), open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    start = moved(truth, 3)
    (fit,) = descended(fitter, tile, start[None], iterations=1)
    delta = SPACE.local(start, fit.pose)
    assert delta.any()
    assert np.linalg.norm(delta[:3]) <= 2.0 + 1e-9
    assert np.linalg.norm(delta[3:6]) <= 0.01 + 1e-9
    assert np.abs(delta[6:]).max() <= 0.02 + 1e-9


def test_fits_come_in_the_order_of_their_starts_and_again_the_same(fitters: dict[str, HandFitter]) -> None:
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    starts = np.stack([moved(truth, k) for k in range(7)])
    fits = descended(fitter, tile, starts, 4)
    for again in (
        descended(fitter, tile, starts, 4),
        [descended(fitter, tile, s[None], 4)[0] for s in starts],
    ):
        for first, second in zip(fits, again, strict=True):
            for ours, theirs in (
                (first.pose, second.pose),
                (first.cost, second.cost),
                (*first.data[:1], second.data[0]),
            ):
                assert ours.tobytes() == theirs.tobytes()
    costs = fitter.costs(tile, starts)
    np.testing.assert_array_equal(costs, [fitter.costs(tile, start[None])[0] for start in starts])
    assert len(set(costs)) == 7
    assert fitter.costs(tile, starts[:0]).shape == (0,)


@pytest.mark.parametrize("shift", [(40.0, -25.0, 60.0), (-25.0, 10.0, -60.0), (0.0, 0.0, 120.0)])
def test_an_aligned_pose_lies_where_the_hand_is(
    fitters: dict[str, HandFitter], shift: tuple[float, ...]
) -> None:
    """The same hand elsewhere, far from the optical axis, is shifted back."""
    fitter, truth = fitters["right"], open_hand(position=(200.0, 120.0, 650.0))
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    away = truth.copy()
    away[:3] += shift
    (found,) = fitter.aligned(tile, away[None])
    np.testing.assert_array_equal(found[3:], truth[3:])
    # nearer and aside, other parts of the skin are seen and the window cuts off fingertips: some 6 mm
    assert np.linalg.norm(found[:3] - truth[:3]) < 0.15 * np.linalg.norm(shift)
    np.testing.assert_array_equal(away[:3], truth[:3] + shift)  # what is given stays


def empty(observation: Observation) -> Observation:
    return Observation(observation.window, np.zeros_like(observation.image), 0)


def hidden(observation: Observation) -> Observation:
    return Observation(observation.window, np.full_like(observation.image, -200.0), 0)


def wall(observation: Observation) -> Observation:
    return Observation(observation.window, np.full_like(observation.image, -1500.0), 0)


@pytest.mark.parametrize("make", [empty, hidden, wall])
def test_where_there_is_no_hand_nothing_is_moved(fitters: dict[str, HandFitter], make) -> None:  # type: ignore[no-untyped-def]
    fitter, pose = fitters["right"], open_hand()
    tile = fitter.tile(make(observed(RIGHT, fitter, pose)))
    np.testing.assert_array_equal(fitter.aligned(tile, pose[None]), pose[None])
    (fit,) = descended(fitter, tile, pose[None])
    assert fit.cost[0] == CLAMP_MM
    np.testing.assert_array_equal(fit.pose, pose)
    assert not fit.data.matrix.any()


@pytest.mark.parametrize("z", [120.0, 40.0, 0.0, -300.0])
def test_a_hand_in_the_camera_costs_the_most_and_is_no_error(
    fitters: dict[str, HandFitter], z: float
) -> None:
    """Its wrist or fingertips lie before the near plane."""
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    pose = open_hand(position=(0.0, 0.0, z))
    pose[3:7] = rotations.exponential(np.array([np.pi / 2, 0.0, 0.0]))  # points at the camera
    assert fitter.costs(tile, pose[None])[0] == CLAMP_MM
    np.testing.assert_array_equal(fitter.aligned(tile, pose[None]), pose[None])
    (fit,) = descended(fitter, tile, pose[None])
    assert fit.cost[0] <= CLAMP_MM
    assert np.isfinite(fit.pose).all()
    assert np.isfinite(fit.data.matrix).all()


def test_a_hand_beside_the_window_is_pulled_in(fitters: dict[str, HandFitter]) -> None:
    """No pixel of it is drawn: observed ones look for its nearest skin."""
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    away = truth.copy()
    away[0] += 320.0
    assert fitter.costs(tile, away[None])[0] == CLAMP_MM
    fit = fitter.assessed(tile, away)
    assert fit.data.vector[0] < 0.0


def test_swapping_takes_each_finger_from_where_it_fits(fitters: dict[str, HandFitter]) -> None:
    """Three fits with one wrong finger each make the true hand."""
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    poses = np.tile(truth, (3, 1))
    for row, finger in enumerate((1, 2, 4)):
        poses[row, FINGER_ANGLES[finger]] += [0.6, 0.0, 0.8]
    fits = [fitter.assessed(tile, pose) for pose in poses]
    found = fitter.swapped(tile, [fits, fits[::-1]])
    np.testing.assert_array_equal(found, [truth, truth])
    alone = fitter.swapped(tile, [fits[:1], fits[1:2], fits[2:]])
    np.testing.assert_array_equal(alone, poses)


def test_no_finger_is_swapped_for_less_than_the_prior_has_against_it(fitters: dict[str, HandFitter]) -> None:
    fitter, truth = fitters["right"], open_hand()
    tile = fitter.tile(observed(RIGHT, fitter, truth))
    aside = truth.copy()
    aside[FINGER_ANGLES[2]] += [0.3, 0.0, 0.3]
    fits = [fitter.assessed(tile, pose) for pose in (aside, truth)]
    gain = float(fits[0].cost[0] - fits[1].cost[0])
    assert gain > 0.1
    prior = PosePrior(aside, 25.0 * FREE)
    doubt = float(np.subtract(*fitter.objectives(tile._replace(mm_per_nat=1.0), fits[::-1], prior))) + gain
    assert doubt > 0.1  # nats, of the true finger more than of the one beside it
    for share, expected in ((0.9, truth), (1.1, aside)):
        weighed = tile._replace(mm_per_nat=share * gain / doubt)
        found = fitter.swapped(weighed, [fits], prior)
        np.testing.assert_array_equal(found[0], expected)
    np.testing.assert_array_equal(fitter.swapped(tile, [fits], prior)[0], truth)


def test_starts_are_the_expected_pose_others_and_scattered_ones() -> None:
    expected, other = open_hand(), moved(open_hand(), 1)
    starts = fit_starts(expected, other[None], 6, SPACE, np.random.default_rng(1))
    assert starts.shape == (6, POSE_SIZE)
    np.testing.assert_array_equal(starts[:2], [expected, other])
    np.testing.assert_allclose(np.linalg.norm(starts[:, 3:7], axis=1), 1.0)
    again = fit_starts(expected, other[None], 6, SPACE, np.random.default_rng(1))
    np.testing.assert_array_equal(starts, again)
    assert not np.array_equal(starts, fit_starts(expected, other[None], 6, SPACE, np.random.default_rng(2)))
    for count in (1, 2):
        np.testing.assert_array_equal(
            fit_starts(expected, other[None], count, SPACE, np.random.default_rng(1)),
            [expected, other][:count],
        )
    alone = fit_starts(expected, np.empty((0, POSE_SIZE)), 4, SPACE, np.random.default_rng(1))
    np.testing.assert_array_equal(alone[0], expected)
    assert len({row.tobytes() for row in alone}) == 4


def test_scattered_starts_spread_as_stated_and_fold_fingers_together_or_each_alone() -> None:
    count, expected = 20_000, open_hand()
    none = np.empty((0, POSE_SIZE))
    starts = fit_starts(expected, none, count + 1, SPACE, np.random.default_rng(3))[1:]
    delta = SPACE.local(expected, starts)
    # position, rotation, and the abductions of fingers, which no fold changes
    free = [*range(6), *range(10, 21, 3)]
    np.testing.assert_allclose(delta[:, free].std(axis=0), SCATTER[free], rtol=4.0 / np.sqrt(2 * count))
    bends = starts[:, [[7 + 3 * finger, 9 + 3 * finger] for finger in range(1, 5)]]
    together, alone = bends[::2], bends[1::2]
    assert {tuple(bend) for bend in together[:, 0]} == FOLDS
    np.testing.assert_array_equal(together, np.repeat(together[:, :1], 4, axis=1))
    for finger in range(1, 5):
        refolded = np.array([tuple(bend) in FOLDS for bend in alone[:, finger - 1]])
        assert refolded.mean() == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(0.5 * count))
        assert {tuple(bend) for bend in alone[refolded, finger - 1]} == FOLDS
        kept = delta[1::2][~refolded][:, [6 + 3 * finger, 8 + 3 * finger]]
        assert np.abs(kept.mean(axis=0)).max() < 4.0 * 0.36 / np.sqrt(0.25 * count)
    thumbs = {tuple(pose[7:10]) for pose in refolds(expected)} - {tuple(expected[7:10])}
    assert len(thumbs) == 6
    refolded = np.array([tuple(pose[7:10]) in thumbs for pose in starts])
    assert refolded.mean() == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(count))
    assert {tuple(pose[7:10]) for pose in starts[refolded]} == thumbs
    spread = 4.0 / np.sqrt(2 * 0.5 * count)
    np.testing.assert_allclose(delta[~refolded][:, 6:9].std(axis=0), SCATTER[6:9], rtol=spread)


def test_refolded_fingers_of_a_search_are_scattered_about_straight_ahead() -> None:
    """And those that keep their fold about as far sideways as they are; nothing else changes."""
    count, expected = 20_000, open_hand()
    sideways = np.array([0.3, -0.2, 0.1, -0.3])
    expected[SIDEWAYS] = sideways
    none = np.empty((0, POSE_SIZE))
    here, ahead = (
        fit_starts(expected, none, count + 1, SPACE, np.random.default_rng(3), ahead=ahead)[1:]
        for ahead in (False, True)
    )
    bends = here[:, [[7 + 3 * finger, 9 + 3 * finger] for finger in range(1, 5)]]
    refolded = np.array([[tuple(bend) in FOLDS for bend in row] for row in bends])
    assert 0.7 < refolded.mean() < 0.8  # all of every second pose, half of the others
    off = np.where(refolded, sideways, 0.0)
    np.testing.assert_allclose(ahead[:, SIDEWAYS], here[:, SIDEWAYS] - off, atol=1e-12)
    same = np.setdiff1d(np.arange(POSE_SIZE), SIDEWAYS)
    np.testing.assert_array_equal(ahead[:, same], here[:, same])
    assert np.abs(ahead[:, SIDEWAYS][refolded].mean()) < 4.0 * SCATTER[10] / np.sqrt(refolded.sum())


def test_a_refolded_finger_stays_as_far_sideways_as_it_was_and_no_other_moves() -> None:
    pose = moved(open_hand(), 1)
    poses = refolds(pose)
    np.testing.assert_array_equal(poses[:, :7], np.tile(pose[:7], (26, 1)))
    changed = np.array([(poses[:, part] != pose[part]).any(axis=1) for part in FINGER_ANGLES])
    np.testing.assert_array_equal(np.argmax(changed, axis=0), [*np.repeat([1, 2, 3, 4], 5), *[0] * 6])
    np.testing.assert_array_equal(changed.sum(axis=0), 1)
    np.testing.assert_array_equal(poses[:, SIDEWAYS], np.tile(pose[SIDEWAYS], (26, 1)))


def test_a_search_finds_a_finger_closed_that_was_laid_on_its_neighbour(
    fitters: dict[str, HandFitter],
) -> None:
    """Three fingers closed since the frame before; the middle one was laid on the index and stays there.

    Folded where it lies it would cross the index, and the few iterations from there lead nowhere.
    """
    fitter, closed = fitters["right"], open_hand()
    closed[10:] = [-0.3, -0.1, 0.3, 0.4, -0.3, 1.5, 0.5, -0.25, 1.45, 0.6, -0.2, 1.55]
    laid = closed.copy()
    laid[FINGER_ANGLES[2]] = -0.5, 0.4, 1.35
    tile = fitter.tile(observed(RIGHT, fitter, closed))
    stuck = best_of(descended(fitter, tile, laid[None]))
    assert error("right", stuck.pose, closed) > 5.0
    draws = 20
    found = {
        ahead: sum(
            error("right", _searched(fitter, tile, stuck.pose, seed, ahead).pose, closed) < 1.5 * FOUND_MM
            for seed in range(draws)
        )
        for ahead in (False, True)
    }
    assert found[True] >= 0.8 * draws  # 18, and 14 of those scattered about where fingers lie
    assert found[True] > found[False]


def _searched(fitter: HandFitter, tile: Tile, pose: FloatArray, seed: int, ahead: bool) -> Fit:
    """The best fit from scattered starts about one that is refined, as ``Acquisition`` makes them."""
    settings, rng = AcquisitionSettings(), np.random.default_rng(seed)
    none = np.empty((0, POSE_SIZE))
    starts = fit_starts(pose, none, settings.scattered, SPACE, rng, ahead=ahead)
    fits = descended(fitter, tile, fitter.aligned(tile, starts), ITERATIONS)
    likeliest = sorted(fits, key=lambda fit: float(fit.cost[0]))[:MAX_SWAPPED]
    return best_of(fits + descended(fitter, tile, fitter.swapped(tile, [likeliest]), ITERATIONS))


def test_a_prior_about_another_place_keeps_all_else() -> None:
    prior = free(open_hand()).about(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(prior.mean, [1.0, 2.0, 3.0, *open_hand()[3:]])
    np.testing.assert_array_equal(prior.precision, FREE)
