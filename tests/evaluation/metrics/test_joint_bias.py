"""Bias per joint: the mean error vector in the palm's axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.hand.model.anatomy import JOINT_NAMES
from support.metrics import measure, number
from support.tracks import random_hand

ROUNDING_MM = 1e-9


def longer(track: Track, name: str, palm: tuple[float, float, float]) -> Track:
    """The estimate whose joint lies ``palm`` mm too far in the palm's axes, in every frame."""
    assert track.points is not None and track.quaternion is not None
    points = track.points.copy()
    points[:, JOINT_NAMES.index(name)] += rotations.rotate(track.quaternion, np.array(palm))
    return replace(track, points=points)


def test_a_constant_in_the_palm_is_found_however_the_hand_turns() -> None:
    truth = random_hand(50)
    measures, _ = measure(longer(truth, "ring_tip", (3.0, -4.0, 12.0)), truth)
    parts = [number(measures, f"joint_bias_{axis}_mm.ring_tip") for axis in "xyz"]
    assert parts == pytest.approx([3.0, -4.0, 12.0], abs=ROUNDING_MM)
    assert number(measures, "joint_bias_mm.ring_tip") == pytest.approx(13.0, abs=ROUNDING_MM)
    assert number(measures, "joint_bias_mm.wrist") == pytest.approx(0.0, abs=ROUNDING_MM)
    assert number(measures, "joint_bias_mm") == pytest.approx(13.0 / 21.0, abs=ROUNDING_MM)
    assert number(measures, "joint_bias_y_mm") == pytest.approx(-4.0 / 21.0, abs=ROUNDING_MM)


def test_errors_to_either_side_are_no_bias() -> None:
    truth = random_hand(2)
    here, there = longer(truth, "wrist", (5.0, 0.0, 0.0)), longer(truth, "wrist", (-5.0, 0.0, 0.0))
    assert here.points is not None and there.points is not None
    both = replace(truth, points=np.stack([here.points[0], there.points[1]]))
    measures, _ = measure(both, truth)
    assert number(measures, "joint_bias_mm.wrist") == pytest.approx(0.0, abs=ROUNDING_MM)
    assert measures.metrics["joint_error_mm.wrist"].mean == pytest.approx(5.0)


def test_lost_frames_have_no_bias() -> None:
    truth = random_hand(4)
    off = longer(truth, "wrist", (2.0, 0.0, 0.0))
    assert off.points is not None
    points = off.points.copy()
    points[3] += 400.0
    measures, _ = measure(replace(off, points=points, lost=np.arange(4) == 3), truth)
    assert number(measures, "joint_bias_x_mm.wrist") == pytest.approx(2.0, abs=ROUNDING_MM)


def test_without_a_rotation_there_are_no_palm_axes() -> None:
    truth = random_hand(3)
    measures, _ = measure(replace(truth, quaternion=None), truth)
    assert measures.absent["joint_bias_mm"] == "the result has no rotation"
    assert "joint_bias_x_mm" not in measures.metrics


def test_a_truth_of_joints_alone_is_enough() -> None:
    truth = random_hand(3)
    joints = replace(truth, position=None, quaternion=None, shape=None, twist=None)
    measures, _ = measure(longer(truth, "wrist", (0.0, 1.5, 0.0)), joints)
    assert number(measures, "joint_bias_y_mm.wrist") == pytest.approx(1.5, abs=ROUNDING_MM)
