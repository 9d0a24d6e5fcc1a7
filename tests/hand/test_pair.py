"""Two hands in one recording: what each explains, who is who after a crossing, and their common shape."""

from __future__ import annotations

import filecmp
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.errors import UsageError
from posetrack_cli.hand.autodetect import detect_hand
from posetrack_cli.hand.both import PairFinder, PairFrame, common_side
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.fit.skeleton import NO_INNER
from posetrack_cli.hand.model.anatomy import HandShape, PopulationSpace
from posetrack_cli.hand.model.kinematics import joint_positions, mirrored_poses
from posetrack_cli.hand.observe.others import HandDrawer, SeenHand, without_others
from posetrack_cli.hand.run import HandRun, RunOptions
from posetrack_cli.hand.search import ACCEPT_MM, Candidate, cheapest_pair, lead_of
from posetrack_cli.hand.shape_fit import combined, read_shape
from posetrack_cli.hand.tracker import FIRST_STEP_NS
from posetrack_cli.recording.base import Frame
from posetrack_cli.rendering.port import RenderingDevice
from posetrack_cli.results import read_result
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.topics import FILTERED, SMOOTHED, estimate_topic
from support.calibrations import calibration_of
from support.flat_recording import after
from support.hand import KINECT
from support.hand_scene import HANDS, WALL_MM, Drawn, Stage, relaxed

FRAMES, FEW = 24, 12
BOTH = HandConfig.model_validate(
    {"hand": {"count": "2"}, "init": {"shape": "given"}, "output": {"flush_frames": 5, "mesh": "none"}}
)
NEAR_MM, FAR_MM = 600.0, 720.0
FIT_MM = 8.0
"""Mean joint error of a clearly visible hand of known shape with noise of 3 mm: measured 2 to 4 mm."""
GOOD_MM = 2.5
"""Cost of good fits to noise of 3 mm."""
SWAPPED_BACK = 6
"""Frames until identities are right: the search after four frames of doubt, and a refit."""
WRONG_MM = 20.0
"""Mean joint error beyond which an estimate must not be tracked."""


def crossing(t: float, reach: float = 110.0) -> tuple[FloatArray, FloatArray]:
    """Poses (22,) of the right hand, in front, and of the left one at a time from 0 to 1."""
    x = reach * np.cos(np.pi * t)
    left = mirrored_poses(relaxed(x=x, z=FAR_MM)[None])[0]
    return relaxed(x=x, z=NEAR_MM), left


def seen(device: RenderingDevice, poses: Sequence[tuple[FloatArray, FloatArray]]) -> Drawn:
    """What a sensor with noise of 3 mm sees of a right and a left hand."""
    right, left = Stage(device, HANDS["right"]), Stage(device, HANDS["left"])
    rng = np.random.default_rng(4)
    depths = (np.minimum(right.depth(a), left.depth(b)) for a, b in poses)
    return Drawn(tuple((one + rng.normal(0.0, 3.0, one.shape)).astype(np.float32) for one in depths))


@pytest.fixture(scope="module")
def poses() -> list[tuple[FloatArray, FloatArray]]:
    return [crossing(t) for t in np.linspace(0.0, 1.0, FRAMES)]


@pytest.fixture(scope="module")
def recording(device: RenderingDevice, poses: list[tuple[FloatArray, FloatArray]]) -> Drawn:
    return seen(device, poses)


def joints(side: str, pose: FloatArray) -> FloatArray:
    return joint_positions(HANDS[side].anatomy, pose[None])[0]


def columns(path: Path, label: str, track: str = FILTERED) -> Columns:
    """Estimates of one of the hands."""
    result = read_result(path).of(label)
    return result.columns(estimate_topic(result.subject.topic, track))


def errors(path: Path, label: str, side: str, poses: Sequence[FloatArray]) -> FloatArray:
    """Mean joint error (F,) of a track, mm."""
    found = columns(path, label)["points"]
    return np.array(
        [
            np.linalg.norm(one - joints(side, pose), axis=1).mean()
            for one, pose in zip(found, poses, strict=True)
        ]
    )


