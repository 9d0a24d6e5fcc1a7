"""Results of pieces as one result."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.mcap.stream import McapFile
from posetrack_cli.results import ResultWriter, load_arrays, read_result
from posetrack_cli.results.joining import Share, join_results
from posetrack_cli.results.topics import SMOOTHED
from support.results import (
    CAMERA,
    RUN,
    SUBJECT,
    begin,
    make_estimate,
    make_truth,
    make_vertices,
    with_fields,
    write_result,
)

FRAMES = 26
CHANGES = {"pieces": "2"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_result(tmp_path_factory.mktemp("whole") / "whole.mcap", FRAMES)


def messages_of(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    """By topic: how truth lies between frames depends on its stamps, which a writer of tests makes up."""
    found: dict[str, list[tuple[int, bytes]]] = {}
    for _, channel, message in McapFile(path).messages(in_file_order=True):
        found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def write_smoothed(path: Path, frames: int) -> Path:
    with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
        for index in range(frames):
            writer.write(make_estimate(index))
        for index in reversed(range(frames)):
            writer.write_smoothed(make_estimate(index))
        writer.finish({})
    return path


@given(cuts=st.sets(st.integers(1, FRAMES - 1), max_size=4))
def test_shares_of_one_result_join_to_it(whole: Path, cuts: set[int]) -> None:
    """Whatever it is cut into: the same messages on each topic, attachments, counts."""
    edges = [0, *sorted(cuts), FRAMES]
    shares = [Share(whole, *pair) for pair in pairwise(edges)]
    joined = whole.with_name("joined.mcap")
    join_results(shares, joined, CHANGES, overwrite=True)
    assert messages_of(joined) == messages_of(whole)
    result = read_result(joined)
    assert result.attachment("model.txt") == b"a model"
    assert result.run == {**RUN, **CHANGES}
    assert result.summary == {
        key: value for key, value in read_result(whole).summary.items() if key != "skipped"
    }


def test_processors_of_all_pieces_are_stated(tmp_path: Path) -> None:
    kinds = ("openblas Zen", "openblas Haswell", "openblas Zen")
    pieces = [tmp_path / f"{k}.mcap" for k in range(3)]
    for piece, kind in zip(pieces, kinds, strict=True):
        write_result(piece, FRAMES, run=RUN | {"processor": kind})
    shares = [Share(piece, k, k + 1) for k, piece in enumerate(pieces)]
    join_results(shares, tmp_path / "joined.mcap", CHANGES)
    assert read_result(tmp_path / "joined.mcap").run["processor"] == "openblas Zen; openblas Haswell"


def test_frames_come_from_their_own_share(tmp_path: Path) -> None:
    """Pieces overlap, and each frame is that of the piece whose own it is."""
    first, second = write_result(tmp_path / "first.mcap", FRAMES), tmp_path / "second.mcap"
    with begin(second) as writer:
        for index in range(8, FRAMES):
            writer.write(with_fields(make_estimate(index), confidence=0.125))
        writer.finish({"losses": "2 images are damaged", "remarks": "dark"})
    join_results([Share(first, 0, 12), Share(second, 12, FRAMES)], tmp_path / "joined.mcap", {})
    joined, alone = load_arrays(tmp_path / "joined.mcap"), load_arrays(first)
    assert joined["frame_index"].tolist() == list(range(FRAMES))
    assert np.array_equal(joined["confidence"][:12], alone["confidence"][:12])
    assert np.array_equal(joined["confidence"][12:], np.full(FRAMES - 12, 0.125))
    said = read_result(tmp_path / "joined.mcap").summary
    assert said["losses"] == f"frames 12 to {FRAMES - 1}: 2 images are damaged"
    assert said["remarks"] == f"frames 12 to {FRAMES - 1}: dark"


def test_smoothed_tracks_are_joined_backwards(tmp_path: Path) -> None:
    whole = write_smoothed(tmp_path / "whole.mcap", FRAMES)
    join_results([Share(whole, 0, 9), Share(whole, 9, FRAMES)], tmp_path / "joined.mcap", {})
    joined = read_result(tmp_path / "joined.mcap")
    assert SMOOTHED in joined.tracks
    topic = joined.topic_of_track(SMOOTHED)
    found, expected = (load_arrays(path, topic) for path in (tmp_path / "joined.mcap", whole))
    for name in ("frame_index", "position", "points"):
        assert np.array_equal(found[name], expected[name])
    assert messages_of(tmp_path / "joined.mcap") == messages_of(whole)


def test_truth_comes_once_and_in_order(tmp_path: Path) -> None:
    """Each piece carries all truth up to its frames; the joined result has every message once."""
    paths = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for path, start in zip(paths, (0, 6), strict=True):
        with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
            for index in range(FRAMES):
                truth = make_truth(index)
                writer.add_truth(
                    truth.__class__(**{**vars(truth), "log_time_ns": make_estimate(index).stamp_ns})
                )
                if index >= start:
                    writer.write(make_estimate(index), make_vertices(index))
            writer.finish({})
    join_results([Share(paths[0], 0, 10), Share(paths[1], 10, FRAMES)], tmp_path / "joined.mcap", {})
    data = [message.data for message in read_result(tmp_path / "joined.mcap").truth()]
    assert data == [make_truth(index).data for index in range(FRAMES)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"camera": CAMERA.__class__(**{**CAMERA.values(), "fx": 300.0})}, "has a different camera"),
        ({"run": {**RUN, "input.sha256": "1"}}, "has a different recording"),
    ],
)
def test_what_is_of_something_else_is_refused(tmp_path: Path, change: dict[str, object], words: str) -> None:
    first = write_result(tmp_path / "first.mcap", 6)
    about = {"camera": CAMERA, "run": RUN, **change}
    with ResultWriter(tmp_path / "other.mcap", SUBJECT, about["camera"], about["run"]) as writer:  # type: ignore[arg-type]
        writer.write(make_estimate(7))
        writer.finish({})
    with pytest.raises(ResultError, match=words):
        join_results([Share(first, 0, 6), Share(tmp_path / "other.mcap", 6, 9)], tmp_path / "joined.mcap", {})
    assert not (tmp_path / "joined.mcap").exists()


def test_an_unfinished_piece_and_a_taken_name_are_refused(tmp_path: Path) -> None:
    first = write_result(tmp_path / "first.mcap", 6)
    with begin(tmp_path / "cut.mcap") as writer:
        writer.write(make_estimate(6))
    with pytest.raises(ResultError, match="unfinished"):
        join_results(
            [Share(first, 0, 6), Share(tmp_path / "cut.mcap.part", 6, 9)], tmp_path / "joined.mcap", {}
        )
    with pytest.raises(UsageError, match="already exists"):
        join_results([Share(first, 0, 6)], first, {})
