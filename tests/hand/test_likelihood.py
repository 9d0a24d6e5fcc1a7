"""Costs against loops over pixels, what each of them sees, and the Gibbs likelihoods."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.likelihood import RenderedCosts, log_gibbs, paper_cost, union_cost
from posetrack_cli.hand.model.anatomy import make_anatomy
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.observe.observation import Observation, window_around
from posetrack_cli.rendering.port import Comparison, RenderingDevice, sums_in_numpy
from support.hand import KINECT, REST, bent

ROUNDING = 1e-9
depths = arrays(np.float32, (2, 3, 4), elements=st.sampled_from([0.0, 500.0, 507.0, 540.0]))
images = arrays(np.float32, (3, 4), elements=st.sampled_from([0.0, -900.0, 503.0, 530.0, 800.0]))


def paper_by_pixels(depth: np.ndarray, image: np.ndarray, c_max: float) -> float:
    """(4) as the paper writes it: the mean over R, the pixels where the rendering has depth."""
    terms = []
    for d, y in zip(depth.ravel().tolist(), image.ravel().tolist(), strict=True):
        if d > 0:
            terms.append(min(abs(d - y), c_max) if y > 0 else c_max)
    return sum(terms) / len(terms) if terms else c_max


def union_by_pixels(depth: np.ndarray, image: np.ndarray, c_max: float, unread: float) -> float:
    """hand.md, observation model: disagreeing regions count c_max, a missing reading ``unread``."""
    total = weight = 0.0
    for d, y in zip(depth.ravel().tolist(), image.ravel().tolist(), strict=True):
        if d > 0 and y > 0:
            total, weight = total + min(abs(d - y), c_max), weight + 1.0
        elif d > 0 or y > 0:
            share = unread if y == 0 else 1.0
            total, weight = total + share * c_max, weight + share
    return total / weight if weight else c_max


@settings(deadline=None)
@given(depths, images, st.floats(1.0, 100.0), st.floats(0.0, 1.0))
def test_costs_are_the_sums_over_pixels(
    depth: np.ndarray, image: np.ndarray, c_max: float, unread: float
) -> None:
    options = ObservationSettings(clamp_mm=c_max, unread_weight=unread)
    sums = sums_in_numpy(depth, Comparison(image, c_max))
    # all readings of the paper's observation are targets: it has no negative ones
    expected = [paper_by_pixels(d, image, c_max) for d in depth]
    np.testing.assert_allclose(paper_cost(sums, options), expected, atol=ROUNDING)
    expected = [union_by_pixels(d, image, c_max, unread) for d in depth]
    np.testing.assert_allclose(union_cost(sums, options), expected, atol=ROUNDING)


def test_a_hand_on_no_pixel_costs_c_max() -> None:
    options = ObservationSettings(clamp_mm=35.0)
    nothing = sums_in_numpy(np.zeros((2, 3, 4), np.float32), Comparison(np.zeros((3, 4), np.float32), 35.0))
    for cost in (paper_cost, union_cost):
        np.testing.assert_array_equal(cost(nothing, options), [35.0, 35.0])


@pytest.mark.parametrize("sigma", [1.5, 20.0])
def test_gibbs_ratios(sigma: float) -> None:
    costs = np.array([0.0, 3.0, 7.0])
    gaussian = log_gibbs(costs, ObservationSettings(sigma_mm=sigma))  # (47), the default
    np.testing.assert_allclose(np.exp(gaussian - gaussian[0]), np.exp(-(costs**2) / (2.0 * sigma**2)))
    exponential = log_gibbs(costs, ObservationSettings(sigma_mm=sigma, likelihood="exponential"))  # (3)
    np.testing.assert_allclose(np.exp(exponential - exponential[0]), np.exp(-costs / sigma))


ANATOMY = make_anatomy()


@pytest.fixture(scope="module")
def device(any_device: RenderingDevice) -> RenderingDevice:
    """All that follows holds for every implementation."""
    return any_device


class Table:
    """A flat hand in front of nothing, and costs of other poses against it."""

    def __init__(self, device: RenderingDevice, cost: str) -> None:
        self.settings = ObservationSettings(cost=cost)
        self.truth = REST.copy()
        self.truth[:3] = [0.0, 60.0, 650.0]
        window = window_around(joint_positions(ANATOMY, self.truth[None])[0], KINECT, self.settings)
        drawing = device.depth_renderer(average_hand().lean, (64, 64), 1)
        image = drawing.depth(skinning_transforms(ANATOMY, self.truth[None]), KINECT, window)[0]
        background = np.where(image > 0, image, -1500.0 if cost == "union" else 0.0)
        self.observation = Observation(window, background.astype(np.float32), int((image > 0).sum()))
        self.scorer = RenderedCosts(device, average_hand(), KINECT, self.settings, 8)

    def moved(self, pose: np.ndarray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
        out = pose.copy()
        out[:3] = self.truth[:3] + np.array([x, y, z])
        return out

    def costs(self, *poses: np.ndarray) -> np.ndarray:
        return self.scorer.costs(np.array(poses), self.observation)


@pytest.mark.parametrize("cost", ["union", "paper"])
def test_the_true_pose_costs_nothing_and_a_shifted_one_its_depth(device: RenderingDevice, cost: str) -> None:
    table = Table(device, cost)
    true, nearer, outside, behind = table.costs(
        table.truth,
        table.moved(table.truth, 0.0, 0.0, -4.0),
        table.moved(table.truth, 2000.0, 0.0, 0.0),
        table.moved(table.truth, 0.0, 0.0, -2000.0),
    )
    assert true < 1e-3  # two float32 roundings of a depth
    # 4 mm nearer: as much on every pixel, and a rim of a twentieth of the width that disagrees
    assert 3.5 < nearer < 4.0 + 0.1 * 40.0
    assert outside == behind == table.settings.clamp_mm
    assert table.costs(table.truth)[0] < 1e-3  # another renderer draws single poses


def test_a_folded_finger_costs_the_union_but_not_the_paper(device: RenderingDevice) -> None:
    # the paper's own diagnosis (7.3, 8): (4) does not see that an observed finger is not explained
    folded = bent(index_mcp_flexion=np.pi / 2, index_pip_flexion=1.8)
    edge_on = REST.copy()
    edge_on[3:7] = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]
    union, paper = Table(device, "union"), Table(device, "paper")
    share = {}
    for name, table in (("union", union), ("paper", paper)):
        share[name] = table.costs(table.moved(folded), table.moved(edge_on)) / table.settings.clamp_mm
    # the index finger is some 9 % of the hand's area, and half of the hand is hidden edge-on
    assert (share["union"] > [0.08, 0.5]).all()
    assert (share["union"] > share["paper"]).all()


def test_the_union_sees_what_is_missing_where_the_paper_sees_a_perfect_fit() -> None:
    image = np.full((1, 10), 600.0, np.float32)
    narrow = np.where(np.arange(10) < 4, 600.0, 0.0).astype(np.float32)[None, None]  # 4 of 10 pixels, exact
    sums = sums_in_numpy(narrow, Comparison(image, 40.0))
    assert paper_cost(sums, ObservationSettings()) == 0.0
    assert union_cost(sums, ObservationSettings()) == pytest.approx(0.6 * 40.0)


def test_the_paper_clamps_at_100_mm_what_it_does_not_find(device: RenderingDevice) -> None:
    table = Table(device, "paper")
    deep = table.moved(table.truth, 0.0, 0.0, 300.0)
    assert table.costs(deep)[0] == pytest.approx(table.settings.clamp_mm, abs=1e-3)
