"""One clock for a topic: resets, images without a stamp, and everything else as it is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.losses import LossLog
from posetrack_cli.recording.opening import open_recording
from posetrack_cli.recording.timeline import AHEAD, BACK_INTERVALS, Clock, Shifts, Timed
from posetrack_cli.units import NS_PER_S

PERIOD_NS = 33_000_000
EPOCH_NS = 1_700_000_000 * NS_PER_S


def stamped(
    own: list[int], log: list[int] | None = None, shifts: Shifts | None = None
) -> tuple[list[int], Any]:
    """Stamps that images get, and notes; log times are those of a computer's clock if not given."""
    losses = LossLog()
    log = log or [EPOCH_NS + k * PERIOD_NS for k in range(len(own))]
    images = [Timed(k, stamp, at) for k, (stamp, at) in enumerate(zip(own, log, strict=True))]
    found = list(Clock[int]("/image", losses, shifts).stamped(images))
    assert [item for item, _ in found] == list(range(len(own)))
    return [stamp for _, stamp in found], losses.notes


@given(st.lists(st.integers(1, NS_PER_S), min_size=1, max_size=40))
def test_stamps_that_increase_stay(steps: list[int]) -> None:
    own = np.cumsum(steps).tolist()
    assert stamped(own) == (own, ())


@given(st.integers(5, 40), st.integers(0, 30), st.integers(1, BACK_INTERVALS - 1))
def test_a_late_image_stays_late(count: int, place: int, by: int) -> None:
    """It is less late than a reset, or what follows does not go on from it; matching drops it."""
    own = [EPOCH_NS + k * PERIOD_NS for k in range(count)]
    place = min(place, count - 1)
    own.insert(place + 1, own[max(place - by, 0)])
    assert stamped(own) == (own, ())
    own[place + 1] = own[place] - min(2 * NS_PER_S, own[place] - 1)
    if place + 2 < len(own):
        assert stamped(own) == (own, ())


@given(st.integers(12, 40), st.integers(AHEAD + 1, 40), st.integers(0, 5 * NS_PER_S))
def test_all_images_are_kept_where_a_clock_is_reset(before: int, after: int, start: int) -> None:
    """Log times tell how much later the first image after the reset was taken."""
    first = [9 * NS_PER_S + k * PERIOD_NS for k in range(before)]
    second = [start + 1 + k * PERIOD_NS for k in range(after)]
    pause = 7 * PERIOD_NS
    log = [EPOCH_NS + k * PERIOD_NS + (k >= before) * pause for k in range(before + after)]
    found, notes = stamped(first + second, log)
    begin = 9 * NS_PER_S
    assert found == [begin + at - EPOCH_NS for at in log] or second[0] > first[-1]
    assert (np.diff(found) > 0).all()
    if second[0] <= first[-1] - NS_PER_S:
        assert len(notes) == 1 and "was reset, back by" in notes[0]


def test_a_clock_that_is_set_forward_by_years() -> None:
    """A camera that starts in 1970 and learns the time while it records."""
    own = [k * PERIOD_NS + NS_PER_S for k in range(5)] + [EPOCH_NS + k * PERIOD_NS for k in range(5, 10)]
    found, notes = stamped(own)
    assert found == [k * PERIOD_NS + NS_PER_S for k in range(10)]
    forward = f"forward by {(EPOCH_NS - NS_PER_S) / NS_PER_S:.3g} s"
    assert notes == (f"clock of /image was set, {forward}: stamps continued by log times",)


def test_a_pause_that_both_clocks_have_is_a_pause() -> None:
    own = [0 * PERIOD_NS + 1, PERIOD_NS, PERIOD_NS + 7200 * NS_PER_S]
    log = [EPOCH_NS, EPOCH_NS + PERIOD_NS, EPOCH_NS + PERIOD_NS + 7200 * NS_PER_S]
    assert stamped(own, log) == (own, ())


