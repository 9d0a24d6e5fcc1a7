"""Velocity errors: examples by hand, scipy, and velocities that are not there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from support.metrics import figures, measure
from support.tracks import random_hand, random_head

VELOCITIES = ("velocity_error_mm_s", "angular_velocity_error_deg_s", "angle_velocity_error_deg_s")


def test_velocities_by_hand() -> None:
    truth = random_hand(2)
    assert truth.twist is not None
    twist = truth.twist.copy()
    twist[0, :3] += [3.0, 4.0, 0.0]
    twist[1, 3:6] += [0.0, np.radians(30.0), 0.0]
    twist[1, 6] -= np.radians(15.0)
    measures, _ = measure(replace(truth, twist=twist), truth)
    np.testing.assert_allclose(measures.series["velocity_error_mm_s"], [5.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(measures.series["angular_velocity_error_deg_s"], [0.0, 30.0], atol=1e-9)
    np.testing.assert_allclose(measures.series["angle_velocity_error_deg_s"], [0.0, 1.0], atol=1e-9)
    assert figures(measures, "angle_velocity_error_deg_s.thumb_cmc_flexion").max == pytest.approx(15.0)


@pytest.mark.parametrize("random", [random_hand, random_head])
def test_velocities_are_those_of_a_loop(random: object) -> None:
    make = random_hand if random is random_hand else random_head
    estimate, truth = make(12, 1), make(12, 2)
    measures, _ = measure(estimate, truth)
    assert estimate.twist is not None
    assert truth.twist is not None
    assert estimate.quaternion is not None
    assert truth.quaternion is not None
    for frame in range(12):
        mine, theirs = estimate.twist[frame], truth.twist[frame]
        linear = np.linalg.norm(mine[:3] - theirs[:3])
        spin = Rotation.from_quat(estimate.quaternion[frame]).apply(mine[3:6])
        true_spin = Rotation.from_quat(truth.quaternion[frame]).apply(theirs[3:6])
        assert measures.series[VELOCITIES[0]][frame] == pytest.approx(linear)
        assert measures.series[VELOCITIES[1]][frame] == pytest.approx(
            np.degrees(np.linalg.norm(spin - true_spin))
        )
        if estimate.subject == "hand":
            angles = np.degrees(np.abs(mine[6:] - theirs[6:]))
            assert measures.series[VELOCITIES[2]][frame] == pytest.approx(angles.mean())
    assert (VELOCITIES[2] in measures.metrics) == (estimate.subject == "hand")


def test_a_filter_without_velocity_is_not_judged_by_it() -> None:
    truth = random_hand(3)
    nothing = np.zeros((3, 21))
    measures, _ = measure(replace(truth, twist=nothing, twist_variance=nothing), truth)
    for address in (*VELOCITIES, "velocity_nees", "velocity_inside_90"):
        assert measures.absent[address] == "the run does not estimate velocities"
    assert "nees" in measures.metrics


def test_a_hand_that_is_held_still_has_a_velocity() -> None:
    truth = random_hand(3)
    measures, _ = measure(replace(truth, twist=np.zeros((3, 21))), truth)
    assert figures(measures, "velocity_error_mm_s").count == 3


def test_a_truth_that_is_held_still_has_a_velocity_too() -> None:
    estimate, still = random_hand(3, 1), random_hand(1)
    rows = np.zeros(3, dtype=np.int64)
    truth = replace(
        random_hand(3, 2),
        position=still.position[rows],  # type: ignore[index]
        quaternion=still.quaternion[rows],  # type: ignore[index]
        twist=np.zeros((3, 21)),
    )
    measures, _ = measure(estimate, truth)
    assert estimate.twist is not None
    np.testing.assert_allclose(
        measures.series["velocity_error_mm_s"], np.linalg.norm(estimate.twist[:, :3], axis=1)
    )


@pytest.mark.parametrize("twist", [None, np.full((3, 21), np.nan), np.zeros((3, 21))])
def test_a_truth_without_velocity_says_so(twist: np.ndarray | None) -> None:
    truth = random_hand(3)
    measures, _ = measure(truth, replace(truth, twist=twist))
    for address in (*VELOCITIES, "velocity_nees", "velocity_inside_90"):
        assert measures.absent[address] == "the ground truth has no velocity"


def test_frames_without_a_velocity_are_left_out_and_told() -> None:
    estimate, truth = random_hand(4, 1), random_hand(4, 2)
    assert truth.twist is not None
    twist = truth.twist.copy()
    twist[1] = np.nan
    whole, _ = measure(estimate, truth)
    measures, _ = measure(estimate, replace(truth, twist=twist))
    assert measures.notes == [f"{address} covers 3 of 4 frames" for address in VELOCITIES]
    for address in (*VELOCITIES, "velocity_nees"):
        kept = whole.series[address][[0, 2, 3]]
        got = measures.series[address]
        assert np.isnan(got).tolist() == [False, True, False, False]
        np.testing.assert_allclose(got[[0, 2, 3]], kept)
        assert figures(measures, address).mean * kept.size == pytest.approx(kept.sum())
    assert figures(measures, "angle_velocity_error_deg_s.index_pip_flexion").count == 3


def test_a_truth_may_know_some_velocities_only() -> None:
    estimate, truth = random_hand(4, 1), random_hand(4, 2)
    assert truth.twist is not None
    twist = np.full_like(truth.twist, np.nan)
    twist[:, :3] = truth.twist[:, :3]
    whole, _ = measure(estimate, truth)
    measures, _ = measure(estimate, replace(truth, twist=twist))
    assert figures(measures, VELOCITIES[0]) == figures(whole, VELOCITIES[0])
    for address in (*VELOCITIES[1:], "velocity_nees", "velocity_inside_90"):
        assert measures.absent[address] == "the ground truth has no velocity"
        assert address not in measures.metrics
    # a CSV without finger angles has six velocities
    measures, _ = measure(estimate, replace(truth, shape=None, shape_names=(), twist=truth.twist[:, :6]))
    assert figures(measures, VELOCITIES[1]) == figures(whole, VELOCITIES[1])
    assert measures.absent[VELOCITIES[2]] == "the ground truth has no finger angles"


def test_angular_velocities_need_a_rotation() -> None:
    truth = random_hand(3)
    measures, _ = measure(truth, replace(truth, quaternion=None))
    assert measures.absent["angular_velocity_error_deg_s"] == "the ground truth has no rotation"
    assert figures(measures, "velocity_error_mm_s").max == 0.0


def test_an_entry_of_0_is_a_velocity() -> None:
    """A hand that moves along x only: most of its velocity is exactly 0 and, so the filter says, certain."""
    estimate, truth = random_hand(3, 1), random_hand(3, 2)
    along_x = np.zeros((3, 21))
    along_x[:, 0] = 5.0
    for one, other in ((along_x, truth.twist), (estimate.twist, along_x)):
        measures, _ = measure(
            replace(estimate, twist=one, twist_variance=np.zeros((3, 21))), replace(truth, twist=other)
        )
        assert figures(measures, VELOCITIES[0]).count == 3


def test_a_truth_that_only_turns_and_has_no_velocity_says_so() -> None:
    truth = random_hand(3)
    assert truth.position is not None
    turning = replace(truth, position=np.broadcast_to(truth.position[0], (3, 3)), twist=np.zeros((3, 21)))
    measures, _ = measure(truth, turning)
    assert measures.absent[VELOCITIES[1]] == "the ground truth has no velocity"


def test_one_frame_without_velocity_is_enough_to_tell_that_the_filter_has_none() -> None:
    truth = random_hand(1)
    still = replace(truth, twist=np.zeros((1, 21)), twist_variance=np.zeros((1, 21)))
    measures, _ = measure(still, truth)
    assert measures.absent[VELOCITIES[0]] == "the run does not estimate velocities"
