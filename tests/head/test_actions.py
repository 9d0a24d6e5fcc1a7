"""Actions by name: planted ones come back, a mirror exchanges the sides, and results state them."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.head.actions import ACTION_NAMES, ACTIONS, action_numbers, displacements, strengths
from posetrack_cli.head.face.points import MIRRORED, POINT_COUNT
from posetrack_cli.head.subject import mono_diagnostic_names, stereo_diagnostic_names


@pytest.mark.parametrize("action", range(len(ACTIONS)), ids=ACTIONS)
def test_a_full_action_is_found_to_its_stated_deviation(action: int) -> None:
    """What is found is drawn to 0 by the prior, and nothing else is found much of."""
    planted = np.eye(len(ACTIONS))[action]
    found = strengths(np.tensordot(planted, displacements(), axes=1))
    assert np.all(np.abs(found.values - planted) < 1.5 * found.deviations)
    assert found.values.argmax() == action


def test_noise_of_points_is_within_the_stated_deviations() -> None:
    rng, true = np.random.default_rng(3), np.array([0.3, 0.2, 0.0, -0.4, 0.5])
    moved = np.tensordot(true, displacements(), axes=1)
    sd = np.repeat([1.0, 2.0, 1.5, 1.5], [4, 2, 2, 2])[:, None]
    found = [strengths(moved + sd * rng.standard_normal((POINT_COUNT, 3))) for _ in range(400)]
    off = (np.array([one.values for one in found]) - true) / found[0].deviations
    assert np.all(np.sqrt(np.mean(off**2, axis=0)) < 1.2)


def test_a_mirrored_face_does_the_mirrored_actions() -> None:
    moved = np.random.default_rng(1).normal(0.0, 3.0, (POINT_COUNT, 3))
    mirrored = moved[list(MIRRORED)] * [-1.0, 1.0, 1.0]
    exchanged = np.where([name == "mouth_left" for name in ACTIONS], -1.0, 1.0)
    np.testing.assert_allclose(strengths(mirrored).values, exchanged * strengths(moved).values, atol=1e-9)


def test_results_name_them_and_a_face_that_is_not_seen_does_nothing_known() -> None:
    for names in (stereo_diagnostic_names(5), mono_diagnostic_names(10)):
        assert names[-len(ACTION_NAMES) :] == ACTION_NAMES
    assert np.isnan(action_numbers(None)).all()
    assert len(action_numbers(np.zeros((POINT_COUNT, 3)))) == len(ACTION_NAMES)
