"""Agreement with the images: against noise that is known, and against pixels counted one by one."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.errors import ResultError
from posetrack_cli.evaluation.measuring.evaluation import Statistics, Value, statistics
from posetrack_cli.evaluation.measuring.image_consistency import (
    image_consistency,
    region_overlap,
    residual_mm,
)
from posetrack_cli.evaluation.viewing.drawing import Shown
from posetrack_cli.evaluation.viewing.hand_drawing import HandDrawer
from posetrack_cli.hand.model.hand import average_hand
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.recording import Recording
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums, sums_in_numpy
from posetrack_cli.results import ResultWriter, Subject, read_result
from posetrack_cli.synthesis.hand.options import Switches
from support.viewing import lost_from, make_recording, make_result, moved, truth_of

FRAMES = 5
NOISE_MM = 1.0
"""Standard deviation of a reading at 0.65 m (``noise_sd``); its mean absolute value is sqrt(2 / pi) of it."""
QUANTUM_MM = 1.0
HAND_DEEP_MM = 300.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Everything that a real recording has."""
    return open_recording(make_recording(tmp_path_factory.mktemp("scene") / "scene.mcap", FRAMES))


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A hand before a wall: every pixel has an exact reading, of the one or of the other."""
    path = tmp_path_factory.mktemp("bare") / "bare.mcap"
    return open_recording(make_recording(path, FRAMES, switches=Switches(background=True)))


def measured(tmp_path: Path, recording: Recording, *changes: Any, **options: Any) -> dict[str, Value]:
    found = image_consistency(
        read_result(make_result(tmp_path / "r.mcap", recording, *changes, **options)), recording
    )
    return {name: statistics(values[~np.isnan(values)]) for name, values in found.items()}


def statistics_of(values: dict[str, Value], name: str) -> Statistics:
    value = values[name]
    assert isinstance(value, Statistics)
    return value


def test_the_truth_agrees_to_within_the_sensor_s_noise(tmp_path: Path, scene: Recording) -> None:
    values = measured(tmp_path, scene)
    residual, overlap = (statistics_of(values, name) for name in ("residual_mm", "region_overlap"))
    expected = np.hypot(NOISE_MM, QUANTUM_MM / np.sqrt(12)) * np.sqrt(2 / np.pi)
    assert residual.count == overlap.count == FRAMES
    assert residual.mean == pytest.approx(expected, rel=0.15), "the noise grows towards the corners"
    assert overlap.mean > 0.98 and overlap.max <= 1.0


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (12.0, 0.0, 0.0), (-25.0, 8.0, 0.0), (0.0, 0.0, 15.0)])
def test_shifted_hands_against_pixels_counted_one_by_one(
    tmp_path: Path, bare: Recording, device: RenderingDevice, shift: tuple[float, float, float]
) -> None:
    """Overlap and residual over the whole image in numpy: the hand is what is not the wall."""
    values = measured(tmp_path, bare, moved(*shift))
    drawer = HandDrawer(device, average_hand())
    overlaps, residuals = [], []
    for truth, frame in zip(truth_of(bare), bare.frames(), strict=True):
        depth = drawer.depth(bare.cameras[0], Shown(truth.position + shift, truth.quaternion, truth.shape))
        assert depth is not None
        rendered, observed = depth > 0, frame.depth < truth.position[2] + HAND_DEEP_MM
        overlaps.append((rendered & observed).sum() / (rendered | observed).sum())
        residuals.append(np.abs(depth - frame.depth)[rendered & observed].mean())
    # the measure drops the last millimetre of the wrist: up to one row of pixels of some 70 rows
    assert statistics_of(values, "region_overlap").mean == pytest.approx(np.mean(overlaps), abs=0.02)
    assert statistics_of(values, "residual_mm").mean == pytest.approx(np.mean(residuals), abs=0.1)
    if shift[0]:
        assert np.mean(overlaps) < 0.8


def test_further_from_the_hand_the_overlap_falls(tmp_path: Path, scene: Recording) -> None:
    overlaps = [
        statistics_of(measured(tmp_path, scene, moved(x)), "region_overlap").mean
        for x in (0.0, 5.0, 20.0, 60.0)
    ]
    assert all(after < before for before, after in pairwise(overlaps))


def test_a_hand_where_nothing_is_has_overlap_zero_and_no_residual(tmp_path: Path, bare: Recording) -> None:
    values = measured(tmp_path, bare, moved(5000.0))
    assert statistics_of(values, "region_overlap").mean == 0.0
    assert statistics_of(values, "region_overlap").count == FRAMES
    assert statistics_of(values, "residual_mm").count == 0


def test_lost_frames_count(tmp_path: Path, bare: Recording) -> None:
    assert statistics_of(measured(tmp_path, bare, lost_from(1)), "region_overlap").count == FRAMES


def test_a_left_hand_is_measured_as_one(tmp_path: Path) -> None:
    recording = open_recording(make_recording(tmp_path / "left.mcap", 3, side="left"))
    right = measured(tmp_path, recording, side="right")
    left = measured(tmp_path, recording, side="left")
    overlaps = [statistics_of(values, "region_overlap").mean for values in (right, left)]
    assert overlaps[1] > 0.98 and overlaps[0] < 0.9


def test_a_recording_with_none_of_the_frames_gives_nothing(tmp_path: Path, bare: Recording) -> None:
    class Empty:
        path, cameras = bare.path, bare.cameras

        def stored_frames(self, *_: Any, **__: Any) -> Iterator[Any]:
            return iter(())

    result = read_result(make_result(tmp_path / "r.mcap", bare))
    assert image_consistency(result, Empty()) == {}


def test_other_subjects_are_refused(tmp_path: Path, bare: Recording) -> None:
    subject = Subject("head", "camera", (), ("nose",), (-1,))
    with ResultWriter(tmp_path / "r.mcap", subject, bare.cameras[0], {"tracker": "head"}) as writer:
        writer.finish({})
    with pytest.raises(ResultError, match="no hand configuration"):
        image_consistency(read_result(tmp_path / "r.mcap"), bare)


def test_sums_by_hand() -> None:
    """Rendered 2 x 3 pixels of 600 mm; observed 1: 590, 2: 640, 1 other, 1 unread inside, 1 hand beside."""
    rendered = np.array([[[600, 600, 600, 600, 600, 0]]], np.float32)
    observed = np.array([[590, 640, 640, -900, 0, 650]], np.float32)
    sums = sums_in_numpy(rendered, Comparison(observed, 1e6))
    assert residual_mm(sums) == pytest.approx((10 + 40 + 40) / 3)
    assert region_overlap(sums) == pytest.approx(3 / 5), "3 both, 1 rendered only, 1 observed only"


def test_nothing_at_all_is_no_agreement() -> None:
    zero = np.zeros(1)
    nothing = TileSums(zero, zero, zero, zero, zero, zero, zero, zero, 0.0)
    assert region_overlap(nothing) == 0.0 and np.isnan(residual_mm(nothing))