def test_one_stamp_of_the_future_costs_no_image() -> None:
    own = [NS_PER_S + k * PERIOD_NS for k in range(9)]
    right = list(own)
    own[4] = EPOCH_NS
    found, _ = stamped(own)
    assert found == right


def test_images_without_a_stamp() -> None:
    counted = [NS_PER_S + k * PERIOD_NS for k in range(6)]
    log = [EPOCH_NS + k * PERIOD_NS for k in range(6)]
    assert stamped([0, 0, *counted[2:]])[0] == counted, (
        "the first ones, of a camera that counts from its start"
    )
    assert stamped([*counted[:3], 0, *counted[4:]])[0] == counted, "one between"
    assert stamped([0] * 6) == (log, ()), "all of them"
    assert stamped([0, *log[1:]]) == (log, ()), "of a camera on the computer's clock"


def test_two_cameras_whose_clocks_are_reset_together_stay_together() -> None:
    """Each shift is measured by log times, which differ by what a bus delays."""
    shifts = Shifts()
    own = [9 * NS_PER_S + k * PERIOD_NS for k in range(12)] + [1 + k * PERIOD_NS for k in range(12)]
    log = [EPOCH_NS + k * PERIOD_NS for k in range(24)]
    late = [at + 4_000_000 * (k >= 12) for k, at in enumerate(log)]
    assert stamped(own, log, shifts)[0] == stamped(own, late, shifts)[0]


def test_what_cannot_be_used_keeps_its_place() -> None:
    images = [Timed("a", 5, 5), Timed(None, -1, 6), Timed("b", 7, 7)]
    assert list(Clock[str | None]("/image", LossLog()).stamped(images)) == [("a", 5), (None, -1), ("b", 7)]


# Through files


def test_a_recording_keeps_all_images_through_a_reset(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(10)
    frames: list[Any] = [("/cam/info", "CameraInfo", 1, EPOCH_NS - 1, make.calibration_fields(upper=False))]
    for k, image in enumerate(images):
        own = 8 * NS_PER_S + k * PERIOD_NS if k < 5 else 1 + (k - 5) * PERIOD_NS
        frames.append(("/cam/image", "Image", own, EPOCH_NS + k * PERIOD_NS, make.raw_fields(image, "16UC1")))
    recording = open_recording(make.write_ros2(tmp_path / "r.mcap", frames))
    found = list(recording.frames())
    assert [frame.stamp_ns for frame in found] == [8 * NS_PER_S + k * PERIOD_NS for k in range(10)]
    assert recording.losses == () and len(recording.notes) == 1


def test_images_of_another_camera_on_the_topic_are_left_out(tmp_path: Path, make: SimpleNamespace) -> None:
    images = make.depth_codes(6)
    frames: list[Any] = []
    for k, image in enumerate(images):
        frame = {"frame_id": ("left", "right")[k % 2]}
        k_left = make.calibration_fields(upper=False)
        k_right = k_left | {"k": [60.0, 0, 12.0, 0, 61.0, 8.0, 0, 0, 1.0]}
        own = make.START_NS + k * PERIOD_NS
        frames.append(("/cam/info", "CameraInfo", own, own - 9, (k_left, k_right)[k % 2] | frame))
        frames.append(("/cam/image", "Image", own, own, make.raw_fields(image, "16UC1") | frame))
    recording = open_recording(make.write_ros2(tmp_path / "r.mcap", frames))
    found = list(recording.frames())
    assert [frame.index for frame in found] == [0, 2, 4]
    for frame in found:
        np.testing.assert_array_equal(frame.depth, images[frame.index])
    (loss,) = recording.losses
    assert loss.count == 3 and "also carries images of frame 'right'" in loss.what
    assert recording.notes == () and recording.cameras[0].fx == 30.0
    frames[0] = (*frames[2][:4], frames[2][4])  # the first calibration is the other camera's
    recording = open_recording(make.write_ros2(tmp_path / "other.mcap", frames))
    assert recording.cameras[0].fx == 30.0
