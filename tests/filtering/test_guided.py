"""Proposals that look at the frame: exact against a Kalman filter, and with the true mass in every mode."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.filters import MarginalState, ParticleState, Prior
from posetrack_cli.filtering.guided import Guide, draw_guided
from posetrack_cli.filtering.model import Dynamics, Euclidean, FilterModel
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.resampling import Resampling
from posetrack_cli.filtering.step import Posterior, Prediction
from posetrack_cli.geometry import rotations as rot

PARTICLES = 2000
RESAMPLING = Resampling()
SLACK = 2.0
"""On the predicted RMS error, as in test_linear_gaussian."""
ROUNDING = 1e-8
"""A hundred operations on numbers of up to 1e4."""

MIXINGS = {
    "all": np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.4], [0.2, 0.1, 0.7]]),
    "part": np.array([[1.0, 0.5, 0.0], [-0.3, 2.0, 0.4]]),  # singular information
}


def rms(errors: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(errors), axis=0))


def exact_guide(world, modes: int = 1, **options):
    """Fits that are exact, made somewhere beside the likelihood's top, where the gradient is not zero."""
    rng = np.random.default_rng(3)

    def guide(y: np.ndarray) -> Guide:
        near = np.linalg.lstsq(world.sensor[:, : world.dimension], y, rcond=None)[0]
        fits = world.exact_modes(y, near + rng.standard_normal((modes, near.size)))
        shared = LikelihoodModes(
            fits.poses, fits.gradients, fits.information, fits.log_heights - np.log(modes)
        )
        return Guide(shared, **options)

    return guide


def run(world, observations: np.ndarray, seed: int, guide) -> list[Posterior]:
    advance = world.marginal if world.moving else world.particle
    return advance(observations, PARTICLES, seed, RESAMPLING, guide=guide)


def assert_meets_kalman(world, observations: np.ndarray, posteriors: list[Posterior]) -> None:
    exact = world.kalman(observations)
    predicted = np.sqrt(world.monte_carlo_variance(exact, posteriors, PARTICLES).mean(axis=0))
    moving = world.moving
    means = np.array([np.r_[p.pose, p.velocity] if moving else p.pose for p in posteriors])
    assert np.all(rms(means - exact.means) < SLACK * predicted)
    variances = np.array(
        [np.r_[p.pose_variance, p.velocity_variance] if moving else p.pose_variance for p in posteriors]
    )
    truth = np.diagonal(exact.covariances, axis1=1, axis2=2)
    relative = np.sqrt(2.0) * predicted / np.sqrt(truth.mean(axis=0))
    assert np.all(rms(variances / truth - 1.0) < SLACK * relative)
    error = sum(p.log_evidence for p in posteriors) - exact.log_evidence.sum()
    # each frame's evidence is a mean over ancestors of c_i, which varies no more than the weights would
    sd = np.sqrt(sum(1.0 / p.effective_sample_size + 1.0 / PARTICLES for p in posteriors))
    assert abs(error) < 4.0 * sd


@pytest.mark.parametrize("mixing", MIXINGS)
@pytest.mark.parametrize("moving", [True, False])
def test_exact_fits_meet_kalman(make_world, steps: np.ndarray, moving: bool, mixing: str) -> None:
    """The Laplace proposal of a linear-Gaussian model is exact: all weights are equal, at every frame.

    What is not observed at all spreads like a random walk, and particles follow it only for so many frames.
    """
    steps = steps if mixing == "all" else steps[:20]
    world = make_world(steps, dimension=3, moving=moving, mixing=MIXINGS[mixing])
    observations = world.observations(1)
    posteriors = run(world, observations, 2, exact_guide(world, prior_share=0.0))
    assert_meets_kalman(world, observations, posteriors)
    sizes = [p.effective_sample_size for p in posteriors]
    np.testing.assert_allclose(sizes, PARTICLES, rtol=ROUNDING)


