"""The law of a state space, and the checks of a motion model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.filtering.model import Dynamics, Euclidean

poses = arrays(np.float64, (4, 3), elements=st.floats(-100.0, 100.0))
ROUNDING = 400 * np.finfo(np.float64).eps
"""Two roundings of numbers up to 200."""


@given(poses, poses)
def test_retract_undoes_local(x: np.ndarray, y: np.ndarray) -> None:
    space = Euclidean()
    np.testing.assert_allclose(space.retract(x, space.local(x, y)), y, atol=ROUNDING)


def test_mean_is_weighted() -> None:
    mean = Euclidean().mean(np.array([[0.0, 4.0], [8.0, 0.0]]), np.array([0.25, 0.75]))
    np.testing.assert_array_equal(mean, [6.0, 1.0])


@pytest.mark.parametrize(
    ("pose_noise", "velocity_noise", "message"),
    [
        ([-1.0], [1.0], "invalid pose_noise"),
        ([1.0], [np.nan], "invalid velocity_noise"),
        ([np.inf], [1.0], "invalid pose_noise"),
        (1.0, 1.0, "invalid pose_noise"),
        ([1.0, 1.0], [1.0], "noise shapes differ"),
    ],
)
def test_noise_is_checked(pose_noise, velocity_noise, message: str) -> None:
    with pytest.raises(FilterError, match=message):
        Dynamics(np.array(pose_noise), np.array(velocity_noise))


def test_unknown_discretisation_is_refused() -> None:
    with pytest.raises(FilterError, match="unknown discretisation, found eulr"):
        Dynamics(np.ones(1), np.ones(1), "eulr")
    with pytest.raises(FilterError, match=r"unknown gain.*did you mean 'printed'"):
        Dynamics(np.ones(1), np.ones(1), gain="print")  # type: ignore[arg-type]


def test_noise_is_a_copy_of_its_own_and_read_only() -> None:
    noise = np.ones(2)
    dynamics = Dynamics(noise, noise)
    noise[0] = 5.0
    np.testing.assert_array_equal(dynamics.pose_noise, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        dynamics.velocity_noise[0] = 2.0
