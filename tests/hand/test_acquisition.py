"""Hands that are found from nothing: drawn ones, and those of natural motion with every sensor effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.model.anatomy import ANGLES
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observer import Observer
from posetrack_cli.hand.search import ACCEPT_MM, Acquisition, Bar, Candidate, cheaper_of, distinct
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.synthesis.hand.frames import CAMERA, synthesise
from posetrack_cli.synthesis.hand.options import SynthOptions
from support.hand import KINECT, random_poses
from support.hand_scene import HANDS, WALL_MM, Stage, acquisition, relaxed, turned_about_its_length

FOUND_MM = 5.0
"""A drawn hand is found to 1 mm; what its window cuts off or it hides itself may be off."""


@pytest.fixture(scope="module")
def stage(device: RenderingDevice) -> Stage:
    return Stage(device, HANDS["right"])


@pytest.fixture(scope="module")
def finder(device: RenderingDevice) -> Acquisition:
    return acquisition(HANDS["right"])


@pytest.mark.parametrize(
    "pose",
    [
        relaxed(),
        relaxed(-180.0, -60.0, 900.0),
        relaxed(150.0, 100.0, 500.0, (0.0, 0.0, 1.2)),
        turned_about_its_length(relaxed(60.0, 20.0, 700.0), np.pi),
        relaxed(0.0, -80.0, 650.0, (0.0, 0.0, 3.0)),
    ],
    ids=["middle", "far", "near aside", "back of the hand", "upside down"],
)
def test_a_drawn_hand_is_found_anywhere(finder: Acquisition, stage: Stage, pose: np.ndarray) -> None:
    found = finder.search(stage.depth(pose))
    assert found is not None
    assert stage.error(found.pose, pose) < FOUND_MM
    assert found.cost < 3.0


def test_a_left_hand_is_found_with_a_left_model(device: RenderingDevice) -> None:
    left = Stage(device, HANDS["left"])
    pose = relaxed(-40.0, 30.0, 700.0)
    found = acquisition(HANDS["left"]).search(left.depth(pose))
    assert found is not None
    assert left.error(found.pose, pose) < FOUND_MM


def test_the_nearer_of_two_hands_is_found(finder: Acquisition, stage: Stage) -> None:
    near, far = relaxed(-120.0, 60.0, 600.0), relaxed(150.0, 60.0, 850.0)
    found = finder.search(stage.depth(near, far))
    assert found is not None
    assert stage.error(found.pose, near) < FOUND_MM


@pytest.mark.parametrize("bar", [Bar(cost=-10.0), Bar(cost=-10.0, total_cost=-10.0)])
def test_hands_that_are_of_no_use_are_only_fitted_roughly(
    finder: Acquisition, stage: Stage, monkeypatch: pytest.MonkeyPatch, bar: Bar
) -> None:
    """A hand above its bar, or above both, is found as well, only not as closely."""
    depth = stage.depth(relaxed())
    full = finder.search(depth, bar=Bar(cost=3.0))
    monkeypatch.setattr(Acquisition, "_fit_fully", lambda *_: pytest.fail("fitted to all pixels"))
    rough = finder.search(depth, bar=bar)
    assert full is not None and rough is not None
    assert full.cost <= rough.cost < ACCEPT_MM
    assert stage.error(rough.pose, relaxed()) < FOUND_MM


def test_a_known_hand_is_refitted(finder: Acquisition, stage: Stage) -> None:
    truth, start = relaxed(), relaxed(8.0, -6.0)
    found = finder.refit(stage.depth(truth), start)
    assert found is not None and stage.error(found.pose, truth) < FOUND_MM
    assert finder.refit(np.zeros((KINECT.height, KINECT.width), dtype=np.float32), start) is None


def test_where_there_is_no_hand_none_is_found(finder: Acquisition) -> None:
    blank = np.zeros((KINECT.height, KINECT.width), dtype=np.float32)
    assert finder.search(blank) is None
    assert finder.search(blank + WALL_MM) is None
    disc = blank + WALL_MM
    v, u = np.mgrid[: KINECT.height, : KINECT.width]
    disc[(u - 256) ** 2 + (v - 212) ** 2 < 90**2] = 600.0  # of 150 mm radius
    assert finder.search(disc) is None


def test_what_fits_badly_is_no_find(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of 2 mm leaves errors of 1.6 mm on average, however well the hand is placed."""
    noise = np.random.default_rng(0).normal(scale=2.0, size=(KINECT.height, KINECT.width))
    noisy = (stage.depth(relaxed()) + noise).astype(np.float32)
    for accept_mm, found in ((0.5, False), (5.0, True)):
        monkeypatch.setattr("posetrack_cli.hand.search.ACCEPT_MM", accept_mm)
        assert (acquisition(HANDS["right"]).search(noisy) is not None) == found


