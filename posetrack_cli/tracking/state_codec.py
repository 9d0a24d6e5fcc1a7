"""Codecs between tracker states and named arrays, for checkpoints, model files and second passes.

Codecs are composed like the states: ``Value`` is an array or number, ``Fields`` an object with several
parts, ``Maybe`` an optional value, ``Stacked`` equal-sized objects stored as rows of common arrays,
``Numbered`` objects of different sizes. ``codec_of`` derives the codec of a class whose fields declare
their layouts. Arrays are checked against these layouts (``results.columns``) before anything is built from
untrusted files. All codecs satisfy, and tests check:

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
"""Codec of the attribute with that name; or an attribute path or function, and the codec of its value."""


class Codec(ABC, Generic[T]):
    """Conversion between values of one type and named arrays.

    The only array of a single-array value is named "".
    """

    @abstractmethod
    def to_arrays(self, value: T) -> dict[str, Array]:
        """Return the arrays of a value, by name."""

    @abstractmethod
    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts that the given arrays must have.

        Raises:
            LayoutError: the arrays contain an invalid number of objects.
        """

    @abstractmethod
    def build(self, arrays: Arrays) -> T:
        """Return the value of arrays that match the layouts."""

    def from_arrays(self, arrays: Arrays) -> T:
        """Return the value of arrays created by ``to_arrays``.

        Raises:
            LayoutError: the arrays do not match the layouts.
        """
        check_arrays(arrays, self.layouts(arrays))
        return self.build(arrays)


class Value(Codec[T]):
    """Codec of one array, or of a number as a 0-d array.

    Args:
        layout: layout of the array.
        make: converts the array to the value; default: the array itself.
    """

    def __init__(self, layout: Layout, make: Callable[[Array], T] | None = None) -> None:
        self._layout, self._make = layout, make

    def to_arrays(self, value: T) -> dict[str, Array]:
        """Return the array."""
        return {"": np.asarray(value, dtype=self._layout.dtype)}

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layout."""
        return {"": self._layout}

    def build(self, arrays: Arrays) -> T:
        """Return the array or number."""
        made: T = arrays[""] if self._make is None else self._make(arrays[""])  # type: ignore[assignment]
        return made


def whole(within: Range = COUNTS) -> Value[int]:
    """Return the codec of an integer."""
    return Value(Layout("int64", (), *within), int)


def stamp() -> Value[int]:
    """Return the codec of a time, ns."""
    return whole(STAMPS_NS)


def flag() -> Value[bool]:
    """Return the codec of a boolean."""
    return Value(Layout("int64", (), *FLAGS), bool)


def real(layout: Layout | None = None) -> Value[float]:
    """Return the codec of a float, finite or as given by a layout."""
    return Value(layout or floats(), float)


class Fields(Codec[T]):
    """Codec of an object with several named parts.

    Args:
        make: creates the object from its parts by name; raises LayoutError for inconsistent parts.
        parts: source and codec of each part.
    """

    def __init__(self, make: Callable[..., T], /, **parts: Part) -> None:
        self._make = make
        named = {name: part if isinstance(part, tuple) else (name, part) for name, part in parts.items()}
        self._parts = {
            name: (attrgetter(take) if isinstance(take, str) else take, codec)
            for name, (take, codec) in named.items()
        }

    def to_arrays(self, value: T) -> dict[str, Array]:
        """Return the arrays of all parts, named ``part.array``."""
        return {
            joined(name, inner): array
            for name, (take, codec) in self._parts.items()
            for inner, array in codec.to_arrays(take(value)).items()
        }

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of all parts; lengths with the same name must be equal across parts."""
        return {
            joined(name, inner): layout
            for name, (_, codec) in self._parts.items()
            for inner, layout in codec.layouts(part_of(arrays, name)).items()
        }

    def build(self, arrays: Arrays) -> T:
        """Return the object built from its parts."""
        return self._make(
            **{name: codec.build(part_of(arrays, name)) for name, (_, codec) in self._parts.items()}
        )


class Maybe(Codec[T | None]):
    """Codec of an optional value; None has no arrays.

    Args:
        codec: codec of the value, which must always have arrays.
    """

    def __init__(self, codec: Codec[T]) -> None:
        self._codec = codec

    def to_arrays(self, value: T | None) -> dict[str, Array]:
        """Return the value's arrays, none for None."""
        return {} if value is None else self._codec.to_arrays(value)

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the value's layouts, none without arrays."""
        return self._codec.layouts(arrays) if arrays else {}

    def build(self, arrays: Arrays) -> T | None:
        """Return the value, None without arrays."""
        return self._codec.build(arrays) if arrays else None


