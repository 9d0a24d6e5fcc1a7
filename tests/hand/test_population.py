"""The hands that are shipped: a mean and independent ways to differ, smooth, in lengths of one hand."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.hand.model.anatomy import (
    COEFFICIENTS,
    HAND_LENGTH_MM,
    HandShape,
    RestHand,
    make_anatomy,
    population,
    random_shape,
)
from posetrack_cli.hand.model.hand import LEVELS, average_hand, hand_mesh
from posetrack_cli.rendering.mesh import is_closed
from support.hand import enclosed_volume

PEOPLE = population()
FLOAT32 = 1e-5
"""Mean and modes are stored as float32, rounded to 1e-6: of numbers up to 100, and sums of 24."""
TIPS = 0.1
"""What 1.5 mm or less of five bones, four times, are beside a mode's 10 mm and more of all."""


def unit(k: int, size: float = 1.0) -> tuple[float, ...]:
    return tuple(size * np.eye(COEFFICIENTS)[k])


def flat(hand: RestHand) -> FloatArray:
    return np.concatenate([part.ravel() for part in hand])


def drawn(seed: int) -> tuple[float, ...]:
    return random_shape(np.random.default_rng(seed)).coefficients


def test_what_is_shipped_has_the_parts_of_a_hand() -> None:
    hand = PEOPLE.hand()
    assert [part.shape[1:] for part in hand] == [(3,), (3,), (3,), (4,)]
    assert len(hand.cage) == len(PEOPLE.weights) == PEOPLE.triangles.max() + 1
    assert len(PEOPLE.modes) == COEFFICIENTS
    np.testing.assert_allclose(PEOPLE.weights.sum(axis=1), 1.0, atol=FLOAT32)
    assert (PEOPLE.weights >= 0.0).all() and is_closed(PEOPLE.triangles)


def test_a_hand_without_coefficients_is_the_mean_and_those_left_out_are_zero() -> None:
    np.testing.assert_array_equal(flat(PEOPLE.hand()), PEOPLE.mean)
    np.testing.assert_array_equal(flat(PEOPLE.hand([0.0] * COEFFICIENTS)), PEOPLE.mean)
    np.testing.assert_array_equal(flat(PEOPLE.hand([1.5, -1.0])), flat(PEOPLE.hand([1.5, -1.0, 0.0])))
    same = average_hand("right", HandShape(coefficients=(0.0,) * COEFFICIENTS))
    np.testing.assert_array_equal(same.smooth.vertices, average_hand().smooth.vertices)


@pytest.mark.parametrize("k", [0, 5, COEFFICIENTS - 1])
def test_a_coefficient_of_one_adds_its_mode(k: int) -> None:
    added = flat(PEOPLE.hand(unit(k))) - PEOPLE.mean
    np.testing.assert_allclose(added, PEOPLE.modes[k], atol=1e-12)
    np.testing.assert_allclose(flat(PEOPLE.hand(unit(k, -2.0))), PEOPLE.mean - 2.0 * added, atol=1e-12)


def test_modes_are_told_apart_and_the_strongest_come_first() -> None:
    """They are orthogonal where a bone's number counts four times one of the skin's (the build's metric).

    Tips, which are put where the skin ends afterwards, turn the weakest of them a little.
    """
    counted = np.ones(PEOPLE.modes.shape[1])
    counted[-50:-20] = 4.0
    gram = (PEOPLE.modes * counted) @ (PEOPLE.modes * counted).T
    strength = np.sqrt(np.diag(gram))
    np.testing.assert_allclose(gram / np.outer(strength, strength), np.eye(COEFFICIENTS), atol=TIPS)
    assert (strength[1:] < (1.0 + TIPS) * strength[:-1]).all()


@pytest.mark.parametrize("seed", range(4))
def test_hands_of_scale_1_are_of_one_length(seed: int) -> None:
    """Those that were learned from are of one length; between them it is no linear function."""
    hand = PEOPLE.hand(drawn(seed))
    length = np.linalg.norm(hand.bases[2]) + hand.segments[2].sum()
    assert length == pytest.approx(HAND_LENGTH_MM, abs=1.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_drawn_hand_is_one(seed: int) -> None:
    coefficients = drawn(seed)
    hand, anatomy = PEOPLE.hand(coefficients), make_anatomy(coefficients=coefficients)
    assert (hand.segments > 5.0).all() and (hand.radii > 0.0).all()
    assert (np.diff(hand.bases[1:, 0]) < -5.0).all()  # knuckles beside each other, index first
    volumes = []
    for level in LEVELS:
        mesh = hand_mesh(anatomy, level)
        volumes.append(enclosed_volume(mesh.vertices, mesh.triangles) / 1000.0)
    # ml, of hands of one length: thin to thick
    assert min(volumes) > 100.0 and max(volumes) < 420.0


@pytest.mark.parametrize("k", range(0, COEFFICIENTS, 5))
def test_a_mode_changes_the_skin_smoothly(k: int) -> None:
    """Neighbours move alike: edges change by less than what their ends move, and by little of themselves."""
    a, b = PEOPLE.triangles.T[:2]
    hands = [PEOPLE.hand(unit(k, size)).cage for size in (0.0, 1.0)]
    moved = np.linalg.norm(hands[1] - hands[0], axis=1)
    apart = np.linalg.norm((hands[1] - hands[0])[a] - (hands[1] - hands[0])[b], axis=1)
    assert np.sqrt((apart**2).mean()) < 0.75 * np.sqrt((moved**2).mean())
    lengths = [np.linalg.norm(cage[a] - cage[b], axis=1) for cage in hands]
    assert np.abs(lengths[1] - lengths[0]).mean() < 0.2 * lengths[0].mean()


def test_coefficients_and_factors_are_applied_one_after_the_other() -> None:
    """The other person's hand, stretched: its bones are those of the population times the factors."""
    coefficients, lengths = drawn(7), (1.0, 1.1, 1.0, 0.9, 1.0)
    own, stretched = (
        make_anatomy(coefficients=coefficients, **more)
        for more in ({}, {"scale": 1.2, "finger_lengths": lengths})
    )
    np.testing.assert_allclose(stretched.segments, 1.2 * np.array(lengths)[:, None] * own.segments)
    np.testing.assert_allclose(stretched.base_positions, 1.2 * own.base_positions)
    usual, skin = hand_mesh(own), hand_mesh(stretched)
    palm = usual.weights[:, 0] == 1.0
    np.testing.assert_allclose(skin.vertices[palm], 1.2 * usual.vertices[palm], atol=1e-9)
