"""Components of trajectories: truth where it belongs, bands of the right width."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posetrack_cli.evaluation.html.components import (
    Component,
    components,
    euler_variance,
    quaternion_variance,
)
from posetrack_cli.evaluation.measuring.evaluation import Evaluation
from posetrack_cli.evaluation.measuring.pose_metrics import INSIDE_90
from posetrack_cli.evaluation.reading.tracks import Pairs
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.rotations import quaternion_from_roll_pitch_yaw, roll_pitch_yaw
from support.evaluation import hand_evaluation

DEG = np.pi / 180.0
SAMPLES = 40_000
SAMPLED = 5.0 / np.sqrt(SAMPLES)  # five standard errors of a sampled variance are 5 sqrt(2 / n) of it
SMALL = 1e-3  # rad: the second order is below the sampling error


def found(evaluation: Evaluation) -> dict[tuple[str, str], Component]:
    return {(one.group, one.label): one for one in components(evaluation)}


def with_track(evaluation: Evaluation, **changes: Any) -> Evaluation:
    return dataclasses.replace(evaluation, track=dataclasses.replace(evaluation.track, **changes))


def test_a_hand_has_position_rotation_angles_and_velocities() -> None:
    groups = dict.fromkeys(one.group for one in components(hand_evaluation(frames=3)))
    assert list(groups)[:3] == ["Wrist position", "Wrist rotation", "Wrist rotation, quaternion"]
    assert {"Thumb angles", "Little angles", "Wrist velocity", "Index angle velocities"} <= set(groups)


def test_values_truth_and_band_of_a_finger_angle_are_in_degrees() -> None:
    evaluation = hand_evaluation(frames=4)
    one = found(evaluation)["Index angles", "pip flexion"]
    column = evaluation.track.shape_names.index("index_pip_flexion")
    assert evaluation.track.shape is not None and evaluation.track.pose_variance is not None
    assert evaluation.truth is not None and evaluation.truth.shape is not None
    np.testing.assert_allclose(one.estimate, evaluation.track.shape[:, column] / DEG)
    assert one.truth is not None and one.half_width is not None
    np.testing.assert_allclose(one.truth, evaluation.truth.shape[:, column] / DEG)
    sd = np.sqrt(evaluation.track.pose_variance[:, 6 + column])
    np.testing.assert_allclose(one.half_width, INSIDE_90 * sd / DEG)


def test_the_truth_stands_at_the_frames_that_it_belongs_to() -> None:
    evaluation = dataclasses.replace(
        hand_evaluation(frames=4), pairs=Pairs(np.array([0, 3]), np.array([1, 2]))
    )
    one = found(evaluation)["Wrist position", "z"]
    assert evaluation.truth is not None and evaluation.truth.position is not None
    assert one.truth is not None
    np.testing.assert_array_equal(np.isnan(one.truth), [False, True, True, False])
    np.testing.assert_allclose(one.truth[[0, 3]], evaluation.truth.position[[1, 2], 2])


def test_the_true_angular_velocity_is_shown_in_the_estimates_body_axes() -> None:
    """A truth a quarter turn about z away from the estimate that turns about its own x axis."""
    made = hand_evaluation(frames=3)
    assert made.truth is not None
    still = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    twist = np.zeros((3, 21))
    twist[:, 3] = 2.0
    turned = np.tile(Rotation.from_euler("z", 90.0, degrees=True).as_quat(), (3, 1))
    truth = dataclasses.replace(made.truth, quaternion=turned, twist=twist)
    evaluation = dataclasses.replace(with_track(made, quaternion=still), truth=truth)
    shown = found(evaluation)
    for axis, expected in (("x", 0.0), ("y", 2.0 / DEG), ("z", 0.0)):
        component = shown["Wrist angular velocity, body axes", axis]
        np.testing.assert_allclose(component.truth, expected, atol=1e-12)
    assert np.array_equal(twist[:, 3:6], [[2.0, 0.0, 0.0]] * 3)  # the truth itself is left as it is


def test_what_is_not_known_is_left_out() -> None:
    bare = dataclasses.replace(hand_evaluation(frames=2), truth=None, pairs=None)
    bare = with_track(bare, quaternion=None, twist=None, pose_variance=None)
    made = found(bare)
    assert {group for group, _ in made} == {
        "Wrist position",
        *(f"{finger} angles" for finger in ("Thumb", "Index", "Middle", "Ring", "Little")),
    }
    assert all(one.truth is None and one.half_width is None for one in made.values())


def test_angles_do_not_jump_at_half_a_turn_and_the_truth_stays_near() -> None:
    yaw = np.array([170.0, 178.0, 186.0, 194.0]) * DEG
    evaluation = hand_evaluation(frames=4)

    def turned(by: np.ndarray) -> np.ndarray:
        return quaternion_from_roll_pitch_yaw(np.stack([0 * by, 0 * by, by], axis=1))

    assert evaluation.truth is not None
    truth = dataclasses.replace(evaluation.truth, quaternion=turned(yaw + 3 * DEG))
    made = found(dataclasses.replace(with_track(evaluation, quaternion=turned(yaw)), truth=truth))
    one = made["Wrist rotation", "yaw"]
    np.testing.assert_allclose(one.estimate, [170.0, 178.0, 186.0, 194.0])
    assert one.truth is not None
    np.testing.assert_allclose(one.truth, one.estimate + 3.0)
    w = np.stack([made["Wrist rotation, quaternion", axis].estimate for axis in "xyzw"], axis=1)
    assert (np.einsum("ni,ni->n", w[1:], w[:-1]) > 0.99).all()


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.3, -0.8, 2.0), (-2.0, 1.0, -0.5)])
def test_variances_of_euler_angles_and_quaternions_are_those_of_samples(angles: tuple[float, ...]) -> None:
    rng = np.random.default_rng(1)
    variance = SMALL**2 * np.array([[1.0, 4.0, 0.25]])
    q = quaternion_from_roll_pitch_yaw(np.array([angles]))
    samples = rng.standard_normal((SAMPLES, 3)) * np.sqrt(variance)
    turned = (Rotation.from_quat(q) * Rotation.from_rotvec(samples)).as_quat()
    turned *= np.sign(np.einsum("ni,i->n", turned, q[0]))[:, None]
    np.testing.assert_allclose(
        euler_variance(q, variance)[0], roll_pitch_yaw(turned).var(axis=0), rtol=2 * SAMPLED
    )
    atol = SAMPLED * SMALL**2
    np.testing.assert_allclose(quaternion_variance(q, variance)[0], turned.var(axis=0), atol=atol)


def test_at_no_rotation_each_euler_angle_has_the_variance_of_its_axis() -> None:
    variance = np.array([[1.0, 2.0, 3.0]])  # about x, y, z: pitch, yaw, roll
    identity = np.array([rotations.IDENTITY])
    np.testing.assert_allclose(euler_variance(identity, variance), [[3.0, 1.0, 2.0]], rtol=1e-6)


def test_the_band_holds_nine_tenths_of_a_gaussian() -> None:
    from scipy.stats import norm

    assert norm.ppf(0.95) == pytest.approx(INSIDE_90, abs=0.5e-3)  # rounded to three digits
