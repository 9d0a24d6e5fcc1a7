"""Stamps of frames: from files, at a fixed rate, from video, or in file names."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from statistics import median

from posetrack_cli.errors import RecordingError, UsageError
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.tables import NS_PER_UNIT, TextFile, whole_of
from posetrack_cli.units import NS_PER_S

# timestamps.csv, fixed rates, and video
STAMPS_FILE_NAME = "timestamps.csv"
EXPECTED = "stamps must be a CSV file in UTF-8"
EXPECTED_HEADER = "header 'stamp_ns' or 'time_s', optionally after 'filename'"
STAMP_COLUMNS = ("stamp_ns", "time_s")
SLOWEST_HZ, FASTEST_HZ = 1e-6, 1e6
# Consecutive frames that may precede the latest one: the reordering depth of decoders.
MAX_REORDERED = 16


def stamps_at_rate(count: int, fps: float) -> list[int]:
    """Return stamps of frames 0 to count - 1 at a fixed rate: frame i at round(i / fps), ns.

    Raises:
        UsageError: the rate is out of range.
    """
    if not SLOWEST_HZ <= fps <= FASTEST_HZ:
        expected = f"{SLOWEST_HZ:g} to {FASTEST_HZ:g}"
        raise UsageError("frame rate out of range", found=f"--fps {fps}", expected=expected)
    return [stamp_at_rate(index, fps) for index in range(count)]


def stamp_at_rate(index: int, fps: float) -> int:
    """Return the stamp of one frame at a fixed rate, ns."""
    return round(index * (NS_PER_S / Fraction(fps)))


def load_stamps(path: Path, names: Sequence[str]) -> list[int]:
    """Read the stamp of each image from a timestamps.csv.

    Args:
        path: the file; its header is ``stamp_ns`` (integers) or ``time_s`` (seconds), optionally with
            ``filename`` before it.
        names: file names of the images, sorted.

    Returns:
        One stamp per name, ns.

    Raises:
        RecordingError: the file cannot be read, or does not give exactly one stamp per image.
    """
    file = TextFile(path, RecordingError, EXPECTED)
    table = file.table((), EXPECTED_HEADER)
    header = table.names
    if header[-1] not in STAMP_COLUMNS or header[:-1] not in ((), ("filename",)):
        raise RecordingError("unknown header", where=path, found=table.shown, expected=EXPECTED_HEADER)
    unit = NS_PER_UNIT[header[-1]]
    entries = [
        (row[0].strip(), whole_of(row[-1], file.where(line), RecordingError, unit)) for line, row in table
    ]
    if len(entries) != len(names):
        raise RecordingError(
            "numbers of stamps and images differ",
            where=path,
            found=f"{len(entries)} stamps",
            expected=f"{len(names)}, one per image",
        )
    if len(header) == 1:
        return [stamp for _, stamp in entries]
    stamps = dict(entries)
    missing = next((name for name in names if name not in stamps), None)
    if missing is not None:
        raise RecordingError(f"no stamp for image {missing}", where=path, expected="one line per image")
    return [stamps[name] for name in names]


class VideoStamps:
    """Makes a video's stamps increase as far as its frames are in order.

    After damage a decoder may output a frame it had held back, long after its time. Such a frame keeps its
    stamp, which is then not later than the previous one, so readers drop it. Where stamps restart, as in
    concatenated files, they continue instead.

    Args:
        period_ns: frame interval where stamps do not give it, above 0.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = max(period_ns, 1)
        self._latest: int | None = None
        self._offset, self._behind = 0, 0

    def stamp(self, pts_ns: int) -> int:
        """Return the stamp, ns, of a frame with presentation time ``pts_ns``, 0 if unknown."""
        if self._latest is None:
            self._offset = max(-pts_ns, 0)
        elif pts_ns + self._offset <= self._latest:
            if pts_ns > 0 and self._behind < MAX_REORDERED:
                self._behind += 1
                return pts_ns + self._offset
            self._offset = self._latest + self._period_ns - pts_ns
        self._behind = 0
        self._latest = pts_ns + self._offset
        return self._latest


# Natural order of file names, and missing numbers of sequences
DIGITS = re.compile(r"[0-9]+")
REGULAR_SHARE = 0.75  # minimum share of single-frame steps between numbers; the others are gaps
FEWEST_NUMBERED = 4  # gaps in shorter sequences mean nothing
SHARED_SHARE = 0.5  # minimum share of numbers that layouts have in common
SHOWN_RANGES = 3  # ranges of missing numbers listed in a remark


