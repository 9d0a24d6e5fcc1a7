"""Order, numbers and stamps of file names: a counter is never taken for stamps, nor stamps for a counter."""

from __future__ import annotations

import random
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from posetrack_cli.recording.stamps import natural_order, numbered_sequence, order_remark, stamps_in_names

EPOCH_US = 1_305_031_102_160_407
PERIOD_US = 33_333
STAMPS_NS = [(EPOCH_US + i * PERIOD_US) * 1000 for i in range(12) if i not in (5, 6)]
"""Of a camera that lost two frames."""


def ordered(names: list[str]) -> list[str]:
    return [names[i] for i in natural_order(names)]


@pytest.mark.parametrize(
    "names",
    [
        ["depth_1.png", "depth_2.png", "depth_10.png"],
        ["frame2_1.png", "frame2_10.png", "frame10_2.png", "frame10_11.png"],
        ["a2.png", "a10.png", "b1.png"],
        ["-2.png", "-10.png"],
        ["B2.png", "a1.png"],
        ["frame.png", "frame1.png", "frame1_b.png", "frame2.png"],
        ["007.png", "07.png", "7.png", "8.png"],
        ["9" * 200 + ".png", "1" + "0" * 200 + ".png"],
        ["1.jpg", "2.png", "10.jpg"],
    ],
)
def test_numbers_in_names_are_in_order(names: list[str]) -> None:
    for seed in range(5):
        assert ordered(random.Random(seed).sample(names, len(names))) == names


def test_hexadecimal_names_of_one_length_are_in_the_order_of_their_characters() -> None:
    names = [f"{number:02x}.png" for number in range(40)]
    assert ordered(names[::-1]) == names


@given(
    st.lists(st.text(st.characters(codec="utf-8"), max_size=6), unique=True, max_size=12), st.integers(0, 5)
)
def test_padded_numbers_are_in_the_order_of_their_characters(texts: list[str], width: int) -> None:
    """A law: where numbers have one width, names sort as before."""
    names = [f"frame{i:04d}{'_' * width}{i % 7:02d}.png" for i in range(len(texts))]
    assert ordered(names) == sorted(names)
    letters = [text for text in texts if not any(c.isdigit() for c in text)]
    assert ordered(letters) == sorted(letters)


@given(st.lists(st.integers(0, 10**12), unique=True, min_size=1, max_size=20))
def test_bare_numbers_are_in_the_order_of_their_values(numbers: list[int]) -> None:
    assert ordered([f"x{n}.png" for n in numbers]) == [f"x{n}.png" for n in sorted(numbers)]


def test_another_order_than_that_of_characters_is_reported() -> None:
    (remark,) = order_remark(["1.png", "2.png", "10.png"])
    assert remark == "images are sorted by the numbers in their names: 2.png before 10.png"
    assert order_remark(["01.png", "02.png", "10.png"]) == ()


NAMES = {
    "s": [f"{ns / 1e9:.6f}" for ns in STAMPS_NS],
    "ms": [f"depth_{ns // 10**6}" for ns in STAMPS_NS],
    "us": [f"{i:06d}-{ns // 1000}" for i, ns in enumerate(STAMPS_NS)],
    "ns": [f"{ns}_rect" for ns in STAMPS_NS],
}


@pytest.mark.parametrize("unit", NAMES)
def test_stamps_are_recognised_in_each_unit(unit: str) -> None:
    found = stamps_in_names(NAMES[unit])
    assert found is not None
    assert found.unit == unit
    resolution_ns = {"s": 1000, "ms": 10**6, "us": 1000, "ns": 1}[unit]
    assert all(
        abs(a - b) < resolution_ns + 300  # a float holds seconds since 1970 to 240 ns
        for a, b in zip(found.stamps_ns, STAMPS_NS, strict=True)
    )
    assert found.words == f"in {unit}: 10 frames, {0.367 if unit == 'ms' else 0.3667} s, largest gap 0.1 s"


EXACT = {
    "after a counter": [f"{i:06d}-{ns // 10**9}.{ns % 10**9 // 1000:06d}" for i, ns in enumerate(STAMPS_NS)],
    "zeros cut off": [f"{ns // 10**9}.{ns % 10**9:09d}".rstrip("0") for ns in STAMPS_NS],
    "seconds and ns": [f"frame_{ns // 10**9}_{ns % 10**9:09d}" for ns in STAMPS_NS],
    "ns without zeros": [f"{ns // 10**9}.{ns % 10**9}" for ns in [*STAMPS_NS, 1305031103_003000000]],
    "ns since 1970": [f"{ns}" for ns in STAMPS_NS],
    "ms with a fraction": [f"a_Depth_{ns // 10**6}.{ns % 10**6:06d}00000000" for ns in STAMPS_NS],
}


@pytest.mark.parametrize("kind", EXACT)
def test_stamps_are_read_exactly(kind: str) -> None:
    expected = [*STAMPS_NS, 1305031103_003000000] if kind == "ns without zeros" else STAMPS_NS
    found = stamps_in_names(EXACT[kind])
    assert found is not None
    assert list(found.stamps_ns) == expected


DATES = [datetime.fromtimestamp(ns / 1e9, UTC) for ns in STAMPS_NS]


