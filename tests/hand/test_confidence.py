"""The probability that an estimate is right: a logistic regression on running means; its ends and laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.confidence import NO_EVIDENCE, probability, signs_of, with_model_error
from posetrack_cli.hand.model.hand import tangent_vector
from posetrack_cli.hand.start import START_SPREAD, with_doubt


def of_frames(*signs: FloatArray) -> float:
    evidence = NO_EVIDENCE
    for one in signs:
        evidence = evidence.after(one)
    return probability(evidence)


def test_what_is_followed_as_the_persons_own_hand_is_right_and_what_jumps_about_is_not() -> None:
    """The two ends of what it was fitted to: exact meshes, and hands that are lost on their arm."""
    assert of_frames(signs_of(4.0, 3.0, 1, 0.9, 1.0)) > 0.95
    assert of_frames(signs_of(12.0, 25.0, 4, 0.3, 1.5)) < 0.2


@given(
    st.floats(1.0, 40.0),
    st.floats(0.0, 200.0),
    st.integers(1, 4),
    st.floats(-1.0, 1.0),
    st.floats(0.5, 5.0),
)
def test_dearer_fits_larger_innovations_and_more_alternatives_are_never_more_probable(
    usual: float, innovation: float, count: int, contrast: float, raised: float
) -> None:
    p = of_frames(signs_of(usual, innovation, count, contrast, raised))
    assert 0.0 <= p <= 1.0
    for worse in (
        signs_of(usual + 1.0, innovation, count, contrast, raised),
        signs_of(usual, innovation + 1.0, count, contrast, raised),
        signs_of(usual, innovation, count + 1, contrast, raised),
        signs_of(usual, innovation, count, contrast - 0.1, raised),
        signs_of(usual, innovation, count, contrast, raised + 0.2),
    ):
        assert of_frames(worse) <= p


def test_it_is_the_stated_regression() -> None:
    """Against the formula of the module, number by number."""
    logit = 10.27 - 1.08 * np.log(5.0) - 1.60 * np.log(4.5) - 1.40 * 2 + 3.11 * 0.5 - 7.07 * np.log(1.25)
    found = of_frames(signs_of(5.0, 4.0, 2, 0.5, 1.25))
    assert found == pytest.approx(1.0 / (1.0 + np.exp(-logit)), rel=1e-9)


def test_before_the_first_frame_nothing_is_right() -> None:
    assert of_frames() == 0.0


def test_one_frame_that_errs_does_not_lose_a_hand() -> None:
    good, bad = signs_of(4.0, 3.0, 1, 0.9, 1.0), signs_of(9.0, 30.0, 3, 0.9, 1.4)
    assert of_frames(bad) < 0.5
    assert of_frames(*[good] * 10, bad) > 0.5
    assert of_frames(*[good] * 10, *[bad] * 10) < 0.5


@given(st.floats(0.0, 40.0), st.floats(0.0, 40.0))
def test_what_fits_leave_beyond_noise_widens_the_position_alone(first: float, second: float) -> None:
    variance = np.linspace(0.1, 2.0, 21)
    less, more = (with_model_error(variance, usual) for usual in sorted((first, second)))
    assert (more[:3] >= less[:3]).all() and (less[:3] >= variance[:3]).all()
    np.testing.assert_array_equal(more[3:], variance[3:])
    np.testing.assert_array_equal(with_model_error(variance, 2.0), variance)
    assert with_model_error(variance, 4.0)[0] == pytest.approx(0.1 + 1.2**2)


@given(st.floats(0.0, 1.0))
def test_a_doubtful_estimate_has_the_variance_of_a_mixture(confidence: float) -> None:
    """In a sample, the right share has the filter's variance, the rest that of a start in addition."""
    variance, spread = np.full(21, 4.0), tangent_vector(START_SPREAD)
    count = 10**4
    right = round(count * confidence)
    unit = np.tile([-1.0, 1.0], count // 2)[:, None]  # of variance 1 exactly, in any even part
    of_each = np.where(np.arange(count)[:, None] < right, variance, variance + spread**2)
    sample = unit * np.sqrt(of_each)
    np.testing.assert_allclose(with_doubt(variance, right / count), (sample**2).mean(axis=0), rtol=1e-9)
    np.testing.assert_array_equal(with_doubt(variance, 1.0), variance)