def test_a_reading_belongs_to_the_hand_whose_surface_is_nearest(device: RenderingDevice) -> None:
    right, left = Stage(device, HANDS["right"]), Stage(device, HANDS["left"])
    a, b = crossing(0.46)
    near, far = right.depth(a), left.depth(b)
    both: Float32Array = np.minimum(near, far)
    of_right, of_left = (near < WALL_MM) & (near <= far), (far < WALL_MM) & (far < near)
    assert of_left.any() and of_right.any() and ((near < WALL_MM) & (far < WALL_MM)).any()
    hands = {
        side: SeenHand(HandDrawer(device, HANDS[side], KINECT), pose, NO_INNER)
        for side, pose in (("right", a), ("left", b))
    }
    masked = without_others(both, hands["right"], [hands["left"]], KINECT)
    # readings at outlines may count for either hand
    assert np.mean(masked[of_left] < 0.0) > 0.93 and np.mean(masked[of_right] < 0.0) < 0.01
    assert np.all(masked[both == WALL_MM] > 0.0) and np.array_equal(np.abs(masked), both)
    unsure = without_others(both, replace(hands["right"], is_sure=False), [hands["left"]], KINECT)
    assert np.count_nonzero(unsure < 0.0) >= np.count_nonzero(masked < 0.0)
    assert without_others(both, hands["right"], [], KINECT) is both


def test_crossing_hands_keep_their_identity(
    device: RenderingDevice, recording: Drawn, poses: list[tuple[FloatArray, FloatArray]], tmp_path: Path
) -> None:
    out = tmp_path / "r.mcap"
    HandRun(recording, BOTH, RunOptions(out), device).track(lambda estimate: None)
    assert read_result(out).labels == ("right", "left")
    rights, lefts = ([pair[k] for pair in poses] for k in (0, 1))
    assert errors(out, "right", "right", rights).max() < FIT_MM
    left = errors(out, "left", "left", lefts)
    lost = columns(out, "left")["status"] == "lost"
    assert left[[0, 1, 2, -3, -2, -1]].max() < FIT_MM and not lost[-3:].any()
    assert np.all(lost | (left < WRONG_MM))


def test_trackers_on_each_others_hands_exchange_them(
    device: RenderingDevice, recording: Drawn, poses: list[tuple[FloatArray, FloatArray]], tmp_path: Path
) -> None:
    """A right hand's model fits a left hand from its back, so both doubt where they are."""
    known = BOTH.status.model_copy(update={"baseline_cost_mm": GOOD_MM})
    config = BOTH.model_copy(update={"status": known})
    tracker = HandRun(recording, config, RunOptions(tmp_path / "r.mcap"), device).tracker
    rng, frame = np.random.default_rng(0), next(recording.frames(start=0, end=None))
    start = tracker.start_unknown(poses[0][0], frame, rng)
    right, left = poses[0]
    swapped = (tracker.trackers[k].start(pose, -FIRST_STEP_NS, rng) for k, pose in enumerate((left, right)))
    state = replace(start, hands=tuple(swapped))
    for k in range(SWAPPED_BACK):
        state, _ = tracker.step(state, replace(frame, index=k, stamp_ns=k * FIRST_STEP_NS), rng)
    for hand, side, pose in zip(state.hands, ("right", "left"), poses[0], strict=True):
        assert np.linalg.norm(joints(side, hand.pose) - joints(side, pose), axis=1).mean() < FIT_MM


def test_sides_are_compared_after_hands_met(
    device: RenderingDevice, recording: Drawn, poses: list[tuple[FloatArray, FloatArray]], tmp_path: Path
) -> None:
    """Also of trackers that are sure: without another frame, these do not know what good fits cost."""
    tracker = HandRun(recording, BOTH, RunOptions(tmp_path / "r.mcap"), device).tracker
    rng, frame = np.random.default_rng(0), next(recording.frames(start=0, end=None))
    start = tracker.start_unknown(poses[0][0], frame, rng)
    right, left = poses[0]
    swapped = (tracker.trackers[k].start(pose, -FIRST_STEP_NS, rng) for k, pose in enumerate((left, right)))
    state = replace(start, hands=tuple(swapped), compare_in=1)
    state, _ = tracker.step(state, frame, rng)
    for hand, side, pose in zip(state.hands, ("right", "left"), poses[0], strict=True):
        assert np.linalg.norm(joints(side, hand.pose) - joints(side, pose), axis=1).mean() < FIT_MM


