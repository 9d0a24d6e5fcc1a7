"""Trackers' states as arrays by name, and back: for checkpoints, model files and second passes.

A codec is put together of small ones, as the state is: ``Value`` is one array or number, ``Fields`` an object
of several, ``Maybe`` what may be None, ``Stacked`` objects alike of which each array is one row, ``Numbered``
objects that differ in length. ``codec_of`` makes that of a class whose fields state their layouts. Each says
what its arrays must be (``results.columns``): those of a stranger are refused before anything is made of
them. The laws that tests hold every codec to:

    from_arrays(to_arrays(x)) equals x;    to_arrays(from_arrays(a)) equals a, bit by bit.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from types import NoneType
from typing import Annotated, Any, Generic, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from posetrack_cli.results.columns import (
    COUNTS,
    FLAGS,
    STAMPS_NS,
    Arrays,
    Layout,
    Range,
    check_arrays,
    floats,
)

T = TypeVar("T")
Array: TypeAlias = np.ndarray[Any, Any]
Part: TypeAlias = "Codec[Any] | tuple[str | Callable[[Any], Any], Codec[Any]]"
"""The codec of the attribute of that name; or an attribute's path, or a function, and the codec of that."""


class Codec(ABC, Generic[T]):
    """How values of one type become arrays by name, and arrays become values.

    The one array of a value that has no more is called "".
    """

    @abstractmethod
    def to_arrays(self, value: T) -> dict[str, Array]:
        """Return the arrays of a value, by name."""

    @abstractmethod
    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return what the arrays of a value must be, given which there are.

        Raises:
            LayoutError: they say wrongly how many things there are.
        """

    @abstractmethod
    def build(self, arrays: Arrays) -> T:
        """Return the value of arrays that are as its layout states."""

    def from_arrays(self, arrays: Arrays) -> T:
        """Return the value that ``to_arrays`` made these of.

        Raises:
            LayoutError: they are of no such value.
        """
        check_arrays(arrays, self.layouts(arrays))
        return self.build(arrays)


class Value(Codec[T]):
    """One array, or a number as an array of no dimension.

    Args:
        layout: what it must be.
        make: the value of an array; by default the array itself.
    """

    def __init__(self, layout: Layout, make: Callable[[Array], T] | None = None) -> None:
        self._layout, self._make = layout, make

    def to_arrays(self, value: T) -> dict[str, Array]:
        """Return the one array."""
        return {"": np.asarray(value, dtype=self._layout.dtype)}

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the one layout."""
        return {"": self._layout}

    def build(self, arrays: Arrays) -> T:
        """Return the array, or the number that it holds."""
        made: T = arrays[""] if self._make is None else self._make(arrays[""])  # type: ignore[assignment]
        return made


def whole(within: Range = COUNTS) -> Value[int]:
    """Return the codec of a whole number."""
    return Value(Layout("int64", (), *within), int)


def stamp() -> Value[int]:
    """Return the codec of a time, ns."""
    return whole(STAMPS_NS)


def flag() -> Value[bool]:
    """Return the codec of what is so or not."""
    return Value(Layout("int64", (), *FLAGS), bool)


def real(layout: Layout | None = None) -> Value[float]:
    """Return the codec of a number of double precision, any finite one or as a layout says."""
    return Value(layout or floats(), float)


class Fields(Codec[T]):
    """An object of several parts, each under a name of its own.

    Args:
        make: makes the object, given its parts by name; LayoutError for parts that do not fit each other.
        parts: how each is taken and encoded.
    """

    def __init__(self, make: Callable[..., T], /, **parts: Part) -> None:
        self._make = make
        named = {name: part if isinstance(part, tuple) else (name, part) for name, part in parts.items()}
        self._parts = {
            name: (attrgetter(take) if isinstance(take, str) else take, codec)
            for name, (take, codec) in named.items()
        }

    def to_arrays(self, value: T) -> dict[str, Array]:
        """Return the arrays of all parts, as ``part.array``."""
        return {
            joined(name, inner): array
            for name, (take, codec) in self._parts.items()
            for inner, array in codec.to_arrays(take(value)).items()
        }

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of all parts; lengths that two of them name alike are equal."""
        return {
            joined(name, inner): layout
            for name, (_, codec) in self._parts.items()
            for inner, layout in codec.layouts(part_of(arrays, name)).items()
        }

    def build(self, arrays: Arrays) -> T:
        """Return the object of its parts."""
        return self._make(
            **{name: codec.build(part_of(arrays, name)) for name, (_, codec) in self._parts.items()}
        )


class Maybe(Codec[T | None]):
    """What may be None: then there are no arrays.

    Args:
        codec: of what it is otherwise; it must always have arrays.
    """

    def __init__(self, codec: Codec[T]) -> None:
        self._codec = codec

    def to_arrays(self, value: T | None) -> dict[str, Array]:
        """Return no arrays of None."""
        return {} if value is None else self._codec.to_arrays(value)

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return no layouts if there are no arrays."""
        return self._codec.layouts(arrays) if arrays else {}

    def build(self, arrays: Arrays) -> T | None:
        """Return None if there are no arrays."""
        return self._codec.build(arrays) if arrays else None