class Stacked(Codec[tuple[T, ...]]):
    """Codec of equal-sized objects, with one row per object in each array; no objects have no arrays.

    Args:
        codec: codec of one object; array shapes are equal in all objects.
        rows: number of objects, or its name if it varies.
        least: minimum number of objects.
    """

    def __init__(self, codec: Codec[T], rows: int | str, least: int = 0) -> None:
        self._codec, self._rows, self._least = codec, rows, least

    def to_arrays(self, value: Sequence[T]) -> dict[str, Array]:
        """Return the stacked arrays."""
        each = [self._codec.to_arrays(one) for one in value]
        return {name: np.stack([arrays[name] for arrays in each]) for name in (each[0] if each else ())}

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of one object with an additional leading length."""
        if not arrays and self._least == 0:
            return {}
        of_one = self._codec.layouts(self._row(arrays, 0))
        return {name: replace(layout, shape=(self._rows, *layout.shape)) for name, layout in of_one.items()}

    def build(self, arrays: Arrays) -> tuple[T, ...]:
        """Return one object per row."""
        rows = len(next(iter(arrays.values()), ()))
        return tuple(self._codec.build(self._row(arrays, index)) for index in range(rows))

    def _row(self, arrays: Arrays, index: int) -> dict[str, Array]:
        """Return one object's arrays, skipping arrays without that row."""
        return {name: array[index] for name, array in arrays.items() if array.ndim and len(array) > index}


class Numbered(Codec[tuple[T, ...]]):
    """Codec of objects of different sizes, with numbered arrays for each; no objects have no arrays.

    Args:
        codec: codec of one object.
        counted: name of the array with the number of objects.
        called: name prefix of an object, followed by its number.
        most: maximum number of objects.
    """

    def __init__(self, codec: Codec[T], *, counted: str, called: str, most: int) -> None:
        self._codec, self._counted, self._called = codec, counted, called
        self._count = Layout("int64", (), 0, most)

    def to_arrays(self, value: Sequence[T]) -> dict[str, Array]:
        """Return the arrays of all objects, and their number."""
        if not value:
            return {}
        arrays: dict[str, Array] = {self._counted: np.array(len(value))}
        for index, one in enumerate(value):
            own = self._codec.to_arrays(one)
            arrays |= {joined(self._name(index), name): array for name, array in own.items()}
        return arrays

    def layouts(self, arrays: Arrays) -> dict[str, Layout]:
        """Return the layouts of all objects; lengths with the same name may differ between objects."""
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
        """Return as many objects as the count states."""
        count = int(arrays[self._counted]) if self._counted in arrays else 0
        return tuple(self._codec.build(part_of(arrays, self._name(index))) for index in range(count))

    def _name(self, index: int) -> str:
        return f"{self._called}{index}"


NOT_KEPT = object()
"""Annotation of a field that a codec omits."""
_OF_TYPE: Mapping[Any, Callable[[], Codec[Any]]] = {int: whole, bool: flag, float: real}


def codec_of(kind: Callable[..., T], sizes: Mapping[str, int] | None = None, **given: Part) -> Codec[T]:
    """Return the codec of a dataclass or named tuple whose fields declare their types; see ``parts_of``."""
    return Fields(kind, **parts_of(kind, sizes, **given))


def parts_of(kind: Any, sizes: Mapping[str, int] | None = None, **given: Part) -> dict[str, Part]:
    """Return the codecs of the fields of a dataclass or named tuple, in order.

    The field's type selects the codec: int (a count), bool, float (finite), a class of such fields, or any
    of these or None. ``Annotated[FloatArray, floats(3)]`` gives a layout; the annotation may also be a
    codec or ``NOT_KEPT``.

    Args:
        kind: the class.
        sizes: values of named lengths in layouts.
        given: codecs of fields whose type does not determine one.
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
            raise TypeError(f"no codec for a field of {kind} with type {hint}")
        known = of(inner[0])
        return None if known is None else Maybe(known)

    hints = get_type_hints(kind, include_extras=True)
    parts = {name: given[name] if name in given else of(hint) for name, hint in hints.items()}
    return {name: part for name, part in parts.items() if part is not None}


def joined(name: str, inner: str) -> str:
    """Return the name of a part's array."""
    return f"{name}.{inner}" if inner else name


def part_of(arrays: Arrays, name: str) -> dict[str, Array]:
    """Return the arrays of a part, by their names within it."""
    start = f"{name}."
    inner = {full.removeprefix(start): array for full, array in arrays.items() if full.startswith(start)}
    return ({"": arrays[name]} if name in arrays else {}) | inner
