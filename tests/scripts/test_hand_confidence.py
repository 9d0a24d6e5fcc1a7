"""The confidence of hands is fitted: a regression is found, kinds count alike, judged frames are read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hand_confidence
from hand_confidence import Frames, fitted, read_judged, report
from posetrack_cli.tracking.confidence import Regression

TRUE = Regression(2.0, np.array([-1.0, -2.0, 0.0, 0.5, -0.25]))


def drawn(person: str, seed: int, count: int = 4000, *, is_real: bool = False) -> Frames:
    rng = np.random.default_rng(seed)
    signs = rng.normal(size=(count, 5))
    right = rng.random(count) < [TRUE.probability(one) for one in signs]
    return Frames(person, signs, right, ~right, np.full(count, 0.5), is_real)


def test_a_known_regression_is_found() -> None:
    """To three standard deviations of 8,000 frames, and to what the penalty takes."""
    found = fitted([drawn("a", 0), drawn("b", 1, is_real=True)])
    np.testing.assert_allclose([found.bias, *found.weights], [TRUE.bias, *TRUE.weights], atol=0.2)


def test_synthetic_and_real_recordings_count_alike() -> None:
    """Ten alike say what one says, but for the penalty, which is of the signs' deviations over all frames."""
    synthetic, real = drawn("a", 0), drawn("b", 1, is_real=True)
    wrong = Frames("a", synthetic.signs, ~synthetic.right, synthetic.right, synthetic.stated)
    many, one = fitted([*[wrong] * 10, real]), fitted([wrong, real])
    np.testing.assert_allclose([many.bias, *many.weights], [one.bias, *one.weights], atol=0.02)


def test_frames_that_were_looked_at_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    signs = np.arange(50.0).reshape(10, 5)
    monkeypatch.setattr(hand_confidence, "read_signs", lambda _: signs)
    monkeypatch.setattr(hand_confidence, "load_arrays", lambda _: {"confidence": np.arange(10) / 10})
    found = read_judged("k", Path("result.mcap"), (1, 4), (7,))
    np.testing.assert_array_equal(found.signs, signs[[1, 4, 7]])
    np.testing.assert_array_equal(found.right, [True, True, False])
    np.testing.assert_allclose(found.stated, [0.1, 0.4, 0.7])
    assert found.is_real and not found.far.any()


def test_people_are_judged_by_what_was_fitted_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    fits: list[set[str]] = []

    def remembered(frames: list[Frames]) -> Regression:
        fits.append({one.person for one in frames})
        return TRUE

    monkeypatch.setattr(hand_confidence, "fitted", remembered)
    lines = report([drawn("a", 0, 300), drawn("a", 1, 300), drawn("b", 2, 300)])
    assert fits == [{"b"}, {"b"}, {"a"}, {"a", "b"}]
    assert lines[0] == "bias 2.00, weights -1.00, -2.00, 0.00, 0.50, -0.25"
    assert lines[1].startswith("all: 900 frames")
