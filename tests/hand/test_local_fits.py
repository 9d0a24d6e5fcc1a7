"""Local fits as approximations of the likelihood, on drawn hands."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.least_squares import eliminated
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit import local_fits
from posetrack_cli.hand.fit.gauss_newton import ABDUCTION_SD, IP_SD
from posetrack_cli.hand.fit.likelihood import RenderedCosts
from posetrack_cli.hand.fit.local_fits import (
    MARGINAL_THUMB_SHARE,
    MAX_MODES,
    SHARPENING,
    USUAL_MOTION,
    LocalFits,
    LocalFitter,
    motion_precision,
)
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.tracking.velocity import BodySpace
from support.hand import KINECT
from support.hand_scene import HANDS, Stage, relaxed, turned_about_its_length

FRAME_S = 1.0 / 30.0
HAND, SPACE = HANDS["right"], BodySpace()
FOUND_MM = 2.0


@pytest.fixture(scope="module")
def stage(device: RenderingDevice) -> Stage:
    return Stage(device, HAND)


def local_fitter(**fit: object) -> LocalFitter:
    return LocalFitter(HandConfig.model_validate({"fit": fit}), HAND, KINECT)


def observation_of(depth: np.ndarray, expected: FloatArray) -> Observation:
    return Observer(HandConfig(), HAND.anatomy, KINECT, segment=True).observe(depth, expected)


def fitted(guide: LocalFitter, observation: Observation, expected: FloatArray, seed: int = 0) -> LocalFits:
    return guide.fit(observation, expected, expected[None], FRAME_S, np.random.default_rng(seed))


def moved(pose: FloatArray, seed: int) -> FloatArray:
    """A usual frame's motion farther: 12 mm, 7 degrees, 11 degrees of the bends."""
    sd = np.concatenate([[7.0] * 3, [0.07] * 3, np.tile([0.2, 0.05, 0.2], 5)])
    return SPACE.retract(pose[None], sd * np.random.default_rng(seed).standard_normal((1, 21)))[0]


@pytest.mark.parametrize("seed", range(4))
def test_the_first_mode_is_the_hand_and_modes_are_sound(stage: Stage, seed: int) -> None:
    truth = relaxed()
    expected = moved(truth, seed)
    guide = local_fitter()
    found = fitted(guide, observation_of(stage.depth(truth), expected), expected, seed)
    modes = found.modes
    assert stage.error(expected, truth) > 8.0
    assert stage.error(modes.poses[0], truth) < FOUND_MM
    assert found.cost < 1.5
    assert (np.diff(modes.log_heights) <= 0.0).all()
    assert (modes.log_heights <= 0.0).all()
    for information in modes.information:
        np.testing.assert_allclose(information, information.T, rtol=1e-9, atol=1e-9)
        assert np.linalg.eigvalsh(information)[0] > -1e-9 * np.abs(information).max()
        # a whole hand's place is told to better than a millimetre, and worse than a hundredth
        sd = np.sqrt(np.diag(np.linalg.inv(information))[:3])
        assert (sd < 3.0).all()
        assert (sd > 0.01).all()


