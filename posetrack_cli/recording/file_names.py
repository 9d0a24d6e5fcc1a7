"""Order and numbers of file names: 2 before 10, and which numbers of a sequence are missing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

DIGITS = re.compile(r"[0-9]+")
REGULAR_SHARE = 0.75
"""Smallest share of steps between numbers that are one frame; the other steps are gaps."""
FEWEST_NUMBERED = 4
"""Fewer names are not a sequence whose missing numbers mean anything."""
SHARED_SHARE = 0.5
"""Share of the numbers of one layout that the other layouts have, too."""
SHOWN_RANGES = 3
"""Ranges of missing numbers that a remark lists."""


def natural_key(name: str) -> tuple[str, str]:
    """Return a key that sorts numbers by value and all else by character: ``a2`` before ``a10``.

    A number becomes "0", its length and its digits without leading zeros, so it compares with other
    characters as its first digit would. Names with zero-padded numbers sort as they do by character.
    """
    return DIGITS.sub(_comparable, name), name


def natural_order(names: Sequence[str]) -> list[int]:
    """Return the positions of names in natural order.

    Names of one length that differ in more than their digits are hexadecimal or arbitrary (``1a``, ``10``);
    they are sorted by character.
    """
    by_character = sorted(range(len(names)), key=names.__getitem__)
    natural = sorted(range(len(names)), key=lambda i: natural_key(names[i]))
    if natural == by_character or (len({len(n) for n in names}) == 1 and not _has_one_layout(names)):
        return by_character
    return natural


def order_remark(names: Sequence[str]) -> tuple[str, ...]:
    """Return a remark if ordered names are not in the order of their characters."""
    for name, following in pairwise(names):
        if name > following:
            return (f"images are in the order of the numbers in their names: {name} before {following}",)
    return ()


def varying_numbers(names: Sequence[str]) -> list[tuple[int, ...]] | None:
    """Return for each name the numbers that differ between names, () if none; None if layouts differ."""
    if not _has_one_layout(names):
        return None
    columns = list(zip(*(DIGITS.findall(name) for name in names), strict=True))
    varying = [[number(text) for text in column] for column in columns if len(set(column)) > 1]
    return [tuple(column[i] for column in varying) for i in range(len(names))]


def number(digits: str) -> int:
    """Return the value of digits in a file name."""
    return int(digits)  # a name of a file has at most 255 bytes


@dataclass(frozen=True)
class NumberedSequence:
    """A sequence of images that are numbered.

    Attributes:
        positions: of each image, frames from the first one; more than its index after a gap.
        missing: first and last number of each range that no image has.
    """

    positions: tuple[int, ...]
    missing: tuple[tuple[int, int], ...]

    @property
    def words(self) -> str:
        """For people: ``number 5`` or ``numbers 5, 9 to 11``; at most some ranges."""
        shown = [str(a) if a == b else f"{a} to {b}" for a, b in self.missing[:SHOWN_RANGES]]
        more = ", ..." if len(self.missing) > SHOWN_RANGES else ""
        one = len(self.missing) == 1 and self.missing[0][0] == self.missing[0][1]
        return f"number{'' if one else 's'} {', '.join(shown)}{more}"


def numbered_sequence(names: Sequence[str]) -> NumberedSequence | None:
    """Return the sequence that the only varying number of ordered names counts, None if it has no gap.

    Most numbers are one step from the one before, the others a multiple of it, and no more numbers are
    missing than there are images.
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
    """Return the positions of names by layout if most numbers are there in several layouts, else {}.

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
    """Whether names differ in the values of their numbers only."""
    return len(set(map(layout, names))) == 1
