"""Frames looked at again by the smoother: what a fit is worth, and fits from what other frames expect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.filtering.modes import LikelihoodModes
from posetrack_cli.filtering.smoothing import StateGaussian
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit import local_fits
from posetrack_cli.hand.fit.local_fits import HandFits
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.spool import RecordSpool
from posetrack_cli.tracking.velocity import BodySpace
from support.hand import KINECT
from support.hand_scene import HANDS, Stage, relaxed

HAND, SPACE = HANDS["right"], BodySpace()
SD = np.concatenate([[4.0] * 3, [0.06] * 3, np.tile([0.15, 0.05, 0.15], 5)])


@pytest.fixture(scope="module")
def stage(device: RenderingDevice) -> Stage:
    return Stage(device, HAND)


@pytest.fixture(autouse=True)
def all_fits_are_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of these tests are bad ones, too."""
    monkeypatch.setattr(local_fits, "TRUSTED_BELOW_MM", 40.0)


def fits() -> HandFits:
    return HandFits(HandConfig(), HAND, KINECT)


def observation_of(stage: Stage, truth: FloatArray, noise_mm: float = 0.0) -> Observation:
    depth = stage.depth(truth)
    noise = np.random.default_rng(0).normal(0.0, noise_mm, depth.shape) if noise_mm else 0.0
    observer = Observer(HandConfig(), HAND.anatomy, KINECT, segment=True)
    return observer.observe((depth + noise).astype(np.float32), truth)


def modes_at(*poses: FloatArray) -> LikelihoodModes:
    """Fits of which only the places count."""
    count = len(poses)
    return LikelihoodModes(np.array(poses), np.zeros((count, 21)), np.zeros((count, 21, 21)), np.zeros(count))


def kept(looks: HandFits, seen: Observation, *fits: FloatArray, confidence: float = 0.9) -> dict[str, Any]:
    """A frame whose estimate is its first fit."""
    return looks.keep(seen, modes_at(*fits), fits[0], confidence)


def belief_at(pose: FloatArray, sd: FloatArray = SD) -> StateGaussian:
    return StateGaussian(pose, np.zeros(21), np.diag(np.concatenate([sd, np.ones(21)]) ** 2))


def moved(pose: FloatArray, seed: int) -> FloatArray:
    return SPACE.retract(pose[None], SD * np.random.default_rng(seed).standard_normal((1, 21)))[0]


def test_a_frame_without_fits_keeps_arrays_like_any_other(stage: Stage) -> None:
    truth, looks = relaxed(), fits()
    nothing, seen = looks.keep(None, None, truth, 0.0), kept(looks, observation_of(stage, truth), truth)
    assert looks.known(nothing) is None
    for name, values in seen.items():
        assert (np.shape(values), np.asarray(values).dtype) == (
            np.shape(nothing[name]),
            np.asarray(nothing[name]).dtype,
        )


def test_what_was_kept_gives_the_same_fits_after_the_disk(stage: Stage, tmp_path: Path) -> None:
    truth, looks = relaxed(), fits()
    frame = kept(looks, observation_of(stage, truth), truth, moved(truth, 1))
    with RecordSpool(tmp_path / "spool") as spool:
        spool.append({name: np.asarray(values) for name, values in frame.items()})
        back = next(reversed(spool))
    first, second = looks.known(frame), fits().known(back)
    assert first is not None
    assert second is not None
    assert len(first) == 2
    for name, values in vars(first).items():
        np.testing.assert_array_equal(getattr(second, name), values)


def test_what_a_fit_leaves_says_what_it_is_worth(stage: Stage) -> None:
    """Information goes with the inverse square of the noise: four times as much of it, a sixteenth."""
    truth, looks = relaxed(), fits()
    traces = []
    for noise in (3.0, 12.0):
        known = looks.known(kept(looks, observation_of(stage, truth, noise), truth))
        assert known is not None
        traces.append(np.trace(known.information[0, :3, :3]))
    assert 8.0 < traces[0] / traces[1] < 30.0  # the robust weights fall, and pixels are lost, with noise, too