def natural_key(name: str) -> tuple[str, str]:
    """Return a sort key by value for numbers and by character otherwise: ``a2`` before ``a10``.

    A number becomes "0", its length and its digits without leading zeros, so it compares with other
    characters as its first digit would. Names with zero-padded numbers sort as by character.
    """
    return DIGITS.sub(_comparable, name), name


def natural_order(names: Sequence[str]) -> list[int]:
    """Return the positions of names in natural order.

    Names of equal length that differ in more than their digits are hexadecimal or arbitrary (``1a``,
    ``10``) and sort by character.
    """
    by_character = sorted(range(len(names)), key=names.__getitem__)
    natural = sorted(range(len(names)), key=lambda i: natural_key(names[i]))
    if natural == by_character or (len({len(n) for n in names}) == 1 and not _has_one_layout(names)):
        return by_character
    return natural


def order_remark(names: Sequence[str]) -> tuple[str, ...]:
    """Return a remark if names are not in character order."""
    for name, following in pairwise(names):
        if name > following:
            return (f"images are sorted by the numbers in their names: {name} before {following}",)
    return ()


def varying_numbers(names: Sequence[str]) -> list[tuple[int, ...]] | None:
    """Return each name's numbers that differ between names, () if none; None if layouts differ."""
    if not _has_one_layout(names):
        return None
    columns = list(zip(*(DIGITS.findall(name) for name in names), strict=True))
    varying = [[number(text) for text in column] for column in columns if len(set(column)) > 1]
    return [tuple(column[i] for column in varying) for i in range(len(names))]


def number(digits: str) -> int:
    """Return the value of digits in a file name."""
    return int(digits)  # bounded: a file name has at most 255 bytes


@dataclass(frozen=True)
class NumberedSequence:
    """A numbered sequence of images.

    Attributes:
        positions: frame offset of each image from the first; larger than its index after a gap.
        missing: first and last number of each missing range.
    """

    positions: tuple[int, ...]
    missing: tuple[tuple[int, int], ...]

    @property
    def words(self) -> str:
        """The missing numbers as text: ``number 5`` or ``numbers 5, 9 to 11``, at most a few."""
        shown = [str(a) if a == b else f"{a} to {b}" for a, b in self.missing[:SHOWN_RANGES]]
        more = ", ..." if len(self.missing) > SHOWN_RANGES else ""
        one = len(self.missing) == 1 and self.missing[0][0] == self.missing[0][1]
        return f"number{'' if one else 's'} {', '.join(shown)}{more}"


