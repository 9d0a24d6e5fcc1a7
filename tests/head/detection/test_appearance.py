"""What points look like: histograms of gradients, their log-odds, and the file that holds them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.head.detection.appearance import (
    BINS,
    RIGHT_SIDE,
    SHIPPED,
    TAPS,
    histograms,
    load_appearance,
)
from posetrack_cli.head.detection.fit import fit_jointly
from posetrack_cli.head.detection.responses import HEIGHT, WIDTH
from posetrack_cli.head.face.points import FEATURES, MIRRORED, POINT_COUNT
from research import face_features
from research.face_features import PointMoments, Seen, described, learn, moments, moments_of

ROUNDED = 1e-3
"""Sums of 392 products in float32, of order 10."""


def picture() -> np.ndarray:
    noise = np.random.default_rng(3).integers(0, 255, (HEIGHT, WIDTH), np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 20, 230, cv2.NORM_MINMAX)


def test_a_gradient_counts_in_the_bin_of_its_direction_in_any_light() -> None:
    ramp = np.tile(np.linspace(40.0, 220.0, 64), (64, 1))
    found = histograms(ramp.astype(np.uint8))[:, 32, 20:44].mean(axis=1)
    assert int(np.argmax(found)) == 0  # to the right it grows lighter
    assert int(np.argmax(histograms(ramp.T.astype(np.uint8))[:, 32, 32])) == BINS // 4
    dimmed = histograms((0.5 * ramp).astype(np.uint8))[:, 32, 20:44].mean(axis=1)
    assert dimmed[0] == pytest.approx(found[0], rel=0.1)


def test_log_odds_are_linear_in_the_histograms_that_are_learned_from() -> None:
    looks, found = load_appearance(), histograms(picture())
    scores = looks.log_odds(found, 4, (2, 100), 9)
    y, x = np.mgrid[100:109, 2:11]
    by_hand = described(found, np.stack([x, y], axis=-1).reshape(-1, 2)) @ looks.weights[4].ravel()
    np.testing.assert_allclose(scores.ravel(), by_hand + looks.constants[4], atol=ROUNDED)


def test_a_mirrored_face_has_mirrored_log_odds() -> None:
    looks, grey = load_appearance(), picture()
    mirrored = histograms(np.ascontiguousarray(grey[:, ::-1]))
    for k in range(POINT_COUNT):
        here = looks.log_odds(histograms(grey), k, (60, 80), 5)
        there = looks.log_odds(mirrored, MIRRORED[k], (WIDTH - 1 - 64, 80), 5)
        np.testing.assert_allclose(there, here[:, ::-1], atol=0.02)  # blurs of a mirror image round otherwise


def test_a_discriminant_of_normal_clouds_is_their_log_odds() -> None:
    rng = np.random.default_rng(5)
    at, near = rng.normal([1.5, 0.0], 1.0, (8000, 2)), rng.normal([0.0, 0.0], 1.0, (8000, 2))
    w, b = PointMoments(moments([at]), moments([near])).discriminant()
    # ln N(x; m) / N(x; 0) = m x - m^2 / 2; means are known to 1 / sqrt(8000), shrinking takes a fortieth
    np.testing.assert_allclose(w, [1.5, 0.0], atol=0.08)
    assert b == pytest.approx(-0.5 * 1.5**2, abs=0.1)


def test_a_person_is_learned_from_alike_whoever_else_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the order of people nor who is left out changes what is drawn of a person."""
    places = 0.9 * (FEATURES[:, :2] * [1.0, -1.0]) + [110.0, 75.0]
    faces = {
        Path(name): Seen(np.roll(picture(), shift, axis=1), places, 0.9)
        for shift, name in enumerate(("first", "second", "third"))
    }
    monkeypatch.setattr(face_features, "seen_in", lambda path: iter([faces[path]]))
    people = {path: (moments_of(path), 1.0) for path in faces}
    alone = moments_of(Path("second"))
    for one, other in zip(alone, people[Path("second")][0], strict=True):
        np.testing.assert_array_equal(one.near.square, other.near.square)
    (weights, constants), (again, same) = learn(list(people.values())), learn(list(people.values())[::-1])
    np.testing.assert_allclose(again, weights, atol=ROUNDED)
    np.testing.assert_allclose(same, constants, atol=ROUNDED)


def test_points_do_not_leave_a_face_for_what_alone_looks_like_them() -> None:
    """Where nothing looks like a face the points keep the shape of one."""
    flat = np.full((HEIGHT, WIDTH), 128, np.uint8)
    pose = np.array([110.0, 75.0, 0.95, 0.0, 0.0, 0.0])
    expected = 0.95 * (FEATURES[:, :2] * [1.0, -1.0]) + pose[:2]
    found = fit_jointly(flat, expected + np.array([2.0, -1.0]), pose, load_appearance())
    assert np.abs(found.pixels - expected).max() < 8.0
    assert found.probabilities.max() < 0.9
    assert found.misfit_px < 2.0


def test_files_that_hold_something_else_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such appearance model"):
        load_appearance(tmp_path / "missing.npz")
    good = {"constants": np.zeros(5), "shape_modes": np.zeros((2, 10, 3))}
    shape = (len(RIGHT_SIDE), BINS, TAPS, TAPS)
    for number, weights in enumerate((np.zeros((2, 3)), np.full(shape, np.nan))):
        path = tmp_path / f"{number}.npz"
        np.savez(path, weights=weights, **good)  # type: ignore[arg-type]
        with pytest.raises(ResultError, match="not an appearance model"):
            load_appearance(path)
    np.savez(tmp_path / "good.npz", weights=np.zeros(shape), **good)  # type: ignore[arg-type]
    assert not load_appearance(tmp_path / "good.npz").weights.any()
    assert SHIPPED.stat().st_size < 20_000
