"""Columns against the estimates they are made of, one by one."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from posetrack_cli.errors import ResultError
from posetrack_cli.recording.base import TruthMessage
from posetrack_cli.results import ESTIMATE_SCHEMA_NAME, Estimate, estimate_to_json, read_result
from posetrack_cli.results.columns import Columns, column_blocks, empty_columns, joined
from posetrack_cli.results.fields import FIELD_NAMES, VELOCITY_FIELDS, Sizes
from support.results import K, P, begin, make_estimate, with_fields, write_frames, write_result

NO_VELOCITY: dict[str, object] = dict.fromkeys(VELOCITY_FIELDS)
KINDS = {"frame_index": "i", "stamp_ns": "i", "status": "U", "resampled": "b"}


def estimates(count: int) -> list[Estimate]:
    """Estimates of which every fourth knows no velocity."""
    return [
        with_fields(make_estimate(index), **(NO_VELOCITY if index % 4 == 2 else {})) for index in range(count)
    ]


def stacked(name: str, of: list[Estimate]) -> np.ndarray:
    """One field of all estimates, NaN where it is None."""
    known = next((value for e in of if (value := getattr(e, name)) is not None), np.nan)
    nothing = np.full(np.shape(known), np.nan)
    return np.array([nothing if (value := getattr(e, name)) is None else value for e in of])


def assert_columns(found: Columns, of: list[Estimate]) -> None:
    assert tuple(found) == FIELD_NAMES
    for name, column in found.items():
        assert column.dtype.kind == KINDS.get(name, "f"), name
        if of:
            np.testing.assert_array_equal(column, stacked(name, of), err_msg=name)
        else:
            assert len(column) == 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 30), st.integers(1, 12))
def test_blocks_hold_every_frame_once_and_in_order(count: int, frames: int) -> None:
    of = estimates(count)
    blocks = list(column_blocks(map(estimate_to_json, of), frames=frames))
    assert [len(block["stamp_ns"]) for block in blocks[:-1]] == [frames] * (len(blocks) - 1)
    assert_columns(joined(iter(blocks)) or empty_columns(FIELD_NAMES, Sizes(K, P)), of)


def test_long_columns_grow_without_a_second_copy() -> None:
    """One frame, many times: the numbers of all frames are held once, and one block."""
    message, count = estimate_to_json(make_estimate(1)), 20_000

    def messages() -> Iterator[bytes]:
        for _ in range(count):
            yield message

    joined(column_blocks([message]))
    tracemalloc.start()
    columns = joined(column_blocks(messages()))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = sum(column.nbytes for column in columns.values())
    assert len(columns["stamp_ns"]) == count
    assert peak < 1.5 * size
    np.testing.assert_array_equal(columns["points"][-1], make_estimate(1).points)


def test_blocks_of_a_result_do_not_grow_with_its_length(tmp_path: Path) -> None:
    peaks, estimate = [], make_estimate(1)
    for frames in (2000, 4000):
        with begin(tmp_path / f"{frames}.mcap") as writer:
            for index in range(frames):
                writer.write(with_fields(estimate, frame_index=index))
            writer.finish({})
        result = read_result(tmp_path / f"{frames}.mcap")
        tracemalloc.start()
        count = sum(len(block["cost"]) for block in result.column_blocks())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert count == frames
    assert peaks[1] < 1.3 * peaks[0], "twice the frames: only the index grows"


def test_columns_are_those_of_the_file(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "r.mcap"))
    assert_columns(result.columns(), [make_estimate(index) for index in range(26)])
    assert result.losses == ()


def test_only_the_fields_asked_for_are_read(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "r.mcap"))
    columns = result.columns(fields=("stamp_ns", "points", "status"))
    assert set(columns) == {"stamp_ns", "points", "status"}
    np.testing.assert_array_equal(columns["points"], result.columns()["points"])
    assert set(read_result(write_result(tmp_path / "e.mcap", 0)).columns(fields=("cost",))) == {"cost"}


def test_a_truth_may_have_other_joints_than_the_subject(tmp_path: Path) -> None:
    topic = "/truth/hand/estimate"
    truths = [make_estimate(index, k=5, p=2) for index in range(7)]
    with begin(tmp_path / "r.mcap") as writer:
        write_frames(writer, 0, 3)
        for truth in truths:
            data = estimate_to_json(truth)
            writer.add_truth(
                TruthMessage(topic, ESTIMATE_SCHEMA_NAME, "jsonschema", b"{}", "json", truth.stamp_ns, data)
            )
        writer.finish({})
    assert_columns(read_result(tmp_path / "r.mcap").columns(topic), truths)


def test_messages_out_of_order_stay_as_they_lie_in_the_file(tmp_path: Path) -> None:
    stamps = [5, 3, 9, 9, 1]
    with begin(tmp_path / "r.mcap", flush_frames=2) as writer:
        for index, stamp in enumerate(stamps):
            writer.write(with_fields(make_estimate(index), stamp_ns=stamp))
        writer.finish({})
    assert read_result(tmp_path / "r.mcap").columns()["stamp_ns"].tolist() == stamps


def changed(**changes: Any) -> bytes:
    fields = json.loads(estimate_to_json(make_estimate(1)))
    fields |= changes
    return json.dumps({key: value for key, value in fields.items() if value != "gone"}).encode()


@pytest.mark.parametrize(
    "data",
    [
        b"{",
        b"[]",
        changed(position=[0.0, 1.0]),
        changed(position=["0", "1", "2"]),
        changed(position=None),
        changed(shape=[0.0] * 4),
        changed(points=[{"x": 0, "y": 0, "z": 0}]),
        changed(points=[{"x": 0, "y": 0}] * P),
        changed(points=[[0, 0, 0]] * P),
        changed(status="happy"),
        changed(stamp_ns=0.5),
        changed(stamp_ns=2**64),
        changed(confidence="gone"),
        changed(twist="gone", pose_rate=[1.0]),
        changed(points="gone"),
    ],
)
def test_what_is_no_estimate_is_refused_in_one_line(data: bytes) -> None:
    with pytest.raises(
        ResultError, match=r"r\.mcap: message 1 is not a posetrack\.Estimate, found .+"
    ) as error:
        list(column_blocks([estimate_to_json(make_estimate(0)), data], where="r.mcap"))
    assert "\n" not in str(error.value)


def test_whole_numbers_are_numbers() -> None:
    (block,) = column_blocks([changed(position=[1, 2, 3], cost=None)])
    assert block["position"].tolist() == [[1.0, 2.0, 3.0]]
    assert np.isnan(block["cost"]).all()
