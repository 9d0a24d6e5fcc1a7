"""The mixture likelihood of rendered hands: what occludes says nothing, what is seen through does."""

from __future__ import annotations

import numpy as np
import pytest

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.hand.config import MixtureSettings, ObservationSettings
from posetrack_cli.hand.fit.likelihood import RenderedCosts, log_gibbs, reading_share
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.hand.model.kinematics import joint_positions, skinning_transforms
from posetrack_cli.hand.observe.observation import Observation, window_around
from posetrack_cli.rendering.port import RenderingDevice
from support.hand import KINECT, REST, bent
from support.rendering import moved_a_subpixel

HAND = average_hand()
TRUTH = REST.copy()
TRUTH[:3] = [0.0, 60.0, 650.0]
ROOM_MM = 1500.0


def moved(pose: FloatArray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> FloatArray:
    out = pose.copy()
    out[:3] = TRUTH[:3] + np.array([x, y, z])
    return out


POSES = np.array(
    [
        TRUTH,
        *(moved(TRUTH, z=z) for z in (-9.0, -2.0, 3.0, 12.0)),
        *(moved(TRUTH, x=x) for x in (-25.0, -3.0, 6.0)),
        *(moved(bent(index_mcp_flexion=angle)) for angle in (0.2, 0.7, 1.4)),
        moved(TRUTH, x=300.0),
    ]
)

A_PIXEL_ASIDE = 6
"""The pose that is moved by less than a coarse pixel."""


SHARP = {
    "near_sd_mm": 1.5,
    "sd_mm_per_m2": 0.7,
    "outlier_share": 0.1,
    "outline_sd_mm": 1.5,
    "correlation_mm": 10.0,
}
"""Noise as measured on hands of the model's own shape: with it, laws hold to the tolerances below."""


class Scene:
    """A flat hand before a room, sampled by so many pixels."""

    def __init__(self, device: RenderingDevice, tile: int = 64, **mixture: float) -> None:
        self.settings = ObservationSettings(
            cost="mixture", tile_px=tile, window_px=128, mixture=MixtureSettings(**(SHARP | mixture))
        )
        self.window = window_around(joint_positions(HAND.anatomy, TRUTH[None])[0], KINECT, self.settings)
        drawing = device.depth_renderer(HAND.lean, (tile, tile), 1)
        transforms = skinning_transforms(HAND.anatomy, TRUTH[None])
        drawn = drawing.depth(transforms, KINECT, self.window)[0]
        self.image: Float32Array = np.where(drawn > 0, drawn, -ROOM_MM).astype(np.float32)
        self.scorer = RenderedCosts(device, HAND, KINECT, self.settings, len(POSES))

    def log_likelihood(self, image: Float32Array, poses: FloatArray = POSES) -> FloatArray:
        seen = Observation(self.window, image.astype(np.float32), int((image > 0).sum()))
        return self.scorer.log_likelihood(poses, seen)

    @property
    def rounding(self) -> float:
        """What a GPU, which rounds corners of triangles, costs the true pose at most: half of each squared
        shift in standard deviations, in as many readings as the pixels are worth."""
        shifts = moved_a_subpixel(self.image) / self.settings.mixture.near_sd_mm
        share = reading_share(TRUTH[2], self.window.step, KINECT, self.settings.mixture.correlation_mm)
        return share * 0.5 * float(np.square(shifts).sum())

    def beside_the_thumb(self) -> np.ndarray:
        """The half of the window, left or right, in which the index finger is."""
        index = KINECT.pixels_from_points(joint_positions(HAND.anatomy, TRUTH[None])[0, 5:9])[0][:, 0].mean()
        little = KINECT.pixels_from_points(joint_positions(HAND.anatomy, TRUTH[None])[0, 17:21])[0][
            :, 0
        ].mean()
        limit, columns = 0.5 * (index + little), self.window.columns()
        half = columns < limit if index < little else columns > limit
        return np.broadcast_to(half, self.image.shape)


def test_the_true_pose_is_perfect_and_the_farther_a_pose_the_worse(device: RenderingDevice) -> None:
    scene = Scene(device)
    found = scene.log_likelihood(scene.image)
    # the outline's pixels see two surfaces at float32: nothing else differs, but for a GPU's rounding
    assert found[0] == pytest.approx(0.0, abs=0.01 + scene.rounding)
    assert (found[1:] < found[0]).all()
    assert found[1] < found[2]  # 9 and 2 mm nearer
    assert found[4] < found[3]
    assert found[5] < found[6]  # 25 and 3 mm aside
    assert found[10] < found[9] < found[8]  # a finger bent more and more
    assert found[11] == found.min()  # beside the hand


def test_what_is_in_front_leaves_the_ranking_and_a_hole_does_not(device: RenderingDevice) -> None:
    scene = Scene(device)
    half = scene.beside_the_thumb()
    # depth alone, so that all poses are hidden alike
    poses = np.array([moved(TRUTH, z=z) for z in (-9.0, -4.0, -1.0, 0.0, 2.0, 6.0, 14.0)])
    free = scene.log_likelihood(scene.image, poses)
    hidden = scene.log_likelihood(np.where(half, np.float32(-400.0), scene.image), poses)
    np.testing.assert_array_equal(np.argsort(hidden), np.argsort(free))
    assert hidden[3] == pytest.approx(0.0, abs=0.01)  # nothing contradicts the true pose
    # of the same half only the room is seen: now a hand that stays out of it is better than the true one
    outside = np.array([TRUTH, moved(TRUTH, x=1000.0)])
    through = scene.log_likelihood(np.where(half, np.float32(-ROOM_MM), scene.image), outside)
    assert through[0] < hidden[3] - 10.0


def test_a_finger_behind_an_object_may_be_anywhere_behind_it(device: RenderingDevice) -> None:
    scene = Scene(device)
    drawn = scene.image > 0
    bent_finger = moved(bent(index_mcp_flexion=0.35))
    straight, folded = scene.log_likelihood(scene.image, np.array([TRUTH, bent_finger]))
    assert straight - folded > 5.0
    covered = np.where(scene.beside_the_thumb(), np.float32(-400.0), scene.image)
    straight, hidden = scene.log_likelihood(covered, np.array([TRUTH, bent_finger]))
    assert abs(straight - hidden) < 0.1 * abs(straight - folded)
    assert drawn.any()


def test_unread_pixels_cost_less_than_a_hole(device: RenderingDevice) -> None:
    scene = Scene(device)
    half = scene.beside_the_thumb()
    unread = scene.log_likelihood(np.where(half, np.float32(0.0), scene.image), TRUTH[None])[0]
    hole = scene.log_likelihood(np.where(half, np.float32(-ROOM_MM), scene.image), TRUTH[None])[0]
    assert unread == pytest.approx(scene.settings.unread_weight * hole, rel=0.05)


def test_the_temperature_does_not_depend_on_how_finely_the_hand_is_sampled(device: RenderingDevice) -> None:
    coarse, fine = Scene(device, 64), Scene(device, 128)
    assert fine.window.step * 2 == coarse.window.step
    once, twice = coarse.log_likelihood(coarse.image), fine.log_likelihood(fine.image)
    # four times the pixels, each worth a quarter; the rest is the outline's staircase, 3.6 mm a pixel
    np.testing.assert_allclose(twice[1:5], once[1:5], rtol=0.08)  # in depth
    rest = [k for k in range(1, len(POSES)) if k != A_PIXEL_ASIDE]
    np.testing.assert_allclose(twice[rest], once[rest], rtol=0.3)


def test_a_patch_counts_as_one_reading(device: RenderingDevice) -> None:
    short, long = Scene(device, correlation_mm=8.0), Scene(device, correlation_mm=16.0)
    once, weaker = short.log_likelihood(short.image), long.log_likelihood(long.image)
    np.testing.assert_allclose(4.0 * weaker, once, rtol=1e-9, atol=1e-12)


def test_the_share_of_a_reading() -> None:
    # at 730 mm a pixel of 365 px focal length is 2 mm wide; every third one stands for 6 x 6 mm
    assert reading_share(730.0, 3, KINECT, 12.0) == pytest.approx(36.0 / 144.0)
    assert reading_share(730.0, 3, KINECT, 1.0) == 1.0  # no pixel is more than one reading


def test_scores_are_costs_and_likelihoods_of_one_drawing(device: RenderingDevice) -> None:
    scene = Scene(device)
    seen = Observation(scene.window, scene.image, int((scene.image > 0).sum()))
    costs, log_likelihood = scene.scorer.scores(POSES, seen)
    # costs alone ask for no misfits, and a device's program without them may add up in another order
    np.testing.assert_allclose(costs, scene.scorer.costs(POSES, seen), rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(log_likelihood, scene.scorer.log_likelihood(POSES, seen))
    union = RenderedCosts(device, HAND, KINECT, ObservationSettings(cost="union", window_px=128), len(POSES))
    # what is reported is the union's cost, added up in another order
    np.testing.assert_allclose(costs, union.costs(POSES, seen), rtol=1e-6, atol=1e-6)
    expected = log_gibbs(costs, ObservationSettings())
    np.testing.assert_allclose(union.log_likelihood(POSES, seen), expected, rtol=1e-5, atol=1e-6)


def test_nothing_to_compare_with_says_nothing(device: RenderingDevice) -> None:
    scene = Scene(device)
    np.testing.assert_array_equal(scene.log_likelihood(np.full_like(scene.image, -ROOM_MM)), 0.0)