def test_a_pair_leads_by_what_exchanged_hands_cost_more() -> None:
    def at(x: float, cost: float) -> Candidate:
        return Candidate(relaxed(x=x, z=NEAR_MM), cost, cost)

    rights, lefts = [at(-200.0, 3.0), at(200.0, 6.0)], [at(-190.0, 7.0), at(210.0, 4.0)]
    assert lead_of((rights[0], lefts[1]), rights, lefts) == (6.0 + 7.0) - (3.0 + 4.0)
    assert lead_of((rights[0], None), rights, lefts) == 7.0 - 3.0
    assert lead_of((rights[0], None), rights, lefts[1:]) == ACCEPT_MM - 3.0


def test_a_hand_and_its_elbow_are_no_pair() -> None:
    """They lie on one line, each at the end of the other's forearm."""

    def at(y: float, arm: float) -> Candidate:
        return Candidate(relaxed(y=y, z=NEAR_MM), 3.0, 3.0, np.array([0.0, arm, 0.0, 0.0, 0.0, 0.0]))

    hand, elbow, below = at(-50.0, 1.0), at(50.0, -1.0), at(50.0, 1.0)
    assert cheapest_pair([hand], [elbow]) in {(hand, None), (None, elbow)}
    assert cheapest_pair([hand], [below]) == (hand, below)


def test_either_hand_is_tried_at_a_place_of_the_other(
    device: RenderingDevice, recording: Drawn, poses: list[tuple[FloatArray, FloatArray]], tmp_path: Path
) -> None:
    tracker = HandRun(recording, BOTH, RunOptions(tmp_path / "r.mcap"), device).tracker
    depth, (pose, _) = next(recording.frames(start=0, end=None)).depth, poses[0]
    right, left = tracker.trackers
    known = Candidate(pose, GOOD_MM, GOOD_MM + 1.0)
    assert (other := left.lookalike(depth, known)) is not None
    assert (again := right.lookalike(depth, other)) is not None
    assert np.linalg.norm(joints("right", again.pose) - joints("right", pose), axis=1).mean() < FIT_MM
    assert other.cost > again.cost and again.total_cost == pytest.approx(again.cost + 1.0)


def test_one_of_two_hands_is_followed_through_a_crossing(
    device: RenderingDevice, recording: Drawn, poses: list[tuple[FloatArray, FloatArray]], tmp_path: Path
) -> None:
    config = BOTH.model_copy(update={"hand": BOTH.hand.model_copy(update={"count": "1", "side": "left"})})
    found = detect_hand(recording, config, 0)
    assert found.config.hand.count == "1 of 2"
    out = tmp_path / "r.mcap"
    HandRun(recording, found.config, RunOptions(out), device).track(lambda estimate: None)
    assert read_result(out).labels == ("",)
    left = errors(out, "", "left", [pair[1] for pair in poses])
    assert left[[0, -1]].max() < FIT_MM


def test_an_interrupted_run_of_two_hands_goes_on_as_if_it_had_not_been(
    device: RenderingDevice, recording: Drawn, tmp_path: Path
) -> None:
    whole, parts = tmp_path / "whole.mcap", tmp_path / "parts.mcap"
    for out, stop, resume in ((whole, FEW + 1, False), (parts, 7, False), (parts, FEW + 1, True)):
        options = RunOptions(out, smooth=True, resume=resume, end=FEW)
        HandRun(recording, BOTH, options, device).track(lambda estimate: None, after(stop))
    assert filecmp.cmp(whole, parts, shallow=False)
    smoothed = columns(whole, "left", SMOOTHED)
    assert len(smoothed["stamp_ns"]) == FEW


def test_two_hands_are_counted_and_one_before_a_wall_is_not_two(
    device: RenderingDevice, recording: Drawn, poses: list[tuple[FloatArray, FloatArray]]
) -> None:
    one = Drawn.of(Stage(device, HANDS["right"]), [pair[0] for pair in poses[::6]])
    assert PairFinder(recording, HandConfig(), 1.0, 0).shows_two
    assert not PairFinder(one, HandConfig(), 1.0, 0).shows_two


