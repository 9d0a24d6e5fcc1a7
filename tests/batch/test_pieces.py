"""Where pieces of a recording begin and end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.batch.jobs import Piece, handover_frame, join_results, pieces_of
from posetrack_cli.results import ResultWriter, load_arrays
from support.results import CAMERA, RUN, SUBJECT, make_estimate, with_fields

NS = 1_000_000_000
STEPS = st.lists(st.integers(1, 4 * NS), min_size=1, max_size=60)
"""From frame to frame, ns: also gaps longer than a piece."""


@given(steps=STEPS, chunk_s=st.floats(1.0, 20.0), before_s=st.floats(0.0, 5.0), after_s=st.floats(0.0, 5.0))
def test_every_frame_is_one_pieces_own(
    steps: list[int], chunk_s: float, before_s: float, after_s: float
) -> None:
    stamps = [sum(steps[:k]) for k in range(len(steps))]
    numbers = [7 + 3 * k for k in range(len(steps))]  # as --start 7 --stride 3 has them
    pieces = pieces_of(numbers, stamps, chunk_s, before_s, after_s)
    own = [n for piece in pieces for n in numbers if piece.first <= n < piece.last]
    assert own == numbers
    for piece in pieces:
        assert piece.start <= piece.first < piece.last
        tracked = [stamp for stamp, n in zip(stamps, numbers, strict=True) if piece.start <= n < piece.end]
        mine = [stamp for stamp, n in zip(stamps, numbers, strict=True) if piece.first <= n < piece.last]
        around = [s for s in stamps if mine[0] - before_s * NS - 1 <= s <= mine[-1] + after_s * NS + 1]
        inside = [s for s in stamps if mine[0] - before_s * NS + 1 <= s <= mine[-1] + after_s * NS - 1]
        assert set(inside) <= set(tracked) <= set(around)
        assert mine[-1] - mine[0] <= 1.5 * chunk_s * NS + 1


def test_an_even_recording_has_even_pieces() -> None:
    stamps = [k * NS // 30 for k in range(300)]  # 10 s
    pieces = pieces_of(range(300), stamps, 2.5, 1.0, 0.0)
    assert [(piece.first, piece.last) for piece in pieces] == [(0, 75), (75, 150), (150, 225), (225, 300)]
    assert [piece.start for piece in pieces] == [0, 45, 120, 195]
    assert [piece.end for piece in pieces] == [piece.last for piece in pieces]


def test_a_short_recording_is_one_piece() -> None:
    stamps = [k * NS // 30 for k in range(44)]
    (piece,) = pieces_of(range(44), stamps, 1.0, 0.5, 0.5)
    assert (piece.start, piece.end, piece.first, piece.last) == (0, 44, 0, 44)


def write_piece(path: Path, piece: Piece, offsets: dict[int, float]) -> tuple[Path, Piece]:
    """A result whose points are off by so many mm in some frames."""
    with ResultWriter(path, SUBJECT, CAMERA, RUN) as writer:
        for index in range(piece.start, piece.end):
            estimate = make_estimate(index)
            writer.write(with_fields(estimate, points=estimate.points + offsets.get(index, 0.0)))
        writer.finish({})
    return path, piece


@pytest.mark.parametrize(
    ("offsets", "frame"),
    [
        ({}, 19),  # as late as it can be, where both are alike
        ({19: 5.0, 18: 5.0}, 17),
        ({k: 9.0 - 0.1 * k for k in range(10, 20)}, 19),  # coming nearer
        ({k: float(k) for k in range(10, 20)}, 15),  # only the later half is looked at
    ],
)
def test_pieces_meet_where_they_agree(tmp_path: Path, offsets: dict[int, float], frame: int) -> None:
    one = write_piece(tmp_path / "one.mcap", Piece(0, 20, 0, 20), {})
    other = write_piece(tmp_path / "other.mcap", Piece(10, 30, 20, 30), offsets)
    assert handover_frame(one, other) == frame
    join_results([one, other], tmp_path / "joined.mcap", 1.0, 0.5)
    joined = load_arrays(tmp_path / "joined.mcap")
    assert joined["frame_index"].tolist() == list(range(30))
    expected = [load_arrays(path)["points"] for path, _ in (one, other)]
    assert np.array_equal(joined["points"], np.concatenate([expected[0][:frame], expected[1][frame - 10 :]]))


def test_pieces_without_a_common_frame_meet_at_their_ends(tmp_path: Path) -> None:
    one = write_piece(tmp_path / "one.mcap", Piece(0, 20, 0, 20), {})
    other = write_piece(tmp_path / "other.mcap", Piece(20, 30, 20, 30), {})
    assert handover_frame(one, other) == 20
