"""Kalman steps against the joint Gaussian solved directly, and the marginal velocity against Kalman steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import (
    DISCRETISATIONS,
    Gaussian,
    constant_velocity,
    kalman_predict,
    step_noise,
    velocity_gain,
)
from support.kalman import kalman_update

ROUNDING = 1e-9
"""Relative: products and differences of a few numbers; the printed form of (57) cancels up to six digits."""

both = pytest.mark.parametrize("discretisation", DISCRETISATIONS)
positive = arrays(np.float64, 3, elements=st.floats(1e-2, 1e3))
time_steps = st.floats(5e-3, 0.5)
# nothing, or so much that products of two are no subnormal numbers, which have fewer digits
variances = st.one_of(st.just(0.0), st.floats(1e-100, 1e6))
relaxed = settings(deadline=None)


def joint(pose_cov: np.ndarray, velocity_cov: np.ndarray) -> np.ndarray:
    zero = np.zeros((pose_cov.size, pose_cov.size))
    return np.block([[np.diag(pose_cov), zero], [zero, np.diag(velocity_cov)]])


def test_the_printed_gain_by_hand() -> None:
    """(55)-(57) as printed with P = 2, Q^n = 300, Q^l = 6, dt = 0.1: N = .02 + 30, L = 2 / N."""
    gain = velocity_gain(
        np.array([2.0]), step_noise(np.full(1, 300.0), np.full(1, 6.0), 0.1, "euler"), 0.1, "printed"
    )
    assert gain.increment_variance[0] == pytest.approx(30.02)
    assert gain.gain[0] == pytest.approx(2.0 / 30.02)
    assert gain.variance[0] == pytest.approx(2.0 + 0.6 - 4.0 / 30.02)
    corrected = velocity_gain(
        np.array([2.0]), step_noise(np.full(1, 300.0), np.full(1, 6.0), 0.1, "euler"), 0.1
    )
    assert gain.gain[0] == pytest.approx(corrected.gain[0] / 0.1)  # the factor dt that it lacks


def test_the_printed_gain_refuses_a_negative_variance() -> None:
    """A velocity that matters: P = 900 and dt Q^n = 53, so P^2 / N is some 15,000."""
    noise = step_noise(np.full(1, 1600.0), np.full(1, 600.0**2), 1.0 / 30.0, "euler")
    with pytest.raises(FilterError, match=r"negative, found -2.*expected motion\.velocity"):
        velocity_gain(np.full(1, 900.0), noise, 1.0 / 30.0, "printed")


@both
@relaxed
@given(P=positive, Qn=positive, Ql=positive, dt=time_steps)
def test_gain_is_the_regression_of_velocity_on_the_increment(
    discretisation: str, P: np.ndarray, Qn: np.ndarray, Ql: np.ndarray, dt: float
) -> None:
    """Pose known exactly before and after the step: a Kalman update with R = 0 must give L, N and P'."""
    F, Q = constant_velocity(step_noise(Qn, Ql, dt, discretisation), dt)
    predicted = kalman_predict(Gaussian(np.zeros(6), joint(np.zeros(3), P)), F, Q).covariance
    N, cross, velocity = np.diag(predicted)[:3], np.diag(predicted[3:, :3]), np.diag(predicted)[3:]
    gain = velocity_gain(P, step_noise(Qn, Ql, dt, discretisation), dt)
    np.testing.assert_allclose(gain.increment_variance, N, rtol=ROUNDING)
    np.testing.assert_allclose(gain.gain, cross / N, rtol=ROUNDING)
    np.testing.assert_allclose(
        gain.variance, velocity - cross**2 / N, rtol=ROUNDING, atol=ROUNDING * velocity.max()
    )


@relaxed
@given(P=positive, Qn=positive, Ql=positive, dt=time_steps)
def test_euler_is_the_corrected_recursion_as_written(
    P: np.ndarray, Qn: np.ndarray, Ql: np.ndarray, dt: float
) -> None:
    N = dt**2 * P + dt * Qn
    L = dt * P / N
    gain = velocity_gain(P, step_noise(Qn, Ql, dt, "euler"), dt)
    np.testing.assert_allclose(gain.increment_variance, N, rtol=ROUNDING)
    np.testing.assert_allclose(gain.gain, L, rtol=ROUNDING)
    np.testing.assert_allclose(
        gain.variance, P + dt * Ql - L * N * L, rtol=ROUNDING, atol=ROUNDING * (P + dt * Ql).max()
    )


@pytest.mark.parametrize(("P", "steps"), [(100.0, 1), (1.0, 2)])
def test_gain_as_printed_makes_the_variance_negative(P: float, steps: int) -> None:
    """(56) as printed, L = P / N, with hand.md's numbers: why the factor dt is a fix and no taste."""
    dt, Qn, Ql = 1.0 / 30.0, 4.0, 400.0
    for _ in range(steps):
        N = dt**2 * P + dt * Qn
        P = P + dt * Ql - (P / N) ** 2 * N
    assert P < 0.0


@both
@relaxed
@given(
    P=arrays(np.float64, 3, elements=variances),
    Qn=arrays(np.float64, 3, elements=variances),
    Ql=arrays(np.float64, 3, elements=variances),
    dt=st.floats(1e-6, 100.0),
)
def test_variance_stays_between_zero_and_what_was_there(
    discretisation: str, P: np.ndarray, Qn: np.ndarray, Ql: np.ndarray, dt: float
) -> None:
    gain = velocity_gain(P, step_noise(Qn, Ql, dt, discretisation), dt)
    assert np.all(gain.variance >= 0.0)
    assert np.all(gain.variance <= (P + dt * Ql) * (1.0 + 1e-12))
    assert np.all(np.isfinite(gain.gain))
    assert np.all(gain.gain >= 0.0)


