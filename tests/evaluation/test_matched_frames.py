"""Which frames of a recording belong to which estimates, and how little is read for it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from posetrack_cli.evaluation.reading.tracks import matched_frames
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import StoredFrame, StoredImage, UnreadableImageError


class Recorded:
    """A recording in memory: frame i shows the depth i, its stamp is 100 i; notes what is decoded."""

    path = Path("recorded")

    def __init__(self, count: int, damaged: int = -1) -> None:
        self.count, self.damaged = count, damaged
        self.decoded: list[int] = []
        self.passed = 0

    def stored_frames(self, losses: LossLog, **_: Any) -> Iterator[tuple[int, StoredFrame]]:
        for index in range(self.count):
            self.passed = index
            image = StoredImage(100 * index, "", lambda i=index: self._depth(i))
            yield index, StoredFrame(100 * index, "", (image,))

    def _depth(self, index: int) -> np.ndarray:
        self.decoded.append(index)
        if index == self.damaged:
            raise UnreadableImageError("image cannot be decoded")
        return np.full((2, 2), index, dtype=np.float32)


def matched(
    recording: Recorded, stamps: list[int], numbers: list[int] | None = None
) -> tuple[list[tuple[int, int]], LossLog]:
    """(position, depth shown) of every frame, and the losses."""
    losses = LossLog()
    frame_index = None if numbers is None else np.array(numbers)
    frames = matched_frames(recording, np.array(stamps, dtype=np.int64), frame_index, losses)
    return [(position, int(frame.depth[0, 0])) for position, frame in frames], losses


def test_frames_are_matched_by_their_stamps_and_only_they_are_decoded() -> None:
    recording = Recorded(1000)
    pairs, losses = matched(recording, [200, 500, 900])
    assert pairs == [(0, 2), (1, 5), (2, 9)]
    assert recording.decoded == [2, 5, 9] and recording.passed <= 10, "nothing beyond the last is read"
    assert not losses.losses


def test_positions_are_those_of_the_estimates_and_frames_come_in_the_recording_s_order() -> None:
    assert matched(Recorded(10), [700, 100])[0] == [(1, 1), (0, 7)]


def test_numbers_serve_where_no_stamp_agrees() -> None:
    pairs, losses = matched(Recorded(10), [33, 66, 99], [1, 2, 3])
    assert pairs == [(0, 1), (1, 2), (2, 3)] and not losses.losses


def test_numbers_do_not_serve_where_a_stamp_agrees() -> None:
    pairs, losses = matched(Recorded(10), [300, 366], [1, 2])
    assert pairs == [(0, 3)], "366 is not in the recording, and its number would be another frame's"
    assert [(loss.count, loss.what) for loss in losses.losses] == [
        (1, "estimates without a frame in the recording")
    ]


def test_an_image_that_cannot_be_decoded_is_one_loss() -> None:
    pairs, losses = matched(Recorded(10, damaged=2), [100, 200, 300])
    assert pairs == [(0, 1), (2, 3)]
    assert [(loss.what, loss.count) for loss in losses.losses] == [
        ("image skipped, image cannot be decoded", 1)
    ]


def test_estimates_beyond_the_recording_s_end_are_lost() -> None:
    pairs, losses = matched(Recorded(3), [0, 200, 400, 600])
    assert pairs == [(0, 0), (1, 2)]
    assert losses.losses[0].count == 2


@pytest.mark.parametrize("count", [0, 5])
def test_without_estimates_nothing_is_read(count: int) -> None:
    recording = Recorded(count)
    pairs, losses = matched(recording, [], [])
    assert pairs == [] and recording.decoded == [] and not losses.losses


def test_whoever_stops_early_stops_the_reading() -> None:
    recording = Recorded(100_000)
    frames = matched_frames(recording, np.arange(0, 10_000_000, 100), None, LossLog())
    with closing(frames):
        next(frames)
    assert len(recording.decoded) < 20