@pytest.mark.parametrize(
    ("moving", "options"),
    [(True, {}), (False, {"inflation": 1.5}), (True, {"prior_share": 0.5, "inflation": 2.0})],
)
def test_shares_and_inflation_change_no_posterior(make_world, moving: bool, options: dict) -> None:
    """The ratio to the prediction is 0.8 to 1.5, the same with 2000 and 8000 particles: it is no bias."""
    world = make_world(np.full(200, 1.0 / 30.0), dimension=3, moving=moving, mixing=MIXINGS["all"])
    observations = world.observations(4)
    posteriors = run(world, observations, 5, exact_guide(world, modes=3, **options))
    assert_meets_kalman(world, observations, posteriors)


def test_prior_alone_is_the_plain_filter_s_distribution(make_world) -> None:
    world = make_world(np.full(100, 1.0 / 30.0))
    observations = world.observations(6)
    assert_meets_kalman(world, observations, run(world, observations, 7, exact_guide(world, prior_share=1.0)))


def test_twenty_one_dimensions_where_the_prior_alone_fails(make_world) -> None:
    """A sharp likelihood, as an image's is: else even the best ancestors are few, in so many dimensions."""
    mixing = 10.0 * np.random.default_rng(0).normal(size=(21, 21))
    world = make_world(np.full(40, 1.0 / 30.0), dimension=21, mixing=mixing, start_sd=0.0)
    observations = world.observations(8)
    posteriors = run(world, observations, 9, exact_guide(world, prior_share=0.1))
    assert_meets_kalman(world, observations, posteriors)
    assert min(p.effective_sample_size for p in posteriors) > 0.85 * PARTICLES
    plain = world.marginal(observations, PARTICLES, 9, RESAMPLING)
    assert max(p.effective_sample_size for p in plain) < 0.01 * PARTICLES


# An ambiguous finger: straight or bent, and a second angle that goes with the first. The likelihood of either
# is skewed and no Gaussian, and the bent one is narrower.
TOPS, WIDTHS, HEIGHTS = np.array([[0.2, 0.0], [1.3, 0.4]]), np.array([0.12, 0.07]), np.array([0.0, 0.7])
PRIOR_MEAN, PRIOR_SD, PRIOR_NOISE, DT = np.array([0.7, 0.1]), 0.15, np.array([3.0, 1.5]), 1.0 / 30.0
DRAWS = 20_000
TOO_HIGH = np.array([0.0, 3.0])


def ambiguous(poses: np.ndarray) -> np.ndarray:
    """Log of the sum over both fingers of their heights, falling along a bent valley."""
    away = (poses[:, None] - TOPS) / WIDTHS[:, None]
    skewed = np.square(away[..., 0] + 0.2 * np.square(away[..., 1])) + np.square(away[..., 1])
    return np.logaddexp.reduce(HEIGHTS - 0.5 * skewed, axis=1)


def fits(
    found: tuple[int, ...] = (0, 1), sharper: float = 1.0, heights: np.ndarray = HEIGHTS
) -> LikelihoodModes:
    """Laplace's fits of the fingers found, with an information that is so many times the right one."""
    chosen = list(found)
    information = sharper * np.eye(2) / np.square(WIDTHS)[chosen, None, None]
    return LikelihoodModes(TOPS[chosen], np.zeros((len(chosen), 2)), information, heights[chosen])


@cache
def true_moments() -> tuple[float, np.ndarray, float]:
    """Mass of the bent finger, mean pose and log evidence after one frame, by the sum over a fine grid."""
    side = np.linspace(-1.5, 3.0, 1501)
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    variance = PRIOR_SD**2 + DT * PRIOR_NOISE
    log_prior = -0.5 * (np.square(grid - PRIOR_MEAN) / variance + np.log(2.0 * np.pi * variance)).sum(axis=1)
    density = np.exp(log_prior + ambiguous(grid))
    total = density.sum()
    evidence = np.log(total * (side[1] - side[0]) ** 2)
    return density[grid[:, 0] > BETWEEN].sum() / total, density @ grid / total, evidence


BETWEEN = 0.75
"""Of the two fingers: the likelihood there is below exp(-10) of either's."""

