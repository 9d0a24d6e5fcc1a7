"""Right or left, once both hands have the shapes that fit them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from posetrack_cli.hand.autodetect import (
    CLEAR_LOG_ODDS,
    SIDES,
    SideAndScaleSearch,
    decide_side,
    side_log_odds,
)
from posetrack_cli.hand.model.anatomy import HandShape
from posetrack_cli.hand.shape_fit import Calibration
from support.calibrations import calibration_of


def told(log_odds: float, by_keypoints: float = 0.0) -> SideAndScaleSearch:
    """A trial of hands of scale 1 that told so much of a right one."""
    side = SIDES[0] if log_odds >= 0.0 else SIDES[1]
    sure = abs(log_odds) >= CLEAR_LOG_ODDS
    trial = SimpleNamespace(sides=SIDES, log_odds=log_odds, side=side, is_sure_of_side=sure)
    trial.keypoint_log_odds, trial.scale = by_keypoints, lambda side: 1.0
    return trial  # type: ignore[return-value]


def costing(side: str, cost_mm: float, begun_scale: float = 1.0) -> Calibration:
    return calibration_of(HandShape(), side, costs_mm=(9.0, cost_mm), begun_scale=begun_scale)


@pytest.mark.parametrize(("log_odds", "side"), [(4.5, "right"), (-9.0, "left"), (np.inf, "right")])
def test_a_side_that_is_certain_is_not_asked_again(log_odds: float, side: str) -> None:
    asked: list[str] = []

    def estimate(of: str) -> Calibration:
        asked.append(of)
        return costing(of, 1.0)

    decided = decide_side(told(log_odds), estimate)
    assert asked == [side] == [decided.side]
    assert decided.is_sure and decided.found is not None and decided.log_odds == abs(log_odds)


def test_the_hand_whose_shape_explains_more_is_the_likelier() -> None:
    """0.9 mm are one unit of log odds, and the frames count as four: -1 + 4 = 3."""
    costs = {"right": 6.0, "left": 6.9}
    decided = decide_side(told(-1.0), lambda side: costing(side, costs[side]))
    assert decided.side == "right" and decided.log_odds == pytest.approx(3.0)
    assert decided.probability == pytest.approx(1.0 / (1.0 + np.exp(-3.0))) and not decided.is_sure
    assert decided.found is not None and decided.found.side == "right"


def test_sides_are_compared_frame_by_frame() -> None:
    """The right hand's median is 2.7 mm lower, but in common frames it costs 0.3 mm more: about 4 / 3."""
    each = {"right": (4.3, 4.3, 4.3, 7.3, 7.3), "left": (4.0, 4.0, 4.0, 7.0, 7.0, 9.0, 9.0, 9.0, 9.0)}

    def estimate(side: str) -> Calibration:
        median = float(np.median(each[side]))
        return calibration_of(HandShape(), side, costs_mm=(9.0, median), each_mm=each[side])

    decided = decide_side(told(0.0), estimate)
    odds = [0.3 / 0.9] * 3 + [0.3 / 0.9 / (7.0 / 6.0)] * 2  # costs above the usual 6 mm mean less
    assert decided.side == "left" and decided.log_odds == pytest.approx(4.0 * np.mean(odds))


def test_of_hands_that_fit_alike_the_usual_one_is_the_likelier() -> None:
    def estimate(side: str) -> Calibration:
        return replace(costing(side, 4.0), unlikeliness=20.0 if side == "right" else 10.0)

    decided = decide_side(told(0.5), estimate)
    assert decided.side == "left" and decided.log_odds == pytest.approx(0.4 * 10.0 - 0.5)


def test_shapes_without_a_common_frame_leave_the_side_as_it_was() -> None:
    def estimate(side: str) -> Calibration:
        found = calibration_of(HandShape(), side, costs_mm=(9.0, 3.0 if side == "left" else 8.0))
        return replace(found, frame_costs={SIDES.index(side): 3.0})

    assert decide_side(told(1.5), estimate).log_odds == pytest.approx(1.5)


def test_both_sides_are_treated_alike() -> None:
    costs = {"right": 6.0, "left": 7.3}
    one = decide_side(told(0.7), lambda side: costing(side, costs[side]))
    other = decide_side(told(-0.7), lambda side: costing(side, 13.3 - costs[side]))
    assert (one.side, other.side) == ("right", "left")
    assert one.log_odds == pytest.approx(other.log_odds) and one.is_sure == other.is_sure


@pytest.mark.parametrize("missing", SIDES)
def test_a_side_without_a_shape_tells_nothing(missing: str) -> None:
    decided = decide_side(told(-2.0), lambda side: None if side == missing else costing(side, 1.0))
    assert decided.side == "left" and decided.log_odds == pytest.approx(2.0)
    assert (decided.found is None) == (missing == "left")


@pytest.mark.parametrize("log_odds", [9.0, 1.0, -1.0, -9.0])
def test_hands_of_another_size_than_was_tried_decide_the_side_anew(log_odds: float) -> None:
    """What frames told of the side by hands of a wrong size is forgotten: 4 (8 - 6.2) / 0.9 = 8 remain."""
    costs = {"right": 8.0, "left": 6.2}
    decided = decide_side(told(log_odds), lambda side: costing(side, costs[side], begun_scale=0.75))
    # hands that cost more than the usual 6 mm tell less
    assert decided.side == "left" and decided.log_odds == pytest.approx(8.0 / (6.2 / 6.0))
    by_keypoints = decide_side(told(log_odds, 9.0), lambda side: costing(side, costs[side], begun_scale=0.75))
    assert by_keypoints.side == "right" and by_keypoints.log_odds == pytest.approx(9.0 - 8.0 / (6.2 / 6.0))


@pytest.mark.parametrize("resized", SIDES)
def test_of_hands_of_another_size_one_that_explains_nothing_is_the_less_likely(resized: str) -> None:
    def estimate(side: str) -> Calibration | None:
        return costing(side, 6.0, begun_scale=0.75) if side == resized else None

    for log_odds in (-1.0, 1.0):
        decided = decide_side(told(log_odds), estimate)
        assert decided.side == resized and decided.found is not None and not decided.is_sure


@pytest.mark.parametrize(("cost", "other"), [(3.0, 4.5), (6.0, 7.0), (12.0, 14.0), (5.0, 30.0)])
def test_a_frame_tells_as_much_of_one_side_as_of_the_other(cost: float, other: float) -> None:
    assert side_log_odds(cost, other) == -side_log_odds(other, cost) > 0.0


def test_a_hand_that_is_unlike_the_average_tells_less_of_its_side_in_a_frame() -> None:
    """Of the Kinect's hand, at 11 to 17 mm, single frames are 5 mm cheaper for the wrong side."""
    usual, strange = side_log_odds(6.0, 7.5), side_log_odds(12.0, 13.5)
    assert usual == pytest.approx(2.0 * strange)
    assert side_log_odds(12.0, 40.0) == pytest.approx(0.5 * side_log_odds(6.0, 40.0))
    assert side_log_odds(1.0, 2.5) == pytest.approx(usual)
