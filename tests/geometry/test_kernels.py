"""The compiled rotations against those that do many at once, and against their derivatives."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.kernels import (
    matrix_product,
    quaternion_from_vector,
    quaternion_product,
    rotate_in_place,
    rotate_with_jacobian,
    rotation_matrix,
    vector_from_quaternion,
)

ROUNDING = 1e-13
"""A few hundred operations on numbers of about 1."""
LENGTHS = (0.0, 1e-9, 1e-4, 9e-4, 1.1e-3, 0.06, 0.07, 1.0, 3.1)
"""On both sides of every limit below which a series is taken."""


@pytest.fixture(name="vectors")
def _vectors() -> FloatArray:
    directions = np.random.default_rng(3).normal(size=(len(LENGTHS), 3))
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return unit * np.array(LENGTHS)[:, None]


def matrices(vectors: FloatArray) -> FloatArray:
    """Rotation matrices of rotation vectors, by the functions that do many at once."""
    return rotations.matrices_from_quaternions(rotations.exponential(vectors))


def test_products_have_the_bits_of_those_of_many(vectors: FloatArray) -> None:
    q = rotations.exponential(vectors)
    found = np.array([quaternion_product(*a, *b) for a, b in itertools.pairwise(q)])
    np.testing.assert_array_equal(found, rotations.multiply(q[:-1], q[1:]))


def test_vectors_become_quaternions_and_come_back(vectors: FloatArray) -> None:
    for vector, expected in zip(vectors, rotations.exponential(vectors), strict=True):
        found = np.array(quaternion_from_vector(*vector))
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)
        for sign in (1.0, -1.0):  # q and -q are one rotation
            np.testing.assert_allclose(
                vector_from_quaternion(*(sign * found)), vector, rtol=ROUNDING, atol=ROUNDING
            )


def test_matrices_and_their_product_are_those_of_many(vectors: FloatArray) -> None:
    a, b, out = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    q = rotations.exponential(vectors)
    for p, r in itertools.pairwise(q):
        rotation_matrix(p, a)
        rotation_matrix(r, b)
        np.testing.assert_array_equal(a, rotations.matrices_from_quaternions(p))
        matrix_product(a, b, out)
        np.testing.assert_allclose(out, a @ b, rtol=0, atol=ROUNDING)


def test_both_rotations_of_a_matrix_multiply_from_the_left(vectors: FloatArray) -> None:
    start, rotated, left = matrices(vectors[-1]), np.empty((3, 3)), np.empty((3, 3))
    for vector, turn in zip(vectors, matrices(vectors), strict=True):
        in_place = start.copy()
        rotate_in_place(in_place, vector)
        rotate_with_jacobian(vector, start, rotated, left)
        np.testing.assert_allclose(in_place, turn @ start, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(rotated, turn @ start, rtol=0, atol=ROUNDING)


def test_a_rotation_by_nothing_keeps_every_bit() -> None:
    start = matrices(np.array([0.3, -0.2, 0.9]))
    kept = start.copy()
    rotate_in_place(kept, np.zeros(3))
    np.testing.assert_array_equal(kept, start)


def test_the_jacobian_is_the_derivative(vectors: FloatArray) -> None:
    """exp(w + dw) exp(w)^T = exp(J dw) to first order; h balances truncation h^2 and rounding 1e-16 / h."""
    h = 1e-5
    left, rotated = np.empty((3, 3)), np.empty((3, 3))
    for vector in vectors:
        rotate_with_jacobian(vector, np.eye(3), rotated, left)
        for k in range(3):
            step = h * np.eye(3)[k]
            change = (matrices(vector + step) - matrices(vector - step)) @ matrices(vector).T / (2.0 * h)
            derivative = np.array([change[2, 1], change[0, 2], change[1, 0]])
            np.testing.assert_allclose(derivative, left[:, k], rtol=0, atol=1e-9)