GUIDES = {
    "right": Guide(fits(), 0.0),
    "too sharp by 4": Guide(fits(sharper=4.0), 0.2),
    "too wide by 4": Guide(fits(sharper=0.25), 0.1),
    "too sharp, inflated": Guide(fits(sharper=4.0), 0.1, 4.0),
    "heights wrong by e^3": Guide(fits(heights=HEIGHTS - TOO_HIGH), 0.1),
    "bent not found": Guide(fits(found=(0,)), 0.3),
    "straight not found": Guide(fits(found=(1,)), 0.3),
    "found twice": Guide(fits(found=(0, 0, 1)), 0.1),
}


@pytest.mark.parametrize("guide", GUIDES.values(), ids=GUIDES.keys())
@pytest.mark.parametrize("kind", ["particle", "marginal"])
def test_both_modes_keep_their_true_mass(guide: Guide, kind: str) -> None:
    """Whatever the fits are like, the weights put it right, to within the error that ESS and N allow."""
    mass, mean, log_evidence = true_moments()
    weights, poses, posterior = one_frame(guide, kind)
    found = weights[poses[:, 0] > BETWEEN].sum()
    # of a weighted mean: sum w^2 (f - mean)^2; ancestors add the spread of their own choice, at most 1 / N
    for error, values in ((found - mass, poses[:, 0] > BETWEEN), (posterior.pose - mean, poses)):
        spread = np.square(values.T - np.atleast_1d(weights @ values)[:, None])
        sd = np.sqrt(spread @ np.square(weights) + spread @ weights / DRAWS)
        assert np.all(np.abs(error) < 4.0 * sd)
        assert np.all(sd < 0.03)  # so that a wrong mass would show: the bent finger's is 0.24
    sd = np.sqrt(1.0 / posterior.effective_sample_size + 1.0 / DRAWS)
    assert abs(posterior.log_evidence - log_evidence) < 4.0 * sd


def one_frame(guide: Guide, kind: str) -> tuple[np.ndarray, np.ndarray, Posterior]:
    """Weights, poses and posterior after a frame that starts from Gaussian particles."""
    rng, space, spread = np.random.default_rng(11), Euclidean(), np.full(2, PRIOR_SD)
    state = ParticleState.initial(Prior(PRIOR_MEAN, spread, np.zeros(0)), DRAWS, space, rng)
    dynamics = Dynamics(PRIOR_NOISE, np.zeros(2))
    if kind == "marginal":  # dt^2 P + dt Q^n is the same variance
        velocity_sd = np.sqrt(0.5 * PRIOR_NOISE / DT)
        state = MarginalState.initial(Prior(PRIOR_MEAN, spread, velocity_sd), DRAWS, space, rng)
        dynamics = Dynamics(0.5 * PRIOR_NOISE, np.zeros(2))
    model = FilterModel(dynamics, space, RESAMPLING)
    after, posterior = state.step(DT, model, ambiguous, rng, guide)
    return np.exp(after.log_weights), after.poses, posterior


