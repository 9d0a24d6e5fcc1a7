"""Constant velocity and adaptive diffusion: (3.26), (3.31)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.filtering.errors import FilterError
from posetrack_cli.head.config import ParticleSettings
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.particles.particles import (
    FRAME_S,
    SPEED_LIMITS,
    HeadMotion,
    velocity_between,
)

SETTINGS = ParticleSettings()
FLOOR = [0.8, 0.8, 1.5, 0.008, 0.010, 0.006]
POSE = HeadPose(np.array([10.0, -20.0, 700.0]), np.array([1.0, 0.0, 0.0, 0.0]))
VELOCITY = np.array([100.0, -50.0, 20.0, 0.5, -1.0, 0.2])
velocities = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(
    lambda v: np.array(v) * [1000.0, 1000.0, 1000.0, 6.0, 6.0, 6.0]
)


def test_a_head_at_rest_diffuses_by_the_floors():
    assert HeadMotion(np.zeros(6), FRAME_S, SETTINGS).pose_diffusion == pytest.approx(FLOOR)


def test_a_fast_component_diffuses_by_its_own_way():
    """0.4 of what it goes in a frame, and the others by their floors."""
    velocity = np.array([0.0, -300.0, 0.0, 0.0, 3.0, 0.0])
    expected = [0.8, 4.0, 1.5, 0.008, 0.04, 0.006]
    assert HeadMotion(velocity, FRAME_S, SETTINGS).pose_diffusion == pytest.approx(expected)


@given(velocities, st.floats(1e-4, 0.1))
def test_one_step_of_two_dt_spreads_as_two_of_dt(velocity, dt):
    mu = np.array([8.0, 3.0, 0.5])
    one, two = (HeadMotion(velocity, step, SETTINGS).pose_diffusion for step in (dt, 2.0 * dt))
    assert np.square(two) == pytest.approx(2.0 * np.square(one))
    one, two = (HeadMotion(velocity, step, SETTINGS).deformation_diffusion(mu) for step in (dt, 2.0 * dt))
    assert np.square(two) == pytest.approx(2.0 * np.square(one))


def test_deformation_diffuses_by_kappa_mu():
    mu = np.array([8.0, 3.0])
    assert HeadMotion(VELOCITY, FRAME_S, SETTINGS).deformation_diffusion(mu) == pytest.approx([4.0, 1.5])


@given(velocities, st.floats(1e-3, 0.2))
def test_velocity_between_is_what_was_predicted_with(velocity, dt):
    after = HeadMotion(velocity, dt, SETTINGS).predicted(POSE)
    # A rotation of less than pi is told from its end; position is added to and taken from 700 mm.
    assert velocity_between(POSE, after, dt) == pytest.approx(velocity, abs=1e-12 * 700.0 / dt)


def test_long_gaps_and_wild_velocities_are_limited():
    limit, wild = SETTINGS.gap_max_s, np.array([1e6, 0.0, 0.0, 0.0, 0.0, -1e6])
    long, longest = (HeadMotion(VELOCITY, dt, SETTINGS).predicted(POSE) for dt in (limit, 100.0))
    assert long.difference(longest) == pytest.approx(np.zeros(6))
    speeds = SPEED_LIMITS * np.sign(wild)
    moved = POSE.difference(HeadMotion(wild, 0.1, SETTINGS).predicted(POSE))
    assert moved == pytest.approx(0.1 * speeds)
    expected = HeadMotion(speeds, 0.1, SETTINGS).pose_diffusion
    assert HeadMotion(wild, 0.1, SETTINGS).pose_diffusion == pytest.approx(expected)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_time_must_move_on(dt):
    for call in (
        lambda: HeadMotion(VELOCITY, dt, SETTINGS),
        lambda: velocity_between(POSE, POSE, dt),
    ):
        with pytest.raises(FilterError):
            call()
