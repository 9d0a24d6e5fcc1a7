"""The history of identities is the last N_s of them."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.head.tracker.person import IdentityHistory


@given(st.integers(0, 1000), st.integers(1, 20), st.integers(1, 6))
def test_keeps_the_last_ones(seed, count, size):
    identities = np.random.default_rng(seed).normal(size=(count, 4))
    history = IdentityHistory.starting_with(identities[0], size)
    for one in identities[1:]:
        history = history.with_identity(one)
    last = identities[-size:]
    np.testing.assert_array_equal(history.identities, last)
    np.testing.assert_array_equal(history.mean, last.mean(axis=0))
    np.testing.assert_array_equal(history.spread, last.std(axis=0))


def test_adding_leaves_the_history_before_as_it_was():
    before = IdentityHistory.starting_with(np.ones(3), 2)
    before.with_identity(np.zeros(3)).with_identity(np.full(3, 5.0))
    np.testing.assert_array_equal(before.identities, np.ones((1, 3)))
    np.testing.assert_array_equal(before.spread, 0.0)


def test_does_not_change_with_the_array_that_it_began_with():
    identity = np.ones(3)
    history = IdentityHistory.starting_with(identity, 2)
    identity[:] = 7.0
    np.testing.assert_array_equal(history.mean, np.ones(3))
