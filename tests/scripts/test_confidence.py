"""Confidence is fitted: a known regression is found, recordings are weighted, people are left out."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.tracking.confidence import Regression
from research import confidence
from research.confidence import AGAINST, FOR, KINDS, Frames, fitted, harden, report
from support.heads import heads_folder

TRUE = Regression(2.0, np.array([-1.0, -2.0, 0.0, 0.5, -0.25]))
BOUNDS = (AGAINST, AGAINST, AGAINST, FOR, AGAINST)


def drawn(person: str, seed: int, count: int = 4000, *, is_real: bool = False) -> Frames:
    rng = np.random.default_rng(seed)
    signs = rng.normal(size=(count, 5))
    right = rng.random(count) < [TRUE.probability(one) for one in signs]
    return Frames(person, signs, right, ~right, is_real)


def test_a_known_regression_is_found() -> None:
    """To three standard deviations of 8,000 frames, and to what the penalty takes."""
    found = fitted([drawn("a", 0), drawn("b", 1, is_real=True)], 1.0, BOUNDS)
    np.testing.assert_allclose([found.bias, *found.weights], [TRUE.bias, *TRUE.weights], atol=0.2)


def test_people_are_judged_by_what_was_fitted_to_others(monkeypatch: pytest.MonkeyPatch) -> None:
    fits: list[set[str]] = []

    def remembered(frames: list[Frames], *_: object) -> Regression:
        fits.append({one.person for one in frames})
        return TRUE

    monkeypatch.setattr(confidence, "fitted", remembered)
    lines = report([drawn("a", 0, 300), drawn("a", 1, 300), drawn("b", 2, 300)], 1.0, BOUNDS)
    assert fits == [{"a", "b"}, {"b"}, {"b"}, {"a"}]
    assert lines[0] == "bias 2.00, weights -1.00, -2.00, 0.00, 0.50, -0.25"
    assert lines[1].startswith("all: 900 frames")


@pytest.mark.parametrize("kind", KINDS)
def test_recordings_are_made_harder(tmp_path: Path, kind: str) -> None:
    folder = heads_folder(tmp_path, "p") / "p"
    rng = np.random.default_rng(0)
    for camera in ("left", "right"):
        (folder / camera).mkdir()
        for index in range(20):
            cv2.imwrite(str(folder / camera / f"{index:02d}.png"), rng.integers(0, 255, (240, 320), np.uint8))
    harden(folder, tmp_path / "out", kind)
    last = cv2.imread(str(tmp_path / "out" / "right" / "000019.png"), cv2.IMREAD_GRAYSCALE)
    before = cv2.imread(str(folder / "right" / "19.png"), cv2.IMREAD_GRAYSCALE)
    share = 0.3 if kind == "small" else 1.0
    assert last.shape == tuple(round(share * side) for side in before.shape)
    assert kind == "small" or np.any(last != before)
    calibration = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert calibration["cameras"]["left"]["K"][0][0] == pytest.approx(90 * share)
    assert (tmp_path / "out" / "truth.csv").read_text() == (folder / "truth.csv").read_text()