@both
def test_frozen_component_has_no_gain_and_stays_frozen(discretisation: str) -> None:
    zero = np.zeros(2)
    gain = velocity_gain(zero, step_noise(np.array([0.0, 4.0]), zero, 0.1, discretisation), 0.1)
    np.testing.assert_array_equal(gain.gain, zero)
    np.testing.assert_array_equal(gain.variance, zero)
    np.testing.assert_allclose(gain.increment_variance, [0.0, 0.4])


def test_without_pose_noise_the_increment_is_the_velocity() -> None:
    gain = velocity_gain(np.array([9.0]), step_noise(np.zeros(1), np.array([5.0]), 0.1, "euler"), 0.1)
    np.testing.assert_allclose(gain.gain, [10.0])  # 1 / dt
    np.testing.assert_allclose(gain.variance, [0.5])  # only what the velocity wanders in the step


@relaxed
@given(Qn=positive, Ql=positive, dt=time_steps, parts=st.integers(2, 5))
def test_exact_steps_compose(Qn: np.ndarray, Ql: np.ndarray, dt: float, parts: int) -> None:
    F, Q = constant_velocity(step_noise(Qn, Ql, dt, "exact"), dt)
    transition, noise = np.eye(6), np.zeros((6, 6))
    for _ in range(parts):
        transition, noise = F @ transition, F @ noise @ F.T + Q
    whole_F, whole_Q = constant_velocity(step_noise(Qn, Ql, parts * dt, "exact"), parts * dt)
    np.testing.assert_allclose(transition, whole_F, rtol=1e-12)
    np.testing.assert_allclose(noise, whole_Q, rtol=1e-12)


def test_euler_steps_miss_by_the_velocity_s_wander() -> None:
    Qn, Ql, dt = np.array([4.0]), np.array([400.0]), 1.0 / 30.0
    F, Q = constant_velocity(step_noise(Qn, Ql, dt, "euler"), dt)
    _, whole = constant_velocity(step_noise(Qn, Ql, 2 * dt, "euler"), 2 * dt)
    missing = F @ Q @ F.T + Q - whole
    np.testing.assert_allclose(missing, Ql[0] * np.array([[dt**3, dt**2], [dt**2, 0.0]]), atol=1e-12)


@relaxed
@given(P=positive, Qn=positive, Ql=positive, dt=time_steps)
def test_two_marginal_steps_are_one_of_twice_the_time(
    P: np.ndarray, Qn: np.ndarray, Ql: np.ndarray, dt: float
) -> None:
    """Particles (x, v) and their shared P together have the same Gaussian either way (total variance)."""

    def step(carried: np.ndarray, P: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
        gain = velocity_gain(P, step_noise(Qn, Ql, dt), dt)
        F, _ = constant_velocity(step_noise(Qn, Ql, dt), dt)
        spread = np.vstack([np.eye(3), np.diag(gain.gain)])  # an innovation moves pose and mean velocity
        return F @ carried @ F.T + spread @ np.diag(gain.increment_variance) @ spread.T, gain.variance

    once, P_once = step(np.zeros((6, 6)), P, 2 * dt)
    twice, P_twice = step(*step(np.zeros((6, 6)), P, dt), dt)
    total_once, total_twice = once + joint(0 * P, P_once), twice + joint(0 * P, P_twice)
    np.testing.assert_allclose(total_twice, total_once, rtol=ROUNDING, atol=ROUNDING * total_once.max())


def test_kalman_equals_the_joint_gaussian_solved_directly() -> None:
    """Condition the Gaussian of all states and observations at once, and compare last state and evidence."""
    rng = np.random.default_rng(0)
    F, Q = constant_velocity(step_noise(np.array([4.0, 1.0]), np.array([30.0, 9.0]), 0.2), 0.2)
    H, R = rng.standard_normal((3, 4)), np.diag([1.0, 0.5, 2.0])
    start = Gaussian(rng.standard_normal(4), np.diag([1.0, 2.0, 3.0, 4.0]))
    observations = rng.standard_normal((4, 3))
    belief, log_evidence = start, 0.0
    for y in observations:
        belief, part = kalman_update(kalman_predict(belief, F, Q), y, H, R)
        log_evidence += part

    mean, covariance = start.mean, start.covariance
    means, blocks = [], [[np.zeros((4, 4))] * 4 for _ in range(4)]
    for t in range(4):
        mean, covariance = F @ mean, F @ covariance @ F.T + Q
        means.append(mean)
        moved = covariance
        for s in range(t, 4):
            blocks[s][t], blocks[t][s] = moved, moved.T
            moved = F @ moved
    states, prior = np.concatenate(means), np.block(blocks)
    sensor = np.kron(np.eye(4), H)
    S = sensor @ prior @ sensor.T + np.kron(np.eye(4), R)
    innovation = observations.ravel() - sensor @ states
    gain = prior @ sensor.T @ np.linalg.inv(S)
    np.testing.assert_allclose(belief.mean, (states + gain @ innovation)[-4:], rtol=ROUNDING, atol=1e-12)
    np.testing.assert_allclose(
        belief.covariance, (prior - gain @ S @ gain.T)[-4:, -4:], rtol=ROUNDING, atol=1e-11
    )
    expected = -0.5 * (np.linalg.slogdet(2 * np.pi * S)[1] + innovation @ np.linalg.solve(S, innovation))
    assert log_evidence == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_time_must_move_forward(dt: float) -> None:
    with pytest.raises(FilterError, match="invalid time step"):
        step_noise(np.ones(1), np.ones(1), dt)


def test_unknown_discretisation_names_the_nearest() -> None:
    with pytest.raises(FilterError, match="did you mean 'euler'"):
        step_noise(np.ones(1), np.ones(1), 0.1, "eular")
