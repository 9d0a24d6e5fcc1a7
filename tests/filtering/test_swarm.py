"""The swarm on functions whose minimum is known, and its laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.swarm import Box, Optimum, SwarmRules, constriction, minimise, scattered

NOTHING = np.array([], dtype=np.int64)


def box(size: int, half: float = 5.0, redrawn: np.ndarray = NOTHING) -> Box:
    return Box(np.full(size, -half), np.full(size, half), redrawn)


def sphere(x: np.ndarray) -> np.ndarray:
    return np.square(x - 1.0).sum(axis=1)


def rosenbrock(x: np.ndarray) -> np.ndarray:
    return (100.0 * np.square(x[:, 1:] - x[:, :-1] ** 2) + np.square(1.0 - x[:, :-1])).sum(axis=1)


def rastrigin(x: np.ndarray) -> np.ndarray:
    return 10.0 * x.shape[1] + (x**2 - 10.0 * np.cos(2.0 * np.pi * x)).sum(axis=1)


def optimum(cost, size: int, rules: SwarmRules, *, seed: int = 0, particles: int = 64, **more) -> Optimum:
    space, rng = box(size, **more), np.random.default_rng(seed)
    start = scattered(np.full(size, -2.0), np.full(size, 1.0), particles, space, rng)
    return minimise(cost, start, space, rules, rng)


def test_the_constriction_factor_is_that_of_the_published_coefficients() -> None:
    """psi = 4.1: sqrt(4.1 (4.1 - 4)) = sqrt(.41), so w = 2 / (2.1 + sqrt(.41)); the papers print .7298."""
    assert constriction(2.8, 1.3) == pytest.approx(2.0 / (2.1 + np.sqrt(0.41)), rel=1e-14)
    assert round(constriction(2.8, 1.3), 4) == 0.7298
    assert constriction(2.05, 2.05) == pytest.approx(constriction(2.8, 1.3), rel=1e-14)


@given(st.floats(4.01, 50.0))
def test_the_constriction_factor_solves_its_equation(psi: float) -> None:
    """w is the smaller root, in size, of z^2 + (psi - 2) z + 1 = 0, with its sign turned: w < 1."""
    w = constriction(psi, 0.0)
    assert 0.0 < w < 1.0
    assert w * w - (psi - 2.0) * w + 1.0 == pytest.approx(0.0, abs=1e-12 * psi**2)


@pytest.mark.parametrize("pair", [(2.0, 2.0), (5.0, -0.5), (np.nan, 3.0), (np.inf, 3.0)])
def test_coefficients_that_do_not_converge_are_refused(pair: tuple[float, float]) -> None:
    with pytest.raises(FilterError, match="would not converge"):
        SwarmRules(cognitive=pair[0], social=pair[1])


@pytest.mark.parametrize("rules", [{"generations": 0}, {"redraw_every": -1}, {"redraw_share": 1.5}])
def test_rules_out_of_range_are_refused(rules: dict[str, float]) -> None:
    with pytest.raises(FilterError, match="invalid swarm parameters"):
        SwarmRules(**rules)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("cost", "size", "generations", "bound"),
    [(sphere, 5, 150, 1e-8), (rosenbrock, 3, 400, 1e-3), (rastrigin, 3, 300, 1e-3)],
)
def test_minima_are_found(cost, size: int, generations: int, bound: float, seed: int) -> None:
    """The start, N(-2, 1), lies beside the minimum; bounds are far below the next one (rastrigin: 1)."""
    found = optimum(cost, size, SwarmRules(generations=generations, redraw_every=0), seed=seed)
    assert found.cost < bound
    assert cost(found.position[None])[0] == found.cost


def test_one_generation_by_hand() -> None:
    """Two particles on a line: the leader stands still at first, the other moves towards it."""
    start, rng, drawn = np.array([[0.0], [4.0]]), np.random.default_rng(7), np.random.default_rng(7)
    seen: list[np.ndarray] = []

    def cost(x: np.ndarray) -> np.ndarray:
        seen.append(x.copy())
        return np.abs(x[:, 0])

    minimise(cost, start, box(1), SwarmRules(generations=2), rng)
    common = drawn.random((2, 2, 1))[1]
    moved = 4.0 + constriction(2.8, 1.3) * 1.3 * common[1, 0] * (0.0 - 4.0)
    np.testing.assert_array_equal(seen[0], start)
    np.testing.assert_allclose(seen[1], [[0.0], [moved]], rtol=1e-14)


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    particles=st.integers(1, 9),
    size=st.integers(1, 4),
    rules=st.builds(
        SwarmRules,
        generations=st.integers(1, 12),
        redraw_every=st.integers(0, 3),
        redraw_share=st.floats(0.0, 1.0),
    ),
)
def test_laws_of_every_run(seed: int, particles: int, size: int, rules: SwarmRules) -> None:
    seen: list[np.ndarray] = []

    def cost(x: np.ndarray) -> np.ndarray:
        seen.append(x.copy())
        return rastrigin(x - 7.0)  # the minimum is outside: the bounds are pressed against

    found = optimum(cost, size, rules, seed=seed, particles=particles, redrawn=np.arange(size))
    everywhere = np.concatenate(seen)
    assert np.abs(everywhere).max() <= 5.0
    assert len(seen) == rules.generations
    assert found.evaluations == len(everywhere) == rules.generations * particles
    assert (np.diff(found.course) <= 0.0).all()
    costs = rastrigin(everywhere - 7.0)
    assert found.cost == found.course[-1] == costs.min()
    np.testing.assert_array_equal(found.position, everywhere[np.argmin(costs)])
    again = optimum(cost, size, rules, seed=seed, particles=particles, redrawn=np.arange(size))
    np.testing.assert_array_equal(again.position, found.position)
    np.testing.assert_array_equal(again.course, found.course)


def test_a_minimum_beyond_the_bounds_is_found_on_them() -> None:
    found = optimum(lambda x: sphere(x - 9.0), 3, SwarmRules(generations=60, redraw_every=0))
    np.testing.assert_array_equal(found.position, 5.0)


def test_redrawing_changes_one_component_of_half_the_particles() -> None:
    seen: list[np.ndarray] = []

    def flat(x: np.ndarray) -> np.ndarray:
        """Of equal costs the first is best, so without redrawing the swarm would contract to particle 0."""
        seen.append(x.copy())
        return np.zeros(len(x))

    start = np.zeros((64, 6))
    redrawn = np.array([2, 4, 5])
    minimise(flat, start, box(6, redrawn=redrawn), SwarmRules(generations=4), np.random.default_rng(1))
    assert not seen[0].any() and not seen[1].any() and not seen[2].any()  # all at one place, at rest
    changed = seen[3] != 0.0
    assert changed.sum(axis=1).tolist().count(1) == 32 and changed.sum() == 32
    assert set(np.flatnonzero(changed.any(axis=0))) == set(redrawn.tolist())
    values = seen[3][changed]
    # uniform over -5..5: the mean of 32 is within 4 standard errors, and the range is used
    assert abs(values.mean()) < 4.0 * (10.0 / np.sqrt(12.0)) / np.sqrt(32) and np.ptp(values) > 7.0


def test_redrawing_gets_out_of_a_valley() -> None:
    """A narrow deep valley far away in one component, which a swarm that has converged cannot see."""

    def cost(x: np.ndarray) -> np.ndarray:
        return np.square(x).sum(axis=1) - 30.0 * np.exp(-0.5 * np.square((x[:, 2] - 4.0) / 0.3))

    def share(rules: SwarmRules) -> int:
        own = {"redrawn": np.arange(3), "particles": 32}
        return sum(optimum(cost, 3, rules, seed=seed, **own).cost < -10.0 for seed in range(20))

    assert share(SwarmRules(generations=40, redraw_every=0)) <= 5
    assert share(SwarmRules(generations=40)) >= 15


def test_impossible_positions_are_left() -> None:
    def cost(x: np.ndarray) -> np.ndarray:
        return np.where(x[:, 0] < -1.0, np.inf, sphere(x))

    found = optimum(cost, 2, SwarmRules(generations=80, redraw_every=0))
    assert found.cost < 1e-4


def test_the_start_is_the_centre_and_what_is_scattered_about_it() -> None:
    space, sd = box(2), np.array([0.5, 100.0])
    found = scattered(np.array([1.0, 2.0]), sd, 4000, space, np.random.default_rng(0))
    np.testing.assert_array_equal(found[0], [1.0, 2.0])
    assert np.std(found[:, 0]) == pytest.approx(0.5, rel=4.0 / np.sqrt(2 * 4000))
    assert np.abs(found[:, 1]).max() == 5.0  # the nearest point of the box


def test_what_cannot_be_searched_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(FilterError, match="invalid bounds"):
        Box(np.ones(2), np.zeros(2), NOTHING)
    with pytest.raises(FilterError, match="no particles"):
        minimise(sphere, np.empty((0, 2)), box(2), SwarmRules(), rng)
    with pytest.raises(FilterError, match="1 of them NaN"):
        minimise(lambda x: np.array([np.nan, 1.0]), np.zeros((2, 2)), box(2), SwarmRules(), rng)