@pytest.mark.parametrize(("seen_in", "frames", "shows_two"), [(1, 16, False), (2, 16, True), (1, 1, True)])
def test_one_frame_of_several_is_not_enough_for_a_second_hand(
    monkeypatch: pytest.MonkeyPatch, seen_in: int, frames: int, shows_two: bool
) -> None:
    """Part of a body may look like a hand once."""
    wrist, leads = np.zeros(3), (0.0, 0.0)

    def pair_in(finder: PairFinder, frame: Frame, limit_mm: float) -> PairFrame:
        return PairFrame(frame, (wrist, wrist if frame.index < seen_in else None), leads)

    monkeypatch.setattr(PairFinder, "_pair_in", pair_in)
    depth = np.zeros((KINECT.height, KINECT.width), np.float32)
    recording = Drawn((depth,) * frames)
    assert PairFinder(recording, HandConfig(), 1.0, 0).shows_two is shows_two


def test_two_people_show_hands_of_one_side(recording: Drawn) -> None:
    """At the other hand's place, too, this side costs less."""
    frame, at = next(recording.frames(start=0, end=None)), np.zeros(3)

    def side_of(*leads: tuple[float, float]) -> str | None:
        return common_side([PairFrame(frame, (at, at), one) for one in leads])

    assert side_of((5.0, 2.0), (1.0, 3.0), (-1.0, 2.0)) is None
    assert side_of((5.0, -2.0), (2.0, -2.0)) == "right" and side_of((-9.0, 5.0), (-1.0, 1.0)) == "left"
    assert side_of((3.0, -9.0)) is None and side_of() is None  # one frame may be wrong
    assert common_side([PairFrame(frame, (at, None), (2.0, -9.0))] * 9) is None


def test_a_configured_shape_of_two_hands_stays(recording: Drawn) -> None:
    hand = {"count": "auto", "finger_lengths": (1.0, 1.05, 1.0, 1.0, 1.0)}
    found = detect_hand(recording, HandConfig.model_validate({"hand": hand}), 0).config.hand
    assert found.count == "2" and found.finger_lengths == hand["finger_lengths"]
    assert found.coefficients == () and found.padding_mm == 0.0


@pytest.mark.parametrize(("count", "kept"), [("1", "left"), ("2", "auto")])
def test_a_shape_from_a_result_says_nothing_of_how_many_hands(
    device: RenderingDevice, recording: Drawn, tmp_path: Path, count: str, kept: str
) -> None:
    """Nor, of both, which one."""
    hand, status = {"count": count, "side": "left", "scale": 0.9}, {"baseline_cost_mm": GOOD_MM}
    config = HandConfig.model_validate(BOTH.model_dump() | {"hand": hand, "status": status})
    HandRun(recording, config, RunOptions(tmp_path / "r.mcap", end=1), device).track(lambda estimate: None)
    named = dict(one.split("=", 1) for one in read_shape(tmp_path / "r.mcap").assignments)
    assert named["hand.scale"] == "0.9" and "hand.count" not in named
    assert named["status.baseline_cost_mm"] == str(GOOD_MM)  # what good fits of this shape cost
    assert named.get("hand.side", '"auto"') == f'"{kept}"'


def test_a_filter_that_fits_no_frames_refuses_two_hands(recording: Drawn) -> None:
    config = HandConfig.model_validate({"hand": {"count": "2"}, "filter": {"kind": "pso"}})
    with pytest.raises(UsageError, match="two hands cannot be tracked"):
        detect_hand(recording, config, 0)


def test_the_shape_of_both_hands_is_the_product_of_what_each_shows() -> None:
    """With equal precision k^-2 / s^2 of both and a prior 1 / s^2: mean weights 1 / (2 - k^2)."""
    space, share = PopulationSpace(), 0.2
    first, second = (
        calibration_of(HandShape(scale, coefficients=(c,)), known=share)
        for scale, c in ((1.0, 0.4), (1.1, -0.2))
    )
    both = combined(first, second, None)
    weight = 1.0 / (2.0 - share**2)
    expected = weight * (space.theta(first.shape) + space.theta(second.shape))
    np.testing.assert_allclose(space.theta(both.shape), expected, atol=1e-12)
    np.testing.assert_allclose(np.diag(both.covariance), share**2 * weight * space.sd**2, rtol=1e-9)
    assert both.measured.sd["hand_length"] < first.measured.sd["hand_length"]
