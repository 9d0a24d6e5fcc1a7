"""Where pieces of a recording begin and end."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.batch.pieces import pieces_of

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
