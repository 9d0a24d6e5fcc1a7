"""Stamps in file names: seconds, ms, us or ns, recognised by their magnitude and the rate they give.

A frame counter is never taken for stamps: what could be either is not recognised.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from statistics import median

from posetrack_cli.recording.file_names import DIGITS, natural_order, number
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.units import NS_PER_S

EARLIEST_S, LATEST_S = 10**9, 4 * 10**9
"""Seconds since 1970 of recordings: 2001 to 2096."""
UNITS = {"s": NS_PER_S, "ms": 10**6, "us": 10**3, "ns": 1}
"""Nanoseconds in one of each."""
FRACTIONS = (3, 6, 9)
"""Digits of a fraction of a second that stands alone: ms, us or ns."""
SHORTEST_NS = 500_000
"""Intervals are at least this long on average: 2000 Hz."""
CAMERA_HZ = (1, 2, 5, 6, 7.5, 10, 12, 12.5, 15, 20, 24, 25, 30, 48, 50, 60, 75, 90, 100, 120)
RATE_TOLERANCE = 0.02
"""Relative deviation of a mean rate from one of ``CAMERA_HZ``: those of consumer cameras stay within 1 %."""
FEWEST_RELATIVE = 6
"""Names with a clock that does not count from 1970."""
EVEN_SHARE, EVENNESS = 0.9, 0.2
"""Share of intervals that are a multiple of the usual one, within a part of it."""
COUNTED_BY = 1000
"""Nobody numbers images in steps that are larger and not a multiple."""
NEVER_COUNTED_BY = 10**6
SLOWEST_RELATIVE_NS, FASTEST_RELATIVE_NS = 2 * NS_PER_S, 2_000_000
"""Range of usual intervals of clocks that do not count from 1970: 0.5 to 500 Hz."""
LONGEST_RELATIVE_NS = 10 * NS_PER_S
"""Longest of their intervals: hours, minutes and seconds as one number would jump by 40 s and more."""
DATE_FORMAT, DATE_DIGITS, DATE_STARTS = "%Y%m%d%H%M%S", 14, (4, 8, 14, 17, 20)
"""Dates with times of day, and how many digits may begin them: of the year, the date, the second or less."""
SEPARATORS = re.compile(r"[._-]")


@dataclass(frozen=True)
class NameStamps:
    """Stamps that names hold.

    Attributes:
        unit: ``s``, ``ms``, ``us``, ``ns``, or ``dates``.
        stamps_ns: of each name.
        is_count: whether they are integers that do not count from 1970: only their rate shows that they are
            stamps.
    """

    unit: str
    stamps_ns: tuple[int, ...]
    is_count: bool = False

    @property
    def words(self) -> str:
        """For people: ``in s: 12 frames, 0.5 s, largest gap 0.133 s``."""
        ordered = sorted(self.stamps_ns)
        gap = max((b - a for a, b in pairwise(ordered)), default=0)
        seconds, gap_s = (ordered[-1] - ordered[0]) / NS_PER_S, gap / NS_PER_S
        return f"in {self.unit}: {len(ordered)} frames, {seconds:.4g} s, largest gap {gap_s:.3g} s"

    @property
    def rate_hz(self) -> float:
        """Mean rate without the frames that are missing; infinity for one stamp."""
        return _rate(self.stamps_ns) if len(self.stamps_ns) > 1 else math.inf

    def fit_rate(self, fps: float) -> bool:
        """Whether frame i has its stamp at i / fps, within half a frame of the middle deviation."""
        period = NS_PER_S / fps
        deviations = [stamp - i * period for i, stamp in enumerate(sorted(self.stamps_ns))]
        middle = median(deviations)
        return all(abs(deviation - middle) < 0.5 * period for deviation in deviations)


def order_of_names(names: Sequence[str], stems: Sequence[str]) -> list[int]:
    """Return the positions of names in order of the stamps that they hold, else in natural order."""
    stamps = stamps_in_names(stems)
    if stamps is None:
        return natural_order(names)
    return sorted(range(len(names)), key=lambda i: (stamps.stamps_ns[i], names[i]))


def stamps_in_names(stems: Sequence[str]) -> NameStamps | None:
    """Return the stamps that names without suffix hold, None if that is not certain.

    Names are of one layout: the same text between numbers. A stamp counts from 1970 (10 digits of seconds,
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


Reading = tuple[str, list[int], bool]
"""Unit, stamps, ns, and whether these are stamps."""


def _readings(columns: Sequence[tuple[str, ...]], separators: Sequence[str]) -> Iterator[Reading]:
    """Yield the stamps that numbers may be which count from 1970, dates, or decimal seconds."""
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
            yield "s", stamps, len(stamps) > 2 and _is_time(stamps, digit) and _is_usual(stamps)


def _count_readings(columns: Sequence[tuple[str, ...]]) -> Iterator[Reading]:
    """Yield the stamps that integers may be which do not count from 1970."""
    for column in columns:
        if len(column) < FEWEST_RELATIVE or _could_count(counts := [number(text) for text in column]):
            continue
        for unit, ns in list(UNITS.items())[1:]:
            stamps = [count * ns for count in counts]
            yield unit, stamps, _is_usual(stamps) and _is_camera_rate(stamps)


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
    """Yield the stamps that dates with times of day give, as of UTC: 20240131_120501_123 and the like."""
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
    """Whether numbers after seconds are a decimal fraction of them."""
    widths = set(map(len, column))
    return separator == "." or (separator in ("_", "-") and len(widths) == 1 and widths <= set(FRACTIONS))


def _date_seconds(digits: str) -> int | None:
    """Return the seconds since 1970 of year, month, day, hour, minute, second; None if not a date."""
    try:
        moment = datetime.strptime(digits[:DATE_DIGITS], DATE_FORMAT).replace(tzinfo=UTC)
    except ValueError:
        return None
    seconds = round(moment.timestamp())
    return seconds if EARLIEST_S <= seconds < LATEST_S else None


def _is_epoch(column: Sequence[str], ns: int) -> bool:
    """Whether all are counts of units of so many ns since 1970, in the years of recordings."""
    scale = NS_PER_S // ns
    return all(EARLIEST_S * scale <= number(text) < LATEST_S * scale for text in column)


def _with_fraction(whole: Sequence[str], fraction: Sequence[str], separator: str) -> Iterator[list[int]]:
    """Yield the stamps, ns, that seconds and what follows them give, the likelier first.

    Fractions of different lengths are decimals whose zeros were cut off, or counts without leading zeros.
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
    """Return the mean deviation of intervals from the usual one, as a part of it."""
    intervals = _intervals(stamps)
    usual = median(intervals) if intervals else 0
    return sum(abs(i - usual) for i in intervals) / (usual * len(intervals)) if usual else math.inf


def _is_time(stamps: Sequence[int], digit_ns: int) -> bool:
    """Whether stamps are of a rate that cameras have, and do not count their last digit."""
    intervals = _intervals(stamps)
    return not intervals or (median(intervals) >= SHORTEST_NS and median(intervals) > digit_ns)


def _is_usual(stamps: Sequence[int]) -> bool:
    """Whether nearly all intervals are multiples of the usual one, which a camera could have."""
    intervals = _intervals(stamps)
    usual = median(intervals)
    if not FASTEST_RELATIVE_NS <= usual <= SLOWEST_RELATIVE_NS or max(intervals) > LONGEST_RELATIVE_NS:
        return False
    even = sum(abs(i - usual * max(1, round(i / usual))) <= EVENNESS * usual for i in intervals)
    return even >= EVEN_SHARE * len(intervals)


def _is_camera_rate(stamps: Sequence[int]) -> bool:
    """Whether the mean rate, without the frames that are missing, is one that cameras have."""
    rate = _rate(stamps)
    return any(abs(rate / camera - 1.0) <= RATE_TOLERANCE for camera in CAMERA_HZ)


def _rate(stamps: Sequence[int]) -> float:
    """Return how often stamps come, Hz, as if none were missing."""
    intervals = _intervals(stamps)
    usual = median(intervals)
    return sum(max(1, round(i / usual)) for i in intervals) / (sum(intervals) / NS_PER_S)


def _could_count(counts: Sequence[int]) -> bool:
    """Whether integers may number images: in steps that people choose, some left out."""
    steps = _intervals(counts)
    step = math.gcd(*steps)
    if step == 1:
        return min(steps) == 1
    return step < COUNTED_BY or (step < NEVER_COUNTED_BY and step % COUNTED_BY == 0)
