"""The smoothed track beside the filtered one: what is written, what is read, what stays the same."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from posetrack_cli.errors import ResultError
from posetrack_cli.outputs import part_path
from posetrack_cli.results import Estimate, ResultWriter, read_result
from posetrack_cli.results.messages import FrameTransforms, Odometry
from posetrack_cli.results.writer import SUMMARY_RECORD
from support.results import (
    SUMMARY,
    begin,
    checkpoint_at,
    make_estimate,
    make_vertices,
    resume_result,
    with_fields,
    write_frames,
    write_result,
)

FRAMES = 26
BEFORE_MM = 1000.0
"""How much nearer the smoothed track is, to tell the two apart."""


def smoothed(index: int) -> Estimate:
    estimate = make_estimate(index)
    return with_fields(estimate, position=estimate.position - [0.0, 0.0, BEFORE_MM])


def write_smoothed_frames(writer: ResultWriter, order: Iterable[int]) -> None:
    for index in order:
        writer.write_smoothed(smoothed(index), make_vertices(index) if index % 3 else None)


def write_both(path: Path, order: Iterable[int] = range(FRAMES)) -> Path:
    with begin(path) as writer:
        write_frames(writer, 0, FRAMES)
        write_smoothed_frames(writer, order)
        writer.finish(SUMMARY)
    return path


@pytest.mark.parametrize("order", [range(FRAMES), range(FRAMES - 1, -1, -1)], ids=["forward", "backward"])
def test_either_track_is_read_in_the_order_of_its_frames(tmp_path: Path, order: range) -> None:
    result = read_result(write_both(tmp_path / "r.mcap", order))
    assert result.tracks == ("filtered", "smoothed")
    filtered, other = (result.columns(result.topic_of_track(track)) for track in result.tracks)
    for columns in (filtered, other):
        assert columns["frame_index"].tolist() == list(range(FRAMES))
    np.testing.assert_array_equal(filtered["position"], [make_estimate(i).position for i in range(FRAMES)])
    np.testing.assert_array_equal(other["position"], [smoothed(i).position for i in range(FRAMES)])
    one_by_one = [e.frame_index for e in result.estimates(result.topic_of_track("smoothed"))]
    assert one_by_one == list(range(FRAMES))


def test_the_result_s_own_estimates_stay_the_filtered_ones(tmp_path: Path) -> None:
    with_it, without = write_both(tmp_path / "with.mcap"), write_result(tmp_path / "without.mcap", FRAMES)
    theirs = read_result(without).columns()
    for name, column in read_result(with_it).columns().items():
        np.testing.assert_array_equal(column, theirs[name])


def test_the_filtered_part_of_the_file_is_that_of_a_run_without_smoothing(tmp_path: Path) -> None:
    """Byte for byte up to the first thing that has to differ: the chunk that follows, or the summary."""
    with_it, without = write_both(tmp_path / "with.mcap"), write_result(tmp_path / "without.mcap", FRAMES)
    with without.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    (end,) = (index.offset for index in summary.metadata_indexes if index.name == SUMMARY_RECORD)
    assert end > 0.9 * sum(index.chunk_length for index in summary.chunk_indexes)
    assert with_it.read_bytes()[:end] == without.read_bytes()[:end]


def test_every_frame_of_a_smoothed_body_has_a_name_of_its_own(tmp_path: Path) -> None:
    """Two bodies of one name would jump to and fro in a viewer."""
    frames: dict[str, set[str]] = {}
    with write_both(tmp_path / "r.mcap").open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(
            ["/tf", "/smoothed/tf", "/smoothed/hand/odometry"]
        ):
            own = frames.setdefault(channel.topic, set())
            if channel.topic.endswith("odometry"):
                own.add(Odometry.FromString(message.data).body_frame_id)
            else:
                own |= {t.child_frame_id for t in FrameTransforms.FromString(message.data).transforms}
    assert frames["/smoothed/hand/odometry"] == {"hand_smoothed"}
    assert "hand_smoothed/wrist" in frames["/smoothed/tf"]
    assert not frames["/tf"] & frames["/smoothed/tf"]


def test_smoothed_messages_have_the_log_times_of_their_frames_and_the_same_schemas(tmp_path: Path) -> None:
    schemas: dict[str, int] = {}
    times: dict[str, list[int]] = {}
    with write_both(tmp_path / "r.mcap", range(FRAMES - 1, -1, -1)).open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            schemas[channel.topic] = schema.id
            times.setdefault(channel.topic, []).append(message.log_time)
    for kind in ("odometry", "estimate", "joint_states", "scene"):
        assert schemas[f"/smoothed/hand/{kind}"] == schemas[f"/hand/{kind}"]
        assert times[f"/smoothed/hand/{kind}"] == times[f"/hand/{kind}"]


def test_the_summary_counts_smoothed_frames(tmp_path: Path) -> None:
    summary = read_result(write_both(tmp_path / "r.mcap")).summary
    assert (summary["frames"], summary["smoothed"]) == (str(FRAMES), str(FRAMES))


def test_a_run_without_smoothing_says_how_to_get_it(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "r.mcap"))
    assert result.tracks == ("filtered",)
    with pytest.raises(ResultError, match=r"has no smoothed track.*--smooth"):
        result.topic_of_track("smoothed")
    with pytest.raises(ResultError, match="no such track, found 'smooth', expected filtered or smoothed"):
        result.topic_of_track("smooth")


def test_an_interrupted_backward_pass_leaves_no_smoothed_track(tmp_path: Path) -> None:
    """It would begin in the middle of the recording."""
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, FRAMES)
        write_smoothed_frames(writer, range(FRAMES - 1, 3, -1))
    result = read_result(part_path(tmp_path / "r.mcap"))
    assert result.tracks == ("filtered",)
    assert len(result.columns()["stamp_ns"]) == FRAMES
    with pytest.raises(ResultError, match="the run did not finish"):
        result.topic_of_track("smoothed")


@pytest.mark.parametrize("done", [1, 10, 25])
def test_a_run_resumed_in_its_backward_pass_equals_an_uninterrupted_one(tmp_path: Path, done: int) -> None:
    whole = write_both(tmp_path / "whole.mcap", range(FRAMES - 1, -1, -1)).read_bytes()
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, FRAMES)
        write_smoothed_frames(writer, itertools.islice(range(FRAMES - 1, -1, -1), done))

    class Smoothing(ResultWriter):
        def finish(self, summary: object) -> None:
            write_smoothed_frames(self, range(FRAMES - 1, -1, -1))
            super().finish(SUMMARY)

    checkpoint = resume_result(tmp_path / "r.mcap", FRAMES, Smoothing)
    assert checkpoint.frame_index == 19
    assert (tmp_path / "r.mcap").read_bytes() == whole


def test_smoothed_frames_keep_to_one_direction(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, FRAMES)
        write_smoothed_frames(writer, (9, 8))
        for index in (8, 9):
            with pytest.raises(ResultError, match="each frame once, in order or in reverse"):
                writer.write_smoothed(smoothed(index))
        write_smoothed_frames(writer, (7,))


def test_after_the_first_smoothed_frame_the_filtered_track_is_closed(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 10)
        write_smoothed_frames(writer, (9,))
        with pytest.raises(ResultError, match="filtered frame after the smoothed track began"):
            writer.write(make_estimate(10))
        with pytest.raises(ResultError, match="checkpoint after the smoothed track began"):
            writer.save_checkpoint(checkpoint_at(writer, 9))


def test_a_smoothed_estimate_is_checked_as_any_other(tmp_path: Path) -> None:
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 3)
        with pytest.raises(ResultError, match="position is not finite"):
            writer.write_smoothed(with_fields(smoothed(0), position=np.full(3, np.nan)))
