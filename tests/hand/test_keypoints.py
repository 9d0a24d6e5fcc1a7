"""What keypoints are worth: poses out of points with noise and outliers, and a tracker that is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.autodetect import CLEAR_LOG_ODDS
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.likelihood import RenderedCosts
from posetrack_cli.hand.keypoints.file import UNSURE, KeypointFile
from posetrack_cli.hand.keypoints.hands import (
    MAX_HANDS,
    KeypointHands,
    KeypointSide,
    best_candidate,
    fit_candidates,
    fit_to_targets,
    split_by_distance,
)
from posetrack_cli.hand.keypoints.targets import MIN_POINTS, skin_depths, targets_in_image, targets_in_space
from posetrack_cli.hand.model.kinematics import joint_positions
from posetrack_cli.hand.observe.observation import Observation
from posetrack_cli.hand.policy import LEAVE_AFTER_SEARCHES, TrackMonitor
from posetrack_cli.hand.tracker import HandTracker
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.keypoints.layout import KeypointSets
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results.estimate import Estimate, Status
from support.hand import KINECT, random_poses
from support.hand_scene import FRAME_NS, HANDS, Stage, acquisition, relaxed, turned_about_its_length

RIGHT, LEFT = HANDS["right"], HANDS["left"]
NOISE_MM, NOISE_PX = 8.0, 5.0
FITTED_MM = 3.5
"""Mean error of joints fitted to exact points, of .01 / mm^2: relaxed fingers pull with 0.5 / rad^2, a
relaxed thumb with 4 to 8, closing fingers with 4."""
NOISY_MM = 1.5 * NOISE_MM
"""63 coordinates tell 21 unknowns: sqrt(3 / 3) NOISE_MM, and half of it for three points that are off."""
LIFTED_MM = 16.0
"""From pixels: NOISE_PX are 9 mm at 650 mm each way, and the skin before hidden joints is not theirs."""
TRACKED_MM = 4.0
"""Mean error of a drawn hand that is tracked, as in ``test_recovery``."""
LOST_AFTER = HandConfig().status.lost_after_frames


def joints_of(pose: FloatArray) -> FloatArray:
    return joint_positions(RIGHT.anatomy, pose[None])[0]


def error(first: FloatArray, second: FloatArray) -> float:
    return float(np.linalg.norm(joints_of(first) - joints_of(second), axis=1).mean())


def in_image(pose: FloatArray, camera: Camera = KINECT) -> FloatArray:
    return camera.pixels_from_points(joints_of(pose))[0]


def told_of(points: list[FloatArray], right: float = np.nan, *, in_pixels: bool = False) -> KeypointFile:
    """A file of one set per frame, (21, 2) pixels or (21, 3) mm."""
    count = len(points)
    values = np.full((count, 21, 3), np.nan)
    for k, point in enumerate(points):
        values[k, :, : point.shape[1]] = point
    sets = KeypointSets(np.arange(count), False, values, np.ones((count, 21)), np.full(count, right))
    return KeypointFile("k.csv", "0" * 64, sets, in_pixels, "px" if in_pixels else "mm", "none")


# Points to poses


def test_points_of_the_model_give_its_pose_back() -> None:
    for pose in random_poses(60, seed=1):
        about = targets_in_space(joints_of(pose), np.ones(21))
        assert about is not None
        fitted = fit_to_targets(about, RIGHT.anatomy)
        assert fitted is not None and fitted[1] == pytest.approx(1.0)
        assert error(fitted[0], pose) < FITTED_MM


def test_noise_and_outliers_are_borne() -> None:
    rng, errors = np.random.default_rng(2), []
    for pose in random_poses(60, seed=3):
        points = joints_of(pose) + NOISE_MM * rng.standard_normal((21, 3))
        off = rng.choice(21, 3, replace=False)
        points[off] += rng.uniform(-150.0, 150.0, (3, 3))
        about = targets_in_space(points, np.ones(21))
        fitted = None if about is None else fit_to_targets(about, RIGHT.anatomy)
        assert fitted is not None and fitted[1] > 0.6
        errors.append(error(fitted[0], pose))
    assert float(np.mean(errors)) < NOISY_MM


def test_a_score_of_nothing_takes_a_point_away() -> None:
    pose, scores = random_poses(1, seed=4)[0], np.ones(21)
    points = joints_of(pose)
    points[:8] += 200.0
    scores[:8] = 0.0
    about = targets_in_space(points, scores)
    fitted = None if about is None else fit_to_targets(about, RIGHT.anatomy)
    assert fitted is not None and fitted[1] == pytest.approx(1.0)
    assert np.linalg.norm(joints_of(fitted[0])[8:] - points[8:], axis=1).mean() < FITTED_MM
    assert targets_in_space(points, (np.arange(21) < MIN_POINTS - 1).astype(float)) is None


def test_points_anywhere_are_no_hand() -> None:
    rng = np.random.default_rng(6)
    anywhere = [rng.uniform([-100, -100, 550], [100, 100, 750], (21, 3)) for _ in range(50)]
    frame = Frame(0, 0, (np.zeros((424, 512), dtype=np.float32),))
    told = [KeypointHands(told_of([points]), KINECT, RIGHT.anatomy).of(frame) for points in anywhere]
    assert told == [()] * 50
    on_one_spot = KeypointHands(told_of([np.full((21, 3), 600.0)]), KINECT, RIGHT.anatomy)
    assert on_one_spot.of(frame) == ()


@pytest.mark.parametrize("scatter_mm", [1.0, 3.0])
def test_points_within_millimetres_are_no_hand(scatter_mm: float) -> None:
    """A hand can be folded up about them, with all its joints within what conventions differ by."""
    rng = np.random.default_rng(1)
    frame = Frame(0, 0, (np.zeros((424, 512), dtype=np.float32),))
    for _ in range(15):
        spot = rng.uniform([-200, -200, 500], [200, 200, 1500])
        points = spot + scatter_mm * rng.standard_normal((21, 3))
        assert KeypointHands(told_of([points]), KINECT, RIGHT.anatomy).of(frame) == ()


@pytest.mark.parametrize(
    ("alone", "sides", "used"), [(False, "as told", 1), (False, UNSURE, 2), (True, "as told", 2)]
)
def test_of_two_tracked_hands_each_uses_its_own_keypoints(alone: bool, sides: str, used: int) -> None:
    own, other = (relaxed(x, 0.0, 650.0) for x in (-90.0, 90.0))
    points = np.array([joints_of(own), joints_of(other)])
    sets = KeypointSets(np.zeros(2, dtype=np.int64), False, points, np.ones((2, 21)), np.array([1.0, 0.0]))
    file = KeypointFile("k", "", sets, False, "mm", sides)
    frame = Frame(0, 0, (np.zeros((424, 512), dtype=np.float32),))
    hands = KeypointHands(file, KINECT, RIGHT.anatomy, alone=alone).of(frame)
    assert len(hands) == used and error(hands[0].pose, own) < FITTED_MM


# Pixels and depth


@pytest.fixture(scope="module")
def stage(device: RenderingDevice) -> Stage:
    return Stage(device, RIGHT)


def test_pixels_get_their_depth_from_the_image(stage: Stage) -> None:
    rng, errors = np.random.default_rng(7), []
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        pose = turned_about_its_length(relaxed(20.0, 40.0, 620.0), float(angle))
        pixels = in_image(pose) + NOISE_PX * rng.standard_normal((21, 2))
        about = targets_in_image(pixels, np.ones(21), stage.depth(pose), KINECT, RIGHT.anatomy)
        fitted = None if about is None else fit_to_targets(about, RIGHT.anatomy)
        assert fitted is not None
        errors.append(error(fitted[0], pose))
    assert float(np.mean(errors)) < LIFTED_MM


def test_depth_is_that_of_the_hand_beside_wall_holes_and_noise() -> None:
    depth = np.full((424, 512), 1500.0, dtype=np.float32)
    depth[180:240, 200:300] = 650.0
    pixels = np.column_stack([np.linspace(205.0, 295.0, 21), np.full(21, 179.0)])  # just off its edge
    np.testing.assert_array_equal(skin_depths(pixels, depth, KINECT), 650.0)
    depth[180:240, 200:300][np.random.default_rng(0).random((60, 100)) < 0.5] = 0.0
    np.testing.assert_array_equal(skin_depths(pixels, depth, KINECT), 650.0)
    pixels[3], pixels[4] = (400.0, 50.0), (-900.0, 1e9)  # on the wall, and nowhere
    found = skin_depths(pixels, depth, KINECT)
    assert np.isnan(found[[3, 4]]).all() and (found[5:] == 650.0).all()
    assert np.isnan(skin_depths(pixels, np.zeros_like(depth), KINECT)).all()


def test_a_lens_is_taken_out_of_pixels(stage: Stage) -> None:
    bent = Camera(512, 424, 365.0, 365.0, 255.5, 211.5, (0.2, -0.1, 0.0, 0.0))
    pose = relaxed(-150.0, 60.0, 620.0)
    x, y = ((in_image(pose) - [bent.cx, bent.cy]) / 365.0).T
    r2 = x * x + y * y
    seen = np.column_stack([x, y]) * (1.0 + 0.2 * r2 - 0.1 * r2**2)[:, None] * 365.0 + [bent.cx, bent.cy]
    straight = targets_in_image(in_image(pose), np.ones(21), stage.depth(pose), KINECT, RIGHT.anatomy)
    found = targets_in_image(seen, np.ones(21), stage.depth(pose), bent, RIGHT.anatomy)
    assert straight is not None and found is not None
    lines = [about.positions / about.positions[:, 2:] for about in (straight, found)]
    np.testing.assert_allclose(lines[1], lines[0], atol=1e-6)


# A tracker that is told


def tracker(
    device: RenderingDevice, keypoints: KeypointFile | None, config: HandConfig | None = None
) -> HandTracker:
    config, finder = config or HandConfig(), acquisition(RIGHT, config)
    scorer = RenderedCosts(device, RIGHT, KINECT, config.observation, config.filter.particles)
    told = None if keypoints is None else KeypointHands(keypoints, KINECT, RIGHT.anatomy)
    return HandTracker(config, RIGHT.anatomy, scorer, finder.observer, finder, told)


def tracked(
    tracking: HandTracker,
    depths: Sequence[ImageArray],
    start: FloatArray,
    monitor: TrackMonitor | None = None,
) -> list[Estimate]:
    state, estimates = tracking.start(start, 0, np.random.default_rng(0)), []
    state = replace(state, monitor=monitor or state.monitor)
    for k, depth in enumerate(depths):
        frame = Frame(k, k * FRAME_NS, (depth,))
        state, estimate = tracking.step(state, frame, np.random.default_rng(k))
        estimates.append(estimate)
    return estimates


def pose_of(estimate: Estimate) -> FloatArray:
    return np.concatenate([estimate.position, estimate.quaternion, estimate.shape])


def test_a_lost_hand_is_found_where_it_is_told_during_a_pause(device: RenderingDevice, stage: Stage) -> None:
    pose, frame = relaxed(), Frame(0, FRAME_NS, (stage.depth(relaxed()),))
    noisy = joints_of(pose) + NOISE_MM * np.random.default_rng(0).standard_normal((21, 3))
    found = {}
    for keypoints in (None, told_of([noisy])):
        tracking = tracker(device, keypoints)
        state = tracking.start(relaxed(250.0, 0.0, 900.0), 0, np.random.default_rng(0))
        state = replace(state, monitor=TrackMonitor(lost=True, mean_cost_mm=2.0, search_wait=4))
        after, estimate = tracking.step(state, frame, np.random.default_rng(1))
        found[keypoints is not None] = (after.monitor.lost, error(pose_of(estimate), pose))
    assert found[False][0] and found[False][1] > 100.0
    assert not found[True][0] and found[True][1] < TRACKED_MM


def test_a_track_that_fits_is_not_left_for_a_hand_that_is_told_and_no_better(
    device: RenderingDevice, stage: Stage
) -> None:
    here, there = relaxed(-110.0, 60.0, 640.0), relaxed(110.0, 60.0, 660.0)
    depths = [stage.depth(here, there)] * (LEAVE_AFTER_SEARCHES + 2)
    told = told_of([joints_of(there)] * len(depths), right=1.0)
    assert max(error(pose_of(e), here) for e in tracked(tracker(device, told), depths, here)) < TRACKED_MM


def test_a_track_that_is_on_something_else_leaves_for_the_hand_that_is_told(
    device: RenderingDevice, stage: Stage
) -> None:
    """While searches pause, for their last ones found nothing, only keypoints can tell."""
    there = relaxed(110.0, 60.0, 660.0)
    rows, columns = np.mgrid[:424, :512]
    limb = np.hypot(columns - 130.0, 0.35 * (rows - 210.0)) < 24.0  # as large as a hand, and none
    depth = np.where(limb, 640.0, stage.depth(there)).astype(np.float32)
    depths, start = [depth] * (LEAVE_AFTER_SEARCHES + 1), relaxed(-215.0, 60.0, 650.0)  # no more than a pause
    doubting = HandConfig.model_validate(
        {"status": {"doubt_above_mm": 1.0}}
    )  # no fit to the limb ends the pause
    pausing = TrackMonitor(mean_cost_mm=12.0, search_wait=6, next_search_wait=6)
    silent = tracked(tracker(device, None, doubting), depths, start, pausing)
    assert min(error(pose_of(e), there) for e in silent) > 200.0
    file = told_of([joints_of(there)] * len(depths))
    told = tracked(tracker(device, file, doubting), depths, start, pausing)
    errors = [error(pose_of(e), there) for e in told]
    assert (
        min(errors[: LEAVE_AFTER_SEARCHES - 1]) > 200.0
        and max(errors[LEAVE_AFTER_SEARCHES - 1 :]) < TRACKED_MM
    )
    assert [e.status for e in told[LEAVE_AFTER_SEARCHES - 1 :]] == [Status.REINITIALISED, Status.TRACKING]


def test_a_frame_that_fits_and_tells_of_nothing_better_ends_the_row(
    device: RenderingDevice, stage: Stage
) -> None:
    """Else five frames that are told wrongly, far from each other, would end a good track."""
    pose = relaxed()
    frame = Frame(0, FRAME_NS, (stage.depth(pose),))
    tracking = tracker(device, told_of([joints_of(pose)]))
    state = tracking.start(pose, FRAME_NS, np.random.default_rng(0))
    state = replace(state, monitor=TrackMonitor(mean_cost_mm=2.0, better_elsewhere=LEAVE_AFTER_SEARCHES - 1))
    after, _ = tracking.step(state, frame, np.random.default_rng(1))
    assert after.monitor.better_elsewhere == 0 and not after.cut


def test_a_fit_from_what_is_told_is_a_mode_of_the_likelihood(device: RenderingDevice, stage: Stage) -> None:
    """Of a hand whose back was taken for its palm no fit near the prediction is right."""
    pose = turned_about_its_length(relaxed(), 0.4)
    wrong = turned_about_its_length(pose, np.pi)
    finder = acquisition(RIGHT)
    observation = finder.observer.observe(stage.depth(pose), wrong)
    points = joints_of(pose) + NOISE_MM * np.random.default_rng(3).standard_normal((21, 3))
    about = targets_in_space(points, np.ones(21))
    fitted = None if about is None else fit_to_targets(about, RIGHT.anatomy)
    assert fitted is not None

    def best(*told: FloatArray) -> FloatArray:
        fits = finder.local_fitter.fit(
            observation,
            wrong,
            wrong[None],
            1 / 30,
            np.random.default_rng(0),
            extra=np.array(told).reshape(-1, 22),
        )
        return fits.modes.poses[0]

    assert error(best(), pose) > 10.0
    assert error(best(fitted[0]), pose) < TRACKED_MM
    assert error(best(turned_about_its_length(fitted[0], np.pi)), pose) > 10.0  # as wrong as what is expected


def test_what_is_told_wrongly_costs_nothing(device: RenderingDevice, stage: Stage) -> None:
    poses = [relaxed(4.0 * k, 60.0, 650.0) for k in range(8)]
    depths, rng = [stage.depth(pose) for pose in poses], np.random.default_rng(1)
    silent = [
        error(pose_of(e), p)
        for e, p in zip(tracked(tracker(device, None), depths, poses[0]), poses, strict=True)
    ]
    other = turned_about_its_length(relaxed(0.0, 60.0, 650.0), np.pi / 2)
    for wrong in (
        [rng.uniform([-150, -150, 500], [150, 150, 800], (21, 3)) for _ in poses],
        [joints_of(other)] * 8,
        [joints_of(relaxed(300.0, 0.0, 1200.0))] * 8,
    ):
        told = tracked(tracker(device, told_of(wrong)), depths, poses[0])
        errors = [error(pose_of(e), p) for e, p in zip(told, poses, strict=True)]
        assert np.mean(errors) < np.mean(silent) + 0.5  # mm; another start changes the filter's draws
        assert all(e.status == Status.TRACKING for e in told)


def test_hands_near_the_track_are_starts_and_others_places() -> None:
    pose = relaxed()
    frame = Frame(0, 0, (np.zeros((424, 512), dtype=np.float32),))
    values = np.stack([joints_of(relaxed(x)) for x in (10.0, 30.0, 200.0, 260.0, 300.0)])
    sets = KeypointSets(np.zeros(5, np.int64), False, values, np.ones((5, 21)), np.full(5, np.nan))
    sets.scores[4] = 0.5
    hands = KeypointHands(KeypointFile("k", "", sets, False, "mm", "none"), KINECT, RIGHT.anatomy).of(frame)
    assert len(hands) == MAX_HANDS and min(hand.score for hand in hands) == 1.0
    near, elsewhere = split_by_distance(hands, pose, RIGHT.anatomy)
    assert near.shape == (2, 22) and len(elsewhere) == 2
    assert split_by_distance((), pose, RIGHT.anatomy)[0].shape == (0, 22)


def test_a_label_of_the_other_side_speaks_against_a_place(device: RenderingDevice, stage: Stage) -> None:
    finder, pose = acquisition(RIGHT), relaxed()
    doubts = {}
    for right in (np.nan, 1.0, 0.5, 0.0):
        told = KeypointHands(told_of([joints_of(pose)], right=right), KINECT, RIGHT.anatomy)
        depth = stage.depth(pose)
        found = best_candidate(fit_candidates(finder, depth, told.of(Frame(0, 0, (depth,)))))
        assert found is not None
        doubts[right] = found.total_cost
    values = list(doubts.values())
    assert values[0] == values[1] and np.allclose(np.diff(values[1:]), 2.0)  # _TOLD_MM each


@pytest.mark.parametrize("ends", ["goes on beyond the fingers", "nothing is seen"])
def test_a_place_is_judged_where_its_fit_ends(
    device: RenderingDevice, stage: Stage, monkeypatch: pytest.MonkeyPatch, ends: str
) -> None:
    """Seen from where it is told a limb may be a hand, and from where the fit slides to none."""
    finder, pose = acquisition(RIGHT), relaxed()
    depth = stage.depth(pose)
    hands = KeypointHands(told_of([joints_of(pose)]), KINECT, RIGHT.anatomy).of(Frame(0, 0, (depth,)))
    [found] = fit_candidates(finder, depth, hands)
    observe, seen = finder.observer.observe, []

    def observed(image: ImageArray, about: FloatArray) -> Observation:
        seen.append(about)
        here = observe(image, about)
        if len(seen) == 1:
            return here
        return replace(here, reversed=True) if ends.startswith("goes") else replace(here, target_pixels=0)

    monkeypatch.setattr(finder.observer, "observe", observed)
    assert fit_candidates(finder, depth, hands) == []
    np.testing.assert_array_equal(seen[1], found.pose)


BLANK = Frame(0, 0, (np.zeros((4, 4), dtype=np.float32),))


def side_of(keypoints: KeypointFile | None, frames: int = 1) -> float:
    """The log odds of a right hand after some frames."""
    side = KeypointSide(keypoints, KINECT)
    for _ in range(frames):
        side.add_frame(BLANK, RIGHT.anatomy, LEFT.anatomy)
    return side.log_odds


def test_labels_move_the_odds_less_than_what_is_certain() -> None:
    for right, sign in ((1.0, 1.0), (0.0, -1.0), (0.5, 0.0), (np.nan, 0.0)):
        labels = told_of([np.zeros((21, 3))], right=right)
        assert np.sign(side_of(labels)) == sign and abs(side_of(labels)) <= 0.8
        assert abs(side_of(labels, 50)) < CLEAR_LOG_ODDS
        assert abs(side_of(replace(labels, sides=UNSURE), 50)) == abs(0.8 * sign)
    assert side_of(None) == 0.0


def test_labels_that_contradict_each_other_tell_nothing() -> None:
    values = np.zeros((2, 21, 3))
    sets = KeypointSets(np.zeros(2, np.int64), False, values, np.ones((2, 21)), np.array([1.0, 0.0]))
    assert side_of(KeypointFile("k", "", sets, False, "mm", "as told")) == 0.0


def test_points_in_space_tell_their_side_against_a_few_wrong_labels() -> None:
    rng = np.random.default_rng(8)
    for hand, sign in ((RIGHT, 1.0), (LEFT, -1.0)):
        odds = [
            side_of(
                told_of(
                    [joint_positions(hand.anatomy, pose[None])[0] + NOISE_MM * rng.standard_normal((21, 3))]
                )
            )
            for pose in random_poses(30, seed=9)
        ]
        assert sign * np.mean(odds) > 0.3 and np.mean(np.sign(odds) == sign) > 0.7
        assert np.abs(odds).max() <= 0.8
    mirrored = told_of([joints_of(relaxed()) * (-1.0, 1.0, 1.0)], right=1.0)
    assert abs(side_of(mirrored, 50)) < CLEAR_LOG_ODDS
