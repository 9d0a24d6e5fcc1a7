"""What is found out about a hand before a run: its side from what is seen, and nothing that was given."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posetrack_cli.hand.acquisition import Acquisition
from posetrack_cli.hand.calibration import before_run
from posetrack_cli.hand.calibration.before_run import MOST_ASKED, find_hand
from posetrack_cli.hand.calibration.calibrate import Calibration, CalibrationOptions
from posetrack_cli.hand.config import HandConfig
from posetrack_cli.hand.segmentation import Detection
from posetrack_cli.hand.shape import SHAPE_SIZE, HandShape
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.synthesis.hand.options import SynthOptions
from posetrack_cli.synthesis.hand.writing import write_synthetic

FRAMES = 24
HALF_A_STEP = 0.077  # 1.16^(1/2) - 1
FEW = HandConfig.model_validate({"acquisition": {"fitted": 16, "refined": 2, "scattered": 4}})
"""Half the hypotheses of a search: there is one hand, before an empty wall."""


@pytest.fixture(scope="module", params=["right", "left"])
def seen(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """A recording of a moving hand, and which it is."""
    path = tmp_path_factory.mktemp(request.param) / "hand.mcap"
    write_synthetic(SynthOptions(seed=7, frames=FRAMES, side=request.param), path)
    return request.param, path


def open_path(path: Path) -> Recording:
    return open_recording(path)


def with_hand(**values: object) -> HandConfig:
    return HandConfig.model_validate({"hand": values})


def test_the_side_is_that_of_the_hand_seen(seen: tuple[str, Path]) -> None:
    side, path = seen
    found = find_hand(open_path(path), FEW, start=0, seed=0)
    assert found.config.hand.side == side
    assert found.line == f"a {side} hand"
    rest = found.config.hand.model_copy(update={"side": "auto"})
    assert found.config.model_copy(update={"hand": rest}) == FEW
    if side == "left":  # found alike twice: costs of both sides are those of both sides
        assert find_hand(open_path(path), FEW, start=0, seed=0) == found


def test_a_side_that_is_given_stays(seen: tuple[str, Path]) -> None:
    side, path = seen
    other = "left" if side == "right" else "right"
    config = with_hand(side=other, scale=1.1)
    found = find_hand(open_path(path), config, start=0, seed=0)
    assert found.config == config and found.line == ""


def test_without_a_hand_a_right_one_is_expected_and_that_is_said(
    seen: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Acquisition, "detect", lambda *arguments: [])
    found = find_hand(open_path(seen[1]), HandConfig(), start=0, seed=0)
    assert found.config.hand.side == "right"
    assert "no hand" in found.line and "--hand-side" in found.line


def test_after_the_last_frame_nothing_is_looked_at(seen: tuple[str, Path]) -> None:
    found = find_hand(open_path(seen[1]), HandConfig(), start=10 * FRAMES, seed=0)
    assert found.config.hand.side == "right" and "no hand" in found.line


def say_costs(
    monkeypatch: pytest.MonkeyPatch, right: Sequence[float], left: Sequence[float]
) -> dict[str, Iterator[float]]:
    """Let frames cost as told, in order, for hands of either side."""
    told = {"right": iter(right), "left": iter(left)}

    def appraise(
        self: Acquisition, depth: object, places: list[Detection], others: object
    ) -> tuple[float, list[Detection]]:
        return next(told[self.observer.anatomy.side]), places

    monkeypatch.setattr(Acquisition, "appraise", appraise)
    monkeypatch.setattr(before_run, "ASKED_EVERY", 1)
    return told


def test_costs_that_hardly_differ_are_said_to_with_a_probability(
    seen: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """1.8 mm in all are two units of log odds: 1 / (1 + e^-2) = .88."""
    say_costs(monkeypatch, [5.0] * MOST_ASKED, [3.2] + [5.0] * (MOST_ASKED - 1))
    found = find_hand(open_path(seen[1]), with_hand(scale=1.0), start=0, seed=0)
    assert found.config.hand.side == "left"
    assert found.line == "a left hand, but hardly so (probability 0.88); --hand-side tells"


def test_frames_are_asked_until_they_agree_and_none_decides_alone(
    seen: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A first frame that errs, by however much, is outvoted by those after it."""
    right, left = [30.0, 5.0, 5.0, 5.0, 5.0], [5.0, 8.0, 8.0, 8.0, 8.0]
    told = say_costs(monkeypatch, [*right, 0.0], [*left, 50.0])
    found = find_hand(open_path(seen[1]), with_hand(scale=1.0), start=0, seed=0)
    assert found.config.hand.side == "right" and found.line == "a right hand"
    assert len(list(told["right"])) == 2  # three frames for it outweigh the first, and no more are asked


def test_a_hand_of_another_size_is_found_with_it(tmp_path: Path) -> None:
    """A hand three quarters as large as expected: its size to half a step between those tried.

    That a size that is told is not asked for the tests of told costs show: there are none for other sizes.
    """
    path = tmp_path / "small.mcap"
    write_synthetic(SynthOptions(seed=3, frames=FRAMES, side="right", scale=0.78), path)
    found = find_hand(open_path(path), FEW, start=0, seed=0)
    assert found.config.hand.side == "right"
    assert found.config.hand.scale == pytest.approx(0.78, rel=HALF_A_STEP)
    assert f"of scale {found.config.hand.scale:.2f}" in found.line
    told = FEW.model_copy(update={"hand": with_hand(side="right").hand})
    of_side = find_hand(open_path(path), told, start=0, seed=0)
    assert of_side.config.hand.scale == pytest.approx(0.78, rel=HALF_A_STEP)


def test_a_calibrated_hand_is_what_is_tracked(
    seen: tuple[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = HandShape.of_factors(1.0 + 0.01 * np.arange(SHAPE_SIZE))
    asked: list[CalibrationOptions] = []

    def calibrated(recording: Recording, config: HandConfig, options: CalibrationOptions, report: object):  # type: ignore[no-untyped-def]
        asked.append(options)
        return Calibration("left", shape, np.zeros(SHAPE_SIZE), 20, 9, 1.234)

    monkeypatch.setattr(before_run, "calibrate", calibrated)
    config = HandConfig.model_validate({"init": {"calibrate": True}, "hand": {"mesh": "file.glb"}})
    found = find_hand(open_path(seen[1]), config, start=3, seed=5)
    assert found.config.hand.side == "left" and found.config.hand.shape == shape
    assert found.config.hand.mesh == "file.glb"  # the factors are of that hand
    assert asked == [replace(CalibrationOptions(), side=None, seed=5, start=3)]
    assert "left" in found.line and "9 frames" in found.line and "1.23 mm" in found.line
