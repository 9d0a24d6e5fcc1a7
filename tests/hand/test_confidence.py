"""The probability that an estimate is right: a logistic regression, its ends and its laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.hand.confidence import probability

USUAL = np.concatenate([np.full(3, 0.3), np.full(3, 2e-4), np.full(15, 3e-3)])
"""(21,) variances as hands that are tracked well state: 1 mm, 1.4 degrees, 3 degrees."""


def test_what_fits_like_the_persons_own_hand_is_right_and_what_fits_nothing_is_not() -> None:
    """The two ends of what it was fitted to: exact meshes cost 3 to 5 mm, hands elsewhere 12 and more."""
    assert probability(4.0, USUAL) > 0.9
    assert probability(14.0, USUAL) < 0.5
    assert probability(40.0, USUAL) < 0.1


@given(
    first=st.floats(0.0, 40.0),
    more=st.floats(0.0, 40.0),
    scale=st.floats(0.0, 1e6, allow_subnormal=False),
)
def test_a_dearer_fit_is_never_more_probable(first: float, more: float, scale: float) -> None:
    near, far = probability(first, scale * USUAL), probability(first + more, scale * USUAL)
    assert 0.0 <= far <= near <= 1.0


@pytest.mark.parametrize("cost", [2.0, 5.0, 8.0, 12.0])
def test_it_is_the_stated_regression(cost: float) -> None:
    """Against the formula of the module, number by number."""
    position, rotation, angle = np.sqrt(0.9), np.sqrt(6e-4), np.sqrt(3e-3)
    logit = (
        9.36
        - 3.27 * np.log(cost)
        + 0.52 * np.log(position + 0.1)
        - 1.56 * np.log(angle + 0.01)
        + 1.48 * np.log(rotation + 0.005)
    )
    assert probability(cost, USUAL) == pytest.approx(1.0 / (1.0 + np.exp(-logit)), rel=1e-9)