class Stacked(Codec[tuple[T, ...]]):
    """Objects alike, each array of theirs as one array with a row for each; none has no arrays.

    Args:
        codec: of one object; its arrays have the same shapes in all of them.
        rows: how many there are, if that is known, or a name of it.
        least: how many there are at least.
    """

    def __init__(self, codec: Codec[T], rows: int | str, least: int = 0) -> None:
        self._codec, self._rows, self._least = codec, rows, least

    def to_arrays(self, value: Sequence[T]) -> dict[str, Array]:
        """Return the stacked arrays."""
        each = [self._codec.to_arrays(one) for one in value]
        return {name: np.stack([arrays[name] for arrays in each]) for name in (each[0] if each else ())}

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of one object, with a length more."""
        if not arrays and self._least == 0:
            return {}
        of_one = self._codec.layouts(self._row(arrays, 0))
        return {name: replace(layout, shape=(self._rows, *layout.shape)) for name, layout in of_one.items()}

    def build(self, arrays: Arrays) -> tuple[T, ...]:
        """Return an object for each row."""
        rows = len(next(iter(arrays.values()), ()))
        return tuple(self._codec.build(self._row(arrays, index)) for index in range(rows))

    def _row(self, arrays: Arrays, index: int) -> dict[str, Array]:
        """One object's arrays, of those that have so many rows."""
        return {name: array[index] for name, array in arrays.items() if array.ndim and len(array) > index}


class Numbered(Codec[tuple[T, ...]]):
    """Objects that differ in their lengths: each has arrays of its own, numbered; none has no arrays.

    Args:
        codec: of one object.
        counted: name of the array that says how many there are.
        called: what each is called, before its number.
        most: how many there may be.
    """

    def __init__(self, codec: Codec[T], *, counted: str, called: str, most: int) -> None:
        self._codec, self._counted, self._called = codec, counted, called
        self._count = Layout("int64", (), 0, most)

    def to_arrays(self, value: Sequence[T]) -> dict[str, Array]:
        """Return the arrays of all, and how many there are."""
        if not value:
            return {}
        arrays: dict[str, Array] = {self._counted: np.array(len(value))}
        for index, one in enumerate(value):
            own = self._codec.to_arrays(one)
            arrays |= {joined(self._name(index), name): array for name, array in own.items()}
        return arrays

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of all; lengths that are named alike in two of them may differ."""
        own = {name for name in arrays if name == self._counted or name.startswith(self._called)}
        if not own:
            return {}
        check_arrays(arrays, {self._counted: self._count})
        layouts = {self._counted: self._count}
        for index in range(int(arrays[self._counted])):
            called = self._name(index)
            of_one = self._codec.layouts(part_of(arrays, called))
            layouts |= {joined(called, name): layout.named(f"{called}.") for name, layout in of_one.items()}
        return layouts

    def build(self, arrays: Arrays) -> tuple[T, ...]:
        """Return as many objects as there are said to be."""
        count = int(arrays[self._counted]) if self._counted in arrays else 0
        return tuple(self._codec.build(part_of(arrays, self._name(index))) for index in range(count))

    def _name(self, index: int) -> str:
        return f"{self._called}{index}"


NOT_KEPT = object()
"""Annotates a field that a codec leaves out."""
_OF_TYPE: Mapping[Any, Callable[[], Codec[Any]]] = {int: whole, bool: flag, float: real}


def codec_of(kind: Callable[..., T], sizes: Mapping[str, int] | None = None, **given: Part) -> Codec[T]:
    """Return the codec of a dataclass or named tuple whose fields state what they are; see ``parts_of``."""
    return Fields(kind, **parts_of(kind, sizes, **given))


def parts_of(kind: Any, sizes: Mapping[str, int] | None = None, **given: Part) -> dict[str, Part]:
    """Return the codecs of the fields of a dataclass or named tuple, in their order.

    A field's type says what it is: a count, a flag, any finite number, an object of such fields, or one of
    these or None. ``Annotated[FloatArray, floats(3)]`` says it by a layout; there may also be a codec, or
    ``NOT_KEPT``.

    Args:
        kind: the class.
        sizes: lengths that layouts name.
        given: codecs of fields that cannot be told by their type.
    """

    def of(hint: Any) -> Codec[Any] | None:
        if hint in _OF_TYPE:
            return _OF_TYPE[hint]()
        inner = get_args(hint)
        if get_origin(hint) is Annotated:
            own, stated = inner
            if isinstance(stated, Layout):
                return Value(stated.sized(sizes or {}), own if own in _OF_TYPE else None)
            return stated if isinstance(stated, Codec) else None
        if not inner:
            return codec_of(hint, sizes)
        if inner[1:] != (NoneType,):
            raise TypeError(f"a field of {kind} as {hint} has no codec")
        known = of(inner[0])
        return None if known is None else Maybe(known)

    hints = get_type_hints(kind, include_extras=True)
    parts = {name: given[name] if name in given else of(hint) for name, hint in hints.items()}
    return {name: part for name, part in parts.items() if part is not None}


def joined(name: str, inner: str) -> str:
    """Return the name of an array of a part."""
    return f"{name}.{inner}" if inner else name


def part_of(arrays: Arrays, name: str) -> dict[str, Array]:
    """Return the arrays of a part, by their names in it."""
    start = f"{name}."
    inner = {full.removeprefix(start): array for full, array in arrays.items() if full.startswith(start)}
    return ({"": arrays[name]} if name in arrays else {}) | inner
