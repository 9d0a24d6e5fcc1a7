"""The objective against a loop over pixels in the paper's notation, and what each of its parts sees."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.hand.config import HandConfig, ObservationSettings, PsoSettings
from posetrack_cli.hand.fit.likelihood import union_cost
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.observe.observation import Observation, window_around
from posetrack_cli.hand.swarm import RenderedObjective, crossing, discrepancy
from posetrack_cli.rendering.port import Comparison, RenderingDevice, sums_in_numpy
from support.hand import KINECT, REST, bent

ROUNDING = 1e-9
HAND = average_hand()
AWAY = np.concatenate([[10.0, 40.0, 650.0], np.zeros(19)])
depths = arrays(np.float32, (2, 3, 4), elements=st.sampled_from([0.0, 500.0, 507.0, 540.0]))
images = arrays(np.float32, (3, 4), elements=st.sampled_from([0.0, -900.0, 503.0, 530.0, 800.0]))


def by_pixels(depth: np.ndarray, image: np.ndarray, own: PsoSettings, unread: float) -> tuple[float, float]:
    """D and its first term, a pixel at a time; each counts 1, or ``unread`` where o_s is not known."""
    far = matched_and_hand = either = 0.0
    for r_d, y in zip(depth.ravel().tolist(), image.ravel().tolist(), strict=True):
        weight = unread if y == 0 and r_d > 0 else 1.0
        o_s, o_d = y > 0, max(y, 0.0)  # no depth is observed outside the hand
        r_m = r_d > 0 and (o_d == 0.0 or abs(o_d - r_d) < own.match_mm)
        far += weight * min(abs(o_d - r_d), own.clamp_mm)
        matched_and_hand += weight * (o_s and r_m)
        either += weight * (o_s or r_m)
    if either == 0.0:
        return own.clamp_mm + own.overlap_mm, own.clamp_mm
    dice = 2.0 * matched_and_hand / (matched_and_hand + either)
    return far / either + own.overlap_mm * (1.0 - dice), far / either


@settings(deadline=None)
@given(
    depths, images, st.floats(1.0, 100.0), st.floats(1.0, 60.0), st.floats(0.0, 300.0), st.floats(0.0, 1.0)
)
def test_the_discrepancy_is_the_published_one(
    depth: np.ndarray, image: np.ndarray, clamp: float, match: float, overlap: float, unread: float
) -> None:
    own = PsoSettings(clamp_mm=clamp, match_mm=match, overlap_mm=overlap)
    sums = sums_in_numpy(depth, Comparison(image, clamp, match_mm=match))
    found = discrepancy(sums, own, unread)
    expected = [by_pixels(one, image, own, unread) for one in depth]
    np.testing.assert_allclose(np.stack(found, axis=1), expected, rtol=ROUNDING, atol=ROUNDING)
    # the first term is what the filters' cost is, so that results of both can be compared
    options = ObservationSettings(clamp_mm=clamp, unread_weight=unread)
    np.testing.assert_allclose(found.depth, union_cost(sums, options), rtol=ROUNDING)


def test_a_discrepancy_by_hand() -> None:
    """Six pixels: 4 mm apart; 25 mm apart, no match; rendered beside the hand; not rendered; unread; neither.

    First term: (4 + 25 + 40 + 40 + .2 40) / (3 + 1 + .2); overlap: one match, 1 - 2 / (1 + 4.2).
    """
    depth = np.array([[[600, 600, 600, 0, 600, 0]]], np.float32)
    image = np.array([[604, 625, -900, 610, 0, -900]], np.float32)
    found = discrepancy(sums_in_numpy(depth, Comparison(image, 40.0, match_mm=10.0)), PsoSettings(), 0.2)
    assert found.depth[0] == pytest.approx(117.0 / 4.2)
    assert found.total[0] == pytest.approx(117.0 / 4.2 + 20.0 * (1.0 - 2.0 / 5.2))


def test_fingers_that_cross_are_counted_by_the_angle_between_them() -> None:
    """The rest pose fans index to little by 5, 0, -5, -11 degrees: neighbours are 5, 5 and 6 apart."""
    poses = np.stack(
        [
            bent(),
            bent(index_mcp_abduction=np.deg2rad(-5.0)),  # parallel to the middle finger
            bent(index_mcp_abduction=np.deg2rad(-15.0)),  # 10 degrees through it
            bent(index_mcp_abduction=np.deg2rad(-15.0), little_mcp_abduction=np.deg2rad(9.0)),  # and 3
            bent(thumb_cmc_abduction=-0.6, index_mcp_abduction=0.4),  # the thumb is none of them
        ]
    )
    expected = np.deg2rad([0.0, 0.0, 10.0, 13.0, 0.0])
    for side in ("right", "left"):  # angles mean the same of both hands
        np.testing.assert_allclose(crossing(make_anatomy(side), poses), expected, atol=ROUNDING)


def hand_seen(device: RenderingDevice, pose: np.ndarray) -> Observation:
    """The depth image of a hand in a pose, with a wall behind it."""
    window = window_around(joint_positions(HAND.anatomy, pose[None])[0], KINECT, ObservationSettings())
    transforms = skinning_transforms(HAND.anatomy, pose[None])
    depth = device.depth_renderer(HAND.lean, (64, 64), 1).depth(transforms, KINECT, window)[0]
    return Observation(window, np.where(depth > 0, depth, np.float32(-2000.0)), int((depth > 0).sum()))


def test_the_objective_is_least_at_the_pose_that_is_seen(device: RenderingDevice) -> None:
    true = REST + AWAY
    objective = RenderedObjective(device, HAND, KINECT, HandConfig())
    seen = hand_seen(device, true)
    moved = np.stack([true] * 5)
    moved[1, 0] += 8.0
    moved[2, 2] += 15.0  # beyond d_m: no pixel matches any more
    moved[3] = bent(index_mcp_flexion=0.8) + AWAY
    moved[4] = bent(index_mcp_abduction=np.deg2rad(-15.0)) + AWAY
    found = objective.evaluate(moved, seen)
    assert found.total[0] == pytest.approx(0.0, abs=1e-3)  # float32 depths
    assert (found.total[1:] > 1.0).all()
    assert found.depth[2] == pytest.approx(15.0, abs=3.0)  # the silhouette is smaller by a rim
    assert found.total[2] - found.depth[2] > 0.9 * 20.0
    free = HandConfig.model_validate({"pso": {"crossing_mm_per_rad": 0.0}})
    without = RenderedObjective(device, HAND, KINECT, free).evaluate(moved, seen)
    np.testing.assert_allclose(
        found.total - without.total, [0, 0, 0, 0, 10.0 * np.deg2rad(10.0)], atol=ROUNDING
    )