def test_stated_deviations_are_those_of_a_fit_to_noise(stage: Stage) -> None:
    """The wrist's place from an image that is noisy alone: within 3 of its stated sd along each axis."""
    truth, looks = relaxed(), fits()
    known = looks.known(kept(looks, observation_of(stage, truth, 3.0), truth))
    assert known is not None
    C = np.linalg.inv(known.information[0] + np.diag(SD**-2.0))
    off = C @ known.gradients[0]
    assert (np.abs(off[:3]) < 3.0 * np.sqrt(np.diag(C)[:3])).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_from_what_other_frames_expect_finds_the_hand(stage: Stage, seed: int) -> None:
    """The filter's fit has one finger folded that is straight; the other frames know about where it is."""
    truth, looks = relaxed(), fits()
    wrong, expected = truth.copy(), moved(truth, seed)
    wrong[[10, 12]] = 1.2, 1.5
    frame = kept(looks, observation_of(stage, truth), wrong)
    known = looks.known(frame)
    assert known is not None
    found = looks.more(frame, known, belief_at(expected))
    assert len(found) == 2
    np.testing.assert_array_equal(found.poses[0], wrong)
    assert stage.error(wrong, truth) > 3.0
    assert stage.error(found.poses[1], truth) < 1.5
    assert found.log_heights[1] > found.log_heights[0]


@pytest.mark.parametrize("share", [1e-5, 0.0])
def test_what_is_known_for_sure_is_not_moved_by_a_frame(stage: Stage, share: float) -> None:
    truth, looks = relaxed(), fits()
    expected = moved(truth, 5)
    frame = kept(looks, observation_of(stage, truth), truth)
    known = looks.known(frame)
    assert known is not None
    found = looks.more(frame, known, belief_at(expected, share * SD))
    np.testing.assert_allclose(found.poses[1], expected, atol=1e-3)


def test_where_fits_leave_much_the_filters_estimate_is_what_is_smoothed(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hand that the model is not: its cheapest pose is another one than what the filter made of it."""
    monkeypatch.setattr(local_fits, "TRUSTED_BELOW_MM", 3.0)
    truth, looks = relaxed(), fits()
    off, estimate = moved(truth, 1), moved(truth, 2)
    seen = observation_of(stage, truth)
    close = looks.known(looks.keep(seen, modes_at(truth, off), estimate, 0.9))
    far = looks.known(looks.keep(seen, modes_at(off), estimate, 0.9))
    assert close is not None and far is not None
    np.testing.assert_array_equal(close.poses, [truth, off])
    np.testing.assert_array_equal(far.poses, [estimate])
    np.testing.assert_array_equal(far.gradients, 0.0)
    assert np.trace(far.information[0]) > 0.0
    frame = looks.keep(seen, modes_at(off), estimate, 0.9)
    assert looks.more(frame, far, belief_at(truth)) is far


@pytest.mark.parametrize(("confidence", "share"), [(0.9, 1.0), (0.5, 1.0), (0.25, 1.0 / 9.0), (0.0, 0.0)])
def test_what_is_probably_wrong_counts_the_less_the_surer_that_is(
    stage: Stage, confidence: float, share: float
) -> None:
    truth, looks, seen = relaxed(), fits(), observation_of(stage, relaxed(), 3.0)
    sure, doubtful = (looks.known(kept(looks, seen, truth, confidence=c)) for c in (1.0, confidence))
    assert sure is not None and doubtful is not None
    np.testing.assert_allclose(doubtful.information, share * sure.information)
    np.testing.assert_allclose(doubtful.gradients, share * sure.gradients)


def test_of_a_cost_without_probabilities_all_frames_count() -> None:
    config = HandConfig.model_validate({"observation": {"cost": "union"}})
    assert HandFits(config, HAND, KINECT).keep(None, None, relaxed(), 0.0)["trust"] == 1.0
