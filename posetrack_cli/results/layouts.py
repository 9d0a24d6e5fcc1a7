"""What the arrays and numbers of a file must be before anything is made of them.

A digest says that a file is as it was written, not that it was written by this program: it can be computed
by anyone. So each tracker states what its arrays are (``Layout``), and nothing is put together of others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

Arrays: TypeAlias = Mapping[str, np.ndarray[Any, Any]]
Range: TypeAlias = tuple[int, int]

LARGEST = 1e9
"""Of any length (mm), angle, rate or pixel that is kept; their squares and products are still numbers."""
STAMPS_NS: Range = (-(1 << 62), 1 << 62)
"""Differences of two stamps are whole numbers of 64 bits, too."""
FARTHEST = 1e140
"""Of pixels where points are thought to be, and of how they move: a lens sends points beyond it anywhere."""
COUNTS: Range = (0, 1 << 53)
"""Of frames and other things that are counted."""
FLAGS: Range = (0, 1)
_TOLERANCE = 1e-6


class LayoutError(ValueError):
    """Arrays or numbers that are not as stated; the text names the first of them."""


@dataclass(frozen=True)
class Layout:
    """What one array must be.

    Attributes:
        dtype: numpy's name of its type; ``str`` is text of any length.
        shape: lengths; a name stands for any length from 1 on that is the same wherever the name stands, and
            a name that ends in ``?`` for one that may be 0.
        least, most: of its values, or of those of each place of its last axis.
        missing: whether values may be NaN.
        unit: from where to where along its last axis there are vectors of length 1; None for nowhere.
        shares: whether its values add up to 1.
    """

    dtype: str
    shape: tuple[int | str, ...] = ()
    least: float | tuple[float, ...] = -LARGEST
    most: float = LARGEST
    missing: bool = False
    unit: tuple[int, int] | None = None
    shares: bool = False

    def named(self, prefix: str) -> Layout:
        """Return the layout with lengths of its own, whose names begin with a prefix."""
        shape = tuple(f"{prefix}{length}" if isinstance(length, str) else length for length in self.shape)
        return replace(self, shape=shape)


def floats(
    *shape: int | str,
    least: float | tuple[float, ...] = -LARGEST,
    most: float = LARGEST,
    missing: bool = False,
) -> Layout:
    """Return the layout of numbers of double precision."""
    return Layout("float64", shape, least, most, missing)


def places(*shape: int | str) -> Layout:
    """Return the layout of what is or moves on images; NaN where nothing is seen."""
    return floats(*shape, least=-FARTHEST, most=FARTHEST, missing=True)


def units(*shape: int | str) -> Layout:
    """Return the layout of unit vectors or quaternions."""
    return Layout("float64", shape, unit=(0, int(shape[-1])))


def stamps(*shape: int | str) -> Layout:
    """Return the layout of times, ns."""
    return Layout("int64", shape, *STAMPS_NS)


def counts(*shape: int | str, most: int = COUNTS[1]) -> Layout:
    """Return the layout of whole numbers from 0 on."""
    return Layout("int64", shape, COUNTS[0], most)


def group(prefix: str, layouts: Mapping[str, Layout], arrays: Iterable[str]) -> dict[str, Layout]:
    """Return layouts under names ``prefix.name``, if arrays have any such name; there are all or none."""
    start = f"{prefix}."
    if not any(name.startswith(start) for name in arrays):
        return {}
    return {f"{start}{name}": layout for name, layout in layouts.items()}


def check_arrays(arrays: Arrays, layouts: Mapping[str, Layout]) -> None:
    """Refuse arrays that are not as stated; those of other names are not looked at.

    Raises:
        LayoutError: one is missing, of another type or shape, or has a value that it cannot have.
    """
    lengths: dict[str, int] = {}
    for name, layout in layouts.items():
        if name not in arrays:
            raise LayoutError(f"no array '{name}'")
        array = arrays[name]
        kind = "str" if array.dtype.kind == "U" else array.dtype.name
        if kind != layout.dtype or not _fits(array.shape, layout.shape, lengths):
            wanted = ", ".join(str(lengths.get(str(length), length)) for length in layout.shape)
            raise LayoutError(f"'{name}' as {array.dtype} {array.shape}, not {layout.dtype} ({wanted})")
        if array.dtype.kind in "fiu":
            _check_values(name, array, layout)


def check_numbers(numbers: Any, ranges: Mapping[str, Range]) -> None:
    """Refuse whole numbers that are not as stated, or not numbers by name.

    Raises:
        LayoutError: one is missing, no whole number, or out of its range.
    """
    if not isinstance(numbers, Mapping):
        raise LayoutError(f"numbers as {type(numbers).__name__}")
    for name, (least, most) in ranges.items():
        if name not in numbers:
            raise LayoutError(f"no number '{name}'")
        value = numbers[name]
        if type(value) is not int or not least <= value <= most:
            found = value if type(value) is int else type(value).__name__
            wanted = least if least == most else f"{least} to {most}"
            raise LayoutError(f"'{name}' as {found}, not {wanted}")


def _fits(shape: tuple[int, ...], stated: tuple[int | str, ...], lengths: dict[str, int]) -> bool:
    """Whether a shape is the one stated; lengths that are met first are noted by name."""
    if len(shape) != len(stated):
        return False
    for length, wanted in zip(shape, stated, strict=True):
        if isinstance(wanted, str):
            if length == 0 and not wanted.endswith("?"):
                return False
            wanted = lengths.setdefault(wanted, length)
        if length != wanted:
            return False
    return True


def _check_values(name: str, array: np.ndarray[Any, Any], layout: Layout) -> None:
    inside = (array >= layout.least) & (array <= layout.most)
    if layout.missing:
        inside |= np.isnan(array)
    if not np.all(inside):
        wrong = array[~inside].flat[0]
        what = f"the value {wrong}" if np.isfinite(wrong) else "values that are not finite"
        raise LayoutError(f"'{name}' with {what}")
    if layout.unit is not None:
        lengths = np.linalg.norm(array[..., slice(*layout.unit)], axis=-1)
        if not np.all(np.abs(lengths - 1.0) <= _TOLERANCE):
            raise LayoutError(f"'{name}' with vectors that are not of length 1")
    if layout.shares and not abs(array.sum() - 1.0) <= _TOLERANCE:
        raise LayoutError(f"'{name}' with shares that do not add up to 1")