def numbered_sequence(names: Sequence[str]) -> NumberedSequence | None:
    """Return the sequence counted by the only varying number of ordered names, None without gaps.

    Most numbers are one step apart, the others a multiple of it, and at most as many numbers are missing as
    there are images.
    """
    if len(names) < FEWEST_NUMBERED:
        return None
    numbers = varying_numbers(names)
    if numbers is None or len(numbers[0]) != 1:
        return None
    values = [value for (value,) in numbers]
    steps = [b - a for a, b in pairwise(values)]
    step, count = Counter(steps).most_common(1)[0]
    total = values[-1] - values[0]
    if step < 1 or count < REGULAR_SHARE * len(steps) or count == len(steps) or any(s % step for s in steps):
        return None
    if min(steps) < step or total // step > 2 * len(values):
        return None
    missing = [(a + step, b - step) for a, b in pairwise(values) if b - a > step]
    return NumberedSequence(tuple((value - values[0]) // step for value in values), tuple(missing))


def _comparable(found: re.Match[str]) -> str:
    digits = found.group().lstrip("0")
    return f"0{chr(len(digits) + 1)}{digits}"


def layout(name: str) -> str:
    """Return a name with ``#`` in place of each number."""
    return DIGITS.sub("#", name)


def layouts_of_one_sequence(names: Sequence[str]) -> dict[str, list[int]]:
    """Return the positions of names by layout if several layouts share most numbers, else {}.

    Such are images of several kinds or cameras: ``frame-1.color``, ``frame-1.depth``.
    """
    by_layout: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        by_layout.setdefault(layout(name), []).append(i)
    kinds = {text: found for text, found in by_layout.items() if len(found) > 1}
    numbers = [{tuple(map(number, DIGITS.findall(names[i]))) for i in found} for found in kinds.values()]
    if len(kinds) < 2 or len(set.intersection(*numbers)) < SHARED_SHARE * min(map(len, numbers)):
        return {}
    return kinds


def _has_one_layout(names: Sequence[str]) -> bool:
    """Return whether names differ in the values of their numbers only."""
    return len(set(map(layout, names))) == 1


# Stamps in file names, recognised by magnitude and rate; ambiguous numbers count as frame numbers

EARLIEST_S, LATEST_S = 10**9, 4 * 10**9  # plausible Unix times: 2001 to 2096
UNITS = {"s": NS_PER_S, "ms": 10**6, "us": 10**3, "ns": 1}  # ns per unit
FRACTIONS = (3, 6, 9)  # digits of a separate fraction of a second: ms, us or ns
SHORTEST_NS = 500_000  # minimum median interval: 2000 Hz
CAMERA_HZ = (1, 2, 5, 6, 7.5, 10, 12, 12.5, 15, 20, 24, 25, 30, 48, 50, 60, 75, 90, 100, 120)
# Relative deviation of a mean rate from one of ``CAMERA_HZ``; consumer cameras stay within 1 %.
RATE_TOLERANCE = 0.02
FEWEST_RELATIVE = 6  # minimum number of names for a clock not counting from 1970
EVEN_SHARE, EVENNESS = 0.9, 0.2  # share of intervals near a multiple of the median; relative tolerance
COUNTED_BY = 1000  # image numbers do not have larger steps unless multiples of it
NEVER_COUNTED_BY = 10**6
# Median intervals of clocks that do not count from 1970: 0.5 to 500 Hz
SLOWEST_RELATIVE_NS, FASTEST_RELATIVE_NS = 2 * NS_PER_S, 2_000_000
# Their longest interval: HHMMSS read as one number would jump by 40 s and more
LONGEST_RELATIVE_NS = 10 * NS_PER_S
# Dates with times; digits that may be their first number: year, date, or up to a fraction of a second
DATE_FORMAT, DATE_DIGITS, DATE_STARTS = "%Y%m%d%H%M%S", 14, (4, 8, 14, 17, 20)
SEPARATORS = re.compile(r"[._-]")


@dataclass(frozen=True)
class NameStamps:
    """Stamps in file names.

    Attributes:
        unit: ``s``, ``ms``, ``us``, ``ns``, or ``dates``.
        stamps_ns: stamp of each name.
        is_count: True for integers not counting from 1970, recognised as stamps by their rate alone.
    """

    unit: str
    stamps_ns: tuple[int, ...]
    is_count: bool = False

    @property
    def words(self) -> str:
        """Summary as text: ``in s: 12 frames, 0.5 s, largest gap 0.133 s``."""
        ordered = sorted(self.stamps_ns)
        gap = max((b - a for a, b in pairwise(ordered)), default=0)
        seconds, gap_s = (ordered[-1] - ordered[0]) / NS_PER_S, gap / NS_PER_S
        return f"in {self.unit}: {len(ordered)} frames, {seconds:.4g} s, largest gap {gap_s:.3g} s"

    @property
    def rate_hz(self) -> float:
        """Mean rate, corrected for missing frames; infinity for one stamp."""
        return _rate(self.stamps_ns) if len(self.stamps_ns) > 1 else math.inf

    def fit_rate(self, fps: float) -> bool:
        """Return whether frame i is at i / fps, within half a frame of the median deviation."""
        period = NS_PER_S / fps
        deviations = [stamp - i * period for i, stamp in enumerate(sorted(self.stamps_ns))]
        middle = median(deviations)
        return all(abs(deviation - middle) < 0.5 * period for deviation in deviations)


def order_of_names(names: Sequence[str], stems: Sequence[str]) -> list[int]:
    """Return the positions of names in order of their stamps, else in natural order."""
    stamps = stamps_in_names(stems)
    if stamps is None:
        return natural_order(names)
    return sorted(range(len(names)), key=lambda i: (stamps.stamps_ns[i], names[i]))


def stamps_in_names(stems: Sequence[str]) -> NameStamps | None:
    """Return the stamps in names without suffix, None unless certain.

    Names have one layout: the same text between numbers. A stamp counts from 1970 (10 digits of seconds,
    with or without a fraction, 13 of ms, 16 of us, 19 of ns), or is a date with a time, a decimal number of
    seconds, or an integer that gives a camera's frame rate in exactly one unit and cannot be a counter.
    """
    if not stems:
        return None
    gaps = DIGITS.split(stems[0])
    if any(DIGITS.split(stem) != gaps for stem in stems):
        return None
    columns = list(zip(*map(DIGITS.findall, stems), strict=True))
    for is_count, readings in ((False, _readings(columns, gaps[1:])), (True, _count_readings(columns))):
        for unit, stamps, is_certain in readings:
            if is_certain and len(set(stamps)) == len(stamps) and max(stamps) <= LATEST_NS:
                return NameStamps(unit, tuple(stamps), is_count)
    return None


Reading = tuple[str, list[int], bool]  # unit, stamps in ns, and whether they pass as stamps


def _readings(columns: Sequence[tuple[str, ...]], separators: Sequence[str]) -> Iterator[Reading]:
    """Yield readings of numbers as Unix times, dates, or decimal seconds."""
    decimals = [
        (whole, fraction, separator)
        for whole, fraction, separator in zip(columns, columns[1:], separators, strict=False)
        if SEPARATORS.fullmatch(separator)
    ]
    yield from _epoch_readings(columns, decimals)
    yield from _date_readings(columns, separators)
    for whole, fraction, separator in decimals:
        if separator == "." and max(map(len, whole)) < 10:
            stamps = [_decimal(w, f) for w, f in zip(whole, fraction, strict=True)]
            digit = NS_PER_S // 10 ** min(9, max(map(len, fraction)))
            yield "s", stamps, len(stamps) > 2 and _is_time(stamps, digit) and _is_regular(stamps)


def _count_readings(columns: Sequence[tuple[str, ...]]) -> Iterator[Reading]:
    """Yield readings of integers as stamps that do not count from 1970."""
    for column in columns:
        if len(column) < FEWEST_RELATIVE or _could_be_counter(counts := [number(text) for text in column]):
            continue
        for unit, ns in list(UNITS.items())[1:]:
            stamps = [count * ns for count in counts]
            yield unit, stamps, _is_regular(stamps) and _is_camera_rate(stamps)


def _epoch_readings(
    columns: Sequence[tuple[str, ...]], decimals: Sequence[tuple[tuple[str, ...], tuple[str, ...], str]]
) -> Iterator[Reading]:
    for whole, fraction, separator in decimals:
        if _is_epoch(whole, NS_PER_S):
            for stamps in _with_fraction(whole, fraction, separator):
                yield "s", stamps, _is_time(stamps, NS_PER_S // 10 ** max(map(len, fraction)))
        for unit in ("ms", "us"):
            if separator == "." and _is_epoch(whole, UNITS[unit]):
                stamps = [_decimal(w, f, UNITS[unit]) for w, f in zip(whole, fraction, strict=True)]
                yield unit, stamps, _is_time(stamps, 0)
    for column in columns:
        for unit, ns in UNITS.items():
            if _is_epoch(column, ns):
                stamps = [number(text) * ns for text in column]
                yield unit, stamps, _is_time(stamps, ns)


def _date_readings(columns: Sequence[tuple[str, ...]], separators: Sequence[str]) -> Iterator[Reading]:
    """Yield readings of dates with times, as UTC: 20240131_120501_123 and the like."""
    for first in range(len(columns)):
        if len(columns[first][0]) not in DATE_STARTS:
            continue
        last = first + 1
        while last < len(columns) and sum(len(column[0]) for column in columns[first:last]) < DATE_DIGITS:
            last += 1
        texts = ["".join(parts) for parts in zip(*columns[first:last], strict=True)]
        width = len(texts[0]) - DATE_DIGITS
        if width not in (0, *FRACTIONS) or any(len(text) != len(texts[0]) for text in texts):
            continue
        fraction = [text[DATE_DIGITS:] for text in texts]
        if width == 0 and last < len(columns) and _is_fraction(columns[last], separators[last - 1]):
            fraction = list(columns[last])
        if _date_seconds(texts[0]) is not None:
            seconds = [_date_seconds(text) for text in texts]
            stamps = [
                _decimal(str(s), f or "0") for s, f in zip(seconds, fraction, strict=True) if s is not None
            ]
            is_certain = len(stamps) == len(texts) and _is_time(
                stamps, NS_PER_S // 10 ** max(map(len, fraction))
            )
            yield "dates", stamps, is_certain


def _is_fraction(column: Sequence[str], separator: str) -> bool:
    """Return whether numbers after seconds are their decimal fraction."""
    widths = set(map(len, column))
    return separator == "." or (separator in ("_", "-") and len(widths) == 1 and widths <= set(FRACTIONS))


def _date_seconds(digits: str) -> int | None:
    """Return the Unix time of year, month, day, hour, minute, second; None if not a date."""
    try:
        moment = datetime.strptime(digits[:DATE_DIGITS], DATE_FORMAT).replace(tzinfo=UTC)
    except ValueError:
        return None
    seconds = round(moment.timestamp())
    return seconds if EARLIEST_S <= seconds < LATEST_S else None


def _is_epoch(column: Sequence[str], ns: int) -> bool:
    """Return whether all numbers are Unix times in units of ``ns``, in plausible years."""
    scale = NS_PER_S // ns
    return all(EARLIEST_S * scale <= number(text) < LATEST_S * scale for text in column)


def _with_fraction(whole: Sequence[str], fraction: Sequence[str], separator: str) -> Iterator[list[int]]:
    """Yield the stamps, ns, of seconds and the digits after them, the likelier first.

    Fractions of different lengths are decimals without trailing zeros, or counts without leading zeros.
    """
    widths = {len(text) for text in fraction}
    longest = max(widths)
    padded = next((digits for digits in FRACTIONS if digits >= longest), None)
    readings = []
    if _is_fraction(fraction, separator):
        readings.append([_decimal(w, f) for w, f in zip(whole, fraction, strict=True)])
    if len(widths) > 1 and padded is not None:
        unit = 10 ** (9 - padded)
        pairs = zip(whole, fraction, strict=True)
        readings.append([number(w) * NS_PER_S + number(f) * unit for w, f in pairs])
    yield from sorted(readings, key=_unevenness)


def _decimal(whole: str, fraction: str, unit_ns: int = NS_PER_S) -> int:
    return round(Decimal(f"{whole}.{fraction}") * unit_ns)


def _intervals(stamps: Sequence[int]) -> list[int]:
    return [b - a for a, b in pairwise(sorted(stamps))]


def _unevenness(stamps: Sequence[int]) -> float:
    """Return the mean relative deviation of intervals from the median."""
    intervals = _intervals(stamps)
    usual = median(intervals) if intervals else 0
    return sum(abs(i - usual) for i in intervals) / (usual * len(intervals)) if usual else math.inf


def _is_time(stamps: Sequence[int], digit_ns: int) -> bool:
    """Return whether stamps have a plausible rate and do not count their last digit."""
    intervals = _intervals(stamps)
    return not intervals or (median(intervals) >= SHORTEST_NS and median(intervals) > digit_ns)


def _is_regular(stamps: Sequence[int]) -> bool:
    """Return whether nearly all intervals are multiples of a median that a camera could have."""
    intervals = _intervals(stamps)
    usual = median(intervals)
    if not FASTEST_RELATIVE_NS <= usual <= SLOWEST_RELATIVE_NS or max(intervals) > LONGEST_RELATIVE_NS:
        return False
    even = sum(abs(i - usual * max(1, round(i / usual))) <= EVENNESS * usual for i in intervals)
    return even >= EVEN_SHARE * len(intervals)


def _is_camera_rate(stamps: Sequence[int]) -> bool:
    """Return whether the mean rate, corrected for missing frames, is a common camera rate."""
    rate = _rate(stamps)
    return any(abs(rate / camera - 1.0) <= RATE_TOLERANCE for camera in CAMERA_HZ)


def _rate(stamps: Sequence[int]) -> float:
    """Return the mean rate, Hz, corrected for missing frames."""
    intervals = _intervals(stamps)
    usual = median(intervals)
    return sum(max(1, round(i / usual)) for i in intervals) / (sum(intervals) / NS_PER_S)


def _could_be_counter(counts: Sequence[int]) -> bool:
    """Return whether integers may be image numbers: round steps, some left out."""
    steps = _intervals(counts)
    step = math.gcd(*steps)
    if step == 1:
        return min(steps) == 1
    return step < COUNTED_BY or (step < NEVER_COUNTED_BY and step % COUNTED_BY == 0)
