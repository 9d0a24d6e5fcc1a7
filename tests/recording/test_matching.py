"""Which images of several cameras become one frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.errors import RecordingError
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import StoredImage
from posetrack_cli.recording.matching import match_images

MS = 1_000_000


def image(stamp_ms: float) -> StoredImage:
    return StoredImage(round(stamp_ms * MS), f"{stamp_ms:g}", lambda: np.zeros((1, 1), np.uint8))


def matched(
    *cameras: Sequence[float], tolerance_ms: float = 10.0, losses: LossLog | None = None
) -> list[tuple[float | None, ...]]:
    """Stamps, ms, of each frame's images."""
    streams = [iter([image(stamp) for stamp in stamps]) for stamps in cameras]
    names = [f"c{number}" for number in range(len(cameras))]
    log = losses if losses is not None else LossLog()
    frames = list(match_images(names, streams, round(tolerance_ms * MS), log))
    for frame in frames:
        first = next(i for i in frame.images if i is not None)
        assert frame.stamp_ns == (frame.images[0] or first).stamp_ns or frame.images[0] is None
    return [tuple(i and i.stamp_ns / MS for i in frame.images) for frame in frames]


def test_images_within_the_tolerance_are_one_frame() -> None:
    assert matched([0, 33, 67], [2, 31, 69]) == [(0, 2), (33, 31), (67, 69)]


def test_a_camera_that_drops_out_has_none() -> None:
    assert matched([0, 33, 67], [0, 67]) == [(0, 0), (33, None), (67, 67)]
    assert matched([0, 67], [0, 33, 67]) == [(0, 0), (None, 33), (67, 67)]


def test_a_camera_that_ends_early_or_begins_late() -> None:
    assert matched([0, 33, 67], [0]) == [(0, 0), (33, None), (67, None)]
    assert matched([33, 67], [0, 33]) == [(None, 0), (33, 33), (67, None)]


def test_beyond_the_tolerance_images_stay_apart() -> None:
    assert matched([0, 33], [10, 44], tolerance_ms=10) == [(0, 10), (33, None), (None, 44)]


def test_a_fast_camera_s_drop_out_is_not_filled_with_its_neighbour() -> None:
    # 120 Hz: the next image is within the tolerance, too, but nearer to another
    assert matched([0, 16.5, 25], [0, 8.5, 16.5, 25]) == [(0, 0), (None, 8.5), (16.5, 16.5), (25, 25)]


def test_three_cameras() -> None:
    assert matched([0, 33], [1, 34], [3, 36]) == [(0, 1, 3), (33, 34, 36)]
    assert matched([0, 33], [1], [36]) == [(0, 1, None), (33, None, 36)]


def test_stamps_that_go_back_are_losses() -> None:
    losses = LossLog()
    assert matched([0, 33, 20, 67], [0, 33, 67], losses=losses) == [(0, 0), (33, 33), (67, 67)]
    assert [loss.count for loss in losses.losses] == [1]


def test_cameras_without_a_frame_in_common_are_an_error_that_tells_how_far_apart_they_are() -> None:
    with pytest.raises(
        RecordingError, match=r"no matching stamps for cameras c0, c1.*12 ms apart.*within 5 ms"
    ):
        matched([0, 33, 67], [12, 45, 79], tolerance_ms=5)


def test_without_an_end_it_is_told_after_some_frames() -> None:
    def endless(offset: int):  # type: ignore[no-untyped-def]
        stamp = offset
        while True:
            yield image(stamp)
            stamp += 100

    with pytest.raises(RecordingError, match="50 ms apart"):
        list(match_images(["a", "b"], [endless(0), endless(50)], 5 * MS, LossLog()))


@settings(deadline=None)
@given(st.data(), st.integers(2, 3), st.integers(1, 12))
def test_drop_outs_and_jitter_keep_every_image_at_its_instant(
    data: st.DataObject, cameras: int, count: int
) -> None:
    jitter = st.floats(-4.0, 4.0)
    present = [[data.draw(st.booleans()) for _ in range(cameras)] for _ in range(count)]
    present.append([True] * cameras)
    stamps = [[100.0 * (i + 1) + data.draw(jitter) for _ in range(cameras)] for i in range(count + 1)]
    streams = [[s[c] for s, p in zip(stamps, present, strict=True) if p[c]] for c in range(cameras)]
    expected = [
        tuple(round(s[c] * MS) / MS if p[c] else None for c in range(cameras))
        for s, p in zip(stamps, present, strict=True)
        if any(p)
    ]
    assert matched(*streams) == expected
