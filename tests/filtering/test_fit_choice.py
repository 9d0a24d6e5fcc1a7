"""Which fit a belief goes on with, and how far it is trusted: against evidence, integrals and hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from posetrack_cli.filtering.fit_smoothing import down_weighted, likeliest, log_evidence, only
from posetrack_cli.filtering.model import Euclidean, Gaussian
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.smoothing import StateGaussian
from support.kalman import kalman_update

SPACE = Euclidean()


def belief(mean: np.ndarray, covariance: np.ndarray) -> StateGaussian:
    """Of a pose; the velocity is known."""
    whole = np.zeros((2 * len(mean), 2 * len(mean)))
    whole[: len(mean), : len(mean)] = covariance
    return StateGaussian(mean, np.zeros(len(mean)), whole)


@pytest.mark.parametrize("observed", [1, 2, 3])
def test_evidence_is_the_kalman_filters(make_world, observed: int) -> None:
    """Wherever the quadratic is expanded, and also of what is seen in part."""
    rng = np.random.default_rng(observed)
    mixing, root = rng.standard_normal((observed, 3)), rng.standard_normal((3, 3))
    world = make_world(np.full(1, 0.1), dimension=3, mixing=mixing)
    mean, covariance, y = rng.standard_normal(3), root @ root.T, rng.standard_normal(observed)
    modes = world.exact_modes(y, 3.0 * rng.standard_normal((4, 3)))
    exact = kalman_update(Gaussian(mean, covariance), y, mixing, np.eye(observed))[1]
    for k in range(4):
        assert log_evidence(belief(mean, covariance), modes, k, SPACE) == pytest.approx(exact, rel=1e-9)


def test_evidence_is_an_integral() -> None:
    """Of N(x; 1, 4) exp(h + g (x - 2) - H (x - 2)^2 / 2)."""
    h, g, H = 0.7, -0.4, 1.5
    modes = LikelihoodModes(np.array([[2.0]]), np.array([[g]]), np.array([[[H]]]), np.array([h]))

    def integrand(x: float) -> float:
        prior = np.exp(-((x - 1.0) ** 2) / 8.0) / np.sqrt(8.0 * np.pi)
        return prior * np.exp(h + g * (x - 2.0) - 0.5 * H * (x - 2.0) ** 2)

    mass = quad(integrand, -20.0, 20.0)[0]
    found = log_evidence(belief(np.ones(1), np.full((1, 1), 4.0)), modes, 0, SPACE)
    assert found == pytest.approx(np.log(mass), abs=1e-9)


@pytest.mark.parametrize(("higher", "expected"), [(0.0, 0), (7.0, 0), (9.0, 1)])
def test_a_far_fit_is_taken_only_where_it_explains_the_frame_better(higher: float, expected: int) -> None:
    """Sharp fits 1 and 4 sd of the belief away: their evidences differ by (4^2 - 1^2) / 2 = 7.5."""
    modes = LikelihoodModes(
        np.array([[1.0], [4.0]]), np.zeros((2, 1)), np.full((2, 1, 1), 1e6), np.array([0.0, higher])
    )
    assert likeliest(belief(np.zeros(1), np.eye(1)), modes, SPACE) == expected
    np.testing.assert_array_equal(only(modes, expected).poses, modes.poses[[expected]])


def test_a_group_that_contradicts_loses_information() -> None:
    """nu = 4; C = 1, H = 1, so V = 2: off by 6 is chi2 18, weight (4 + 1) / (4 + 18); off by 1 stays."""
    H = np.array([[1.0, 0.3], [0.3, 1.0]])
    modes = LikelihoodModes(np.array([[6.0, 1.0]]), np.zeros((1, 2)), np.eye(2)[None], np.zeros(1))
    groups, state = [np.array([0]), np.array([1])], belief(np.zeros(2), np.eye(2))
    found = down_weighted(state, modes, groups, 4.0, SPACE)
    np.testing.assert_allclose(found.information[0], np.diag([5.0 / 22.0, 1.0]), rtol=1e-6)
    coupled = LikelihoodModes(modes.poses, modes.gradients, H[None], modes.log_heights)
    found = down_weighted(state, coupled, groups, 4.0, SPACE)
    root = np.sqrt((4.0 + 1.0) / (4.0 + 36.0 / (1.0 + np.linalg.inv(H)[0, 0])))
    np.testing.assert_allclose(found.information[0], [[root**2, 0.3 * root], [0.3 * root, 1.0]], rtol=1e-6)
    assert np.linalg.eigvalsh(found.information[0])[0] > 0.0


def test_a_doubted_fit_keeps_its_maximum() -> None:
    rng = np.random.default_rng(3)
    root = rng.standard_normal((3, 3))
    H, g = root @ root.T, 5.0 * rng.standard_normal(3)
    modes = LikelihoodModes(rng.standard_normal((1, 3)), g[None], H[None], np.zeros(1))
    found = down_weighted(belief(np.zeros(3), np.eye(3)), modes, [np.arange(2), np.array([2])], 1.0, SPACE)
    assert not np.allclose(found.information[0], H)
    np.testing.assert_allclose(
        np.linalg.solve(found.information[0], found.gradients[0]), np.linalg.solve(H, g), rtol=1e-5
    )


def test_what_agrees_is_not_doubted_even_if_it_knows_little() -> None:
    H = np.diag([2.0, 0.0])
    modes = LikelihoodModes(np.array([[0.1, 9.0]]), np.array([[0.2, 0.0]]), H[None], np.zeros(1))
    found = down_weighted(belief(np.zeros(2), np.eye(2)), modes, [np.array([0]), np.array([1])], 4.0, SPACE)
    np.testing.assert_allclose(found.information[0], H, atol=1e-12)
    np.testing.assert_allclose(found.gradients[0], modes.gradients[0], rtol=1e-8)
