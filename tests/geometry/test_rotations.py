"""Laws of rotations, checked on random and on extreme angles, and against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from posetrack_cli.errors import PosetrackError
from posetrack_cli.geometry import rotations as rot

ROUNDING = 64 * np.finfo(np.float64).eps
"""A few dozen roundings of numbers of size about 1."""

components = st.floats(-1.0, 1.0, allow_subnormal=False)
quaternions = (
    arrays(np.float64, (5, 4), elements=components)
    .filter(lambda q: bool(np.all(np.linalg.norm(q, axis=1) > 1e-3)))
    .map(rot.canonical)
)
# all lengths up to half a turn, with the ends: 0, the underflow of squares, and almost pi
# at half a turn exactly, the two vectors of either sign are the same rotation: that has a test of its own
angles = st.one_of(
    st.floats(0.0, np.pi - 1e-9), st.sampled_from([0.0, 1e-200, 1e-12, 1e-8, 1e-4, np.pi - 1e-9])
)
axes = arrays(np.float64, 3, elements=components).filter(lambda a: float(np.linalg.norm(a)) > 1e-3)
rotation_vectors = st.builds(lambda a, angle: a / np.linalg.norm(a) * angle, axes, angles)
vectors = arrays(np.float64, (5, 3), elements=st.floats(-100.0, 100.0))

relaxed = settings(deadline=None)


def same_rotation(p: np.ndarray, q: np.ndarray, tolerance: float = ROUNDING) -> None:
    np.testing.assert_array_less(rot.angle_between(p, q), tolerance)


@relaxed
@given(quaternions, st.floats(1e-3, 1e3))
def test_canonical_is_unit_with_positive_w_and_forgets_sign_and_length(q: np.ndarray, scale: float) -> None:
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=ROUNDING)
    assert np.all(q[:, 3] >= 0.0)
    np.testing.assert_allclose(rot.canonical(-scale * q), q, atol=ROUNDING)


def test_canonical_half_turn_has_one_form() -> None:
    q = np.array([0.0, -0.6, 0.8, 0.0])
    np.testing.assert_array_equal(rot.canonical(q), rot.canonical(-q))


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_canonical_refuses_a_quaternion_without_direction(bad: float) -> None:
    with pytest.raises(PosetrackError, match="invalid quaternion"):
        rot.canonical(np.full((2, 4), bad))


@relaxed
@given(quaternions, quaternions, quaternions)
def test_group_laws(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> None:
    identity = np.array(rot.IDENTITY)
    left = rot.multiply(rot.multiply(p, q), r)
    np.testing.assert_allclose(left, rot.multiply(p, rot.multiply(q, r)), atol=ROUNDING)
    np.testing.assert_allclose(rot.multiply(p, identity), p, atol=0.0)
    np.testing.assert_allclose(
        rot.multiply(p, rot.conjugate(p)), np.broadcast_to(identity, p.shape), atol=ROUNDING
    )


@relaxed
@given(quaternions, quaternions, vectors)
def test_matrices_and_rotate_are_homomorphisms(p: np.ndarray, q: np.ndarray, v: np.ndarray) -> None:
    P, Q = rot.matrices_from_quaternions(p), rot.matrices_from_quaternions(q)
    np.testing.assert_allclose(rot.matrices_from_quaternions(rot.multiply(p, q)), P @ Q, atol=ROUNDING)
    np.testing.assert_allclose(rot.rotate(q, v), (Q @ v[..., None])[..., 0], atol=100 * ROUNDING)
    np.testing.assert_allclose(
        rot.rotate(rot.multiply(p, q), v), rot.rotate(p, rot.rotate(q, v)), atol=100 * ROUNDING
    )


@relaxed
@given(quaternions)
def test_matrix_round_trip_and_scipy(q: np.ndarray) -> None:
    matrices = rot.matrices_from_quaternions(q)
    np.testing.assert_allclose(matrices, Rotation.from_quat(q).as_matrix(), atol=ROUNDING)
    same_rotation(rot.quaternions_from_matrices(matrices), q)


@relaxed
@given(rotation_vectors)
def test_exponential_and_logarithm_are_inverse_and_agree_with_scipy(r: np.ndarray) -> None:
    q = rot.exponential(r)
    np.testing.assert_allclose(rot.logarithm(q), r, atol=ROUNDING, rtol=ROUNDING)
    np.testing.assert_array_equal(rot.logarithm(-q), rot.logarithm(q))
    same_rotation(q, rot.canonical(Rotation.from_rotvec(r).as_quat()))
    same_rotation(rot.quaternions_from_matrices(rot.matrices_from_quaternions(q)), q)


def test_small_vectors_keep_their_relative_precision() -> None:
    r = np.array([[3e-9, 0.0, 4e-9], [3e-12, 0.0, 4e-12], [1e-170, 0.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(rot.logarithm(rot.exponential(r)), r, rtol=ROUNDING)


@relaxed
@given(axes)
def test_half_a_turn_comes_back_with_either_sign(axis: np.ndarray) -> None:
    r = np.pi * axis / np.linalg.norm(axis)
    back = rot.logarithm(rot.exponential(r))
    np.testing.assert_allclose(np.sign(back @ r) * back, r, atol=ROUNDING, rtol=ROUNDING)


@relaxed
@given(rotation_vectors, st.floats(0.0, 1.0))
def test_angles_beyond_half_a_turn_come_back_the_short_way(r: np.ndarray, share: float) -> None:
    length = np.linalg.norm(r)
    if length < 1e-3:
        return
    longer = r / length * (np.pi + share * np.pi)
    q = rot.exponential(longer)
    assert q[3] >= 0.0
    expected = np.pi - share * np.pi
    assert abs(np.linalg.norm(rot.logarithm(q)) - expected) < ROUNDING


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_from_matrices(axis: int) -> None:
    R = -np.eye(3)
    R[axis, axis] = 1.0
    expected = np.zeros(4)
    expected[axis] = 1.0
    np.testing.assert_allclose(rot.quaternions_from_matrices(R), expected, atol=ROUNDING)


@pytest.mark.parametrize(
    "bad", [2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.full((3, 3), np.nan), np.zeros((3, 3))]
)
def test_matrices_that_are_no_rotation_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(PosetrackError, match="not a rotation"):
        rot.quaternions_from_matrices(bad)


@relaxed
@given(quaternions, quaternions)
def test_angle_is_symmetric_sign_free_and_the_logarithm_s_length(p: np.ndarray, q: np.ndarray) -> None:
    angle = rot.angle_between(p, q)
    np.testing.assert_allclose(angle, rot.angle_between(q, p), atol=ROUNDING)
    np.testing.assert_allclose(angle, rot.angle_between(-p, q), atol=ROUNDING)
    difference = rot.logarithm(rot.multiply(rot.conjugate(p), q))
    np.testing.assert_allclose(np.linalg.norm(difference, axis=-1), angle, atol=ROUNDING)


@relaxed
@given(quaternions, quaternions, arrays(np.float64, 5, elements=st.floats(0.1, 1.0)))
def test_mean_is_sign_free_and_turns_along(p: np.ndarray, q: np.ndarray, weights: np.ndarray) -> None:
    # near the identity, so that the dominant eigenvalue stands apart and the mean is well conditioned
    near = rot.exponential(0.3 * rot.logarithm(p))
    mean = rot.mean_quaternion(near, weights)
    signs = np.array([1.0, -1.0, 1.0, -1.0, -1.0])[:, None]
    same_rotation(rot.mean_quaternion(signs * near, weights), mean, 8 * ROUNDING)
    turned = rot.mean_quaternion(rot.multiply(q[0], near), weights)
    same_rotation(turned, rot.multiply(q[0], mean), 8 * ROUNDING)


def test_mean_of_two_lies_half_way_and_weights_pull() -> None:
    q = rot.exponential(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    same_rotation(rot.mean_quaternion(q, np.array([1.0, 1.0])), rot.exponential(np.array([0.0, 0.0, 0.5])))
    np.testing.assert_allclose(rot.mean_quaternion(q, np.array([0.0, 2.0])), q[1], atol=ROUNDING)


def test_mean_agrees_with_scipy() -> None:
    rng = np.random.default_rng(3)
    q, weights = rot.canonical(rng.standard_normal((50, 4))), rng.random(50)
    expected = Rotation.from_quat(q).mean(weights).as_quat()
    same_rotation(rot.mean_quaternion(q, weights), rot.canonical(expected), 1e-12)  # eigenvalues lie close


@relaxed
@given(quaternions, arrays(np.float64, 3, elements=st.floats(-3.0, 3.0)))
def test_rate_is_the_derivative_of_turning_about_body_axes(q: np.ndarray, omega: np.ndarray) -> None:
    h = 1e-5
    ahead = rot.multiply(q, rot.exponential(h * omega))
    behind = rot.multiply(q, rot.exponential(-h * omega))
    # central difference: truncated at h^2 |omega / 2|^3 / 6 with |omega| < 5.2, rounded to eps / h
    tolerance = 3.0 * h**2 + 8 * np.finfo(np.float64).eps / h
    np.testing.assert_allclose(rot.quaternion_rate(q, omega), (ahead - behind) / (2 * h), atol=tolerance)


def test_leading_axes_broadcast() -> None:
    rng = np.random.default_rng(0)
    q = rot.canonical(rng.standard_normal((2, 3, 4)))
    one = rot.canonical(rng.standard_normal(4))
    assert rot.multiply(one, q).shape == (2, 3, 4)
    assert rot.rotate(q, np.ones(3)).shape == (2, 3, 3)
    assert rot.quaternions_from_matrices(rot.matrices_from_quaternions(q)).shape == (2, 3, 4)
    assert rot.logarithm(q).shape == (2, 3, 3)
    assert rot.angle_between(one, q).shape == (2, 3)
    assert rot.logarithm(one).shape == (3,)
    assert rot.canonical(np.empty((0, 4))).shape == (0, 4)
