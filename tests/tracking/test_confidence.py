"""Logistic regression on signs of a track: means that forget, and a probability."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.tracking.confidence import Regression, RunningSigns, signs_codec
from support.codecs import assert_lawful

SIGNS = 3


def after(frames: np.ndarray) -> RunningSigns:
    running = RunningSigns.before(SIGNS)
    for signs in frames:
        running = running.after(signs)
    return running


def test_signs_are_means_of_the_first_frames_and_then_fade() -> None:
    frames = np.random.default_rng(0).normal(size=(40, SIGNS))
    for count in range(1, 6):
        np.testing.assert_allclose(after(frames[:count]).signs, frames[:count].mean(axis=0))
    expected = frames[:5].mean(axis=0)
    for frame in frames[5:]:
        expected = 0.8 * expected + 0.2 * frame
    np.testing.assert_allclose(after(frames).signs, expected)


def test_it_is_the_stated_regression_and_never_overflows() -> None:
    regression = Regression(0.5, np.array([1.0, -2.0, 0.25]))
    signs = np.array([0.3, 0.1, -4.0])
    assert regression.probability(signs) == pytest.approx(1.0 / (1.0 + np.exp(-(0.5 + 0.3 - 0.2 - 1.0))))
    assert 0.0 < regression.probability(1e6 * signs) < 1e-20
    assert regression.probability(-1e6 * signs) == pytest.approx(1.0)


def test_running_means_are_kept_whole() -> None:
    assert_lawful(signs_codec(SIGNS), after(np.random.default_rng(1).normal(size=(4, SIGNS))))