def test_both_modes_keep_their_mass_from_frame_to_frame() -> None:
    """Ten frames against a filter on a grid: the fits favour the wrong finger, and it does not take over."""
    side = np.linspace(-2.0, 3.5, 1101)
    noise, weak = np.array([0.6]), 4.0

    def score(poses: np.ndarray) -> np.ndarray:
        tops, widths = np.array([0.2, 1.0]), np.array([0.12, 0.08])
        return np.logaddexp.reduce(-0.5 * np.square((poses - tops) / widths) / weak, axis=1)

    transition = np.exp(-0.5 * np.square(side[:, None] - side) / (DT * noise))
    transition /= transition.sum(axis=0)
    density = np.exp(-0.5 * np.square((side - 0.6) / 0.2))
    modes = LikelihoodModes(
        np.array([[0.2], [1.0]]), np.zeros((2, 1)), np.array([[[20.0]], [[40.0]]]), np.array([1.0, 0.0])
    )
    space, masses, truth = Euclidean(), [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        state = ParticleState.initial(Prior(np.array([0.6]), np.array([0.2]), np.zeros(0)), 500, space, rng)
        masses.append([])
        for _ in range(10):
            dynamics = Dynamics(noise, np.zeros(1))
            state, _ = state.step(DT, FilterModel(dynamics, space, RESAMPLING), score, rng, Guide(modes))
            masses[-1].append(np.exp(state.log_weights)[state.poses[:, 0] > 0.6].sum())
    for _ in range(10):
        density = transition @ density * np.exp(score(side[:, None]))
        density /= density.sum()
        truth.append(density[side > 0.6].sum())
    error = np.mean(masses, axis=0) - truth
    assert np.all(np.abs(error) < 4.0 * np.std(masses, axis=0) / np.sqrt(40))
    assert np.all(np.std(masses, axis=0) < 0.1)
    assert min(truth) > 0.2 and max(truth) < 0.8  # both fingers stay possible


class Turning:
    """SO(3) as canonical quaternions, with the volume that the exponential map takes away."""

    def retract(self, x: np.ndarray, delta: np.ndarray) -> np.ndarray:
        return rot.canonical(rot.multiply(x, rot.exponential(delta)))

    def local(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return rot.logarithm(rot.multiply(rot.conjugate(x), y))

    def mean(self, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return rot.mean_quaternion(x, weights)

    def log_volume(self, delta: np.ndarray) -> np.ndarray:
        half = 0.5 * np.linalg.norm(delta, axis=-1)
        return 2.0 * np.log(np.sinc(half / np.pi))


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_rotations_meet_brute_force(share: float) -> None:
    """A wide prior and a likelihood off its centre, where charts disagree: the weights hold to the digit.

    Brute force draws a million turns from the prior and weighs them by the likelihood alone.
    """
    space, spread, drift = Turning(), np.array([0.5, 0.7, 0.4]), np.array([0.5, -0.2, 0.1])
    seen = rot.exponential(np.array([1.2, 0.3, -0.8]))
    information = np.array([[12.0, 3.0, 0.0], [3.0, 6.0, 1.0], [0.0, 1.0, 4.0]])

    def score(poses: np.ndarray) -> np.ndarray:
        away = space.local(np.broadcast_to(seen, poses.shape), poses)
        return -0.5 * np.einsum("ni,ij,nj->n", away, information, away)

    beside = np.array([0.2, -0.1, 0.1])
    height = np.array([-0.5 * beside @ information @ beside])
    pose = space.retract(seen[None], beside[None])
    modes = LikelihoodModes(pose, -beside[None] @ information, information[None], height)
    rng = np.random.default_rng(12)
    many, count = 1_000_000, 20_000
    identity = np.array(rot.IDENTITY)
    turns = space.retract(identity[None], drift + spread * rng.standard_normal((many, 3)))
    weights = np.exp(score(turns))
    state = ParticleState(np.tile(identity, (count, 1)), np.full(count, -np.log(count)))
    prediction = Prediction(state.poses, np.tile(drift, (count, 1)), np.square(spread), state.log_weights)
    draw = draw_guided(prediction, Guide(modes, share), space, "systematic", rng)
    drawn = np.exp(draw.log_weights + score(draw.poses))

    sd = np.hypot(relative_error(weights), relative_error(drawn))
    assert abs(np.log(drawn.sum()) - np.log(weights.mean())) < 4.0 * sd
    assert sd < 0.02
    for axis in range(3):
        truth, truth_sd = weighted_mean(weights, space.local(seen[None], turns)[:, axis])
        found, found_sd = weighted_mean(drawn, space.local(seen[None], draw.poses)[:, axis])
        assert abs(found - truth) < 4.0 * np.hypot(truth_sd, found_sd)
    assert drawn.sum() ** 2 / np.square(drawn).sum() > (0.5 if share else 0.1) * count


def relative_error(weights: np.ndarray) -> float:
    return float(np.std(weights) / (np.mean(weights) * np.sqrt(weights.size)))


def weighted_mean(weights: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    weights = weights / weights.sum()
    mean = weights @ values
    return mean, np.sqrt(np.square(weights) @ np.square(values - mean))


@pytest.mark.parametrize("kind", ["particle", "marginal"])
def test_without_modes_a_step_is_the_plain_one(kind: str) -> None:
    nothing = LikelihoodModes(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0))
    for first, second in zip(one_frame(Guide(nothing), kind), one_frame(None, kind), strict=True):
        if isinstance(first, np.ndarray):
            np.testing.assert_array_equal(first, second)


def test_nothing_observed_is_predicted_whatever_the_guide() -> None:
    space, dynamics = Euclidean(), Dynamics(PRIOR_NOISE, np.ones(2))
    state = MarginalState.initial(
        Prior(PRIOR_MEAN, np.ones(2), np.ones(2)), 10, space, np.random.default_rng(0)
    )
    after = [
        state.step(DT, FilterModel(dynamics, space, RESAMPLING), None, np.random.default_rng(1), guide)[0]
        for guide in (Guide(fits()), None)
    ]
    np.testing.assert_array_equal(after[0].poses, after[1].poses)


@pytest.mark.parametrize("noise", [0.0, 1e-30, 1e-12])
def test_what_hardly_moves_stays_and_has_no_say_in_the_weights(noise: float) -> None:
    """A frozen component at 1000 mm: its digits end before its noise begins, and densities are quotients."""
    space, rng, count = Euclidean(), np.random.default_rng(2), 100
    poses = np.tile([1000.0, 0.0], (count, 1))
    variance = np.array([noise, 1.0])
    prediction = Prediction(poses, np.zeros((count, 2)), variance, np.full(count, -np.log(count)))
    information = np.array([[[1.0, 0.0], [0.0, 4.0]]])
    modes = LikelihoodModes(np.array([[990.0, 1.0]]), np.zeros((1, 2)), information, np.zeros(1))
    draw = draw_guided(prediction, Guide(modes, 0.0), space, "systematic", rng)
    np.testing.assert_allclose(draw.poses[:, 0], 1000.0, atol=10.0 * np.sqrt(noise))
    away = draw.poses - modes.poses
    scores = draw.log_weights - 0.5 * np.einsum("ni,ij,nj->n", away, information[0], away)
    np.testing.assert_allclose(scores, scores[0], rtol=ROUNDING)


def test_ancestors_are_those_whose_future_explains_the_frame() -> None:
    """Of two kinds of particles one moves away from what is seen: all come from the other."""
    space, count = Euclidean(), 50
    velocities = np.where(np.arange(count)[:, None] < 25, [[30.0, 0.0]], [[-30.0, 0.0]])
    prediction = Prediction(
        np.zeros((count, 2)), DT * velocities, np.full(2, 1e-4), np.full(count, -np.log(count))
    )
    seen = LikelihoodModes(np.array([[1.0, 0.0]]), np.zeros((1, 2)), 1e4 * np.eye(2)[None], np.zeros(1))
    draw = draw_guided(prediction, Guide(seen, 0.0), space, "systematic", np.random.default_rng(3))
    assert np.all(draw.ancestors < 25)
    np.testing.assert_allclose(draw.increments, draw.poses, atol=ROUNDING)


def test_a_seed_gives_identical_results() -> None:
    first, second = (one_frame(Guide(fits()), "marginal") for _ in range(2))
    np.testing.assert_array_equal(first[1], second[1])
    np.testing.assert_array_equal(first[0], second[0])


@pytest.mark.parametrize(
    "options",
    [
        {"prior_share": -0.1},
        {"prior_share": np.nan},
        {"prior_share": 1.1},
        {"inflation": 0.5},
        {"inflation": np.inf},
        {"inflation": np.nan},
    ],
)
def test_guides_that_cannot_be_used_are_refused(options: dict) -> None:
    with pytest.raises(FilterError, match="invalid"):
        Guide(fits(), **options)


def test_information_that_is_none_is_refused() -> None:
    modes = LikelihoodModes(np.zeros((1, 2)), np.zeros((1, 2)), -1e6 * np.eye(2)[None], np.zeros(1))
    with pytest.raises(FilterError, match="invalid information"):
        one_frame(Guide(modes), "particle")


def test_a_fit_that_is_not_finite_is_refused() -> None:
    modes = LikelihoodModes(np.zeros((1, 2)), np.full((1, 2), np.nan), np.eye(2)[None], np.zeros(1))
    with pytest.raises(FilterError, match="NaN"):
        one_frame(Guide(modes), "particle")