def test_natural_hands_are_found_in_single_frames(device: RenderingDevice) -> None:
    """With forearm, body, noise and missing readings, at twice the usual speed.

    Of 19 such frames 16 were found to 3 mm, one to 4 mm, two to 13 mm.
    """
    hand, errors = HANDS["right"], []
    finder = acquisition(hand)
    assert CAMERA == KINECT
    for seed in range(1, 5):
        options = SynthOptions(frames=3, fps=2.5, seed=seed, speed=2.0)
        for frame in synthesise(options, device=device):
            found = finder.search(frame.depth)
            joints = np.inf if found is None else joint_positions(hand.anatomy, found.pose[None])[0]
            errors.append(np.linalg.norm(joints - frame.joints, axis=1).mean())
    assert len(errors) == 10
    assert np.mean(np.array(errors) < 10.0) >= 0.75
    assert np.median(errors) < 3.0


@pytest.mark.parametrize("angle", [np.pi, 0.5 * np.pi])
def test_a_hand_that_was_taken_for_its_other_side_is_reconsidered(
    finder: Acquisition, stage: Stage, angle: float
) -> None:
    truth = relaxed()
    wrong = turned_about_its_length(truth, angle)
    observer = Observer(HandConfig(), HANDS["right"].anatomy, KINECT, segment=True)
    observation = observer.observe(stage.depth(truth), wrong)
    found = finder.reconsider(observation, wrong)
    assert found is not None
    assert stage.error(wrong, truth) > 25.0
    assert stage.error(found.pose, truth) < FOUND_MM
    empty = replace(observation, image=np.zeros_like(observation.image), target_pixels=0)
    assert finder.reconsider(empty, wrong) is None


def test_distinct_poses_come_first_and_the_best_of_all() -> None:
    poses = np.repeat(random_poses(6, 1), 3, axis=0)  # three of each kind
    costs = np.random.default_rng(2).permutation(18).astype(np.float64)
    kinds = np.arange(18) // 3
    chosen = distinct(poses, costs, 6)
    assert chosen[0] == int(np.argmin(costs))
    assert sorted(kinds[chosen]) == list(range(6))
    for k in chosen:  # the best of its kind
        assert costs[k] == costs[kinds == kinds[k]].min()
    more = distinct(poses, costs, 10)
    assert more[:6] == chosen
    rest = [k for k in np.argsort(costs) if k not in chosen]
    assert more[6:] == rest[:4]
    assert sorted(distinct(poses, costs, 18)) == list(range(18))
    assert sorted(distinct(poses, costs, 99)) == list(range(18))


def test_hands_differ_by_rotation_or_by_shape() -> None:
    pose = relaxed()
    bent = pose.copy()
    bent[ANGLES] += 0.2
    turned = turned_about_its_length(pose, np.deg2rad(30.0))
    near = turned_about_its_length(pose, np.deg2rad(20.0))
    same = pose.copy()
    same[3:7] *= -1.0  # the same rotation
    poses = np.stack([pose, same, near, bent, turned])
    assert distinct(poses, np.arange(5.0), 3) == [0, 3, 4]


def test_the_cheaper_of_two_candidates() -> None:
    cheap, dear = Candidate(relaxed(), 1.0), Candidate(relaxed(), 2.0)
    assert cheaper_of(cheap, dear) is cheap
    assert cheaper_of(dear, cheap) is cheap
    assert cheaper_of(None, dear) is dear
    assert cheaper_of(dear, None) is dear
    assert cheaper_of(None, None) is None