@pytest.mark.parametrize(
    ("form", "digits"),
    [
        ("%Y-%m-%d_%H-%M-%S.%f", 6),
        ("%Y%m%d_%H%M%S_%f", 6),
        ("IMG_%Y%m%d_%H%M%S%f", 3),
        ("%Y%m%d%H%M%S%f_depth", 3),
        ("%Y-%m-%dT%H.%M.%S.%f", 6),
    ],
)
def test_dates_with_times_are_stamps(form: str, digits: int) -> None:
    cut = form.replace("%f", "{}")
    names = [date.strftime(cut).format(f"{date.microsecond:06d}"[:digits]) for date in DATES]
    found = stamps_in_names(names)
    assert found is not None
    assert found.unit == "dates"
    for stamp, ns in zip(found.stamps_ns, STAMPS_NS, strict=True):
        assert abs(stamp - ns) < 10 ** (9 - digits) + 1000


@pytest.mark.parametrize(
    ("unit", "names"),
    [
        ("ms", [f"{i * 1000 / 30:.0f}" for i in range(20)]),
        ("us", [f"{33_333 * i:08d}" for i in range(20)]),
        ("ns", [f"{40_000_000 * i}" for i in range(20)]),
        ("s", [f"{i / 25:.3f}" for i in range(20)]),
    ],
)
def test_stamps_of_a_clock_that_begins_at_zero(unit: str, names: list[str]) -> None:
    found = stamps_in_names(names)
    assert found is not None
    assert found.unit == unit
    last_s = found.stamps_ns[-1] / 1e9
    assert last_s == pytest.approx(19 / (25 if unit in ("s", "ns") else 30), rel=2e-3)


@pytest.mark.parametrize(
    "names",
    [
        [f"{i}" for i in range(30)],
        [f"{i:06d}" for i in range(20, 220, 20)],
        [f"{i}" for i in range(200) if i % 7],
        [f"depth_{i}" for i in (1, 2, 5, 6, 11, 12, 13)],
        [f"iter_{1000 * i}" for i in range(1, 30)],
        [f"shot1.{i:04d}" for i in range(30)],
        [f"v1.{i}" for i in range(1, 30)],
        [f"1000000000_{i:03d}" for i in range(30)],
        [f"{10**9 + i}" for i in range(30)],
        [f"20240131_120501_{i:04d}" for i in range(30)],
        [f"20240131_120501_{i:03d}" for i in range(30)],
        [f"20240131_{120500 + i}" for i in range(30)],
        [f"20241331_120501_{33 * i:03d}" for i in range(5)],
        [f"{120459800 + i * 33 + (40000 if i > 6 else 0)}" for i in range(30)],
        ["1305031102.1", "1305031102.1", "1305031102.2"],
        [f"{n}" for n in (3, 500, 17, 2, 90000, 12, 55)],
        ["a", "b", "c"],
        ["stack"],
        [],
    ],
    ids=lambda names: f"{names[:2]}",
)
def test_counters_and_arbitrary_numbers_are_not_stamps(names: list[str]) -> None:
    assert stamps_in_names(names) is None


@given(st.integers(0, 10**6), st.integers(1, 60), st.sets(st.integers(0, 60), min_size=1, max_size=60))
def test_no_counter_of_frames_is_taken_for_stamps(first: int, step: int, kept: set[int]) -> None:
    """A law: whatever a counter begins with, counts by, and lost, if two frames follow each other."""
    kept |= {3, 4}
    for name in ("{}", "{:06d}", "cam0_{:05d}_depth"):
        assert stamps_in_names([name.format(first + step * i) for i in sorted(kept)]) is None


def test_a_rate_fits_stamps_without_a_gap() -> None:
    def at(stamps: list[int]) -> bool:
        found = stamps_in_names([str(ns) for ns in stamps])
        assert found is not None
        return found.fit_rate(30.0)

    even = [EPOCH_US * 1000 + round(i * 1e9 / 30) for i in range(300)]
    rng = random.Random(1)
    assert at(even)
    assert at([ns + rng.randrange(-10_000_000, 10_000_000) for ns in even])
    assert not at([ns for i, ns in enumerate(even) if i != 4])
    assert not at([EPOCH_US * 1000 + round(i * 1e9 / 29) for i in range(300)])


def test_missing_numbers_of_a_sequence_are_gaps() -> None:
    sequence = numbered_sequence([f"d_{i:03d}" for i in range(1, 30) if i not in (5, 9, 10, 11)])
    assert sequence is not None
    assert sequence.positions == tuple(i - 1 for i in range(1, 30) if i not in (5, 9, 10, 11))
    assert sequence.words == "numbers 5, 9 to 11"
    by_five = numbered_sequence([str(i) for i in range(0, 200, 5) if i != 50])
    assert by_five is not None
    assert by_five.positions[-1] == 39
    assert by_five.words == "number 50"


@pytest.mark.parametrize(
    "names",
    [
        [str(i) for i in range(30)],
        [str(i) for i in range(0, 300, 10)],
        ["1", "2", "5"],
        [*map(str, range(10)), *map(str, range(1000, 1010))],
        [str(i * i) for i in range(20)],
        [f"{i}_{i % 3}" for i in range(20)],
        ["a", "b", "c", "d", "f"],
    ],
    ids=lambda names: f"{names[:3]}",
)
def test_sequences_without_gaps_and_arbitrary_numbers_have_no_missing_ones(names: list[str]) -> None:
    assert numbered_sequence(names) is None