def test_of_fingers_that_nothing_shows_the_likeliest_fold_comes_first(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fist from its back: how far the ring finger is bent behind it costs less than the anatomy tells."""
    monkeypatch.setattr(local_fits, "APART_MM", 3.0)
    fist, guide = relaxed(), local_fitter()
    fist[[10, 12, 13, 15, 16, 18, 19, 21]] = np.tile([1.3, 1.5], 4)
    back = turned_about_its_length(fist, np.pi)
    odd = back.copy()
    odd[18] = 0.6
    reading = guide.read(observation_of(stage.depth(odd), odd))
    likely, unlikely = (guide.fitter.assessed(reading.tile, pose) for pose in (back, odd))
    assert unlikely.cost[0] < likely.cost[0]
    chosen = guide.likeliest(reading, [unlikely, likely])
    np.testing.assert_array_equal([fit.pose for fit in chosen], [back, odd])


def test_the_same_seed_gives_the_same_modes(stage: Stage) -> None:
    truth = relaxed()
    expected = moved(truth, 1)
    observation = observation_of(stage.depth(truth), expected)
    first, second = (fitted(local_fitter(), observation, expected, seed=7) for _ in range(2))
    for name in vars(first.modes):
        assert getattr(first.modes, name).tobytes() == getattr(second.modes, name).tobytes()
    assert (first.cost, first.renders) == (second.cost, second.renders)


def test_the_likelihood_falls_about_as_the_modes_say(stage: Stage, device: RenderingDevice) -> None:
    """Steps of one stated standard deviation along each translation lose 1/2, to a factor of 4.

    The mixture's likelihood is no parabola, and residuals of a fit know nothing of its outline.
    """
    truth, config = relaxed(), HandConfig()
    observation = observation_of(stage.depth(truth), truth)
    modes = fitted(local_fitter(), observation, truth).modes
    scorer = RenderedCosts(device, HAND, KINECT, config.observation, 64)
    for k in range(3):
        step = np.eye(21)[k] / np.sqrt(modes.information[0, k, k])
        poses = SPACE.retract(
            np.tile(modes.poses[0], (3, 1)), np.stack([0.0 * step, 3.0 * step, -3.0 * step])
        )
        score = scorer.log_likelihood(poses, observation)
        lost = score[0] - 0.5 * (score[1] + score[2])
        assert 0.25 * 4.5 < lost < 4.0 * 4.5


def test_alternatives_are_fits_nearly_as_good_that_lie_elsewhere(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = relaxed()
    expected = moved(truth, 2)
    observation = observation_of(stage.depth(truth), expected)
    monkeypatch.setattr(local_fits, "ALTERNATIVE_MM", 0.0)
    one = fitted(local_fitter(), observation, expected).modes
    assert len(one) == 1
    monkeypatch.setattr(local_fits, "ALTERNATIVE_MM", 40.0)
    monkeypatch.setattr(local_fits, "APART_MM", 3.0)
    many = fitted(local_fitter(), observation, expected).modes
    assert 2 <= len(many) <= MAX_MODES
    np.testing.assert_array_equal(many.poses[0], one.poses[0])
    joints = joint_positions(HAND.anatomy, many.poses)
    for k in range(1, len(many)):
        assert np.linalg.norm(joints[k] - joints[:k], axis=2).max(axis=1).min() > 3.0
    monkeypatch.setattr(local_fits, "MAX_MODES", 2)
    assert len(fitted(local_fitter(), observation, expected).modes) == 2


def test_what_is_hidden_is_told_by_anatomy_alone(stage: Stage) -> None:
    """A finger behind the palm: its information is that of the relaxed hand, far below what is seen."""
    truth = turned_about_its_length(relaxed(), np.pi)  # the back of the hand
    truth[7 + 3 * 2], truth[9 + 3 * 2] = 1.4, 1.6  # the middle finger is bent behind it
    observation = observation_of(stage.depth(truth), truth)
    modes = fitted(local_fitter(), observation, truth).modes
    hidden, seen = 6 + 3 * 2 + 2, 6 + 3 * 1 + 2  # PIP flexion of the middle and of the index finger
    information = np.diag(modes.information[0])
    assert information[hidden] < 0.1 * information[seen]
    assert information[hidden] >= 0.5  # the pull of a relaxed hand


def test_modes_are_the_image_s_equations_scaled_and_anatomy(stage: Stage) -> None:
    """A fit's residuals count as much as the likelihood's readings; anatomy counts once.

    It does in a mode's height, too: who left it out there would count the way back to a joint's limit, which
    the gradient tells, as gained, and particles would all be drawn from the fit that breaks it most.
    """
    truth = relaxed()
    truth[7 + 3 * 1] = 1.7  # the index finger is bent beyond its limit
    config, guide = HandConfig(), local_fitter()
    observation = observation_of(stage.depth(truth), truth)
    found, fitter = fitted(guide, observation, truth), guide.fitter
    modes = found.modes
    z = float(np.median(observation.image[observation.image > 0]))
    noise_sd = (
        config.observation.mixture.near_sd_mm + config.observation.mixture.sd_mm_per_m2 * (z / 1e3) ** 2
    )
    reading = guide.read(observation)
    scale = reading.share * SHARPENING * (4.0 / noise_sd) ** 2
    per_mm, doubts = reading.height / config.observation.clamp_mm, fitter.potentials(modes.poses, found.inner)
    assert (np.abs(doubts) > 0.1).all()
    assert reading.tile.mm_per_nat == pytest.approx(1.0 / per_mm, rel=1e-12)
    for k, pose in enumerate(modes.poses):
        tile = fitter.tile(observation)._replace(inner=found.inner)
        fit = fitter.assessed(tile, pose)
        data, own = fit.data, fitter.anatomy(fit)
        assert own.matrix.any()
        assert modes.log_heights[k] == pytest.approx(-per_mm * fit.cost[0] - doubts[k], rel=1e-9)
        matrix, vector = scale * data.matrix + own.matrix, scale * data.vector + own.vector
        assert not matrix[21:24].any()  # no forearm is seen
        # the thumb's inner angles are integrated out (``marginalise_inner``); they move nothing but its own
        precision, inner = np.array([IP_SD, ABDUCTION_SD]) ** -2.0, [24, 25]
        matrix[inner, inner] += precision / MARGINAL_THUMB_SHARE**2
        vector[inner] -= scale * precision * found.inner[4:]
        kept = [*range(21), 24, 25]
        information, gradient = eliminated(
            matrix[np.ix_(kept, kept)], vector[kept], slice(0, 21), slice(21, 23)
        )
        np.testing.assert_allclose(modes.information[k], information, atol=1e-9)
        np.testing.assert_allclose(modes.gradients[k], gradient, atol=1e-9)


def test_every_pose_that_is_drawn_is_counted(stage: Stage) -> None:
    """Aligning, descending, swapping fingers, polishing, assessing the modes."""
    truth = relaxed()
    observation = observation_of(stage.depth(truth), truth)
    found = fitted(local_fitter(starts=3, iterations=4, polish=2), observation, truth)
    assert found.renders == 3 * 1 + 3 * 5 + 5 * 2 + 3 + len(found.modes)


def test_a_prior_widens_with_time_and_a_thumb_moves_less() -> None:
    usual, twice = motion_precision(FRAME_S), motion_precision(2.0 * FRAME_S)
    np.testing.assert_allclose(twice, 0.5 * usual)
    np.testing.assert_allclose(usual[:3], 1.0 / USUAL_MOTION.position_mm**2)
    np.testing.assert_allclose(usual[3:6], 1.0 / USUAL_MOTION.rotation_rad**2)
    np.testing.assert_allclose(usual[[9, 11]], 1.0 / USUAL_MOTION.flexion_rad**2)
    np.testing.assert_allclose(usual[10], 1.0 / USUAL_MOTION.abduction_rad**2)
    assert (usual[6:8] > usual[9]).all()


def test_a_few_pixels_are_no_error(stage: Stage) -> None:
    truth = relaxed()
    observation = observation_of(stage.depth(truth), truth)
    image = np.zeros_like(observation.image)
    image[30, 30] = 650.0
    found = fitted(local_fitter(), Observation(observation.window, image, 1), truth)
    assert np.isfinite(found.modes.poses).all()
    assert np.isfinite(found.modes.information).all()
    assert np.isfinite(found.cost)
